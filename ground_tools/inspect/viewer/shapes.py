"""Geometry of drawings: conversion from NED to the viewer's axes, and the shapes of half-spaces."""

from __future__ import annotations

import numpy as np

from companion.arrays import Float32s, Floats
from ground_tools.inspect.explain.why import HalfSpace

ARROW_S = 5.0
"""The length of an arrow is the distance flown at its velocity in this time."""
SQUARE_M = 6.0
"""Half the side of the squares that represent half-spaces."""


def square(position_ned_m: Floats, velocity_ned_mps: Floats, space: HalfSpace) -> Floats:
    """Return a line (7, 3) around a square on a half-space's plane, with a tick to the allowed side.

    Velocities are drawn from the own position, as the arrows are.
    """
    normal = np.array(space.normal_ned)
    on_plane = velocity_ned_mps + normal * space.short_mps(tuple(velocity_ned_mps))
    middle = position_ned_m + ARROW_S * on_plane
    level = np.cross(normal, (0.0, 0.0, 1.0) if abs(normal[2]) < 0.9 else (1.0, 0.0, 0.0))
    side = SQUARE_M * level / np.linalg.norm(level)
    up = np.cross(normal, side)
    corners = [middle + side + up, middle + side - up, middle - side - up, middle - side + up]
    return np.array([middle + 0.5 * SQUARE_M * normal, middle, *corners, corners[0]])


def enu(position_ned_m: Floats) -> Float32s:
    """Convert NED positions to (n, 3) east, north, up."""
    return np.column_stack([position_ned_m[:, 1], position_ned_m[:, 0], -position_ned_m[:, 2]]).astype(
        np.float32
    )
