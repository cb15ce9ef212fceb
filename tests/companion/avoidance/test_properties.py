"""What holds of every decision, with everything at once: fences, crewed, silent and growing tracks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.law import Law, LawResult, Neighbour, Situation
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from companion.geometry import Vec3
from tests.companion.avoidance.flown.flying import circle, polygon

LAWS = ("dmuca", "paper", "none")
LIMITS = LimitsConfig()
QUICK = LimitsConfig(max_speed_mps=20.0, max_climb_mps=3.0, max_descent_mps=6.0, max_acceleration_mps2=2.5)
SLOW = LimitsConfig(max_speed_mps=1.0, max_climb_mps=5.0, max_descent_mps=5.0, max_acceleration_mps2=9.0)
SCENES = 60

# ---------------------------------------------------------------- limits

wild = st.one_of(
    st.floats(-60, 60),
    st.floats(-9e6, 9e6),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, -0.0, 1e-300, 1e300]),
)
near = st.floats(-30, 30)


def heard(names: str, place: Any, speed: Any, number: Any) -> st.SearchStrategy[Neighbour]:
    return st.builds(
        Neighbour,
        track_id=st.sampled_from(names),
        position_ned_m=st.tuples(place, place, place),
        velocity_ned_mps=st.tuples(speed, speed, speed),
        age_s=number,
        sigma_m=number,
        sigma_mps=number,
        growth_mps=number,
        silent=st.booleans(),
        share=st.one_of(st.floats(0.5, 1.0), number),
        vertical_known=st.booleans(),
        crewed=st.booleans(),
    )


others = st.lists(
    st.one_of(heard("abcd", wild, wild, wild), heard("efgh", near, st.floats(-8, 8), st.floats(0, 14))),
    max_size=6,
)
corner = st.tuples(st.floats(-60, 60), st.floats(-60, 60))
areas = st.lists(
    st.one_of(
        st.builds(
            polygon,
            st.sampled_from([k.IN_POLYGON, k.OUT_OF_POLYGON]),
            st.just((-41.0, -43.0)),
            st.tuples(st.floats(1, 60), st.floats(-60, -50)),
            st.tuples(st.floats(61, 90), st.floats(1, 60)),
        ),
        st.builds(circle, st.sampled_from([k.IN_CIRCLE, k.OUT_OF_CIRCLE]), corner, st.floats(0.1, 80)),
    ),
    max_size=3,
)


def numbered(fences: list[Floats]) -> Floats | None:
    for number, rows in enumerate(fences):
        rows[:, k.Wall._fields.index("area")] = number
    return np.vstack(fences) if fences else None


def stops(room: float, speed: float, acceleration: float) -> bool:
    """Whether a speed still stops within a room: a second at it, then braking."""
    return speed <= 0.0 or speed * k.BOUNDARY_LAG_S + speed * speed / (2.0 * acceleration) <= room + 1e-6


@pytest.mark.parametrize("name", LAWS)
@settings(max_examples=80, deadline=None)
@given(data=st.data())
def test_no_limit_is_ever_broken(name: Any, data: Any) -> None:
    """Speed, climb, descent, change of the command, floor and ceiling: whatever fence and traffic ask for."""
    limits = data.draw(st.sampled_from([LIMITS, QUICK, SLOW]))
    path = Trajectory([0, 20, 100], [(-40, 0, 0), (0, 0, 0), (0, 60, -30)])
    one = Law(AvoidanceConfig(law=name), limits, path, numbered(data.draw(areas)))
    bounded = data.draw(st.booleans())
    now, before = 20.0, None
    for _ in range(4):
        position = data.draw(st.tuples(near, near, near))
        velocity = data.draw(st.tuples(near, near, near))
        floor, ceiling = (25.0, -25.0) if bounded else (None, None)
        n, e, d = one.decide(
            Situation(now, now, position, velocity, 1.5, data.draw(others), floor, ceiling)
        ).chosen_ned_mps
        assert math.hypot(n, e, d) <= limits.max_speed_mps
        assert -limits.max_climb_mps <= d <= limits.max_descent_mps
        if bounded:
            room = 25.0 - position[2], position[2] + 25.0
            assert stops(room[0], d, limits.max_acceleration_mps2)
            assert stops(room[1], -d, limits.max_acceleration_mps2)
        elif before is not None:
            assert math.dist(before, (n, e, d)) <= limits.max_acceleration_mps2 * 0.2 * (1 + 1e-6)
        before = n, e, d
        now += 0.2


# ---------------------------------------------------------------- scenes and their images


@dataclass(frozen=True)
class Scene:
    """An aircraft at its path, among others and walls."""

    path: tuple[Vec3, ...]
    position: Vec3
    velocity: Vec3
    neighbours: tuple[Neighbour, ...]
    fence: Floats
    floor: float | None = None
    ceiling: float | None = None
    keep_right: bool = True

    def law(self, name: Any = "dmuca") -> Law:
        law = Law(AvoidanceConfig(law=name), LIMITS, Trajectory([0, 60, 90], self.path), self.fence)
        if not self.keep_right:
            law._settings = law._settings._replace(right_rad=0.0)
        return law

    def decisions(self, name: Any = "dmuca") -> list[LawResult]:
        """Five in a row, of one picture."""
        law, views = self.law(name), []
        for step in range(5):
            now, at, velocity = 30.0 + 0.2 * step, self.position, self.velocity
            views.append(Situation(now, 30.0, at, velocity, 1.5, self.neighbours, self.floor, self.ceiling))
        return [law.decide(view) for view in views]


def scene(seed: int, crowd: int = 6) -> Scene:
    """Small aircraft. Those with a crew are left downwards first, in directions of the compass, and with a
    view to walls that are far: they have no such images."""
    rng = np.random.default_rng(seed)

    def at(spread: float, down: float) -> Vec3:
        n, e, d = (rng.uniform(-1, 1, 3) * (spread, spread, down)).tolist()
        return n, e, d

    neighbours = tuple(
        Neighbour(
            f"id{i}",
            at(70.0, 25.0),
            at(4.0, 1.0),
            rng.uniform(0, 8),
            rng.uniform(0, 4),
            rng.uniform(0, 0.5),
            rng.uniform(0, 1.5),
            bool(rng.random() < 0.4),
            rng.uniform(0.5, 1.0),
            vertical_known=bool(rng.random() < 0.8),
        )
        for i in range(rng.integers(1, crowd + 1))
    )
    corners = [(60.0, -40.0), (-30.0, -50.0), (-45.0, 45.0), (10.0, 20.0), (55.0, 48.0)]
    fence = np.vstack(
        [
            polygon(k.IN_POLYGON, *corners),
            circle(k.OUT_OF_CIRCLE, tuple(rng.uniform(-25, 25, 2)), rng.uniform(1, 20), number=1),
        ]
    )
    path = ((-60.0, *at(9.0, 2.0)[1:]), (60.0, *at(9.0, 2.0)[1:]), (60.0, 60.0, 0.0))
    return Scene(path, at(6.0, 6.0), at(2.0, 1.0), neighbours, fence[: len(fence) * int(rng.integers(0, 2))])


def image(one: Scene, turn: Callable[[Any], Vec3]) -> Scene:
    """The scene with each of its vectors turned."""
    fence = one.fence.copy()
    for row in fence:
        wall = k.Wall(*row.tolist())
        n, e, _ = turn((wall.n, wall.e, 0.0))
        end_n, end_e, _ = turn((wall.end_n, wall.end_e, 0.0))
        row[:] = wall._replace(n=n, e=e, end_n=end_n, end_e=end_e)
    return replace(
        one,
        path=tuple(map(turn, one.path)),
        position=turn(one.position),
        velocity=turn(one.velocity),
        neighbours=tuple(
            msgspec.structs.replace(
                n, position_ned_m=turn(n.position_ned_m), velocity_ned_mps=turn(n.velocity_ned_mps)
            )
            for n in one.neighbours
        ),
        fence=fence,
    )


def alike(here: Scene, there: Scene, turn: Callable[[Any], Vec3]) -> None:
    for a, b in zip(here.decisions(), there.decisions(), strict=True):
        assert b.chosen_ned_mps == pytest.approx(turn(a.chosen_ned_mps), abs=1e-7)
        assert b.wanted_ned_mps == pytest.approx(turn(a.wanted_ned_mps), abs=1e-7)
        assert (b.feasible, b.conflict, b.recovering) == (a.feasible, a.conflict, a.recovering)
        assert [t.active for t in b.tracks] == [t.active for t in a.tracks]


@pytest.mark.parametrize("seed", range(SCENES))
def test_up_and_down_are_mirrored(seed: int) -> None:
    """With limits, floor and ceiling that are."""

    def turn(v: Any) -> Vec3:
        return v[0], v[1], -v[2]

    one = replace(scene(seed), floor=12.0, ceiling=-9.0)
    alike(one, replace(image(one, turn), floor=9.0, ceiling=-12.0), turn)


@pytest.mark.parametrize("seed", range(SCENES))
def test_no_direction_is_special(seed: int) -> None:
    """Turned about the vertical, keeping right and all."""
    c, s = math.cos(0.7 + seed), math.sin(0.7 + seed)

    def turn(v: Any) -> Vec3:
        return c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]

    one = scene(seed)
    alike(one, image(one, turn), turn)


@pytest.mark.parametrize("seed", range(SCENES))
def test_left_and_right_are_mirrored_but_for_keeping_right(seed: int) -> None:
    def turn(v: Any) -> Vec3:
        return v[0], -v[1], v[2]

    one = replace(scene(seed), keep_right=False)
    alike(one, image(one, turn), turn)


def test_keeping_right_is_to_the_right() -> None:
    """Its mirrored image is not: in a conflict the wish turns by 0.2 rad, from north to east."""
    others = (Neighbour("a", (50.0, 0.5, 0.0), (-2.0, 0.0, 0.0), 0.0, 1.0),)
    one = Scene(((-60, 0, 0), (60, 0, 0), (90, 0, 0)), (0, 0, 0), (2, 0, 0), others, k.NO_WALLS)
    left = image(one, lambda v: (v[0], -v[1], v[2]))
    for meeting in (one, left):
        turned = meeting.decisions()[-1].chosen_ned_mps[1]
        free = replace(meeting, keep_right=False).decisions()[-1].chosen_ned_mps[1]
        assert turned > free


# ---------------------------------------------------------------- order, irrelevance


def same(a: list[LawResult], b: list[LawResult]) -> None:
    """Bit for bit, but for the tracks."""
    for one, other in zip(a, b, strict=True):
        assert msgspec.structs.replace(one, tracks=()) == msgspec.structs.replace(other, tracks=())


@pytest.mark.parametrize("name", LAWS)
def test_the_order_of_tracks_changes_nothing(name: str) -> None:
    for seed in range(SCENES):
        one = scene(seed, crowd=20)
        order = np.random.default_rng(seed).permutation(len(one.neighbours))
        other = replace(one, neighbours=tuple(one.neighbours[i] for i in order))
        assert one.decisions(name) == other.decisions(name)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("track_id", ["a", "id1x", "z"])
def test_a_far_diverging_track_changes_nothing(name: str, track_id: str) -> None:
    """Wherever it comes in the row, in conflicts and where nothing is feasible."""
    infeasible = quiet = 0
    for seed in range(2 * SCENES):
        one = scene(seed)
        one = replace(one, neighbours=one.neighbours[: seed % 7])
        far = Neighbour(track_id, (900.0, -700.0, 30.0), (6.0, -4.0, 0.0), 1.0, 1.5, growth_mps=1.0)
        expected = one.decisions(name)
        infeasible += not expected[-1].feasible
        quiet += not expected[-1].conflict
        same(expected, replace(one, neighbours=(*one.neighbours, far)).decisions(name))
    assert quiet > 10
    assert infeasible > {"dmuca": 10, "paper": 1, "none": -1}[name]


@pytest.mark.parametrize("name", LAWS)
def test_a_fence_out_of_reach_changes_nothing(name: str) -> None:
    """40 m are out of reach at 5 m/s: 2 m and twice 1.5 m of margin, 5 m of lag, 25 m of braking."""
    for seed in range(SCENES):
        one = replace(scene(seed), fence=k.NO_WALLS)
        for fence in (
            polygon(k.IN_POLYGON, (50.0, 50.0), (50.0, -50.0), (-50.0, -50.0), (-50.0, 50.0)),
            polygon(k.OUT_OF_POLYGON, (50.0, 50.0), (50.0, -50.0), (90.0, 0.0)),
            circle(k.IN_CIRCLE, (0.0, 0.0), 50.0),
            circle(k.OUT_OF_CIRCLE, (60.0, 0.0), 10.0),
        ):
            same(one.decisions(name), replace(one, fence=fence).decisions(name))


# ---------------------------------------------------------------- pairs


@pytest.mark.parametrize("seed", range(SCENES))
def test_two_with_the_same_data_part(seed: int) -> None:
    """Their planes are opposite, and together ask for the whole way out; so when both keep theirs, their
    relative velocity leaves the obstacle on one and the same side."""
    rng = np.random.default_rng(seed)
    p = np.array([rng.uniform(15, 90), rng.uniform(-8, 8), rng.uniform(-6, 6)])
    places = np.zeros(3), p
    speeds = np.array([2.5, 0, 0]) + rng.normal(0, 0.3, 3), np.array([-2.5, 0, 0]) + rng.normal(0, 0.3, 3)
    age, growth = rng.uniform(0, 3), rng.uniform(0, 1)
    found, normals, offsets = [], [], []
    for me, you in ((0, 1), (1, 0)):
        start, step = places[me].tolist(), speeds[me]
        path = Trajectory([0, 100], [tuple(start), tuple((places[me] + 100 * step).tolist())])
        law = Law(AvoidanceConfig(), LIMITS, path)
        sent = places[you] - age * speeds[you]
        other = Neighbour("b", tuple(sent.tolist()), tuple(speeds[you].tolist()), age, 1.5, growth_mps=growth)
        result = law.decide(Situation(0.0, 0.0, tuple(start), tuple(step.tolist()), 1.5, [other]))
        assert result.feasible
        *normal, offset = law._work.planes[2]
        normals.append(np.array(normal))
        offsets.append(offset)
        found.append(np.array(law._solved))
    np.testing.assert_allclose(normals[0], -normals[1], atol=1e-12)
    relative = found[0] - found[1]
    assert normals[0] @ relative >= sum(offsets) - 1e-9
    still = 10.0 + 4.0 * math.hypot(math.hypot(1.5, 1.5), 0.3 * age)
    radius = still + max(0.2 * age, growth * (age + 4.0))
    scaled = np.array([1.0, 1.0, radius / ((still + 0.2 * age) / 0.85)])
    if np.linalg.norm(p * scaled) > radius:
        _, near2 = k.closest(k.Vector(*(p * scaled)), k.Vector(*(relative * scaled)), 20.0)
        assert math.sqrt(near2) >= radius - 1e-6
