"""What was flown: positions of all aircraft of a run in one local frame and on one time line.

Positions are the aircraft's own (GLOBAL_POSITION_INT as its heart took it in, or, without any, those of its
decisions), so a separation here is what the aircraft's own navigation says, to within GNSS error.

Time line. In a lock-step run, and among companions on one machine, `now_s` of the steps is one clock for all
and is used as it is. Elsewhere each companion counts from its own boot: there, UTC of the autopilots
(SYSTEM_TIME) puts them together, to within the latency of the links and the error of the autopilots' clocks.
`common_time` says which was used.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pymap3d
from numpy.typing import NDArray

from companion.config import AvoidanceConfig
from companion.errors import ConfigError
from companion.events import Decision, GlobalPosition, Vec3, VehicleTime
from ground_tools.inspect.read_run import AircraftRecord, Run

Array = NDArray[np.float64]

GRID_S = 0.05
"""Step of the time line on which separations are taken."""
MAX_GAP_S = 2.0
"""Between two own positions farther apart than this the place in between is not known."""
SHARED_CLOCK_S = 0.05
"""Clocks that agree with UTC alike to within this are one clock."""
_ZERO = np.zeros(0)


@dataclass(frozen=True, slots=True)
class Path:
    """Where one aircraft was."""

    name: str
    time_s: Array
    """(n,) on the common time line, rising."""
    position_ned_m: Array
    """(n, 3) in the common frame."""
    radius_m: float
    """Conflict radius it was configured with."""


@dataclass(frozen=True, slots=True)
class Separation:
    """Slant distance of two aircraft over the time that both were flying."""

    first: str
    second: str
    time_s: Array
    """(n,)"""
    distance_m: Array
    """(n,), NaN where either position is not known."""
    minimum_m: float | None
    """None where they were never known at once."""
    minimum_time_s: float | None
    required_m: float
    """Both conflict radii together."""


@dataclass(frozen=True, slots=True)
class Flown:
    """All paths of a run."""

    origin: Vec3
    """lat_deg, lon_deg, alt_msl_m of the common frame."""
    paths: tuple[Path, ...]
    offsets_s: dict[str, float]
    """What to add to an aircraft's `now_s` for the common time line."""
    clock: str
    """Which time line it is, in words."""


def flown(run: Run) -> Flown:
    """Paths of all aircraft of a run.

    Raises:
        ConfigError: no aircraft recorded a position.
    """
    offsets, clock = common_time(run)
    fixes = {record.name: _fixes(record) for record in run.aircraft}
    known = [fix for fix in fixes.values() if len(fix)]
    if not known:
        raise ConfigError(f"{run.folder}: no aircraft recorded a position")
    origin = (float(known[0][0, 1]), float(known[0][0, 2]), float(known[0][0, 3]))
    paths = []
    for record in run.aircraft:
        rows = fixes[record.name]
        if len(rows):
            positions = to_ned(rows[:, 1:], origin)
            radius = record.header.config.avoidance if record.header else AvoidanceConfig()
            paths.append(
                Path(record.name, rows[:, 0] + offsets[record.name], positions, radius.conflict_radius_m)
            )
    return Flown(origin, tuple(paths), offsets, clock)


def common_time(run: Run) -> tuple[dict[str, float], str]:
    """What to add to each aircraft's `now_s`, and in words what the time line then is."""
    nothing = dict.fromkeys((record.name for record in run.aircraft), 0.0)
    if len(run.aircraft) == 1:
        return nothing, "the companion's own clock"
    to_utc = {record.name: _utc_offset(record) for record in run.aircraft}
    known = [offset for offset in to_utc.values() if offset is not None]
    if len(known) < len(to_utc):
        silent = ", ".join(name for name, offset in to_utc.items() if offset is None)
        return nothing, f"one clock taken for granted: no UTC from {silent}"
    if max(known) - min(known) <= SHARED_CLOCK_S:
        return nothing, "one clock shared by all aircraft"
    # Small numbers plot better: the line counts from the start of the first aircraft.
    start = min(
        record.steps[0].now_s + offset
        for record, offset in zip(run.aircraft, known, strict=True)
        if record.steps
    )
    return {name: float(o - start) for name, o in zip(to_utc, known, strict=True)}, "UTC of the autopilots"


def separations(paths: tuple[Path, ...]) -> list[Separation]:
    """Separation of every pair, the closest pair first; pairs never known at once come last."""
    found = [_separation(a, b) for a, b in itertools.combinations(paths, 2)]
    return sorted(found, key=lambda s: np.inf if s.minimum_m is None else s.minimum_m)


def to_ned(geodetic: Array, origin: Vec3) -> Array:
    """(n, 3) of lat_deg, lon_deg, alt_m to (n, 3) north, east, down (m) from `origin`."""
    if not len(geodetic):
        return np.zeros((0, 3))
    n, e, d = pymap3d.geodetic2ned(geodetic[:, 0], geodetic[:, 1], geodetic[:, 2], *origin)
    return np.column_stack([n, e, d])


def from_frame(position_ned_m: Array, frame_origin: Vec3, origin: Vec3) -> Array:
    """(n, 3) NED positions (m) of one local frame in another one."""
    if frame_origin == origin or not len(position_ned_m):
        return position_ned_m
    n, e, d = position_ned_m.T
    return to_ned(np.column_stack(pymap3d.ned2geodetic(n, e, d, *frame_origin)), origin)


def _fixes(record: AircraftRecord) -> Array:
    """(n, 4) of now_s, lat_deg, lon_deg, alt_msl_m; now_s strictly rising."""
    rows: list[tuple[float, ...]] = [
        (step.now_s, event.lat_deg, event.lon_deg, event.alt_msl_m)
        for step in record.steps
        for event in step.events
        if isinstance(event, GlobalPosition)
    ]
    if not rows:
        rows = [
            (step.now_s, *_geodetic(command))
            for step in record.steps
            for command in step.commands
            if isinstance(command, Decision)
        ]
    if not rows:
        return np.zeros((0, 4))
    table = np.asarray(rows, dtype=np.float64)
    # Of several in one step the last counts.
    last: Array = table[np.append(np.diff(table[:, 0]) > 0, True)]
    return last


def _geodetic(decision: Decision) -> Vec3:
    lat, lon, alt = pymap3d.ned2geodetic(*decision.position_ned_m, *decision.origin)
    return float(lat), float(lon), float(alt)


def _utc_offset(record: AircraftRecord) -> float | None:
    offsets = [
        event.utc_s - step.now_s
        for step in record.steps
        for event in step.events
        if isinstance(event, VehicleTime) and event.utc_s is not None
    ]
    return float(np.median(offsets)) if offsets else None


def _separation(first: Path, second: Path) -> Separation:
    required = first.radius_m + second.radius_m
    start = max(first.time_s[0], second.time_s[0])
    end = min(first.time_s[-1], second.time_s[-1])
    if start > end:
        return Separation(first.name, second.name, _ZERO, _ZERO, None, None, required)
    # The samples themselves belong to the line: the closest approach must not fall between its points.
    grid = np.arange(start, end, GRID_S)
    samples = np.concatenate([first.time_s, second.time_s, [end]])
    time = np.union1d(grid, samples[(samples >= start) & (samples <= end)])
    distance = np.linalg.norm(_at(first, time) - _at(second, time), axis=1)
    if np.isnan(distance).all():
        return Separation(first.name, second.name, time, distance, None, None, required)
    closest = int(np.nanargmin(distance))
    return Separation(
        first.name, second.name, time, distance, float(distance[closest]), float(time[closest]), required
    )


def _at(path: Path, time_s: Array) -> Array:
    """(n, 3) positions at times inside the path's, NaN inside gaps."""
    position = np.column_stack([np.interp(time_s, path.time_s, axis) for axis in path.position_ned_m.T])
    after = np.clip(np.searchsorted(path.time_s, time_s), 1, max(len(path.time_s) - 1, 1))
    if len(path.time_s) > 1:
        gap = path.time_s[after] - path.time_s[after - 1]
        position[gap > MAX_GAP_S] = np.nan
    return position
