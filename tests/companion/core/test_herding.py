"""Forged traffic that tries to move the aircraft, through the whole core."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from companion.authority.table import State
from companion.config import ContainmentConfig, LimitsConfig
from companion.events import Firmware, FlightMode, VelocitySetpoint
from tests.companion.core.herding import (
    HOME_HEIGHT_M,
    UNBOUNDED,
    follower,
    helicopter,
    herded,
    sender,
    straight,
)

SMALL = ContainmentConfig(
    side_m=50.0, below_m=15.0, above_m=20.0, track_s=60.0, inside_s=25.0, total_s=90.0, group_s=80.0
)
"""Reached within a short test."""
ASIDE, BELOW, ABOVE = (0.0, -12.0, 0.0), (0.0, 0.0, 13.0), (0.0, 0.0, -13.0)
GIVING_BACK_S = 65.0
"""Longest time from the end of the last conflict until a guarded vehicle is given back where it is."""


def within(bench, config, slack_m=1.0):
    side, above, below = bench.off_m()
    assert side <= config.side_m + slack_m
    assert above <= config.above_m + slack_m
    assert below <= config.below_m + slack_m


@pytest.mark.parametrize("use", ["guard", "fly"])
def test_without_bounds_one_ghost_takes_the_aircraft_anywhere(use):
    """The attack that the other tests bound."""
    bench = herded(use, containment=UNBOUNDED).fly(100.0, sender("GHOST", follower(ASIDE)))
    assert bench.off_m()[0] > 350.0
    assert bench.held_s() > 95.0


@pytest.mark.parametrize("offset", [ASIDE, BELOW, ABOVE], ids=["aside", "up", "down"])
@pytest.mark.parametrize(("use", "firmware"), [("guard", Firmware.PX4), ("fly", Firmware.ARDUPILOT)])
def test_one_ghost_holds_the_aircraft_no_longer_and_takes_it_no_farther(use, firmware, offset):
    bench = herded(use, firmware, SMALL).fly(130.0, sender("GHOST", follower(offset)))
    within(bench, SMALL)
    assert ("track", True) in [(c.scope, c.spent) for c in bench.spent]
    assert any("GHOST has held us" in text and "not avoided any more" in text for text in bench.texts)
    # It is back on its way although the ghost is still beside it.
    assert abs(bench.place[1]) < 5.0
    assert abs(bench.place[2] + HOME_HEIGHT_M) < 5.0
    if use == "guard":
        assert bench.core.state is State.WATCHING
        assert bench.held_s() < SMALL.inside_s + GIVING_BACK_S


@pytest.mark.parametrize("firmware", Firmware)
def test_at_the_default_bounds_with_another_distance(firmware):
    config = ContainmentConfig()
    bench = herded("guard", firmware).fly(170.0, sender("GHOST", follower((0.0, 8.0, 3.0))))
    within(bench, config)
    assert bench.off_m()[0] > 100.0
    assert bench.core.state is State.WATCHING
    assert bench.held_s() < config.inside_s + GIVING_BACK_S


@pytest.mark.parametrize("use", ["guard", "fly"])
def test_new_names_gain_nothing(use):
    """A new identity every eight seconds, beside the aircraft; then every name comes from farther away."""

    def name(now_s):
        return f"G{int(now_s / 8.0)}"

    bench = herded(use, containment=SMALL).fly(110.0, sender(name, follower(ASIDE)))
    within(bench, SMALL)
    assert abs(bench.place[1]) < 5.0

    def coming(bench):
        since_s = bench.now_s % 20.0
        away = max(60.0 - 8.0 * since_s, 12.0)
        return bench.place + np.array([0.0, -away, 0.0]), bench.speed

    bench = herded(use, containment=SMALL)
    bench.fly(240.0, sender(lambda now_s: f"G{int(now_s / 20.0)}", coming))
    within(bench, SMALL)
    scopes = [c.scope for c in bench.spent]
    assert "low" in scopes
    if use == "guard":
        assert bench.held_s() < SMALL.total_s + GIVING_BACK_S


def test_a_fence_is_kept_and_no_reason_to_go_beyond_the_containment():
    limits = LimitsConfig(floor_height_m=45.0, ceiling_height_m=56.0)
    for offset in (BELOW, ABOVE):
        bench = herded("guard", containment=SMALL, limits=limits).fly(40.0, sender("GHOST", follower(offset)))
        _, above, below = bench.off_m()
        assert above <= 6.5
        assert below <= 5.5


@pytest.mark.parametrize("use", ["guard", "fly"])
@pytest.mark.parametrize("offset", [ASIDE, BELOW, (14.0, 0.0, 0.0)], ids=["aside", "up", "back"])
def test_an_honest_blind_aircraft_is_avoided_while_a_ghost_presses(use, offset):
    """It flies to where the ghost's pressing would have the aircraft."""
    ghost = sender("GHOST", follower(offset))
    bench = herded(use).fly(45.0, ghost)
    way, velocity = bench.speed.copy(), np.array([-5.0, 3.0, 0.0])
    start, since_s, before = bench.place + 22.0 * (way - velocity), bench.now_s, len(bench.way)
    bench.fly(35.0, ghost, sender("HONEST", straight(start, velocity, since_s)))
    own = np.array(bench.way[before:])
    times = 0.05 * np.arange(1, len(own) + 1)
    least = np.linalg.norm(own - start - times[:, None] * velocity, axis=1).min()
    assert least > 10.0


@pytest.mark.parametrize("use", ["guard", "fly"])
@pytest.mark.parametrize("renamed_s", [1000.0, 5.0])
@pytest.mark.parametrize("closing_mps", [0.0, 2.0, 5.0])
def test_a_ghost_does_not_push_the_aircraft_into_one_that_flies_beside(use, renamed_s, closing_mps):
    """It appears on the other side, and may seem to come nearer all the time."""
    bench, way = herded(use), np.array([3.0, 0.0, 0.0])
    start, since_s = bench.place + np.array([0.0, 50.0, 0.0]), bench.now_s
    honest = sender("HONEST", straight(start, way, since_s))
    bench.fly(5.0, honest)

    def ghost(bench):
        return bench.place - np.array([0.0, 18.0, 0.0]), bench.speed + np.array([0.0, closing_mps, 0.0])

    bench.fly(27.0, honest, sender(lambda now_s: f"G{int(now_s / renamed_s)}", ghost))
    times = 0.05 * np.arange(1, len(bench.way) + 1)
    least = np.linalg.norm(np.array(bench.way) - start - times[:, None] * way, axis=1).min()
    assert least > 20.0
    within(bench, ContainmentConfig())
    assert any(c.scope == "squeeze" for c in bench.spent)


class RealFollower:
    """A real aircraft that flies after this one with a lag, until it stops doing so and flies straight on."""

    def __init__(self, bench, offset, stops_s):
        self.place, self.speed = bench.place + np.array(offset), bench.speed.copy()
        self.offset, self.stops_s = np.array(offset), bench.now_s + stops_s
        self.way = []

    def __call__(self, bench):
        if bench.now_s < self.stops_s:
            self.speed = bench.speed + 0.4 * (bench.place + self.offset - self.place)
        self.way.append(self.place)
        self.place = self.place + 0.5 * self.speed
        return self.way[-1], self.speed


@pytest.mark.parametrize("use", ["guard", "fly"])
@pytest.mark.parametrize("stops_s", [8.0, 14.0, 100.0])
def test_a_real_follower_is_not_flown_into_while_another_is_beside(use, stops_s):
    bench, way = herded(use), np.array([3.0, 0.0, 0.0])
    start, since_s = bench.place + np.array([0.0, 45.0, 0.0]), bench.now_s
    follower_ = RealFollower(bench, (0.0, -18.0, 0.0), stops_s)
    bench.fly(40.0, sender("BESIDE", straight(start, way, since_s)), sender("FOLLOWS", follower_))
    own = np.array(bench.way)
    times = 0.05 * np.arange(1, len(own) + 1)
    assert np.linalg.norm(own - start - times[:, None] * way, axis=1).min() > 10.0
    # Sampled when it sends, before our step.
    assert min(map(math.dist, own[9::10], follower_.way[1:])) > 10.0


def test_an_honest_blind_aircraft_is_avoided_after_the_ghost_has_spent_everything_it_had():
    ghost = sender("GHOST", follower(ASIDE))
    config = msgspec.structs.replace(SMALL, total_s=200.0)
    bench = herded("guard", containment=config).fly(100.0, ghost)
    assert bench.core.state is State.WATCHING
    velocity = np.array([-5.0, 0.0, 0.0])
    start, since_s, before = bench.place + 25.0 * (bench.speed - velocity), bench.now_s, len(bench.way)
    bench.fly(40.0, ghost, sender("HONEST", straight(start, velocity, since_s)))
    own = np.array(bench.way[before:])
    times = 0.05 * np.arange(1, len(own) + 1)
    assert np.linalg.norm(own - start - times[:, None] * velocity, axis=1).min() > 10.0
    assert any(bench.held[before:])


@pytest.mark.parametrize("firmware", Firmware)
def test_one_that_hovers_where_the_mission_leads_is_never_flown_into_then_the_vehicle_holds(firmware):
    config = ContainmentConfig(track_s=30.0, inside_s=20.0, total_s=60.0)
    hovering = np.array([120.0, 0.0, -HOME_HEIGHT_M])
    bench = herded("guard", firmware, config, length_m=120.0)
    bench.fly(150.0, sender("HOVERS", straight(hovering, (0.0, 0.0, 0.0))))
    assert min(math.dist(place, hovering) for place in bench.way) > 10.0
    assert bench.core.state is State.YIELDED
    assert bench.mode is FlightMode.HOLD
    assert (
        bench.texts.count(
            "DMUCA yielded: unproven traffic has held us for 60 s: HOVERS: the vehicle is asked to hold"
        )
        == 1
    )
    after = [t for t, c in bench.log if isinstance(c, VelocitySetpoint)]
    assert max(after) < bench.now_s - 20.0


def test_with_then_hold_the_vehicle_holds_when_the_total_is_spent():
    config = ContainmentConfig(total_s=20.0, then="hold")
    bench = herded("guard", containment=config).fly(40.0, sender("GHOST", follower(ASIDE)))
    assert bench.core.state is State.YIELDED
    assert bench.mode is FlightMode.HOLD
    assert bench.held_s() < 22.0


@pytest.mark.parametrize("geometric", [True, False], ids=["height", "pressure altitude"])
@pytest.mark.parametrize("use", ["guard", "fly"])
def test_a_ghost_helicopter_moves_the_aircraft_within_its_own_containment(use, geometric):
    config = ContainmentConfig(crewed_side_m=200.0, crewed_above_m=40.0, crewed_total_s=75.0)
    ghost = helicopter(follower((0.0, -90.0, 20.0)), geometric=geometric)
    bench = herded(use, containment=config).fly(90.0, ghost)
    side, above, below = bench.off_m()
    assert 100.0 < side <= 201.0
    assert above <= 41.0
    assert below <= HOME_HEIGHT_M - 15.0 + 1.0
    assert bench.core.state is State.YIELDED
    assert bench.mode is FlightMode.HOLD
    assert any("crewed traffic has held us for 75 s" in text for text in bench.texts)


def test_a_helicopter_may_press_down_to_the_floor_and_the_way_back_is_flown():
    """Below the other volume's floor when the helicopter has gone."""
    above = helicopter(straight((60.0, 0.0, -105.0), (0.0, 0.0, 0.0)), geometric=True)
    bench = herded("guard").fly(60.0, above)
    _, _, below = bench.off_m()
    assert 31.0 < below <= HOME_HEIGHT_M - 15.0 + 1.0
    bench.fly(70.0)
    assert bench.core.state is State.WATCHING
    assert abs(bench.place[2] + HOME_HEIGHT_M) < 5.0


@pytest.mark.parametrize("use", ["guard", "fly"])
def test_an_honest_encounter_is_flown_as_without_bounds(use):
    """Command by command."""
    commands = []
    for config in (UNBOUNDED, None):
        bench = herded(use, containment=config)
        start = np.array([bench.place[0] + 150.0, 4.0, -52.0])
        bench.fly(60.0, sender("HONEST", straight(start, (-4.0, 0.0, 0.0), bench.now_s)))
        commands.append(bench.log)
        assert any(bench.held)
        assert not bench.spent
    assert commands[0] == commands[1]
