"""Poses, places and objects with chosen numbers, for the tests of what follows and fuses them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from companion.config import SensedConfig
from companion.geometry import Vec3
from companion.traffic.sensed.objects import Followed, Objects, _Axis
from companion.traffic.sensed.pose import Pose
from companion.traffic.sensed.seen import Seen

UPRIGHT = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
AT_S = 8.0
"""Time of the first measurement. It and the times after it are exact in binary."""


def pose(at_s: float = AT_S, position: Vec3 = (0.0, 0.0, 0.0), **more: Any) -> Pose:
    values: dict[str, Any] = {"velocity": (0.0, 0.0, 0.0), "turn_rps": 0.0} | more
    return Pose(
        at_s=at_s, position=position, rows=UPRIGHT, yaw_rad=0.0, home_down_m=50.0, local=None, **values
    )


def seen(north: float, east: float, down: float = 0.0, **more: Any) -> Seen:
    values: dict[str, Any] = {"across_m": 0.0, "flat": False} | more
    return Seen((north, east, down), **values)


def objects(*places: Seen, component: int = 196, here: Pose | None = None, **config: Any) -> Objects:
    """Objects that have seen some places once, at `AT_S`."""
    found = Objects(SensedConfig(use=True, **config))
    found.see(component, places, here or pose(), None)
    return found


def followed(**values: Any) -> Followed:
    """An object straight ahead, to the north, that stands."""
    given: dict[str, Any] = {
        "name": "1", "key": None, "at_s": AT_S, "position": (30.0, 0.0, 0.0), "velocity": (0.0, 0.0, 0.0),
        "along": _Axis(0.1, 0.0, 0.1), "across": _Axis(0.5, 0.0, 0.1), "high": _Axis(1.0, 0.0, 1.0),
        "across_m": 1.0, "distance_m": 30.0, "flat": True, "tall": False, "vertical_known": True,
        "tracked": False, "met_mps": (0.0, 0.0, 0.0), "component": 196, "measured": 2,
    } | values  # fmt: skip
    return Followed(**given)


def edge(holds: Callable[[float], bool], most: float) -> float:
    """The largest number up to `most` for which something holds that holds at 0, and not beyond."""
    assert holds(0.0)
    assert not holds(most)
    low, high = 0.0, most
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low
