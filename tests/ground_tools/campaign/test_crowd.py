"""A crowd's step: the grid finds the same neighbours as brute force, and the velocities are the
companion's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.avoidance import kernels as k
from ground_tools.campaign import crowd
from ground_tools.campaign.crowd import Crowd

REACH, RADIUS, SPEED, HORIZON, OVERLAP = 15.0, 3.0, 2.0, 10.0, 0.125


def crowd_of(aircraft, neighbours=10, reach=REACH):
    return Crowd(
        aircraft, radius_m=RADIUS, speed_mps=SPEED, horizon_s=HORIZON, overlap_s=OVERLAP, reach_m=reach,
        neighbours=neighbours,
    )  # fmt: skip


def step(position, velocity, wish, neighbours=10, reach=REACH):
    new = np.full(position.shape, np.nan)
    crowd_of(len(position), neighbours, reach).step(position, velocity, wish, new)
    return new


def found_by_the_grid(position, reach):
    """Whether each aircraft finds each other one with the grid, shape (aircraft, aircraft)."""
    fleet = len(position)
    c, still = crowd_of(fleet, fleet, reach), np.zeros((fleet, 3))
    c.step(position, still, still, np.zeros((fleet, 3)))
    found = np.zeros((fleet, fleet), bool)
    for row, i in enumerate(c._who):
        count = crowd._neighbours(row, c._start, c._place, c._limits, c._side, fleet, c._key, c._near)
        found[i, c._who[c._near[:count]]] = True
        assert found[i].sum() == count
    return found


def one_by_one(position, velocity, wish, neighbours=10, reach=REACH):
    """Reference: all pairs, with the companion's kernels called from Python."""
    new = np.zeros(position.shape)
    for i in range(len(position)):
        near = []
        for j in range(len(position)):
            p, v = position[j] - position[i], velocity[i] - velocity[j]
            if j != i and p[0] * p[0] + p[1] * p[1] + p[2] * p[2] <= reach * reach:
                urgency = crowd._urgency(k.Vector(*p), k.Vector(*v), RADIUS, HORIZON)
                near.append((urgency, *position[j], *velocity[j], j))
        planes = np.zeros((neighbours, 4))
        near = sorted(near)[:neighbours]
        for row, (*_, j) in enumerate(near):
            p, v = position[j] - position[i], velocity[i] - velocity[j]
            n, s = k.half_space(k.Vector(*p), k.Vector(*v), RADIUS, HORIZON, OVERLAP)
            k.put_plane(planes, row, n, k.dot(n, k.Vector(*velocity[i])) + 0.5 * s)
        _, new[i] = k.solve(planes, 0, len(near), SPEED, 0.0, k.Vector(*wish[i]), np.zeros_like(planes))
    return new


def aliases(rng):
    """Aircraft that are far apart but fall into few cubes of the torus (5 cubes along an edge for 120
    aircraft)."""
    turn = 5 * REACH * (1.0 + 1e-6)
    return rng.uniform(0.0, 20.0, (120, 3)) + turn * rng.integers(-3, 4, (120, 3))


def shells(rng):
    """Pairs just inside and just outside the reach, across borders of cubes."""
    first = REACH * rng.integers(-3, 3, (60, 3)) + rng.choice([-1e-12, -1e-18, 0.0, 1e-12], (60, 3))
    axis = np.arange(60) % 3
    first[np.arange(60), (axis + 1) % 3] += 1000.0 * np.arange(60)
    across = np.zeros((60, 3))
    across[np.arange(60), axis] = REACH * rng.choice([-1, 1], 60)
    first[:12], across[:12] = first[:12] * (across[:12] == 0.0), abs(across[:12])
    first[np.arange(12), axis[:12]] = -1e-18  # so close below 0 that its distance from REACH rounds to REACH
    return np.vstack([first, first + across * (1.0 + rng.choice([-1e-15, 0.0, 1e-15], (60, 1)))])


LAYOUTS = {
    "random": lambda rng: rng.uniform(0.0, 60.0, (120, 3)),
    "negative": lambda rng: rng.uniform(-60.0, 60.0, (120, 3)) - 30.0,
    "one cube": lambda rng: rng.uniform(1.0, 12.0, (120, 3)),
    "far apart": lambda rng: rng.uniform(-4e6, 4e6, (120, 3)),
    "aliases": aliases,
    "borders": lambda rng: REACH * (1.0 + 1e-6) * rng.integers(-2, 3, (120, 3)),
    "lattice": lambda rng: np.array([(x, y, z) for x in range(4) for y in range(5) for z in range(6)]) * 5.0,
    "shells": shells,
    "flat": lambda rng: rng.uniform(-60.0, 60.0, (120, 3)) * [1.0, 1.0, 0.0],
    "column": lambda rng: rng.uniform(-90.0, 90.0, (120, 3)) * [0.01, 0.01, 1.0],
    "two": lambda rng: rng.uniform(0.0, 9.0, (2, 3)),
    "alone": lambda rng: rng.uniform(0.0, 9.0, (1, 3)),
}


@pytest.mark.parametrize("reach", [4.0, REACH, 300.0])
@pytest.mark.parametrize("name", LAYOUTS)
def test_the_grid_finds_the_same_neighbours_as_brute_force(name, reach) -> None:
    position = np.ascontiguousarray(LAYOUTS[name](np.random.default_rng(2)), float)
    p = position[:, None] - position
    near = (p * p).sum(axis=2) <= reach * reach
    np.fill_diagonal(near, False)
    np.testing.assert_array_equal(found_by_the_grid(position, reach), near)


@pytest.mark.parametrize("name", LAYOUTS)
def test_the_grid_and_brute_force_agree_bit_for_bit(name) -> None:
    rng = np.random.default_rng(3)
    position = np.ascontiguousarray(LAYOUTS[name](rng), float)
    velocity, wish = rng.normal(0.0, 1.0, position.shape), rng.normal(0.0, 1.0, position.shape)
    if name == "lattice":  # equally urgent neighbours in numbers
        velocity[:] = 0.0
    for neighbours, reach in ((10, REACH), (3, REACH), (200, REACH), (10, 4.0), (10, 300.0)):
        np.testing.assert_array_equal(
            step(position, velocity, wish, neighbours, reach),
            one_by_one(position, velocity, wish, neighbours, reach),
        )


@pytest.mark.parametrize("name", ["random", "one cube", "lattice", "borders"])
def test_the_order_of_the_aircraft_does_not_matter(name) -> None:
    rng = np.random.default_rng(4)
    position = np.ascontiguousarray(LAYOUTS[name](rng), float)
    velocity, wish = rng.integers(-1, 2, position.shape).astype(float), rng.normal(0.0, 1.0, position.shape)
    new = step(position, velocity, wish)
    for _ in range(5):
        order = rng.permutation(len(position))
        np.testing.assert_array_equal(step(position[order], velocity[order], wish[order]), new[order])


def test_a_crowd_can_be_reused() -> None:
    """No state is left from one step to the next."""
    rng = np.random.default_rng(5)
    position, velocity, wish = rng.uniform(0.0, 60.0, (120, 3)), *rng.normal(0.0, 1.0, (2, 120, 3))
    again = crowd_of(120)
    new = np.zeros((120, 3))
    again.step(rng.uniform(-9.0, 9.0, (120, 3)), velocity, wish, new)
    again.step(position, velocity, wish, new)
    np.testing.assert_array_equal(new, step(position, velocity, wish))


def test_a_fast_distant_neighbour_is_kept() -> None:
    """Sixteen aircraft fly along nearby. The nearest ten would not include the one that comes head-on from 55
    m."""
    ring = np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)
    beside = np.column_stack([np.zeros(16), 8.0 * np.cos(ring), 8.0 * np.sin(ring)])
    position = np.vstack([[0.0, 0.0, 0.0], beside, [55.0, 0.0, 0.0]])
    velocity = np.tile([1.0, 0.0, 0.0], (18, 1))
    velocity[-1] = -10.0, 0.0, 0.0
    wish = velocity.copy()
    distance = np.linalg.norm(position - position[0], axis=1)
    assert (distance[:-1] < distance[-1]).sum() > 10
    new = step(position, velocity, wish, reach=60.0)
    assert np.linalg.norm(new[0] - wish[0]) > 0.1
    quiet = step(position[:-1], velocity[:-1], wish[:-1], reach=60.0)
    np.testing.assert_allclose(quiet[0], wish[0], atol=1e-9)


def test_urgency_is_the_time_to_conflict() -> None:
    """Compared with the first time at which the distance is R, found by bisection."""
    rng = np.random.default_rng(6)
    meeting = 0
    for _ in range(2000):
        p, v = rng.normal(0.0, 5.0, 3), rng.normal(0.0, 3.0, 3)
        urgency = crowd._urgency(k.Vector(*p), k.Vector(*v), RADIUS, HORIZON)
        if np.linalg.norm(p) <= RADIUS:
            assert urgency <= 0.0
        elif k.closest(k.Vector(*p), k.Vector(*v), HORIZON)[1] > RADIUS**2:
            assert urgency == pytest.approx(HORIZON + p @ p)
        else:
            low, high = 0.0, HORIZON
            for _ in range(60):
                middle = 0.5 * (low + high)
                low, high = (
                    (low, middle)
                    if k.closest(k.Vector(*p), k.Vector(*v), middle)[1] <= RADIUS**2
                    else (middle, high)
                )
            assert urgency == pytest.approx(high, abs=1e-6)
            meeting += 1
    assert meeting > 100
    near, far, still, fast = (k.Vector(n, 0.0, 0.0) for n in (1.0, 2.0, 0.0, 9.0))
    assert crowd._urgency(near, still, RADIUS, HORIZON) < crowd._urgency(far, fast, RADIUS, HORIZON)


def test_a_crowd_crosses_a_sphere_and_stays_apart() -> None:
    rng = np.random.default_rng(7)
    position = rng.normal(size=(60, 3))
    position *= 40.0 / np.linalg.norm(position, axis=1, keepdims=True)
    while True:
        gap = np.linalg.norm(position[:, None] - position, axis=2) + 99.0 * np.eye(60)
        if gap.min() > 5.0:
            break
        position[gap.min(axis=0).argmin()] = rng.normal(size=3)
        position *= 40.0 / np.linalg.norm(position, axis=1, keepdims=True)
    goal, velocity, new = -position, np.zeros((60, 3)), np.zeros((60, 3))
    flying = crowd_of(60, neighbours=20, reach=43.0)
    least = math.inf
    for _ in range(800):
        wish = goal - position
        wish *= SPEED / np.maximum(np.linalg.norm(wish, axis=1, keepdims=True), SPEED)
        flying.step(position, velocity, wish, new)
        velocity = new.copy()
        position = position + OVERLAP * velocity
        gap = np.linalg.norm(position[:, None] - position, axis=2) + 99.0 * np.eye(60)
        least = min(least, gap.min())
    assert least > RADIUS - 0.01
    assert np.linalg.norm(goal - position, axis=1).max() < 1.0


@pytest.mark.parametrize("which", range(3))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_refused(which, value) -> None:
    state = np.zeros((3, 4, 3))
    state[0, :, 0] = np.arange(4) * 10.0
    state[which, 2, 1] = value
    new = np.full((4, 3), 7.0)
    with pytest.raises(ValueError, match=r"aircraft 2: .*finite"):
        crowd_of(4).step(*state, new)
    assert (new == 7.0).all()


def test_other_bad_input_is_refused() -> None:
    position = np.zeros((4, 3))
    position[3, 0] = -1.6e7
    with pytest.raises(ValueError, match=r"aircraft 3: .*up to 1.5e\+07 m"):
        step(position, np.zeros((4, 3)), np.zeros((4, 3)))
    with pytest.raises(ValueError, match=r"velocity has shape \(3, 3\); allowed: \(4, 3\)"):
        step(np.zeros((4, 3)), np.zeros((3, 3)), np.zeros((4, 3)))
    for reach in (0.0, math.nan, math.inf):
        with pytest.raises(ValueError, match=r"reach_m is .*; allowed: finite and more than 0"):
            step(np.zeros((4, 3)), np.zeros((4, 3)), np.zeros((4, 3)), reach=reach)


def test_a_step_cannot_allocate() -> None:
    assert crowd._step.targetoptions["_nrt"] is False
