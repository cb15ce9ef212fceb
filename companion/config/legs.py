"""Keeps the long legs of a timed path level over the round Earth."""

from __future__ import annotations

import itertools
import math

from companion.config.sections import TrajectoryFile, Waypoint
from companion.geometry import LocalFrame, Vec3, between

LONGEST_LEG_M = 5_000.0
"""Longest leg that is flown straight in a local frame; longer ones are divided."""


def level(path: TrajectoryFile) -> TrajectoryFile:
    """The path with waypoints added on long legs, so that they follow the Earth.

    Straight through it, the middle of a leg of 20 km is 8 m too low, and that of 60 km 70 m. Speed and climb
    are those of the whole leg on all of its pieces, though a degree of longitude is shorter nearer to the
    pole: a leg at a limit keeps the limit.
    """
    waypoints = [path.waypoint[0]]
    for a, b in itertools.pairwise(path.waypoint):
        start, end = ((w.lat_deg, w.lon_deg, w.alt_m) for w in (a, b))
        places = between(start, end, LONGEST_LEG_M)
        lengths = [_length_m(*pair) for pair in itertools.pairwise((start, *places, end))]
        whole_m, way_m = sum(lengths), 0.0
        for (lat_deg, lon_deg, _), length_m in zip(places, lengths, strict=False):
            way_m += length_m
            share = way_m / whole_m
            t_s, alt_m = a.t_s + share * (b.t_s - a.t_s), a.alt_m + share * (b.alt_m - a.alt_m)
            waypoints.append(Waypoint(t_s=t_s, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m))
        waypoints.append(b)
    if len(waypoints) == len(path.waypoint):
        return path
    # Of a very long diagonal leg, the pieces nearest to the equator may still be too long. A resolved
    # configuration is read again for a replay, which must not divide them then.
    return level(TrajectoryFile(altitude=path.altitude, waypoint=tuple(waypoints)))


def _length_m(start: Vec3, end: Vec3) -> float:
    north_m, east_m, _ = LocalFrame(*start).to_ned(end[0], end[1], start[2])
    return math.hypot(north_m, east_m)
