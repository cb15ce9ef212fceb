"""The kernels: the oracle's planes, every known trap by name, the programs against brute force."""

from __future__ import annotations

import gzip
import json
import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import TypingError, jit, njit

from companion.avoidance import kernels as k
from companion.avoidance.law import Law, Neighbour, Situation, settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig

ORACLE = Path(__file__).parents[3] / "data" / "orca_cases.json.gz"


def half_space(p: Any, v: Any, radius: float = 10.0, tau: float = 20.0, overlap: float = 2.0) -> np.ndarray:
    """n (3) and s."""
    n, s = k.half_space(k.Vector(*map(float, p)), k.Vector(*map(float, v)), radius, tau, overlap)
    return np.array([*n, s])


def solve(
    planes: Any, wish: Any, speed: float = 5.0, hard: int = 0, slack: float = 0.0
) -> tuple[bool, np.ndarray]:
    rows = np.array(planes, dtype=float).reshape(-1, 4)
    towards = k.Vector(*map(float, wish))
    ok, v = k.solve(rows, hard, len(rows), speed, slack, towards, np.zeros_like(rows))
    return ok, np.array(v)


def unit(v: Any) -> np.ndarray:
    return np.asarray(v, dtype=float) / np.linalg.norm(v)


def test_warm_up_compiles_everything_that_flies() -> None:
    """After it, a decision with any neighbours compiles nothing more."""
    k.warm_up()
    flown = (k.decide_plain, k.all_within, k.note_velocity, k.note_track, k.path_position, k.path_nearest)
    compiled = {f: len(f.signatures) for f in flown}
    assert all(compiled.values())
    law = Law(AvoidanceConfig(), LimitsConfig(), Trajectory([0, 9], [(0, 0, -50), (9, 0, -50)]))
    law.decide(Situation(1.0, 1.0, (0.0, 0.0, -50.0), (1.0, 0.0, 0.0), 1.0, (), -20.0, None))
    law.decide(Situation(2, 2, (0, 0, -50), (1, 0, 0), 1, (Neighbour("a", (5, 5, -50), (0, 0, 0), 1, 2),)))
    assert {f: len(f.signatures) for f in flown} == compiled


def test_a_flight_loads_nothing_after_the_warm_up() -> None:
    """Loading the first kernel of a process takes some 0.3 s, in which a vehicle waits for its setpoint.

    None of those is missing that the other rooms call.
    """
    root = Path(__file__).parents[4]
    sources = [
        p.read_text() for p in root.glob("companion/**/*.py") if "kernels" not in p.relative_to(root).parts
    ]
    called = {name for text in sources for name in re.findall(r"\b(?:k|kernels)\.(\w+)\(", text)}
    assert {"decide_plain", "note_power", "turn_rate"} <= called
    program = (
        "import sys\n"
        "from companion.avoidance import kernels as k\n"
        "from companion.avoidance.law import Law\n"
        "from companion.avoidance.trajectory import Trajectory\n"
        "from companion.avoidance.walls import walls_of\n"
        "from companion.config import AvoidanceConfig, LimitsConfig\n"
        "from companion.events import FenceArea\n"
        "from companion.geometry import LocalFrame\n"
        "k.warm_up()\n"
        "missing = [f.__name__ for f in k.FUNCTIONS if f.__name__ in sys.argv and not f.signatures]\n"
        "assert not missing, missing\n"
        "before = [len(f.signatures) for f in k.FUNCTIONS]\n"
        "path = Trajectory([0.0, 9.0], [(0.0, 0.0, -50.0), (9.0, 0.0, -50.0)])\n"
        "area = FenceArea(inclusion=True, points=((47.0, 8.0),), radius_m=500.0)\n"
        "walls = walls_of([area], LocalFrame(47.0, 8.0, 450.0), path, 1.0)\n"
        "Law(AvoidanceConfig(), LimitsConfig(), path, walls).follow(path)\n"
        "assert [len(f.signatures) for f in k.FUNCTIONS] == before\n"
    )
    subprocess.run([sys.executable, "-c", program, *called], check=True, cwd=root)


def test_planes_of_the_oracle() -> None:
    cases = json.loads(gzip.decompress(ORACLE.read_bytes()))["cases"]
    compared = 0
    for case in cases:
        agent = case["agent"]
        if len(case["planes"]) != len(case["neighbours"]) or case["conditioning"] == "degenerate":
            continue
        for plane, other in zip(case["planes"], case["neighbours"], strict=True):
            p = np.subtract(other["position"], agent["position"])
            v = np.subtract(agent["velocity"], other["velocity"])
            *n, s = half_space(
                p, v, agent["radius"] + other["radius"], agent["time_horizon"], agent["time_step"]
            )
            np.testing.assert_allclose(n, plane["normal"], atol=1e-6, err_msg=case["id"])
            offset = np.dot(plane["normal"], plane["point"])
            assert np.dot(n, agent["velocity"]) + 0.5 * s == pytest.approx(offset, abs=1e-5), case["id"]
            compared += 1
    assert compared > 1000


# ---------------------------------------------------------------- known traps


@pytest.mark.parametrize("bearing_deg", range(0, 360, 15))
@pytest.mark.parametrize("speed", [2.0, 8.0, 30.0])
def test_trap_exact_head_on_goes_to_the_right(bearing_deg: int, speed: float) -> None:
    ahead = np.array([math.cos(math.radians(bearing_deg)), math.sin(math.radians(bearing_deg)), 0.0])
    right = np.array([-ahead[1], ahead[0], 0.0])  # north turns to east
    *n, s = half_space(60.0 * ahead, 2.0 * speed * ahead)
    assert np.isfinite([*n, s]).all()
    assert np.dot(n, right) > 0.9
    assert s > 0.0


def test_trap_near_head_on_does_not_cancel() -> None:
    """A centimetre beside the line, and far less: the plane stays where geometry puts it."""
    for offset in (1.0, 1e-2, 1e-3, 1e-4):
        *n, s = half_space((60.0, -offset, 0.0), (10.0, 0.0, 0.0))
        sine = 10.0 / math.hypot(60.0, offset)
        cross = 10.0 * offset / math.hypot(60.0, offset)
        along = 600.0 / math.hypot(60.0, offset)
        assert s == pytest.approx(sine * along - math.sqrt(1.0 - sine * sine) * cross, rel=1e-12)
        assert n[1] > 0.9  # the other is a little to the left: pass on the right


def test_trap_both_choose_sides_that_part() -> None:
    """The exchanged view has exactly the opposite normal and the same length, in every kind of geometry."""
    rng = np.random.default_rng(1)
    special = [
        ((0, 0, 40), (0, 0, 9)),
        ((40, 0, 0), (9, 0, 0)),
        ((5, 0, 0), (2.5, 0, 0)),
        ((5, 1, 2), (0, 0, 0)),
    ]
    drawn = [(rng.normal(0, 30, 3), rng.normal(0, 6, 3)) for _ in range(500)]
    for p, v in [*special, *drawn]:
        here, there = half_space(p, v), half_space(np.negative(p), np.negative(v))
        np.testing.assert_array_equal(here[:3], -there[:3])
        assert here[3] == there[3]


def test_trap_straight_above_is_not_a_hole() -> None:
    """There is no right: the upper one (here we) goes north, the lower one south."""
    for below in (1.0, -1.0):
        *n, s = half_space((0, 0, 40 * below), (0, 0, 9 * below))
        # 10 m of radius at 40 m: a quarter of the way out is back.
        assert n == pytest.approx([math.sqrt(15.0 / 16.0) * below, 0.0, -0.25 * below])
        assert s == pytest.approx(9.0 / 4.0)


def test_trap_relative_velocity_in_the_centre_of_the_sphere() -> None:
    """w = 0: at p / tau (cut-off) and at p / overlap (inside the volume)."""
    *n, s = half_space((40.0, 0, 0), (2.0, 0, 0))
    assert n[1] > 0.9
    assert s == pytest.approx(0.5)
    *n, s = half_space((5.0, 0, 0), (2.5, 0, 0))
    assert n == [-1.0, 0.0, 0.0]
    assert s == pytest.approx(5.0)
    *n, s = half_space((2.0, -3.0, 6.0), (1.0, -1.5, 3.0))
    assert n == pytest.approx([-2.0 / 7.0, 3.0 / 7.0, -6.0 / 7.0])
    assert s == pytest.approx(5.0)


def test_trap_same_place_same_velocity_is_finite() -> None:
    *n, s = half_space((0, 0, 0), (0, 0, 0))
    assert np.linalg.norm(n) == pytest.approx(1.0)
    assert s == pytest.approx(5.0)


def test_trap_opposing_planes() -> None:
    """Two walls that leave nothing between: the middle, not a NaN; two that leave a slit: inside of it."""
    ok, v = solve([(1, 0, 0, 2), (-1, 0, 0, -1)], (0, 3, 0))
    assert not ok
    assert v[0] == pytest.approx(1.5)
    ok, v = solve([(1, 0, 0, 1), (-1, 0, 0, -2)], (0, 3, 0))
    assert ok
    assert v == pytest.approx([1, 3, 0])


def test_trap_the_same_plane_twice() -> None:
    n = unit((1, 2, 3))
    ok, v = solve([(*n, 1.0), (*n, 1.0), (*n, 1.0 + 1e-13)], (-4, 0, 0))
    assert ok
    assert n @ v == pytest.approx(1.0)


def test_trap_hard_planes_stay_whole_when_infeasible() -> None:
    """Neighbours press upward harder than the climb limit allows: the limit holds to rounding."""
    hard = [(0, 0, 1, -2.0), (0, 0, -1, -1.5)]
    up, side = unit((0.1, 0, -1)), unit((-0.1, 0, -1))
    ok, v = solve([*hard, (*up, 4.0), (*side, 4.5), (0, 0, 1, 3.0)], (1, 1, 0), hard=2)
    assert not ok
    assert -2.0 - 1e-9 <= v[2] <= 1.5 + 1e-9
    assert np.linalg.norm(v) <= 5.0 + 1e-9


@pytest.mark.parametrize("wish", [(0.0, 3.0, 1.0), (1.0, -2.0, 0.0), (4.0, 0.5, -0.5)])
def test_trap_of_many_least_violations_the_nearest_to_the_wish(wish: Any) -> None:
    """What the planes say nothing about stays as it was wished, not as it was come upon."""
    ok, v = solve([(1, 0, 0, 2), (-1, 0, 0, -1)], wish)
    assert not ok
    assert v == pytest.approx([1.5, *wish[1:]], abs=1e-8)


@pytest.mark.parametrize("slack", [0.0, 0.02, 0.3])
def test_slack_is_spent_on_the_way_to_the_wish(slack: float) -> None:
    """The least of the largest violations is 0.5 m/s, at 1.5 m/s; the wish lies beyond."""
    ok, v = solve([(1, 0, 0, 2), (-1, 0, 0, -1), (0, 1, 0, 1)], (4, 3, 0), slack=slack)
    assert not ok
    assert v == pytest.approx([1.5 + slack, 3.0, 0.0], abs=1e-8)


def test_slack_is_not_spent_where_every_plane_is_kept() -> None:
    ok, v = solve([(1, 0, 0, 2)], (1, 3, 0), slack=0.3)
    assert ok
    assert v == pytest.approx([2.0, 3.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("tilt", [0.0, 1e-10, 1e-9, 1e-8, -1e-8])
@pytest.mark.parametrize("hard", [0, 2])
def test_trap_walls_that_are_parallel_but_for_rounding(tilt: float, hard: int) -> None:
    """Both to be kept with nothing between them: possible, and others are kept besides."""
    walls = [(0.0, 1.0, 0.0, 0.0), (tilt, -math.sqrt(1.0 - tilt * tilt), 0.0, 0.0)]
    for others in ([], [(0.6, 0.0, 0.8, 1.0)], [(0.6, 0.0, 0.8, 1.0), (-0.6, 0.0, 0.8, 1.0)]):
        for wish in ((4.0, 0.0, 0.0), (-4.0, 1.0, 0.0)):
            ok, v = solve([*walls, *others], wish, hard=hard)
            assert ok
            assert v[1] == pytest.approx(0.0, abs=1e-6)
            assert all(np.dot(plane[:3], v) >= plane[3] - 1e-6 for plane in others)


def test_trap_hard_planes_that_are_impossible_together() -> None:
    """As many of the first as are possible stay whole; the others are soft, as are the neighbours."""
    hard = [(0, 0, 1, -2.0), (0, 0, -1, -2.0), (1, 0, 0, 1.0), (-1, 0, 0, 0.0), (0, 1, 0, -1.0)]
    ok, v = solve([*hard, (0, 1, 0, 2.0), (0, 0, 1, 3.0)], (0, 0, 0), hard=5)
    assert not ok
    assert v[0] == pytest.approx(1.0, abs=1e-8)  # the third one whole, its contrary broken by 1
    assert v[1:] == pytest.approx([1.0, 2.0], abs=1e-8)  # by no more than 1


@pytest.mark.parametrize("acceleration", [0.05, 0.3, 1.0, 9.0])
@pytest.mark.parametrize("height_m", [0.1, 2.0, 30.0])
def test_trap_floor_and_ceiling_never_contradict(acceleration: float, height_m: float) -> None:
    path = Trajectory([0, 9], [(0, 0, 0), (9, 0, 0)])
    law = settings_of(AvoidanceConfig(), LimitsConfig(max_acceleration_mps2=acceleration), path)
    still = k.Vector(0.0, 0.0, 0.0)
    for down in np.linspace(-height_m - 9.0, 9.0, 91).tolist():
        own = k.Own(k.Vector(0.0, 0.0, down), still, 0.0, 0.0, 0.0, 0.0, -height_m)
        least, most = k.down_speeds(own, law)
        assert -2.0 <= least <= most <= 2.0
        assert down < 0.0 or most <= 0.0
        assert down > -height_m or least >= 0.0


@pytest.mark.parametrize("name", ["dmuca", "paper"])
def test_nobody_asks_for_more_than_twice_the_greatest_speed(name: Any) -> None:
    """From within a large volume; the published law has no such bound."""
    wide = AvoidanceConfig(law=name, conflict_radius_m=106.0)
    one = Law(wide, LimitsConfig(), Trajectory([0, 9], [(0, 0, -50), (9, 0, -50)]))
    inside = Neighbour("a", (30.0, 5.0, -50.0), (-40.0, 0.0, 0.0), 0.0, 5.0)
    one.decide(Situation(1.0, 1.0, (0.0, 0.0, -50.0), (1.0, 0.0, 0.0), 1.5, (inside,)))
    asked = k.plane_at(one._work.asked[0], 0).least
    assert asked == 10.0 if name == "dmuca" else asked > 20.0


# ---------------------------------------------------------------- meaning of the half-space


@settings(max_examples=300, deadline=None)
@given(
    st.tuples(*[st.floats(-80, 80)] * 3),
    st.tuples(*[st.floats(-12, 12)] * 3),
    st.floats(1.0, 20.0),
    st.floats(2.0, 40.0),
)
def test_u_is_the_way_to_the_boundary(p: Any, v: Any, radius: float, tau: float) -> None:
    """v + s n lies on the boundary: a little further out it misses, a little further in it hits."""
    if np.linalg.norm(p) <= radius * 1.001:
        return
    *n, s = half_space(p, v, radius, tau)
    n = np.array(n)
    assert np.isfinite([*n, s]).all()
    assert np.linalg.norm(n) == pytest.approx(1.0, abs=1e-9)
    for side, misses in ((1e-3, True), (-1e-3, False)):
        w = np.array(v) + (s + side) * n
        _, near2 = k.closest(k.Vector(*p), k.Vector(*w.tolist()), tau)
        assert (math.sqrt(near2) > radius - 1e-6) == misses or abs(math.sqrt(near2) - radius) < 1e-5
    _, near2 = k.closest(k.Vector(*p), k.Vector(*v), tau)
    if abs(s) > 1e-6:
        assert (s > 0.0) == (near2 < radius * radius)


# ---------------------------------------------------------------- programs against brute force


@pytest.mark.parametrize("seed", range(40))
def test_programs_against_brute_force(seed: int) -> None:
    """No point of a dense sample does better than the program, feasible or not."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 12))
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = rng.uniform(-3.0, 3.0 if seed % 2 else 0.5, count)
    hard = [(0, 0, 1, -2.0), (0, 0, -1, -1.0)]
    planes = np.vstack([hard, np.column_stack([normals, offsets])])
    wish = rng.normal(size=3) * 4.0
    ok, v = solve(planes, wish, hard=2)
    assert np.linalg.norm(v) <= 5.0 + 1e-9
    assert -2.0 - 1e-8 <= v[2] <= 1.0 + 1e-8
    points = rng.normal(size=(60_000, 3))
    points *= (5.0 * rng.uniform(size=(60_000, 1)) ** (1 / 3)) / np.linalg.norm(points, axis=1, keepdims=True)
    points = np.vstack([points, v + 0.05 * rng.normal(size=(20_000, 3))])
    points = points[(np.linalg.norm(points, axis=1) <= 5.0) & (points[:, 2] >= -2.0) & (points[:, 2] <= 1.0)]
    worst = (offsets - points @ normals.T).max(axis=1)
    own = float((offsets - normals @ v).max())
    if ok:
        assert own <= 1e-8
        inside = points[worst <= 0.0]
        if len(inside):
            assert np.linalg.norm(v - wish) <= np.linalg.norm(inside - wish, axis=1).min() + 1e-7
    else:
        assert worst.min() > 0.0
        assert own <= worst.min() + 1e-7


@pytest.mark.parametrize("seed", range(40))
def test_a_crowds_programs_are_solved_to_the_end(seed: int) -> None:
    """A hundred planes: the answer meets the conditions of Karush, Kuhn and Tucker, in any order of planes.

    Feasible: v - wish is a sum, with weights above 0, of the normals of what binds. Infeasible: so is 0, and
    the weights of the planes of largest violation add up to 1.
    """
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(100, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    hard = np.array([(0, 0, 1, -2.0), (0, 0, -1, -1.0)])
    soft = np.column_stack([normals, rng.uniform(-6.0, 4.0 if seed % 2 else -1.0, 100)])
    wish = rng.normal(size=3) * 4.0
    ok, v = solve(np.vstack([hard, soft]), wish, hard=2)
    assert ok != bool(seed % 2)
    violation = soft[:, 3] - soft[:, :3] @ v
    largest = 0.0 if ok else violation.max()
    assert violation.max() <= largest + 1e-9
    assert (hard[:, 3] - hard[:, :3] @ v).max() <= 1e-9
    assert np.linalg.norm(v) <= 5.0 + 1e-9
    worst = soft[violation >= largest - 1e-7, :3]
    others = hard[hard[:, 3] - hard[:, :3] @ v >= -1e-7, :3]
    if np.linalg.norm(v) >= 5.0 - 1e-7:
        others = np.vstack([others, -v / 5.0])
    pull = np.hstack([np.vstack([worst, others]), np.zeros((len(worst) + len(others), 1))])
    pull[: len(worst), 3] = 0.0 if ok else 1.0
    due = np.append(v - wish, 0.0) if ok else np.array([0.0, 0.0, 0.0, 1.0])
    weights = np.linalg.lstsq(pull.T, due)[0]
    assert weights.min(initial=0.0) > -1e-7
    np.testing.assert_allclose(pull.T @ weights, due, atol=1e-7)
    for _ in range(5):
        again, other = solve(np.vstack([hard, rng.permutation(soft)]), wish, hard=2)
        assert again == ok
        np.testing.assert_allclose(other, v, atol=1e-9)


def test_no_kernel_can_allocate() -> None:
    """A compiled loop over aircraft asks the memory for nothing: what would, does not compile."""
    assert len(k.FUNCTIONS) > 40
    assert not any(f.targetoptions["_nrt"] for f in k.FUNCTIONS)
    with pytest.raises(TypingError, match="NRT required but not enabled"):
        jit(**k.decide.targetoptions)(lambda: np.zeros(3))()


def test_own_velocity_history() -> None:
    times = np.array([0.0, 1.0, 3.0, 99.0])
    velocities = np.array([[0.0, 0, 0], [2, 0, 0], [2, 4, 0], [9, 9, 9]])
    for t, expected in [(-1, (0, 0, 0)), (0.5, (1, 0, 0)), (2, (2, 2, 0)), (3, (2, 4, 0)), (50, (2, 4, 0))]:
        assert k.own_velocity_at(k.History(times, velocities), 3, float(t)) == pytest.approx(expected)
    assert k.own_velocity_at(k.History(times, velocities), 1, 7.0) == pytest.approx((0, 0, 0))


@njit
def _each(others: Any, own: Any, path: Any, fence: Any, settings: Any, state: Any, work: Any) -> Any:
    decisions = []
    for i in range(len(own)):
        history = k.History(np.zeros(9), np.zeros((9, 3)))
        decisions.append(
            k.decide(others[i], others.shape[1], own[i], path, fence, settings, state, history, work)
        )
    return decisions


def test_a_compiled_loop_over_aircraft_calls_the_same_kernel() -> None:
    rng = np.random.default_rng(2)
    fleet, crowd = 20, 6
    path = Trajectory([0, 100], [(0, 0, 0), (200, 0, 0)])
    law = settings_of(AvoidanceConfig(), LimitsConfig(), path)
    own = [
        k.Own(k.Vector(*p), k.Vector(*v), 1.5, 0.0, 2.0, np.inf, -np.inf)
        for p, v in zip(
            rng.normal(0, 3, (fleet, 3)).tolist(), rng.normal(0, 3, (fleet, 3)).tolist(), strict=True
        )
    ]
    others = np.ones((fleet, crowd, k.OTHER_COLUMNS))
    others[:, :, k.Other._fields.index("crewed")] = 0.0
    others[:, :, :6] = rng.normal(0, [40, 40, 15, 3, 3, 1], (fleet, crowd, 6))
    state, work = k.first_state(law, 0), k.workspace(0, crowd)
    line = k.Path(*path.arrays)
    together = _each(others, tuple(own), line, k.NO_WALLS, law, state, work)
    for i in range(fleet):
        history = k.History(np.zeros(9), np.zeros((9, 3)))
        alone = k.decide(others[i], crowd, own[i], line, k.NO_WALLS, law, state, history, work)
        np.testing.assert_equal(alone, together[i])
        assert 0.0 < np.linalg.norm(alone.chosen) <= 5.0 + 1e-9


def test_uncompiled_gives_the_same_numbers() -> None:
    """The kernels run as plain Python and say the same."""
    program = (
        "import numpy as np\nfrom companion.avoidance import kernels as k\n"
        "print(repr(tuple(k.half_space(k.Vector(30., 2., 1.), k.Vector(3., -1., .5), 10., 20., 2.)[0])))\n"
        "k.warm_up()\n"
    )
    out = subprocess.run(
        [sys.executable, "-c", program],
        env={"NUMBA_DISABLE_JIT": "1", "PATH": "/usr/bin:/bin"},
        cwd=Path(__file__).parents[4],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    here, _ = k.half_space(k.Vector(30.0, 2.0, 1.0), k.Vector(3.0, -1.0, 0.5), 10.0, 20.0, 2.0)
    assert eval(out) == pytest.approx(here, abs=1e-14)
