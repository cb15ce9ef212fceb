"""Checks of a configuration that involve several keys, or the form of a text."""

from __future__ import annotations

from companion import plugins
from companion.address_forms import LINK_FORMS, check_form, used_by
from companion.config.identity_checks import check_identity
from companion.config.sections import Config, policy_plugin
from companion.errors import ConfigError
from companion.geofence import check_areas
from companion.laws import LAWS, kind_of, plugin_of
from companion.radio.registry import RadioConfig
from companion.remote_id.drip.trust import Trust

_LONGEST_NAME = 100


def check(config: Config, name: str) -> None:
    """Check a whole configuration for combinations and texts that are not allowed.

    Args:
        name: name of the file, for messages.

    Raises:
        ConfigError: names the file and the keys, and what is allowed.
    """
    try:
        Trust(config.traffic.keys, config.traffic.anchors)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from error
    try:
        check_identity(config.identity, config.remote_id, config.region)
    except ValueError as error:
        raise ConfigError(f"{name}: {error}") from error
    try:
        plugin_of(config.avoidance.law)
    except ConfigError as error:
        raise ConfigError(f"{name}: avoidance.law: {error}") from error
    policy = policy_plugin(config.atmc.policy)
    if policy is not None:
        try:
            plugins.load(plugins.POLICIES, policy)
        except ConfigError as error:
            raise ConfigError(f"{name}: atmc.policy: {error}") from error
    _check_flight(config, name)
    _check_limits(config, name)
    use = config.flight.use
    if use != "watch" and not config.has_radio and kind_of(config.avoidance.law).avoids:
        otherwise = ', or avoidance.law = "none"' if use == "fly" else ""
        raise ConfigError(
            f"{name}: radio: none configured, so no aircraft is heard; "
            f'use = "{use}" needs a [[radio]]{otherwise}'
        )
    if config.remote_id.signing is not None and config.has_radio and not any(map(_signs, config.radio)):
        raise ConfigError(
            f"{name}: remote_id.signing: no [[radio]] sends signatures; a module that repeats messages at "
            "its own rates leaves them out"
        )
    if config.remote_id.component and config.vehicle.component_id == 236:
        raise ConfigError(f"{name}: vehicle.component_id: 236 is used by remote_id.component; choose another")
    run = config.record.name
    if not (run.isprintable() and 0 < len(run) <= _LONGEST_NAME and "/" not in run):
        raise ConfigError(
            f"{name}: record.name: {run!r}: allowed: 1 to {_LONGEST_NAME} printable characters without /"
        )
    check_form(config.vehicle.link, LINK_FORMS, f"{name}: vehicle.link")
    for number, entry in enumerate(config.radio):
        entry.check(f"{name}: radio[{number}]")
    _check_shared(config, name)
    senders = [entry for entry in config.radio if entry.sends]
    unfit = [entry.unfit_for(config.identity.uas_id) for entry in senders]
    if unfit and all(unfit):
        raise ConfigError(f"{name}: identity.uas_id: no [[radio]] can broadcast it: {unfit[0]}")


def _check_shared(config: Config, name: str) -> None:
    """Check that the vehicle's link and every radio have a device or address of their own."""
    users = {used_by(config.vehicle.link): "vehicle.link"}
    for number, entry in enumerate(config.radio):
        own = entry.uses()
        for key, used in own.items():
            if used in users:
                raise ConfigError(
                    f"{name}: radio[{number}].{key}: {getattr(entry, key)!r}: {users[used]} uses it, too; "
                    "each needs its own"
                )
        users |= {used: f"radio[{number}].{key}" for key, used in own.items()}


def _check_flight(config: Config, name: str) -> None:
    """Check that what is to be flown is given, and that a guarding law avoids."""
    flight, law = config.flight, kind_of(config.avoidance.law)
    if flight.use == "guard" and (flight.trajectory is not None or config.path is not None):
        raise ConfigError(
            f'{name}: flight.trajectory: remove it; use = "guard" guards the mission that the vehicle flies'
        )
    if flight.use == "guard" and not law.avoids:
        raise ConfigError(
            f'{name}: avoidance.law: "{config.avoidance.law}" avoids no aircraft; use = "guard" needs a law '
            "that does"
        )
    if flight.use == "fly" and flight.trajectory is None and config.path is None:
        raise ConfigError(f'{name}: flight.trajectory: missing; use = "fly" needs a file or "mission"')
    if flight.trajectory == "mission" and flight.mission_speed_mps is None:
        raise ConfigError(f'{name}: flight.mission_speed_mps: missing; trajectory = "mission" needs it')
    if flight.start == "utc" and flight.start_utc_s is None:
        raise ConfigError(f'{name}: flight.start_utc_s: missing; start = "utc" needs it (Unix seconds)')
    speed = flight.mission_speed_mps
    if speed is not None and speed > config.limits.max_speed_mps:
        raise ConfigError(
            f"{name}: flight.mission_speed_mps: {speed:g} is above limits.max_speed_mps "
            f"{config.limits.max_speed_mps:g}"
        )


def _check_limits(config: Config, name: str) -> None:
    """Check the fence, the floor and the ceiling."""
    limits = config.limits
    if limits.fence is not None and not kind_of(config.avoidance.law).keeps_fence:
        keeping = " or ".join(f'"{key}"' for key, kind in LAWS.items() if kind.keeps_fence)
        raise ConfigError(
            f"{name}: limits.fence: needs avoidance.law = {keeping}; {config.avoidance.law!r} keeps no fence"
        )
    try:
        check_areas(config.fence)
    except ConfigError as error:
        raise ConfigError(f"{name}: fence: {error}") from error
    floor, ceiling = limits.floor_height_m, limits.ceiling_height_m
    # Without a configured floor, the default one lies below every ceiling, even below the ground.
    if floor is None and ceiling is not None and ceiling < 5.0:
        raise ConfigError(
            f"{name}: limits.ceiling_height_m: {ceiling:g}: allowed: 5 to 10000; where aircraft fly below "
            "home, set floor_height_m as well"
        )
    if floor is not None and ceiling is not None and ceiling - floor < 5.0:
        raise ConfigError(
            f"{name}: limits.ceiling_height_m: {ceiling:g} must be 5 m or more above floor_height_m {floor:g}"
        )


def _signs(radio: RadioConfig) -> bool:
    """Whether a radio sends every broadcast that it is given."""
    return radio.sends and radio.at_own_rates is None
