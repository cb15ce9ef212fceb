"""Keeps the long legs of a timed path level over the round Earth."""

from __future__ import annotations

import itertools

from companion.config.sections import TrajectoryFile, Waypoint
from companion.geometry import between

LONGEST_LEG_M = 5_000.0
"""Longest leg that is flown straight in a local frame; longer ones are divided."""


def level(path: TrajectoryFile) -> TrajectoryFile:
    """The path with waypoints added on long legs, so that they follow the Earth.

    Straight through it, the middle of a leg of 20 km is 8 m too low, and that of 60 km 70 m.
    """
    waypoints = [path.waypoint[0]]
    for a, b in itertools.pairwise(path.waypoint):
        start, end = ((w.lat_deg, w.lon_deg, w.alt_m) for w in (a, b))
        for share, (lat_deg, lon_deg, alt_m) in between(start, end, LONGEST_LEG_M):
            t_s = a.t_s + share * (b.t_s - a.t_s)
            waypoints.append(Waypoint(t_s=t_s, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m))
        waypoints.append(b)
    return TrajectoryFile(altitude=path.altitude, waypoint=tuple(waypoints))
