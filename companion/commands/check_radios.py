"""Findings of `companion check` about the radios, and about the choice of transports in flight."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Final

from companion.commands.preflight import Preflight
from companion.config import Config
from companion.errors import ConfigError
from companion.remote_id.transports import BLE4
from companion.runtime import clock
from companion.runtime.policy import judge_policy, without_choice
from companion.runtime.prepare import prepare
from companion.runtime.radios import Radios

_RADIO_S: Final = 2.5
"""How long a radio may take to become ready, s."""


def find_policy(config: Config, found: Preflight) -> None:
    """Check the policy. A flight replaces a bad one by a fixed legal set; before flight it is an error."""
    try:
        lines = judge_policy(config)
    except ConfigError as error:
        found.red("policy", str(error), "correct the file, or set atmc.policy")
    else:
        for line in lines or ["none: in flight the transports stay as set in [remote_id]"]:
            found.green("policy", line)


def find_radios(config: Config, found: Preflight) -> None:
    """Open the radios without sending, and report their state and what they would broadcast."""
    failed: list[str] = []
    radios = Radios(config, sending=False, failed=failed.append)
    try:
        end = clock.now_s() + _RADIO_S
        waits = config.has_radio and bool(radios.radios)
        while waits and clock.now_s() < end and not radios.health(clock.now_s()).ok:
            radios.events(clock.now_s())
            time.sleep(0.05)
        _judge_radios(config, radios, failed, found)
    finally:
        radios.close()


def _judge_radios(config: Config, radios: Radios, failed: Sequence[str], found: Preflight) -> None:
    health = radios.health(clock.now_s())
    # Watching without a radio may be intended. Flying without one requires law = "none" and is never ready.
    chosen = not config.has_radio and config.flight.use == "watch"
    for line in (*radios.lines(clock.now_s()), *failed) or (f"radio: {health.text}",):
        what, _, text = line.partition(": ")
        if line in failed:
            found.red(what, text, "docs/radios.md says what this backend needs")
        elif line.removeprefix("radio: ") in health.missing:
            found.yellow(what, text, "use another radio if you need what is missing")
        elif chosen:
            found.yellow(what, text, "configure a [[radio]] to broadcast and to receive Remote ID")
        elif health.ok:
            found.green(what, text)
        else:
            found.red(what, text, "docs/radios.md says what this backend needs")
    if failed:
        return
    stuck = without_choice(config, radios.capabilities) if config.has_radio else None
    if stuck is not None:
        found.yellow("policy", stuck, "use a radio that can send its transports, or another atmc.policy")
    try:
        prepared = prepare(config, radios)
    except ConfigError as error:
        what, _, text = str(error).partition(": ")
        found.red(what, text, "change [remote_id], or use a radio that can")
        return
    for line in prepared.lines:
        what, _, text = line.partition(": ")
        if prepared.legal:
            found.green(what, text)
        else:
            found.red(what, text, "change [remote_id], or use a radio that can")
    chosen_once = config.has_radio and config.atmc.policy is None
    if chosen_once and prepared.sent and BLE4 not in prepared.sent:
        found.yellow(
            "remote ID",
            "no BLE 4: where Wi-Fi is busy, others hear this aircraft late or not at all",
            'add "ble4" to remote_id.transports (docs/city-meaning.md has figures), or set atmc.policy',
        )
    if config.flight.use == "fly" and not config.has_radio:
        found.red(
            "radio",
            "none configured, and avoidance.law is none: no aircraft is heard or avoided",
            "configure a [[radio]]",
        )
