"""`companion check`: validate, probe the link and the radio, say in plain words what is missing."""

from __future__ import annotations

import time
from collections.abc import Callable

from companion.autopilot.link import AutopilotLink
from companion.avoidance.path import check_path
from companion.config import Config
from companion.remote_id.broadcaster import asked_rates
from companion.remote_id.identity import check_identity
from companion.remote_id.law import keep_floor, longest_period_s, too_slow
from companion.runtime.kept_link import KeptLink
from companion.runtime.radios import Radios

_RADIO_S = 2.5


def check(config: Config, say: Callable[[str], None]) -> int:
    """Probe what the configuration names. Returns 0 when all is there, 1 otherwise.

    Raises:
        ConfigError: the link or the radio cannot be opened.
    """
    check_path(config, "configuration")
    say(f"configuration: valid; region {config.region.name}")
    for note in check_identity(config.identity, config.remote_id, config.region):
        say(f"configuration: {note}")
    vehicle = _probe_link(config, say)
    radio = _probe_radio(config, say)
    say("check: ready" if vehicle and radio else "check: NOT ready")
    return 0 if vehicle and radio else 1


def _probe_link(config: Config, say: Callable[[str], None]) -> bool:
    link = KeptLink(config.vehicle.link, say)
    protocol = AutopilotLink(config.vehicle)
    end = time.monotonic() + config.vehicle.wait_s
    try:
        while (now := time.monotonic()) < end and protocol.vehicle is None:
            link.wait(0.1)
            protocol.receive(link.receive(now), now)
            protocol.advance(now)
            link.send(protocol.drain())
    finally:
        link.close()
    if protocol.vehicle is None:
        say(f"vehicle: {config.vehicle.link}: no vehicle within {config.vehicle.wait_s:g} s")
        return False
    say(f"vehicle: {protocol.vehicle}")
    return protocol.vehicle.refusal is None


def _probe_radio(config: Config, say: Callable[[str], None]) -> bool:
    radio = Radios(config, sending=False)
    try:
        end = time.monotonic() + _RADIO_S
        while time.monotonic() < end and not radio.health(time.monotonic()).ok:
            radio.events(time.monotonic())
            time.sleep(0.05)
        health = radio.health(time.monotonic())
        say(f"radio: {health.text}")
        for text in health.missing:
            say(f"radio: {text}")
        decided = keep_floor(asked_rates(config), config.region, health.can_send)
        if config.has_radio or not decided.legal:
            rates = ", ".join(f"{t} {rate}/s" for t, rate in decided.rates.items()) or "nothing"
            say(f"remote ID: {rates}" + (f" ({decided.reason})" if decided.reason else ""))
        channel = radio.state(time.monotonic()).wifi_channel
        longest_s = longest_period_s(config.region, "wifi", channel)
        if longest_s is not None and 0.0 < decided.rates.get("wifi", 0) * longest_s < 1.0:
            say(f"remote ID: on channel {channel} a beacon every {longest_s:g} s at least, whatever is asked")
        slow = too_slow(decided.rates, config.region, channel, config.flight.setpoint_rate_hz)
        if slow is not None:
            say(f"remote ID: {slow}")
            return False
        if not decided.legal or (config.has_radio and not decided.rates):
            return False
        # To watch without a radio is a choice; to fly without one is refused by the configuration.
        return health.ok or (not config.has_radio and config.flight.use == "watch")
    finally:
        radio.close()
