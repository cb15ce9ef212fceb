"""The law of a plug-in flies within the limits, whatever it asks for, and fails in words."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from companion.avoidance import kernels as k
from companion.avoidance.law import Law, Neighbour, Situation, new_law
from companion.avoidance.plugin_law import PluginLaw, try_out
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from companion.errors import ConfigError
from tests.companion.avoidance.flown.flying import fly, polygon, room
from tests.support import plugged

LIMITS = LimitsConfig()
PATH = Trajectory([0.0, 100.0], [(0.0, 0.0, -50.0), (400.0, 0.0, -50.0)])
SQUARE = polygon(k.IN_POLYGON, (-60.0, -60.0), (-60.0, 60.0), (60.0, 60.0), (60.0, -60.0))
HOVERING = Neighbour(
    track_id="A", position_ned_m=(100.0, 0.0, -50.0), velocity_ned_mps=(0.0, 0.0, 0.0), age_s=0.0, sigma_m=1.0
)


@pytest.fixture(autouse=True)
def site(tmp_path, monkeypatch):
    """The laws of `plugged.LAWS`."""
    yield from plugged.installed(tmp_path, monkeypatch, "plugged_laws", plugged.laws)


def law(name, path=PATH, fence=None, limits=LIMITS):
    return new_law(AvoidanceConfig(law=name), limits, path, fence)


def test_who_asks_for_the_path_flies_as_without_avoidance():
    """Both begin at the path's velocity; the limits are kept by the same kernel."""
    mine = fly(law("follow"), 60.0, velocity=(4.0, 0.0, 0.0), hears=lambda now, p, v: (HOVERING,))
    none = fly(law("none"), 60.0, velocity=(4.0, 0.0, 0.0), hears=lambda now, p, v: (HOVERING,))
    assert np.abs(mine.position - none.position).max() < 1e-6
    assert [r.conflict for r in mine.results] == [r.conflict for r in none.results]
    assert any(r.conflict for r in mine.results)


def test_it_avoids():
    flown = fly(law("aside"), 60.0, velocity=(4.0, 0.0, 0.0), hears=lambda now, p, v: (HOVERING,))
    least = np.linalg.norm(flown.position - np.array(HOVERING.position_ned_m), axis=1).min()
    assert least > 10.0


@pytest.mark.parametrize(("other_m", "kept"), [(None, ["A"]), (250.0, ["B"]), (350.0, ["A", "B"])])
def test_those_that_press_are_left_out_while_another_is_near(other_m, kept):
    yielding = msgspec.structs.replace(HOVERING, yields=True, presses=True)
    others = [] if other_m is None else [
        Neighbour("B", (0.0, other_m + 50.0, -50.0), (0.0, -50.0, 0.0), 1.0, 1.0)
    ]  # fmt: skip
    made = law("aside")
    place = (0.0, 0.0, -50.0)
    found = made.decide(Situation(0.0, 0.0, place, (4.0, 0.0, 0.0), 1.0, (yielding, *others)))
    assert [view.track_id for view in found.tracks] == kept


@pytest.mark.parametrize("name", ["east", "down", "follow", "aside"])
def test_its_commands_obey_the_limits(name):
    made = law(name)
    assert isinstance(made, PluginLaw)
    flown = fly(made, 40.0, velocity=(4.0, 0.0, 0.0), hears=lambda now, p, v: (HOVERING,))
    chosen = np.array([r.chosen_ned_mps for r in flown.results])
    assert np.linalg.norm(chosen, axis=1).max() <= LIMITS.max_speed_mps
    assert chosen[:, 2].max() <= LIMITS.max_descent_mps
    change = np.linalg.norm(np.diff(chosen, axis=0), axis=1)
    assert change.max() <= LIMITS.max_acceleration_mps2 * 0.2 + 1e-9
    assert change.max() > 0.1, "it did manoeuvre"


def test_one_that_flies_out_of_the_fence_is_stopped_before_it():
    flown = fly(law("east", fence=SQUARE), 60.0)
    assert room(SQUARE, flown.position).min() > 0.0
    assert flown.position[:, 1].max() > 40.0
    assert "fence" in flown.results[-1].limits


def test_walls_that_are_added_later_are_kept_too():
    made = law("east")
    made.enclose(SQUARE)
    assert room(SQUARE, fly(made, 60.0).position).min() > 0.0


def test_floor_and_ceiling_are_kept():
    made, down = law("down"), -50.0
    for tick in range(300):
        now = 0.2 * tick
        view = Situation(now, now, (0.0, 0.0, down), (0.0, 0.0, 0.0), 1.0, (), floor_down_m=-30.0)
        found = made.decide(view)
        down += 0.2 * found.chosen_ned_mps[2]
    assert -31.0 < down < -30.0
    assert "descent or floor" in found.limits


def test_lowered_limits_apply_at_once():
    made = law("east")
    fly(made, 20.0)
    made.restrict(LimitsConfig(max_speed_mps=1.0))
    flown = fly(made, 40.0, start_s=20.0, velocity=(0.0, 5.0, 0.0))
    assert math.hypot(*flown.results[-1].chosen_ned_mps) <= 1.0


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("nan", "ValueError: (0, nan, 0) m/s is no velocity"),
        ("huge", "ValueError: (1e+300, 0, 0) m/s is no velocity"),
        ("two", "ValueError: not enough values to unpack"),
        ("words", "ValueError: could not convert string to float"),
        ("nothing", "TypeError: 'NoneType' object is not iterable"),
        ("exits", "SystemExit: 3"),
        ("cancelled", "GeneratorExit: cancelled"),
        ("unmade", "OSError: no weights"),
        ("clumsy", "AttributeError: 'tuple' object has no attribute 'clear'"),
    ],
)
def test_what_is_no_velocity_is_a_fault_and_a_command_that_brakes(name, cause):
    made = law(name)
    flown = fly(made, 20.0, velocity=(4.0, 0.0, 0.0), hears=lambda now, p, v: (HOVERING,))
    assert made.fault is not None
    assert made.fault.startswith(f'law "{name}" (plugged_laws:')
    assert cause in made.fault
    speeds = [math.hypot(*r.chosen_ned_mps) for r in flown.results]
    assert max(speeds) <= 4.0
    assert speeds[-1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", ["nan", "exits", "unmade"])
def test_it_is_tried_out_on_the_ground(name):
    with pytest.raises(ConfigError, match=f'law "{name}"'):
        try_out(AvoidanceConfig(law=name), LIMITS)
    try_out(AvoidanceConfig(law="aside"), LIMITS)


def test_ctrl_c_while_it_decides_is_no_fault_of_its():
    with pytest.raises(KeyboardInterrupt):
        fly(law("interrupted"), 1.0)


def test_a_law_of_our_own_has_no_fault():
    assert Law(AvoidanceConfig(), LIMITS, PATH).fault is None
