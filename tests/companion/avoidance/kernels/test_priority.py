"""The order in which planes count, and what it is for."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from companion.avoidance import kernels as k
from companion.avoidance.law import Law, LawResult, Neighbour, Situation
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig

SPEED = 10.0


def asked(first_class: Any, second_class: Any, hard: Any = ()) -> k.Asked:
    """Planes as rows of a normal and the least component along it."""
    rows = np.array([*hard, *first_class, *second_class], float).reshape(-1, 4)
    last = len(hard) + len(first_class)
    return k.Asked(rows, len(hard), last, len(rows), np.zeros_like(rows))


EAST, WEST, NORTH = (0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)


@pytest.mark.parametrize("least", [2.0, 6.0, 20.0])
def test_whoever_yields_bends_nothing_of_what_the_others_allow(least: float) -> None:
    """The first asks for 3 m/s to the west at least, the other one for the east."""
    feasible, v = k.solve_in_order(asked([(*WEST, 3.0)], [(*EAST, least)]), SPEED, k.Vector(5.0, 0.0, 0.0))
    assert not feasible
    assert v.e == pytest.approx(-3.0, abs=0.03)


def test_without_contradiction_both_are_kept() -> None:
    feasible, v = k.solve_in_order(asked([(*WEST, 3.0)], [(*NORTH, 7.0)]), SPEED, k.Vector(5.0, 0.0, 0.0))
    assert feasible
    assert tuple(v) == pytest.approx((7.0, -3.0, 0.0))


def test_where_the_first_cannot_be_kept_the_others_have_what_is_left() -> None:
    """The first ones ask for the west and the east: whatever is done, one of them is 4 m/s short."""
    torn, wish = [(*WEST, 3.0), (*EAST, 5.0)], k.Vector(2.0, 0.0, 0.0)
    planes = asked(torn, [(*NORTH, 7.0)])
    before = planes.planes.copy()
    feasible, v = k.solve_in_order(planes, SPEED, wish)
    assert not feasible
    assert tuple(v) == pytest.approx((7.0, 1.0, 0.0), abs=0.05)
    assert sorted(planes.planes[:2].tolist()) == sorted(before[:2].tolist())


@pytest.mark.parametrize("seed", range(40))
def test_the_last_never_worsen_the_most_violated_of_the_first(seed: int) -> None:
    rng = np.random.default_rng(seed)

    def planes(count: int, most: float) -> list[tuple[float, ...]]:
        normals = rng.standard_normal((count, 3))
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        return [(*n, float(rng.uniform(-5.0, most))) for n in normals.tolist()]

    first, others = planes(int(rng.integers(1, 12)), float(rng.uniform(-2.0, 9.0))), planes(6, 9.0)
    wish = k.Vector(*rng.uniform(-6.0, 6.0, 3).tolist())

    def worst(v: k.Vector) -> float:
        return max(max(least - np.dot(n, v) for *n, least in first), 0.0)

    alone, both = (k.solve_in_order(asked(first, more), SPEED, wish)[1] for more in ([], others))
    assert worst(both) <= worst(alone) + 1e-6
    assert math.sqrt(k.dot(both, both)) <= SPEED + 1e-6


def test_hard_planes_come_before_all() -> None:
    planes = asked([(*EAST, 9.0)], [(*EAST, 9.5)], hard=[(*WEST, 1.0)])
    assert k.solve_in_order(planes, SPEED, k.Vector(0.0, 0.0, 0.0))[1].e == pytest.approx(-1.0, abs=1e-6)


def decided(*neighbours: Neighbour) -> LawResult:
    """The decision of an aircraft that flies north at 5 m/s."""
    limits = LimitsConfig(max_speed_mps=SPEED, max_acceleration_mps2=20.0)
    path = Trajectory([-100.0, 100.0], [(-500.0, 0.0, -80.0), (500.0, 0.0, -80.0)])
    law = Law(AvoidanceConfig(), limits, path)
    situation = Situation(0.0, 0.0, (0.0, 0.0, -80.0), (5.0, 0.0, 0.0), 1.5, neighbours)
    return law.decide(situation)


def other(name: str, at: Any, velocity: Any = (5.0, 0.0, 0.0), **fields: Any) -> Neighbour:
    place = (at[0], at[1], at[2] - 80.0)
    return Neighbour(name, place, velocity, 0.0, 1.5, **fields)


@pytest.mark.parametrize("ghost_first", [True, False])
def test_one_inside_its_volume_does_not_push_us_into_another(ghost_first: bool) -> None:
    """A ghost 9 m to the east, and an aircraft 26 m to the west that flies along."""
    ghost, honest = ("A", "B") if ghost_first else ("B", "A")
    beside = other(honest, (0.0, -26.0, 0.0))
    pushed, alone, kept = (
        decided(other(ghost, (0.0, 9.0, 0.0), (5.0, -4.0, 0.0), yields=yields), *rest).chosen_ned_mps
        for yields, rest in ((False, (beside,)), (True, ()), (True, (beside,)))
    )
    assert alone[1] < -3.0
    assert pushed[1] < -1.0
    assert kept[1] > -0.5


def test_those_that_yield_are_reported_as_such() -> None:
    views = decided(other("A", (0.0, 9.0, 0.0), yields=True), other("B", (0.0, -60.0, 0.0))).tracks
    assert [(view.track_id, view.yields) for view in views] == [("A", True), ("B", False)]
