"""The timed path waits for an aircraft that has no speed in reserve to catch up with it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from companion.avoidance.law import Law, Neighbour, Situation
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from tests.companion.avoidance.flown.flying import Flight, Hears, fly

LIMITS = LimitsConfig()  # 5 m/s


def north(speed: float, seconds: float = 300.0) -> Trajectory:
    return Trajectory([0, seconds], [(0, 0, -50), (speed * seconds, 0, -50)])


def law(speed: float, name: Any = "dmuca", **keys: Any) -> Law:
    return Law(AvoidanceConfig(law=name, **keys), LIMITS, north(speed))


def standing(n: float, e: float = -3.0) -> Hears:
    """An aircraft that hovers beside the path."""
    return lambda now, p, v: [Neighbour("b", (n, e, -50.0), (0.0, 0.0, 0.0), 0.3, 1.0)]


def flown(one: Law, speed: float, until_s: float, hears: Hears, **keys: Any) -> Flight:
    return fly(one, until_s, start_s=20.0, velocity=(speed, 0.0, 0.0), hears=hears, **keys)


@pytest.mark.parametrize("seed", [None, 1])
def test_without_reserve_the_point_waits(seed: int | None) -> None:
    """After a detour it is back at the delayed point, which is late by what the detour has cost."""
    one = law(5.0)
    flight = flown(one, 5.0, 200.0, standing(300.0), sigma_m=1.0, seed=seed)
    aside = abs(flight.position[:, 1]).max()
    assert aside > 8.0
    assert one.late_s > 0.2
    end, now = flight.position[-1], flight.time_s[-1]
    assert math.dist(end, one.trajectory.position(now)) < 5.0
    lost_s = now - end[0] / 5.0
    assert one.late_s == pytest.approx(lost_s, abs=0.05 if seed is None else 1.0)
    before = flight.late_s[: round((27.0 - 20.0) / 0.2)]
    if seed is None:
        assert before.max() < 1e-9  # until it meets the other


def test_the_less_reserve_the_more_it_waits() -> None:
    late = [
        one.late_s
        for speed in (5.0, 4.9, 4.5)
        if flown(one := law(speed), speed, 200.0, standing(60.0 * speed))
    ]
    assert late[0] > late[1] == late[2] == 0.0


@pytest.mark.parametrize("speed", [2.0, 4.0])
def test_with_reserve_a_small_detour_delays_nothing(speed: float) -> None:
    one = law(speed)
    flight = flown(one, speed, 150.0, standing(60.0 * speed))
    assert abs(flight.position[:, 1]).max() > 8.0
    assert flight.late_s.max() == 0.0
    now = flight.time_s[-1]
    assert math.dist(flight.position[-1], north(speed).position(now)) < 1.0
    assert one.trajectory.start_s == 0.0


def test_what_the_reserve_makes_up_for_in_30_s_is_let_be() -> None:
    """At 4 m/s of 5 m/s: 30 m behind it catches up, farther behind the point waits until it is 30 m."""
    for behind, late in ((29.0, False), (31.0, True)):
        one = law(4.0)
        view = Situation(100.0, 100.0, (400.0 - behind, 0.0, -50.0), (4.0, 0.0, 0.0), 1.0)
        one.decide(view)
        again = Situation(100.2, 100.2, (400.8 - behind, 0.0, -50.0), (4.0, 0.0, 0.0), 1.0)
        one.decide(again)
        assert (one.late_s > 0.0) == late
        # 1 m too far: the point slows down by 1 m / 15 s, of its 4 m/s.
        assert one.late_s == pytest.approx(0.2 / 15.0 / 4.0 if late else 0.0, abs=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_the_delay_never_falls(seed: int) -> None:
    """Neither in a crowd, nor when it overtakes its point, nor after pauses."""
    rng = np.random.default_rng(seed)
    speed = float(rng.choice([2.0, 4.0, 5.0]))
    one, last, now = law(speed), 0.0, 30.0
    for _ in range(400):
        now += float(rng.choice([0.2, 0.2, 0.2, 0.0, 0.5, 3.0]))
        place = (speed * now + rng.uniform(-120, 120), rng.uniform(-20, 20), -50.0 + rng.uniform(-5, 5))
        others = [
            Neighbour(
                str(i), (place[0] + rng.uniform(-40, 40), rng.uniform(-40, 40), -50.0), (0, 0, 0), 0.5, 1.0
            )
            for i in range(rng.integers(0, 4))
        ]
        one.decide(Situation(now, now, place, tuple(rng.uniform(-2, 2, 3)), 1.0, others))
        assert last <= one.late_s < last + 1.0
        last = one.late_s
    assert last > 0.0


def test_the_delay_does_not_fall_when_the_clock_turns_back() -> None:
    one = law(5.0)
    late = []
    for now in (50.0, 50.2, 50.1, 49.0, 49.2):
        one.decide(Situation(now, 50.0, (100.0, 0.0, -50.0), (5.0, 0.0, 0.0), 1.0))
        late.append(one.late_s)
    assert late == sorted(late)
    assert late[1] > 0.0


@pytest.mark.parametrize("down_mps", [-LIMITS.max_climb_mps, LIMITS.max_descent_mps])
def test_a_climb_or_descent_at_its_limit_that_is_held_up_waits(down_mps: float) -> None:
    """The speed that is left is of no use there: the point waits until the gap is closed."""
    path = Trajectory([0, 300], [(0, 0, -400), (300, 0, -400 + 300 * down_mps)])
    for share, waits in ((1.0, True), (0.5, False)):
        times = [0.0, 300.0 / share]
        one = Law(AvoidanceConfig(), LIMITS, Trajectory(times, path.points_ned_m))
        now = 0.1 * times[1]
        n, e, d = one.trajectory.position(now)
        behind = (n - 10.0 / abs(down_mps), e, d - math.copysign(10.0, down_mps))
        velocity = (share, 0.0, share * down_mps)
        flight = fly(one, now + 90.0, start_s=now, position=behind, velocity=velocity)
        end = flight.position[-1]
        assert math.dist(end, one.trajectory.position(float(flight.time_s[-1]))) < 1.0
        assert (one.late_s > 4.9) == waits
        assert (one.late_s == 0.0) != waits


def test_a_pause_costs_no_delay() -> None:
    """Nothing is known of a time without decisions, such as the pilot's."""
    one = law(5.0)
    for now in (50.0, 80.0):
        one.decide(Situation(now, now, (0.0, 0.0, -50.0), (5.0, 0.0, 0.0), 1.0))
    assert one.late_s == 0.0


def test_outside_of_its_own_time_the_path_does_not_wait() -> None:
    for path_time in (-20.0, 0.0, 400.0):
        one = law(5.0)
        for step in range(50):
            now = 0.2 * step
            one.decide(Situation(now, path_time, (-90.0, 0.0, -50.0), (0.0, 0.0, 0.0), 1.0))
        assert one.late_s == 0.0


@pytest.mark.parametrize("name", ["paper", "none"])
def test_the_other_laws_do_not_wait(name: str) -> None:
    """Far behind and, so that the published one does not recover, with somebody in the way."""
    late = {}
    for which in (name, "dmuca"):
        one = law(5.0, which)
        for step in range(100):
            now = 50.0 + 0.2 * step
            near = Neighbour("b", (112.0, 0.0, -50.0), (0.0, 0.0, 0.0), 0.0, 1.0)
            one.decide(Situation(now, now, (100.0, 0.0, -50.0), (5.0, 0.0, 0.0), 1.0, [near]))
        late[which] = one.late_s
    assert late[name] == 0.0
    assert late["dmuca"] > 1.0


def test_the_delayed_trajectory() -> None:
    """Every point of it comes `late_s` later; the one that was planned stays as it is."""
    path = Trajectory([0, 100, 300], [(0, 0, -50), (500, 0, -50), (500, 1000, -60)])
    one = Law(AvoidanceConfig(), LIMITS, path)
    assert one.trajectory is path
    for step in range(60):
        now = 60.0 + 0.2 * step
        one.decide(Situation(now, now, (250.0, 0.0, -50.0), (5.0, 0.0, 0.0), 1.0))
        assert one.trajectory.start_s == one.late_s
    late = one.late_s
    assert late > 2.0
    assert one.trajectory.times_s == pytest.approx([late, 100.0 + late, 300.0 + late], abs=1e-12)
    assert one.trajectory.points_ned_m == path.points_ned_m
    for t in (0.0, 60.0, 150.0, 299.0):
        assert one.trajectory.position(t + late) == pytest.approx(path.position(t), abs=1e-9)
    assert path.start_s == 0.0
    assert one._state.delay_s == late
    # The wish leads to the delayed point, not to the planned one.
    now = 60.0 + 0.2 * 60
    point = one.trajectory.position(now)
    there = one.decide(Situation(now, now, point, (5.0, 0.0, 0.0), 1.0))
    assert there.wanted_ned_mps == pytest.approx((5.0, 0.0, 0.0), abs=1e-9)
    assert not there.recovering
