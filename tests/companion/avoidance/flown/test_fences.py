"""Fences flown: whatever path and traffic ask for, the aircraft stays on the right side."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.kernels import BRAKES, LAG_S, STOP_LAG_S
from companion.avoidance.law import Law, Neighbour, Situation
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from tests.companion.avoidance.flown.flying import Hears, circle, fly, polygon, room

SLOW = LimitsConfig()  # 5 m/s, 1 m/s^2
FAST = LimitsConfig(max_speed_mps=20.0, max_acceleration_mps2=3.0)

# Of a side of 2, scaled with the speed; all corners are of 90 deg and more. The path
# runs through what it must not.
SQUARE = ((-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0))
NOTCHED = ((-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, 0.9), (0.2, 0.0), (1.0, -0.9), (1.0, -1.0))
AREAS: dict[str, tuple[Any, tuple[float, float], tuple[float, float]]] = {
    # fence of a size, where the path begins, which way it goes on and on
    "in a square": (lambda s: polygon(k.IN_POLYGON, *_scaled(SQUARE, s)), (0.0, 0.0), (1.0, 0.3)),
    "in a square, into a corner": (lambda s: polygon(k.IN_POLYGON, *_scaled(SQUARE, s)), (0, 0), (1.0, 1.0)),
    "in a notched square": (lambda s: polygon(k.IN_POLYGON, *_scaled(NOTCHED, s)), (0.5, 0.8), (0.0, -1.0)),
    "in a notched square, at its notch": (
        lambda s: polygon(k.IN_POLYGON, *_scaled(NOTCHED, s)),
        (-0.8, 0.02),
        (1.0, 0.0),
    ),
    "in a circle": (lambda s: circle(k.IN_CIRCLE, (0.0, 0.0), s), (-0.2, 0.1), (0.8, -0.6)),
    "out of a square": (lambda s: polygon(k.OUT_OF_POLYGON, *_scaled(SQUARE, s)), (-2.0, 0.5), (1.0, 0.0)),
    "out of a notched square": (
        lambda s: polygon(k.OUT_OF_POLYGON, *_scaled(NOTCHED, s)),
        (2.0, 0.05),
        (-1.0, 0.0),
    ),
    "out of a circle": (lambda s: circle(k.OUT_OF_CIRCLE, (0.0, 0.0), s), (-2.0, 0.4), (1.0, 0.0)),
    "between two": (
        lambda s: np.vstack(
            [
                polygon(k.IN_POLYGON, *_scaled(SQUARE, s)),
                circle(k.OUT_OF_CIRCLE, (0.5 * s, 0.5 * s), 0.3 * s, number=1),
            ]
        ),
        (0.4, -0.6),
        (0.05, 1.0),
    ),
}


def _scaled(corners: Any, size: float) -> list[tuple[float, float]]:
    return [(n * size, e * size) for n, e in corners]


def straight(start: Any, direction: Any, speed: float) -> Trajectory:
    """For 100 s at a speed, 50 m up."""
    n, e = np.array(direction) / math.hypot(*direction)
    way = 100.0 * speed
    return Trajectory([0, 100], [(*start, -50.0), (start[0] + way * n, start[1] + way * e, -50.0)])


def pursued(speed: float, heading: float) -> Hears:
    """Two that come from behind and from one side, wherever it goes, and are always 5 s from it."""

    def hears(now: float, p: Floats, v: Floats) -> list[Neighbour]:
        found = []
        for number, turn in enumerate((0.0, 0.9)):
            n, e = math.cos(heading + turn), math.sin(heading + turn)
            place = (p[0] - 4.0 * speed * n, p[1] - 4.0 * speed * e, float(p[2]))
            found.append(Neighbour(f"pursuer-{number}", place, (speed * n, speed * e, 0.0), 0.0, 0.5))
        return found

    return hears


@pytest.mark.parametrize("pressed", [False, True])
@pytest.mark.parametrize("limits", [SLOW, FAST], ids=["5 m/s", "20 m/s"])
@pytest.mark.parametrize("name", AREAS)
def test_no_fence_is_crossed(name: str, limits: LimitsConfig, pressed: bool) -> None:
    """A path at full speed through the border, alone or with traffic that drives it there."""
    speed = limits.max_speed_mps
    make, start, direction = AREAS[name]
    size = 20.0 * speed
    fence, heading = make(size), math.atan2(direction[1], direction[0])
    path = straight((start[0] * size, start[1] * size), direction, 0.9 * speed)
    one = Law(AvoidanceConfig(), limits, path, fence)
    flight = fly(one, 45.0, hears=pursued(speed, heading) if pressed else lambda now, p, v: ())
    kept = room(fence, flight.position).min()
    assert 0.0 < kept < 2.0 * k.FENCE_MARGIN_M
    assert any("fence" in result.limits for result in flight.results)
    assert not any("outside the fence" in result.limits for result in flight.results)


@pytest.mark.parametrize("limits", [SLOW, FAST], ids=["5 m/s", "20 m/s"])
@pytest.mark.parametrize(
    "name", ["in a square, into a corner", "out of a square", "out of a circle", "in a circle"]
)
@pytest.mark.parametrize("seed", range(3))
def test_no_fence_is_crossed_with_noise(name: str, limits: LimitsConfig, seed: int) -> None:
    """The measured place keeps a margin of 2 m and twice the declared 1.5 m: the true one, off by an error,
    loses no more of it than that error."""
    speed = limits.max_speed_mps
    make, start, direction = AREAS[name]
    size = 20.0 * speed
    fence = make(size)
    path = straight((start[0] * size, start[1] * size), direction, 0.9 * speed)
    flight = fly(Law(AvoidanceConfig(), limits, path, fence), 45.0, sigma_m=1.5, seed=seed)
    error = np.linalg.norm(flight.error[:, :2], axis=1).max()
    assert room(fence, flight.position).min() > 4.9 - error
    assert room(fence, flight.position + flight.error).min() < 5.1
    assert not any("outside the fence" in result.limits for result in flight.results)


BEYOND = [
    ("in a square", polygon(k.IN_POLYGON, *_scaled(SQUARE, 100.0)), (130.0, 20.0)),
    ("in a square, at a corner", polygon(k.IN_POLYGON, *_scaled(SQUARE, 100.0)), (115.0, 125.0)),
    ("in a circle", circle(k.IN_CIRCLE, (0.0, 0.0), 100.0), (-90.0, 90.0)),
    ("out of a square", polygon(k.OUT_OF_POLYGON, *_scaled(SQUARE, 100.0)), (80.0, -10.0)),
    ("out of a circle", circle(k.OUT_OF_CIRCLE, (0.0, 0.0), 100.0), (70.0, 10.0)),
]


@pytest.mark.parametrize(("fence", "start"), [b[1:] for b in BEYOND], ids=[b[0] for b in BEYOND])
def test_beyond_a_fence_the_way_is_back(fence: Floats, start: tuple[float, float]) -> None:
    """Standing beyond it, with a path that stays there: it says so, comes back and stays."""
    here = (*start, -50.0)
    path = Trajectory([0, 100], [here, (start[0] + 1.0, start[1], -50.0)])
    flight = fly(Law(AvoidanceConfig(), SLOW, path, fence), 60.0)
    assert "outside the fence" in flight.results[0].limits
    rooms = room(fence, flight.position)
    assert rooms[0] < 0.0
    back = int(np.argmax(rooms > 0.0))
    assert 0.0 < flight.time_s[back] < 25.0
    assert rooms[back:].min() > 0.0
    assert not any("outside the fence" in r.limits for r in flight.results[back // 2 + 1 :])
    speed = np.linalg.norm(np.diff(flight.position, axis=0), axis=1).max() / 0.1
    assert speed == pytest.approx(2.5, abs=1e-3)  # half of the greatest


def test_without_a_breach_nobody_is_outside() -> None:
    flight = fly(Law(AvoidanceConfig(), SLOW, straight((0, 0), (1, 0), 2.0), BEYOND[0][1]), 40.0)
    assert not any("outside the fence" in r.limits for r in flight.results)


@pytest.mark.parametrize("speed", [2.0, 4.5])
@pytest.mark.parametrize("sigma_m", [0.0, 1.5])
def test_a_path_along_a_fence_is_flown(speed: float, sigma_m: float) -> None:
    """Just clear of the margin nothing pushes it off, whichever side of the fence it is."""
    margin = k.FENCE_MARGIN_M + 2.0 * sigma_m
    for kind, east in ((k.IN_POLYGON, 100.0 - margin), (k.OUT_OF_POLYGON, 100.0 + margin)):
        fence = polygon(kind, *_scaled(SQUARE, 100.0))
        off = -0.01 if kind == k.IN_POLYGON else 0.01
        line = [(n, east + off, -50.0) for n in (-90.0, 90.0)]
        one = Law(AvoidanceConfig(), SLOW, Trajectory([0, 180.0 / speed], line), fence)
        flight = fly(one, 150.0 / speed, start_s=30.0 / speed, velocity=(speed, 0.0, 0.0), sigma_m=sigma_m)
        assert abs(flight.position[:, 1] - east - off).max() < 1e-9
        assert abs(flight.position[:, 0] + 90.0 - speed * flight.time_s).max() < 1e-6


# ---------------------------------------------------------------- corners, and the way back from the margin


@pytest.mark.parametrize("limits", [SLOW, FAST], ids=["5 m/s", "20 m/s"])
@pytest.mark.parametrize("corner_deg", [75, 60, 45, 30])
def test_an_acute_corner_is_not_crossed(corner_deg: int, limits: LimitsConfig) -> None:
    """Two walls at which it stops in time each are to be stopped at together."""
    speed = limits.max_speed_mps
    length = 30.0 * speed
    half = length * math.tan(math.radians(0.5 * corner_deg))
    fence = polygon(k.IN_POLYGON, (0.0, 0.0), (-length, half), (-length, -half))
    flight = fly(Law(AvoidanceConfig(), limits, straight((-0.9 * length, 0), (1, 0), speed), fence), 60.0)
    rooms = room(fence, flight.position)
    assert 0.0 < rooms.min() < 2.5


@pytest.mark.parametrize(
    ("limits", "radius", "speed"), [(SLOW, 50.0, 4.0), (SLOW, 100.0, 2.0), (FAST, 200.0, 16.0)]
)
def test_gliding_along_the_inside_of_a_circle_does_not_cross_it(
    limits: LimitsConfig, radius: float, speed: float
) -> None:
    """A path 10 m outside of it, round and round: along its tangents it would get out step by step."""
    rate = speed / (radius + 10.0)
    times = [2.0 * i for i in range(101)]
    points = [((radius + 10) * math.cos(rate * t), (radius + 10) * math.sin(rate * t), -50.0) for t in times]
    fence = circle(k.IN_CIRCLE, (0.0, 0.0), radius)
    one = Law(AvoidanceConfig(), limits, Trajectory(times, points), fence)
    flight = fly(one, 200.0, position=(radius - 30.0, 0.0, -50.0))
    # Along its tangent it still stops within the margin, and it flies no farther inside than that takes.
    stop = speed * (LAG_S + STOP_LAG_S + speed / (2.0 * BRAKES * limits.max_acceleration_mps2))
    inner = radius - k.FENCE_MARGIN_M
    assert 0.0 < room(fence, flight.position).min() < radius - math.sqrt(inner * inner - stop * stop) + 0.5


def met_by(*start: float) -> tuple[Hears, Any]:
    """One that comes south at 2 m/s and sees nobody, and where it is."""

    def place(t: Any) -> Floats:
        return np.array(start) + np.multiply.outer(t, (-2.0, 0.0, 0.0))

    return lambda now, p, v: [Neighbour("b", tuple(place(now)), (-2.0, 0.0, 0.0), 0.0, 0.5)], place


@pytest.mark.parametrize("tilt_rad", [0.0, 1e-10, 1e-9, 1e-8, -1e-9, -1e-8])
def test_head_on_in_a_corridor_of_nearly_parallel_walls(tilt_rad: float) -> None:
    """Narrower than both margins; the walls ask for opposite ways, which rounding or a hair of tilt must not
    make impossible together: the other is passed above or below, and neither wall is crossed."""
    wider = 600.0 * tilt_rad
    fence = polygon(k.IN_POLYGON, (-300.0, -3.0), (-300.0, 3.0), (300.0, 3.0 + wider), (300.0, -3.0))
    hears, place = met_by(150.0, 0.0, -50.0)
    path = straight((-100.0, 0.0), (1.0, 0.0), 4.0)
    flight = fly(Law(AvoidanceConfig(), SLOW, path, fence), 80.0, hears=hears, sigma_m=1.5)
    assert np.linalg.norm(flight.position - place(flight.time_s), axis=1).min() > 10.0
    assert room(fence, flight.position).min() > 0.0
    assert all(result.feasible for result in flight.results)


@pytest.mark.parametrize("down_m", [-62.0, -56.0, -52.0, -46.0])
def test_in_a_thin_layer_others_are_avoided(down_m: float) -> None:
    """Above, in and below a layer of 4 m, with little acceleration: what leads back from one bound may be
    faster than what still stops at the other."""
    limits = LimitsConfig(max_acceleration_mps2=0.3)
    hears, place = met_by(70.0, 0.0, down_m)
    here = (0.0, 0.0, down_m)
    law = Law(AvoidanceConfig(), limits, Trajectory([0, 100], [here, (200.0, 0.0, down_m)]))
    p, v, command, nearest = np.array(here), np.array([2.0, 0.0, 0.0]), np.array([2.0, 0.0, 0.0]), math.inf
    for tick in range(300):
        now = 0.2 * tick
        situation = Situation(
            now, now, tuple(p), tuple(v), 0.5, hears(now, p, v), floor_down_m=-50.0, ceiling_down_m=-54.0
        )
        result = law.decide(situation)
        assert result.feasible
        command = np.array(result.chosen_ned_mps)
        v += (command - v) * 0.4
        p = p + 0.2 * v
        nearest = min(nearest, float(np.linalg.norm(p - place(now + 0.2))))
    assert nearest > 10.0
    assert -54.1 < p[2] < -49.9


@pytest.mark.parametrize("kind", [k.IN_POLYGON, k.OUT_OF_POLYGON])
@pytest.mark.parametrize("spot", [*_scaled(SQUARE, 100.0), (-100.0, 3.0), (20.0, 100.0)])
def test_on_the_border_itself_others_are_avoided(kind: float, spot: tuple[float, float]) -> None:
    """On a corner or an edge nothing tells the sides apart: no wall that touches it says anything."""
    fence = polygon(kind, *_scaled(SQUARE, 100.0))
    here = (*spot, -50.0)
    hears, place = met_by(spot[0] + 30.0, spot[1] + 1.0, -50.0)
    path = Trajectory([0, 100], [here, (spot[0] + 1.0, *here[1:])])
    one = Law(AvoidanceConfig(), SLOW, path, fence)
    first = one.decide(Situation(0.0, 0.0, here, (0.0, 0.0, 0.0), 0.5, hears(0.0, *np.zeros((2, 3)))))
    assert np.isfinite(first.chosen_ned_mps).all()
    asked = one._work.planes[: one._hard + 1, :3]
    np.testing.assert_allclose(np.linalg.norm(asked, axis=1), 1.0, atol=1e-12)
    flight = fly(Law(AvoidanceConfig(), SLOW, path, fence), 40.0, hears=hears, sigma_m=0.5)
    assert np.isfinite(flight.position).all()
    assert np.linalg.norm(flight.position - place(flight.time_s), axis=1).min() > 10.0
    assert room(fence, flight.position)[-1] > 0.0


OVERLAPPING = [
    np.vstack([circle(k.OUT_OF_CIRCLE, (0.0, 0.0), 30.0), circle(k.OUT_OF_CIRCLE, (40.0, 0.0), 30.0, 1)]),
    np.vstack(
        [
            polygon(k.OUT_OF_POLYGON, *_scaled(SQUARE, 30.0)),
            polygon(k.OUT_OF_POLYGON, (0.0, 0.0), (0.0, 70.0), (70.0, 70.0), (70.0, 0.0), number=1),
        ]
    ),
]


@pytest.mark.parametrize("fence", OVERLAPPING, ids=["circles", "squares"])
@pytest.mark.parametrize("start", [(18.0, 3.0), (22.0, 5.0), (15.0, 14.0), (26.0, 9.0)])
def test_from_inside_of_two_it_leaves_both(fence: Floats, start: tuple[float, float]) -> None:
    here = (*start, -50.0)
    path = Trajectory([0, 300], [here, (start[0] + 1.0, *here[1:])])
    flight = fly(Law(AvoidanceConfig(), SLOW, path, fence), 90.0)
    rooms = room(fence, flight.position)
    assert rooms[0] < 0.0
    assert rooms[-300:].min() > 0.0
