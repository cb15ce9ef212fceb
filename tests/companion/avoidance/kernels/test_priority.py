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
    return k.Asked(rows, len(hard), len(hard), last, len(rows), np.zeros_like(rows))


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


def test_where_the_first_cannot_be_kept_the_others_change_nothing() -> None:
    wish = k.Vector(5.0, 0.0, 0.0)
    torn = [(*WEST, 3.0), (*EAST, 5.0)]
    alone = k.solve_in_order(asked(torn, []), SPEED, wish)
    feasible, v = k.solve_in_order(asked(torn, [(*NORTH, 9.0)]), SPEED, wish)
    assert (feasible, tuple(v)) == (False, tuple(alone[1]))


def test_hard_planes_come_before_all() -> None:
    planes = asked([(*EAST, 9.0)], [(*EAST, 9.5)], hard=[(*WEST, 1.0)])
    assert k.solve_in_order(planes, SPEED, k.Vector(0.0, 0.0, 0.0))[1].e == pytest.approx(-1.0, abs=1e-6)


def decided(*neighbours: Neighbour, wanted: Any = (5.0, 0.0, 0.0), crewed: bool = False) -> LawResult:
    limits = LimitsConfig(max_speed_mps=SPEED, max_acceleration_mps2=20.0)
    ways = [(t, (*(t * v for v in wanted[:2]), -80.0)) for t in (-100.0, 100.0)]
    law = Law(AvoidanceConfig(), limits, Trajectory(*zip(*ways, strict=True)))  # type: ignore[arg-type]
    situation = Situation(0.0, 0.0, (0.0, 0.0, -80.0), wanted, 1.5, neighbours)
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


@pytest.mark.parametrize("known", [True, False])
def test_crewed_traffic_is_not_met_because_small_aircraft_stand_around_us(known: bool) -> None:
    """They hover to both sides of the way that is chosen without them: it is left in another direction."""
    coming = other(
        "C", (1200.0, 0.0, 0.0), (-40.0, 0.0, 0.0), crewed=True, adsb=True, share=1.0, vertical_known=known,
        sigma_down_m=15.0,
    )  # fmt: skip
    free = decided(coming, wanted=(0.0, 0.0, 0.0)).chosen_ned_mps
    size = math.hypot(*free[:2])
    assert size > 1.0
    turn = math.atan2(free[1], free[0])
    drones = [
        other(f"D{n}", (25.0 * math.cos(turn + a), 25.0 * math.sin(turn + a), 0.0), (0.0, 0.0, 0.0))
        for n, a in enumerate((-0.6, 0.0, 0.6))
    ]
    hemmed = decided(coming, *drones, wanted=(0.0, 0.0, 0.0)).chosen_ned_mps
    # Faster than creeping along the planes of those who stand in the way, and not towards them.
    assert math.hypot(*hemmed[:2]) > 0.5 * size
    assert hemmed[0] * free[0] + hemmed[1] * free[1] < 0.3 * size * size
