"""`companion check`: validate, probe the radios and the link, say in plain words what is missing."""

from __future__ import annotations

import time
from collections.abc import Callable

from companion.autopilot.dialect import impossible_rearm
from companion.autopilot.link import AutopilotLink
from companion.avoidance.path import check_path
from companion.config import ArduRemoteIdRadio, Config
from companion.errors import ConfigError
from companion.remote_id.identity import check_identity
from companion.runtime.kept_link import KeptLink
from companion.runtime.policy import judge_policy
from companion.runtime.prepare import prepare
from companion.runtime.radios import Radios

_RADIO_S = 2.5


def check(config: Config, say: Callable[[str], None]) -> int:
    """Probe what the configuration names. Returns 0 when all is there, 1 otherwise.

    Raises:
        ConfigError: the path cannot be flown, or the link not be opened.
    """
    check_path(config, "configuration")
    say(f"configuration: valid; region {config.region.name}")
    for note in check_identity(config.identity, config.remote_id, config.region):
        say(f"configuration: {note}")
    policy = _probe_policy(config, say)
    radios = _probe_radios(config, say)
    vehicle = _probe_link(config, say)
    ready = policy and vehicle and radios
    say("check: ready" if ready else "check: NOT ready")
    return 0 if ready else 1


def _probe_policy(config: Config, say: Callable[[str], None]) -> bool:
    """In flight a policy that fails is replaced by a fixed legal set; before it, it is to be put right."""
    try:
        for line in judge_policy(config):
            say(line)
    except ConfigError as error:
        say(str(error))
        return False
    return True


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
    for text in _module_of_another(config, protocol.vehicle.system_id):
        say(text)
    rearm = impossible_rearm(protocol.vehicle.firmware, config.flight)
    if rearm is not None:
        say(rearm)
    return protocol.vehicle.refusal is None and rearm is None


def _module_of_another(config: Config, system_id: int) -> list[str]:
    """Remote ID modules that are told to belong to another vehicle."""
    return [
        f"radio[{number}].system_id: {entry.system_id}, but the vehicle is system {system_id}: the module "
        f"takes the first system id that it hears for its own, and its ARM_STATUS then goes to vehicle "
        f"{entry.system_id}; set system_id = {system_id} and power-cycle the module"
        for number, entry in enumerate(config.radio)
        if isinstance(entry, ArduRemoteIdRadio) and entry.system_id != system_id
    ]


def _probe_radios(config: Config, say: Callable[[str], None]) -> bool:
    failed: list[str] = []
    radios = Radios(config, sending=False, failed=failed.append)
    try:
        end = time.monotonic() + _RADIO_S
        waits = config.has_radio and bool(radios.radios)
        while waits and time.monotonic() < end and not radios.health(time.monotonic()).ok:
            radios.events(time.monotonic())
            time.sleep(0.05)
        now = time.monotonic()
        for line in (*radios.lines(now), *failed) or (f"radio: {radios.health(now).text}",):
            say(line)
        if failed:
            return False
        prepared = prepare(config, radios)
        for line in prepared.lines:
            say(line)
        # To watch without a radio is a choice. To fly without one takes law = "none", and is never ready.
        if config.flight.use == "fly" and not config.has_radio:
            say("radio: flies without one (avoidance.law is none): nobody is heard, nobody is kept apart")
        works = radios.health(time.monotonic()).ok
        return prepared.legal and (works or (not config.has_radio and config.flight.use == "watch"))
    except ConfigError as error:
        say(str(error))
        return False
    finally:
        radios.close()
