"""Hours of trouble, in small: the rules hold, they can be broken, and a seed is a flight."""

from __future__ import annotations

import dataclasses
import math
from itertools import product

import numpy as np
import pytest

from companion import ownship
from companion.authority.modes import OurModes
from companion.authority.table import HOLDING
from companion.events import Firmware
from companion.ownship import Ownship
from sitl_mocks import cli
from sitl_mocks.soak import BrokenRuleError, Soak, soak
from sitl_mocks.vehicle_manners import VehicleMode

SEEDS = {"guard": (1, 4), "fly": (1,)}
"""Trouble may leave no encounter to its end: the second has few troubles, and hands back."""


def fly(firmware, use, seed=1, hours=0.1):
    return soak(firmware, use, seed, hours)


@pytest.mark.parametrize(("firmware", "use"), list(product(Firmware, ("guard", "fly"))))
def test_no_rule_is_broken(firmware, use):
    told = [fly(firmware, use, seed) for seed in SEEDS[use]]
    assert all(one.taken > 0 for one in told)
    assert all(one.setpoints > 500 for one in told)
    assert all(sum(one.troubles.values()) > 3 for one in told)
    assert use == "fly" or any(one.given_back > 0 for one in told)


@pytest.mark.parametrize(
    ("where", "name", "broken", "seed", "words"),
    [
        (OurModes, "judge", lambda self, shown, now_s, held: None, 3, "after the pilot's mode was seen"),
        (Ownship, "unfit", lambda self, now_s, stale_after_s: None, 12, "a setpoint on a position"),
        (ownship, "in_mode", lambda beat, custom_mode: beat, 11, "after the pilot's mode was seen"),
    ],
)
def test_a_companion_that_breaks_a_rule_is_found(monkeypatch, where, name, broken, seed, words):
    """With seeds that come to it early."""
    monkeypatch.setattr(where, name, broken)
    with pytest.raises(BrokenRuleError, match=f"seed {seed}, at .*{words}"):
        fly(Firmware.PX4, "fly", seed, hours=0.3)


def test_a_seed_is_a_flight():
    one, other = (dataclasses.asdict(fly(Firmware.PX4, "guard", hours=0.03)) for _ in range(2))
    del one["memory_mb"], other["memory_mb"]
    assert one == other


def test_a_mode_that_is_flown_already_is_not_seen_when_the_pilot_selects_it():
    run = Soak(Firmware.PX4, "fly", np.random.default_rng(1))
    while run.vehicle.mode is not VehicleMode.MISSION or run.onboard.heart.state not in HOLDING:
        run.step()
    run._next_trouble_s = math.inf
    run._select(VehicleMode.MISSION)
    while run.vehicle.mode is VehicleMode.MISSION:
        run.step()
    for _ in range(100):
        run.step()
    assert run.onboard.heart.state in HOLDING


def test_hours_that_are_none_are_refused(capsys):
    assert cli.main(["soak", "--hours", "0"]) == 2
    assert "--hours: 0: allowed above 0 to 1000" in capsys.readouterr().err
