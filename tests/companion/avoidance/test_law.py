"""The three laws: limits that nothing breaks, sides that agree, the published recovery."""

from __future__ import annotations

import math
import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.avoidance import kernels
from companion.avoidance.law import Law, LawResult, Neighbour, Situation, horizon_s
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig

LAWS = ("dmuca", "paper", "none")
LIMITS = LimitsConfig()
NORTH = Trajectory([0, 200], [(0, 0, -50), (400, 0, -50)])  # 2 m/s


def law(name: Any = "dmuca", path: Trajectory = NORTH, limits: LimitsConfig = LIMITS, **keys: Any) -> Law:
    return Law(AvoidanceConfig(law=name, **keys), limits, path)


def situation(
    now: float = 50.0, position: Any = None, velocity: Any = (2.0, 0.0, 0.0), others: Any = (), **keys: Any
) -> Situation:
    if position is None:
        position = NORTH.position(now)
    path_time = keys.pop("path_time_s", now)
    return Situation(now, path_time, position, velocity, keys.pop("sigma_m", 1.5), others, **keys)


def other(
    position: Any, velocity: Any = (0.0, 0.0, 0.0), name: str = "b", age: float = 0.5, **keys: Any
) -> Neighbour:
    return Neighbour(name, position, velocity, age, keys.pop("sigma_m", 1.5), **keys)


def settle(one: Law, view: Situation, seconds: float = 20.0) -> LawResult:
    """The same picture again and again until the command has settled."""
    for step in range(round(seconds / 0.2)):
        now = view.now_s + 0.2 * step
        result = one.decide(
            Situation(
                now, view.path_time_s, view.position_ned_m, view.velocity_ned_mps, view.sigma_m,
                view.neighbours, view.floor_down_m, view.ceiling_down_m,
            )
        )  # fmt: skip
    return result


# ---------------------------------------------------------------- limits


def within_limits(result: LawResult, limits: LimitsConfig) -> None:
    n, e, d = result.chosen_ned_mps
    assert all(map(math.isfinite, (n, e, d, *result.wanted_ned_mps)))
    assert math.hypot(n, e, d) <= limits.max_speed_mps
    assert -limits.max_climb_mps <= d <= limits.max_descent_mps


wild = st.one_of(
    st.floats(-60, 60),
    st.floats(-9e6, 9e6),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, -0.0, 1e-300, 1e300, -1e300]),
)
anything = st.builds(
    Neighbour,
    track_id=st.sampled_from("abcdef"),
    position_ned_m=st.tuples(wild, wild, wild),
    velocity_ned_mps=st.tuples(wild, wild, wild),
    age_s=st.one_of(st.floats(-20, 20), wild),
    sigma_m=st.one_of(st.floats(0, 5), wild),
    vertical_known=st.booleans(),
)
sane = st.builds(
    Neighbour,
    track_id=st.sampled_from("ghijkl"),
    position_ned_m=st.tuples(st.floats(70, 130), st.floats(-30, 30), st.floats(-80, -20)),
    velocity_ned_mps=st.tuples(*[st.floats(-6, 6)] * 3),
    age_s=st.floats(0, 6),
    sigma_m=st.floats(0, 5),
    vertical_known=st.booleans(),
)


@pytest.mark.parametrize("name", LAWS)
@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_never_above_any_limit(name: str, data: Any) -> None:
    """Whatever is heard and whatever the own state is, as long as that is finite."""
    one = law(name)
    free = st.floats(-1e3, 1e3)
    now, before = 40.0, None
    for _ in range(data.draw(st.integers(1, 4))):
        others = data.draw(st.lists(st.one_of(anything, sane), max_size=8))
        velocity = data.draw(st.tuples(*[st.floats(-30, 30)] * 3))
        position = data.draw(st.one_of(st.just((100.0, 0.0, -50.0)), st.tuples(free, free, free)))
        result = one.decide(situation(now, position, velocity, others))
        within_limits(result, LIMITS)
        if before is not None:
            change = math.dist(before, result.chosen_ned_mps)
            assert change <= LIMITS.max_acceleration_mps2 * 0.2 * (1 + 1e-6)
        before = result.chosen_ned_mps
        now += 0.2


@pytest.mark.parametrize("name", LAWS)
def test_boundaries_hold_under_pressure(name: str) -> None:
    """A path through floor and ceiling, and traffic that presses: the vehicle (lag 0.5 s) stays between."""
    for towards in (-1.0, 1.0):
        path = Trajectory([0, 60], [(0, 0, -50), (60, 0, -50 + towards * 60)])
        one = law(name, path)
        position, velocity = np.array([0.0, 0.0, -50.0]), np.array([1.0, 0.0, towards])
        for step in range(600):
            now = 0.1 * step
            if step % 2 == 0:
                press = other(
                    (position[0] + 3.0, 0.0, position[2] - towards * 12.0), (0, 0, towards), age=0.0
                )
                result = one.decide(
                    situation(
                        now,
                        tuple(position),
                        tuple(velocity),
                        [press],
                        floor_down_m=-30.0,
                        ceiling_down_m=-70.0,
                    )
                )
                within_limits(result, LIMITS)
            velocity += (np.array(result.chosen_ned_mps) - velocity) * 0.2
            position += velocity * 0.1
            assert -70.1 < position[2] < -29.9


def test_beyond_a_boundary_the_way_is_back() -> None:
    below = settle(law("none"), situation(position=(100.0, 0.0, -25.0), floor_down_m=-30.0))
    assert below.chosen_ned_mps[2] <= -LIMITS.max_climb_mps + 1e-6
    above = settle(law("none"), situation(position=(100.0, 0.0, -75.0), ceiling_down_m=-70.0))
    assert above.chosen_ned_mps[2] >= LIMITS.max_descent_mps - 1e-6


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize(
    "wrong",
    [
        {"position": (math.nan, 0, 0)},
        {"velocity": (0, math.inf, 0)},
        {"sigma_m": math.nan},
        {"position": (1e300, 0, 0)},
        {"path_time_s": math.inf},
        {"now": math.nan, "position": (0, 0, 0)},
        {"floor_down_m": math.nan},
        {"floor_down_m": -50.0, "ceiling_down_m": -20.0},
    ],
)
def test_wrong_own_state_is_refused(name: str, wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        law(name).decide(situation(**wrong))


def test_non_finite_neighbours_are_dropped_and_the_rest_is_kept() -> None:
    good = other((150.0, 0.0, -50.0), (-2.0, 0.0, 0.0), "good")
    bad = [
        other((math.nan, 0, 0), name="a"),
        other((0, 0, 0), (0, math.inf, 0), name="c"),
        other((150, 0, -50), name="d", sigma_m=math.nan),
        other((150, 0, -50), name="e", age=math.nan),
        other((150, 0, -50), name="f", age=30.1),
        other((1e300, 0, -50), name="g"),
    ]
    alone, together = law().decide(situation(others=[good])), law().decide(situation(others=[*bad, good]))
    assert together == alone
    assert [t.track_id for t in together.tracks] == ["good"]


# ---------------------------------------------------------------- sides, order, irrelevance


def test_permuting_neighbours_changes_nothing() -> None:
    rng = random.Random(5)
    for crowd in (3, 8, 20):
        others = [
            other(
                (100 + rng.uniform(-40, 60), rng.uniform(-40, 40), -50 + rng.uniform(-20, 20)),
                tuple(rng.uniform(-3, 3) for _ in range(3)),
                f"id{i}",
                rng.uniform(0, 3),
            )
            for i in range(crowd)
        ]
        expected = settle(law(), situation(others=others), 3.0)
        for _ in range(5):
            rng.shuffle(others)
            got = settle(law(), situation(others=others), 3.0)
            assert math.dist(got.chosen_ned_mps, expected.chosen_ned_mps) <= 1e-9


@pytest.mark.parametrize("bearing_deg", range(0, 360, 30))
def test_mirrored_aircraft_never_choose_the_same_way_out(bearing_deg: int) -> None:
    """Both of a pair decide from mirrored data: their relative velocity leaves the conflict."""
    rng = random.Random(bearing_deg)
    angle = math.radians(bearing_deg)
    ahead = np.array([math.cos(angle), math.sin(angle), 0.0])
    for trial in range(10):
        gap = rng.uniform(30, 80)
        offset = np.array([rng.uniform(-5, 5), rng.uniform(-5, 5), rng.uniform(-3, 3)]) * (trial > 0)
        places = (-ahead * gap / 2, ahead * gap / 2 + offset)
        speeds = (2.5 * ahead, -2.5 * ahead)
        chosen = []
        for me, you in ((0, 1), (1, 0)):
            start, step = places[me] + [0, 0, -50], speeds[me]
            path = Trajectory([0, 100], [tuple(start), tuple(start + 100 * step)])
            seen = other(tuple(places[you] + [0, 0, -50]), tuple(speeds[you]), age=0.0)
            view = Situation(0.0, 0.0, tuple(start), tuple(step), 1.5, [seen])
            chosen.append(np.array(settle(law(path=path), view).chosen_ned_mps))
        p, before, after = places[1] - places[0], speeds[0] - speeds[1], chosen[0] - chosen[1]
        miss_before = kernels.closest(kernels.Vector(*p), kernels.Vector(*before), 60.0)[1]
        miss_after = kernels.closest(kernels.Vector(*p), kernels.Vector(*after), 60.0)[1]
        assert miss_after > miss_before + 1.0
        if trial == 0:  # exactly head-on: both to their own right
            right = np.array([-ahead[1], ahead[0], 0.0])
            assert chosen[0] @ right > 0.2
            assert chosen[1] @ right < -0.2


def test_a_far_diverging_track_changes_nothing() -> None:
    near = other((150.0, 3.0, -50.0), (-2.0, 0.0, 0.0), "near")
    far = other((900.0, 900.0, -50.0), (4.0, 4.0, 0.0), "far")
    assert (
        law().decide(situation(others=[near])).chosen_ned_mps
        == law().decide(situation(others=[near, far])).chosen_ned_mps
    )
    assert settle(law(), situation(others=[far])).chosen_ned_mps == pytest.approx((2.0, 0.0, 0.0), abs=1e-9)


def test_alone_it_flies_the_path() -> None:
    for name in ("dmuca", "none"):
        assert settle(law(name), situation()).chosen_ned_mps == pytest.approx((2.0, 0.0, 0.0), abs=1e-9)
        off = settle(law(name), situation(position=(100.0, 10.0, -50.0)))
        assert off.recovering
        assert off.chosen_ned_mps == pytest.approx((2.0, -10.0 / 15.0, 0.0), abs=1e-9)


def test_radius_grows_with_error_and_age() -> None:
    later = 10 + 4.0 * math.sqrt(1.5**2 + 1.5**2 + (0.3 * 2.0) ** 2) + 0.2 * 2.0
    for sigma, age, radius in ((0.0, 0.0, 12.0), (1.5, 2.0, later)):
        one = situation(others=[other((300.0, 90.0, -50.0), age=age, sigma_m=sigma)], sigma_m=sigma)
        assert law().decide(one).tracks[0].radius_m == pytest.approx(radius)


def test_track_is_predicted_over_its_age() -> None:
    track = law().decide(situation(others=[other((200.0, 10.0, -40.0), (-3.0, 1.0, 0.5), age=2.0)])).tracks[0]
    assert track.position_ned_m == pytest.approx((194.0, 12.0, -39.0))
    assert track.time_to_closest_s == pytest.approx((94 * 5 - 12 * 1 - 11 * 0.5) / (25 + 1 + 0.25))
    assert track.closest_m == pytest.approx(
        math.dist((94.0, 12.0, 11.0), [track.time_to_closest_s * v for v in (5.0, -1.0, -0.5)])
    )
    assert not track.conflict
    assert law().decide(situation(others=[other((160.0, 3.0, -50.0), (-3.0, 0.0, 0.0))])).tracks[0].conflict


def test_own_velocity_at_the_time_of_the_sample() -> None:
    """The plane is built from the velocity flown when the neighbour was sampled, not from now's."""
    seen = other((140.0, 4.0, -50.0), (-2.0, 0.0, 0.0), age=2.0)
    turned, straight = law(), law()
    for step in range(60):
        now = 40.0 + step / 6.0
        turned.note_velocity(now, (2.0, 0.0, 0.0) if now <= 48.0 else (2.0, 1.5, 0.0))
        straight.note_velocity(now, (2.0, 0.0, 0.0))
    a = settle(straight, situation(50.0, others=[seen]), 0.2)
    b = settle(turned, situation(50.0, others=[seen], velocity=(2.0, 0.0, 0.0)), 0.2)
    assert a.chosen_ned_mps == pytest.approx(b.chosen_ned_mps, abs=1e-9)
    early = law()
    early.note_velocity(40.0, (2.0, 1.5, 0.0))
    early.note_velocity(48.5, (2.0, 1.5, 0.0))
    c = settle(early, situation(50.0, others=[seen]), 0.2)
    assert math.dist(c.chosen_ned_mps, a.chosen_ned_mps) > 1e-3


@pytest.mark.parametrize("rate_hz", [5, 20, 50, 400])
def test_history_reaches_back_to_the_oldest_message(rate_hz: int) -> None:
    """However often the velocity is noted, a message 15 s old meets the velocity flown then."""
    one = law()
    for step in range(60 * rate_hz + 1):
        one.note_velocity(step / rate_hz, (0.01 * step / rate_hz, 0.0, 0.0))
        if step % (7 * rate_hz) == 0 and step >= 16 * rate_hz:
            count = one._samples
            for age in (0.0, 3.0, 15.0):
                t = step / rate_hz - age
                n, _, _ = kernels.own_velocity_at(kernels.History(*one._history), count, t)
                assert n == pytest.approx(0.01 * t, abs=1e-3)


def test_unknown_height_is_passed_beside_not_above() -> None:
    """A track without a height is met as if at our own, and pushes only sideways."""
    level = other((130.0, 1.0, 400.0), (-2.0, 0.0, 3.0), vertical_known=False)
    result = settle(law(), situation(others=[level]))
    assert result.conflict
    assert result.chosen_ned_mps[2] == pytest.approx(0.0, abs=1e-6)
    assert abs(result.chosen_ned_mps[1]) > 0.2
    assert result.tracks[0].position_ned_m[2] == -50.0


def test_after_a_pause_the_command_starts_from_the_velocity_flown() -> None:
    one = law("none")
    settle(one, situation(50.0))
    result = one.decide(situation(90.0, velocity=(0.0, 0.0, 0.0)))
    assert math.hypot(*result.chosen_ned_mps) <= 0.4 + 1e-9


# ---------------------------------------------------------------- the published law


def paper(**keys: Any) -> Law:
    return law(
        "paper",
        limits=LimitsConfig(max_acceleration_mps2=20.0),
        **{"n_noncollide": 3, "recovery_time_s": 10.0, **keys},
    )


def test_paper_recovery_ahead_of_the_path() -> None:
    """t_nearest > t: reach that point when the path does."""
    result = paper().decide(situation(50.0, position=(110.0, 4.0, -50.0)))
    assert result.recovering
    assert result.wanted_ned_mps == pytest.approx((0.0, -4.0 / 5.0, 0.0))


def test_paper_recovery_behind_the_path() -> None:
    """t_nearest <= t: towards the point of now within T, without feed-forward."""
    result = paper().decide(situation(50.0, position=(90.0, 4.0, -52.0)))
    assert result.recovering
    assert result.wanted_ned_mps == pytest.approx((1.0, -0.4, 0.2))


def test_paper_clipping_delays_the_path() -> None:
    one = paper()
    result = one.decide(situation(50.0, position=(0.0, 0.0, -50.0)))  # 100 m behind: 10 m/s wanted
    assert math.hypot(*result.wanted_ned_mps) == pytest.approx(5.0)
    assert one.trajectory.end_s == pytest.approx(200.0 + 100.0 / 5.0 - 10.0)
    ahead = paper()
    ahead.decide(situation(50.0, position=(102.0, 20.0, -50.0)))  # 20 m within 1 s
    assert ahead.trajectory.end_s == pytest.approx(200.0 + 20.0 / 5.0 - 1.0)
    gentle = paper()
    gentle.decide(situation(50.0, position=(90.0, 0.0, -50.0)))
    assert gentle.trajectory.end_s == 200.0


def test_paper_delay_does_not_run_away() -> None:
    """Stuck far from the path, the arrival settles where v_max brings the aircraft back, and stays there."""
    for position in ((-100.0, 0.0, -50.0), (60.0, 150.0, -50.0)):
        one = paper()
        ends = []
        for _ in range(100):
            one.decide(situation(50.0, position=position, velocity=(0.0, 0.0, 0.0)))
            ends.append(one.trajectory.end_s)
        assert ends[50] == pytest.approx(ends[-1], abs=1e-6)
        assert ends[-1] < 300.0


def test_paper_waits_for_n_cycles_and_is_blind_in_recovery() -> None:
    one = paper()
    meeting = other((140.0, 0.0, -50.0), (-2.0, 0.0, 0.0), age=0.0)
    first = one.decide(situation(50.0, others=[meeting]))
    assert first.conflict
    assert not first.recovering
    assert first.wanted_ned_mps == (2.0, 0.0, 0.0)  # the current velocity is what it keeps to
    quiet = [one.decide(situation(50.0 + 0.2 * i)).recovering for i in range(1, 5)]
    assert quiet == [False, False, True, True]
    # Standing still and off the path there is no conflict; recovery then flies straight at the other.
    wall = other((100.0, 15.0, -50.0), age=0.0)
    blind = one.decide(
        situation(51.0, position=(102.0, 40.0, -50.0), velocity=(0.0, 0.0, 0.0), others=[wall])
    )
    assert blind.recovering
    assert blind.chosen_ned_mps[1] < -3.9


# ---------------------------------------------------------------- cost


def test_nothing_is_compiled_in_flight() -> None:
    """Whatever number types configuration and state have, warm-up has compiled the kernels for them."""
    kernels.warm_up()
    k = kernels
    compiled = (k.decide_plain, k.all_within, k.note_velocity, k.path_position, k.path_nearest)
    before = [len(f.signatures) for f in compiled]
    whole = LimitsConfig(max_speed_mps=5, max_climb_mps=2, max_descent_mps=2, max_acceleration_mps2=1)
    path = Trajectory([0, 100], [(0, 0, -50), (100, 0, -50)])
    for name in LAWS:
        one = law(name, path, whole, horizon_s=20, period_s=1, recovery_time_s=10, conflict_radius_m=5)
        for others in ([], [other((20, 0, -50), (0, 0, 0), age=0, sigma_m=1)]):
            one.note_velocity(0, (1, 0, 0))
            one.decide(Situation(1, 1, (0, 0, -50), (1, 0, 0), 1, others, -20, -100))
            one.decide(Situation(np.float64(2), 1, (np.float64(0), 0, -50), (1, 0, 0), 1, others))
            one.trajectory.position(3)
            one.trajectory.nearest((1, 2, -50))
    assert [len(f.signatures) for f in compiled] == before


def test_how_far_ahead_others_are_kept_clear_of() -> None:
    assert horizon_s(AvoidanceConfig(), False) == 20.0
    assert horizon_s(AvoidanceConfig(), True) == 90.0
    assert horizon_s(AvoidanceConfig(horizon_s=100.0), True) == 100.0
