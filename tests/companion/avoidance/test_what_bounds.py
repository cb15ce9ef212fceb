"""What a decision says of what bounds it: limits, fence, other aircraft."""

from __future__ import annotations

import math
from typing import Any

import pytest

from companion.avoidance import kernels as k
from companion.avoidance.law import Law, LawResult, Neighbour, Situation
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from tests.companion.avoidance.flown.flying import circle

LIMITS = LimitsConfig()


def decided(
    end: Any = (200.0, 0.0, -50.0),
    others: Any = (),
    fence: Any = None,
    at: Any = (0.0, 0.0, -50.0),
    **keys: Any,
) -> LawResult:
    """The first decision of an aircraft that flies 2 m/s north, on a path of 100 s from where it is."""
    one = Law(
        AvoidanceConfig(),
        LIMITS,
        Trajectory([0, 50, 100], [at, (end[0] / 2, end[1] / 2, (end[2] + at[2]) / 2), end]),
        fence,
    )
    return one.decide(Situation(10.0, 10.0, at, (2.0, 0.0, 0.0), 1.5, others, **keys))


def test_nothing_bounds_a_path_within_the_limits() -> None:
    assert decided(at=(0.0, 0.0, -50.0)).limits == ()


@pytest.mark.parametrize(
    ("keys", "limits"),
    [
        ({"end": (200.0, 0.0, -650.0)}, ("climb or ceiling",)),
        ({"end": (200.0, 0.0, 650.0)}, ("descent or floor",)),
        ({"end": (2000.0, 0.0, -50.0)}, ("speed",)),
        ({"ceiling_down_m": -50.0, "end": (200.0, 0.0, -90.0)}, ("climb or ceiling",)),
        ({"floor_down_m": -50.0, "end": (200.0, 0.0, -10.0)}, ("descent or floor",)),
        ({"fence": circle(k.OUT_OF_CIRCLE, (20.0, 0.0), 14.0)}, ("fence",)),
        ({"fence": circle(k.IN_CIRCLE, (90.0, 0.0), 14.0)}, ("outside the fence",)),
        ({"fence": circle(k.IN_CIRCLE, (0.0, 0.0), 90.0)}, ()),
        (
            {"fence": circle(k.OUT_OF_CIRCLE, (20.0, 0.0), 14.0), "ceiling_down_m": -49.0},
            ("climb or ceiling", "fence"),
        ),
    ],
)
def test_limits_are_named_where_they_bind(keys: dict[str, Any], limits: tuple[str, ...]) -> None:
    assert decided(**keys).limits == limits


def test_who_bounds_is_active() -> None:
    """The one ahead, whose plane the velocity lies on; not one beside, nor one that has gone."""
    ahead = Neighbour("ahead", (60.0, 1.0, -50.0), (-2.0, 0.0, 0.0), 0.5, 1.5)
    beside = Neighbour("beside", (20.0, -90.0, -50.0), (2.0, 0.0, 0.0), 0.5, 1.5)
    gone = Neighbour("gone", (-60.0, 5.0, -50.0), (-2.0, 0.0, 0.0), 0.5, 1.5)
    result = decided(others=[gone, beside, ahead])
    assert {t.track_id: t.active for t in result.tracks} == {"ahead": True, "beside": False, "gone": False}
    assert result.conflict
    assert not any(t.active for t in decided(others=[gone, beside]).tracks)


def test_all_that_press_are_active_when_nothing_is_feasible() -> None:
    ring = [
        Neighbour(str(i), (9 * math.cos(a), 9 * math.sin(a), -50.0 + d), (0.0, 0.0, 0.0), 0.0, 0.5)
        for i, (a, d) in enumerate((j * math.pi / 3, d) for j in range(6) for d in (-6.0, 6.0))
    ]
    result = decided(others=ring)
    assert not result.feasible
    assert sum(t.active for t in result.tracks) >= 3


@pytest.mark.parametrize(
    ("velocity", "on"),
    [
        ((3.0, 0, 0), True),
        ((3.0 + 5e-7, 9, 9), True),
        ((3.0 + 2e-6, 0, 0), False),
        ((2.0, 0, 0), True),
        ((4.0, 0, 0), False),
    ],
)
def test_on_a_plane_or_beyond(velocity: Any, on: bool) -> None:
    assert k.on_plane(k.Plane(k.Vector(1.0, 0.0, 0.0), 3.0), k.Vector(*map(float, velocity))) is on
