"""Checks of a configuration that involve several keys, or the form of a text."""

from __future__ import annotations

from companion.config.identity_checks import check_identity
from companion.config.sections import ArduRemoteIdRadio, Config, EtherRadio, HciRadio, RadioConfig, WifiRadio
from companion.errors import ConfigError
from companion.geofence import check_areas
from companion.remote_id.authentication import Verifier

_LINK_FORMS = ("udpin:HOST:PORT", "udpout:HOST:PORT", "tcp:HOST:PORT", "serial:DEVICE:BAUD")
_CHANNEL_FORMS = ("user:NUMBER", "uart:DEVICE:BAUD", "tcp:HOST:PORT")
_NUMBERS = {"PORT": range(1, 1 << 16), "BAUD": range(1, 10**9), "NUMBER": range(0xFFFF)}


def check(config: Config, name: str) -> None:
    """Check a whole configuration for combinations and texts that are not allowed.

    Args:
        name: name of the file, for messages.

    Raises:
        ConfigError: names the file and the keys, and what is allowed.
    """
    try:
        Verifier(config.traffic.keys)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from error
    flight, limits = config.flight, config.limits
    try:
        check_identity(config.identity, config.remote_id, config.region)
    except ValueError as error:
        raise ConfigError(f"{name}: {error}") from error
    if flight.use == "guard" and (flight.trajectory is not None or config.path is not None):
        raise ConfigError(
            f'{name}: flight.trajectory: use = "guard" guards what the vehicle itself flies; leave it out'
        )
    if flight.use == "guard" and config.avoidance.law == "none":
        raise ConfigError(f'{name}: avoidance.law: "none" avoids nobody; use = "guard" needs another')
    if flight.use == "fly" and flight.trajectory is None and config.path is None:
        raise ConfigError(f'{name}: flight.trajectory: missing; use = "fly" needs a file or "mission"')
    if flight.trajectory == "mission" and flight.mission_speed_mps is None:
        raise ConfigError(f'{name}: flight.mission_speed_mps: missing; trajectory = "mission" needs it')
    if flight.start == "utc" and flight.start_utc_s is None:
        raise ConfigError(f'{name}: flight.start_utc_s: missing; start = "utc" needs it (Unix seconds)')
    speed = flight.mission_speed_mps
    if speed is not None and speed > limits.max_speed_mps:
        raise ConfigError(
            f"{name}: flight.mission_speed_mps: {speed:g} is above limits.max_speed_mps "
            f"{limits.max_speed_mps:g}"
        )
    if limits.fence is not None and config.avoidance.law != "dmuca":
        raise ConfigError(
            f'{name}: limits.fence: goes with avoidance.law = "dmuca"; {config.avoidance.law!r} keeps none'
        )
    try:
        check_areas(config.fence)
    except ConfigError as error:
        raise ConfigError(f"{name}: fence: {error}") from error
    floor, ceiling = limits.floor_height_m, limits.ceiling_height_m
    if floor is not None and ceiling is not None and ceiling - floor < 5.0:
        raise ConfigError(
            f"{name}: limits.ceiling_height_m: {ceiling:g} must be 5 m or more above floor_height_m {floor:g}"
        )
    if flight.use != "watch" and not config.has_radio and config.avoidance.law != "none":
        otherwise = ', or avoidance.law = "none"' if flight.use == "fly" else ""
        raise ConfigError(
            f'{name}: radio: none configured, so nobody is heard; use = "{flight.use}" needs a [[radio]]'
            f"{otherwise}"
        )
    if config.remote_id.component and config.vehicle.component_id == 236:
        raise ConfigError(f"{name}: vehicle.component_id: 236 is taken by remote_id.component")
    _check_form(config.vehicle.link, _LINK_FORMS, f"{name}: vehicle.link")
    for number, entry in enumerate(config.radio):
        _check_radio(entry, f"{name}: radio[{number}]")


def _check_radio(entry: RadioConfig, name: str) -> None:
    match entry:
        case EtherRadio():
            _check_form(entry.address, ("HOST:PORT",), f"{name}.address")
        case HciRadio():
            _check_form(entry.channel, _CHANNEL_FORMS, f"{name}.channel")
            if not (entry.send or entry.listen):
                raise ConfigError(f"{name}: send and listen are both false: it would do nothing")
        case WifiRadio():
            if entry.hostapd is entry.inject is entry.monitor is None:
                raise ConfigError(f"{name}: needs hostapd, inject or monitor")
            interface = (entry.hostapd or "").rpartition("/")[2]
            if entry.hostapd is not None and not 1 <= len(interface) <= 15:
                raise ConfigError(
                    f"{name}.hostapd: {entry.hostapd!r}: the path must end with the name of a network "
                    f"interface, 1 to 15 characters; {interface!r} has {len(interface)}"
                )
        case ArduRemoteIdRadio():
            _check_form(entry.link, _LINK_FORMS, f"{name}.link")


def _check_form(text: str, forms: tuple[str, ...], name: str) -> None:
    if not any(_has_form(text, form) for form in forms):
        allowed = " or ".join((", ".join(forms[:-1]), forms[-1])) if len(forms) > 1 else forms[0]
        raise ConfigError(f"{name}: {text!r}: allowed: {allowed}; PORT is 1 to 65535")


def _has_form(text: str, form: str) -> bool:
    """Whether a text has a form such as "tcp:HOST:PORT"."""
    start, _, number = text.rpartition(":")
    head, _, word = form.rpartition(":")
    kind = head.removesuffix("HOST").removesuffix("DEVICE")
    fits = start == head if kind == head else start.startswith(kind) and len(start) > len(kind)
    if not (fits and number.isascii() and number.isdigit() and len(number) < 10):
        return False
    # Listening on port 0 uses any free port.
    return int(number) in _NUMBERS[word] or (kind == "udpin:" and int(number) == 0)
