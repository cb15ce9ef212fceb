"""Flown paths: positions of all aircraft of a run in one local frame and on one time line.

Simulated aircraft leave their true positions in the run folder. If every aircraft has them, paths and
separations are based on true positions. Otherwise they are based on the aircraft's own positions: from
GLOBAL_POSITION_INT as the companion's core received it or, without any, from its decisions. A separation then
is as accurate as the aircraft's own navigation, which means to within GNSS error. `Flown.positions` states
which of the two was used.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pymap3d

from companion.arrays import Floats
from companion.config import AvoidanceConfig
from companion.errors import ConfigError
from companion.events import Heartbeat, Landed, LandedState
from companion.geometry import Vec3
from ground_tools.inspect.read.read_run import AircraftRecord, Run
from ground_tools.inspect.read.spill import BLOCK, release, spilled
from ground_tools.inspect.read.timeline import TimeLine, time_line
from ground_tools.inspect.read.truth import ORIGIN

Line = Callable[[Floats, Floats], tuple[Floats, Floats]]
"""Reduces (n,) times and distances to those that are kept."""

GRID_S = 0.05
"""Time step at which separations are computed."""
PART_S = 600.0
"""Length of the parts in which a pair's separation is computed."""
MAX_GAP_S = 2.0
"""If two own positions are farther apart in time than this, the position in between is unknown."""
_SPARSE = 3.0
"""If samples are rare, only a silence of this many times their usual interval is a gap."""
MAX_ERROR_M = 200.0
"""True positions farther than this from the aircraft's own positions belong to another frame or flight."""
_FLIES_MPS, _FLIES_M = 3.0, 10.0
"""An aircraft that was faster than this, or whose altitude changed by more than this, has flown."""
SAME_M = 2.0
"""Two recordings of one aircraft are closer to each other than this if their clocks agree to about 0.1 s."""
TRUE = "true positions"
OWN = "own GNSS positions"
_ZERO = np.zeros(0)


@dataclass(frozen=True, slots=True)
class Path:
    """Positions of one aircraft over time."""

    name: str
    time_s: Floats
    """(n,) rising times on the common time line."""
    position_ned_m: Floats
    """(n, 3) in the common frame."""
    radius_m: float
    """Configured conflict radius."""
    on_ground_s: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    """(n, 2) start and end of each span in which the aircraft stood on the ground or was disarmed."""


@dataclass(frozen=True, slots=True)
class Separation:
    """Slant distance of two aircraft over the time in which both were recorded."""

    first: str
    second: str
    time_s: Floats
    """(n,)"""
    distance_m: Floats
    """(n,), NaN if either position is unknown or either aircraft is on the ground."""
    minimum_m: float | None
    """None if the two were never known to be in the air at the same time."""
    minimum_time_s: float | None
    required_m: float
    """Sum of both conflict radii."""


@dataclass(frozen=True, slots=True)
class Flown:
    """All paths of a run."""

    origin: Vec3
    """lat_deg, lon_deg, alt_msl_m of the common frame."""
    paths: tuple[Path, ...]
    """Flown paths, from the kind of positions that `positions` names."""
    own: tuple[Path, ...]
    """Paths by the aircraft's own positions."""
    positions: str
    """TRUE or OWN."""
    offsets_s: dict[str, float]
    """For each aircraft, the offset from its `now_s` to the common time line."""
    clock: str
    """Description of the time line."""
    from_path: bool
    """True if time 0 is the start of the timed paths."""
    problems: tuple[str, ...]
    """Which paths are placed wrongly in time, why true positions were found but not used, and possible
    duplicate recordings, one line each."""
    utc_at_zero_s: float | None
    """UTC at time 0 of the common time line; None if unknown."""


def flown(run: Run) -> Flown:
    """Return the paths of all aircraft of a run.

    Raises:
        ConfigError: No aircraft recorded a position.
    """
    line = time_line(run)
    fixes = {record.name: fixes_of(record) for record in run.aircraft}
    known = [fix for fix in fixes.values() if len(fix)]
    has_truth = any(record.truth is not None for record in run.aircraft)
    if not known and not has_truth:
        raise ConfigError(f"{run.folder}: no aircraft recorded a position")
    origin = ORIGIN if has_truth else (float(known[0][0, 1]), float(known[0][0, 2]), float(known[0][0, 3]))
    own = tuple(
        Path(
            record.name,
            fixes[record.name][:, 0] + line.offsets_s[record.name],
            _positions(fixes[record.name], origin),
            _radius_m(record),
            on_ground(record) + line.offsets_s[record.name],
        )
        for record in run.aircraft
        if len(fixes[record.name])
    )
    true, problem = _true_paths(run, line, own) if has_truth else ((), None)
    if not true and not own:
        raise ConfigError(
            f"{run.folder}: no aircraft recorded a position, and the true positions are not used: {problem}"
        )
    problems = line.problems
    problems += () if problem is None else (f"the true positions are not used: {problem}",)
    problems += _twice(own) if run.others else ()
    kind = TRUE if true else OWN
    return Flown(
        origin=origin,
        paths=true or own,
        own=own,
        positions=kind,
        offsets_s=line.offsets_s,
        clock=line.words,
        from_path=line.from_path,
        problems=problems,
        utc_at_zero_s=line.utc_at_zero_s,
    )


def placed(run: Run) -> Flown:
    """Return the paths of all aircraft. If no aircraft recorded a position, return only the clocks.

    The frame of a run without positions has no meaning.
    """
    try:
        return flown(run)
    except ConfigError:
        pass
    line = time_line(run)
    return Flown(
        origin=(0.0, 0.0, 0.0),
        paths=(),
        own=(),
        positions=OWN,
        offsets_s=line.offsets_s,
        clock=line.words,
        from_path=line.from_path,
        problems=(*line.problems, "No aircraft recorded a position, so nothing is drawn in space."),
        utc_at_zero_s=line.utc_at_zero_s,
    )


def _true_paths(run: Run, line: TimeLine, own: tuple[Path, ...]) -> tuple[tuple[Path, ...], str | None]:
    """Return the true paths of all aircraft; or no paths, and the reason."""
    if line.utc_at_zero_s is None:
        return (), f"their times are UTC, but the time line is {line.words}"
    paths = []
    for record in run.aircraft:
        if record.truth is None:
            return (), f"those of {record.name} are missing"
        time = record.truth[:, 0] - line.utc_at_zero_s
        ground = on_ground(record) + line.offsets_s[record.name]
        paths.append(Path(record.name, time, record.truth[:, 1:], _radius_m(record), ground))
    by_name = {path.name: path for path in own}
    for path in paths:
        if path.name in by_name and (away := _median_distance_m(path, by_name[path.name])) > MAX_ERROR_M:
            return (), f"those of {path.name} are {away:.0f} m from its own positions"
    return tuple(paths), None


def _twice(own: tuple[Path, ...]) -> tuple[str, ...]:
    """Report pairs of paths so close together that they are probably one aircraft recorded twice."""
    return tuple(
        f"{one.name} and {other.name} were within {SAME_M:g} m of each other most of the time; if they are "
        "one aircraft recorded twice, their separation is meaningless"
        for one, other in itertools.combinations(own, 2)
        if _median_distance_m(one, other) < SAME_M
    )


def _median_distance_m(first: Path, second: Path) -> float:
    """Median distance over the time in which both are known; infinite if there is none."""
    inside = (second.time_s >= first.time_s[0]) & (second.time_s <= first.time_s[-1])
    away = np.linalg.norm(at(first, second.time_s[inside]) - second.position_ned_m[inside], axis=1)
    known = away[~np.isnan(away)]
    return float(np.median(known)) if len(known) else float("inf")


def _radius_m(record: AircraftRecord) -> float:
    return (record.header.config.avoidance if record.header else AvoidanceConfig()).conflict_radius_m


def began_in_flight(record: AircraftRecord) -> bool:
    """Return whether an onboard log shows a flight but no arming, so that it is not known when the aircraft
    was armed.

    ArduPilot logs only changes of the arming. A log that begins in flight, as after a restart in the air, or
    whose beginning is damaged, therefore looks disarmed to its end.
    """
    beats = [what for _, what in record.facts.rare if isinstance(what, Heartbeat)]
    if record.log != "onboard" or not beats or any(beat.armed for beat in beats):
        return False
    fixes, speed, low, high = record.facts.fixes, 0.0, np.inf, -np.inf
    for at_row in range(0, len(fixes), BLOCK):
        rows = fixes[at_row : at_row + BLOCK]
        speed = max(speed, float(np.hypot(rows[:, 4], rows[:, 5]).max()))
        low, high = min(low, float(rows[:, 3].min())), max(high, float(rows[:, 3].max()))
        release(fixes)
    return speed > _FLIES_MPS or high - low > _FLIES_M


def on_ground(record: AircraftRecord) -> Floats:
    """Return the spans (n, 2) of `now_s` on the ground or disarmed. An unknown state counts as flying."""
    spans: list[tuple[float, float]] = []
    landed, armed, since_s = False, True, None
    unknown = began_in_flight(record)
    for now_s, what in record.facts.rare:
        if isinstance(what, LandedState):
            landed = what.landed is Landed.ON_GROUND
        elif isinstance(what, Heartbeat):
            armed = what.armed or unknown
        stands = landed or not armed
        if stands and since_s is None:
            since_s = now_s
        elif not stands and since_s is not None:
            spans.append((since_s, now_s))
            since_s = None
    if since_s is not None:
        spans.append((since_s, np.inf))
    return np.array(spans).reshape(-1, 2)


def separations(paths: tuple[Path, ...]) -> list[Separation]:
    """Return the separation of every pair, closest first. Pairs never known at the same time come last."""
    return _of_pairs(paths, lambda time, distance: (time, distance))


def thinned(paths: tuple[Path, ...], every_s: float) -> list[Separation]:
    """As `separations`, but keep only the smallest distance in each interval of `every_s` seconds."""
    return _of_pairs(paths, lambda time, distance: least_in_bins(time, distance, every_s))


def closest(paths: tuple[Path, ...]) -> list[Separation]:
    """As `separations`, but without times and distances, so that a long flight is never in memory at once."""
    return _of_pairs(paths, None)


def _of_pairs(paths: tuple[Path, ...], line: Line | None) -> list[Separation]:
    found = [_separation(a, b, line) for a, b in itertools.combinations(paths, 2)]
    return sorted(found, key=lambda s: np.inf if s.minimum_m is None else s.minimum_m)


def crossing(ways: Flown, pairs: Sequence[Separation]) -> Floats:
    """Return the point (3,) where the pairs come closest, averaged over all pairs that come near each other.

    `pairs` must have a known minimum, and the closest pair comes first.
    """
    by_name = {path.name: path for path in ways.paths}
    near = [pair for pair in pairs if (pair.minimum_m or 0.0) <= 5.0 * pair.required_m] or pairs[:1]
    middles = [
        place(by_name[name], pair.minimum_time_s or 0.0)
        for pair in near
        for name in (pair.first, pair.second)
    ]
    return np.asarray(np.mean(middles, axis=0), dtype=np.float64)


def least_of(pairs: Sequence[Separation]) -> tuple[Floats, Floats]:
    """Return (n,) times and the smallest separation (n,) of any pair at each, where one is known."""
    time = np.unique(np.concatenate([pair.time_s for pair in pairs]))
    rows = np.full((len(pairs), len(time)), np.inf)
    for row, pair in zip(rows, pairs, strict=True):
        inside = (time >= pair.time_s[0]) & (time <= pair.time_s[-1])
        distance = np.interp(time[inside], pair.time_s, np.nan_to_num(pair.distance_m, nan=np.inf))
        row[inside] = np.where(np.isnan(distance), np.inf, distance)
    least = rows.min(axis=0)
    known = np.isfinite(least)
    return time[known], least[known]


def least_in_bins(time_s: Floats, values: Floats, bin_s: float) -> tuple[Floats, Floats]:
    """Keep the row with the smallest value in each interval of `bin_s`, so that no minimum is lost."""
    if not len(time_s):
        return time_s, values
    bins = np.floor(time_s / bin_s)
    order = np.lexsort((values, bins))
    rows = order[np.append(True, np.diff(bins[order]) > 0.0)]
    return time_s[rows], values[rows]


def to_ned(geodetic: Floats, origin: Vec3) -> Floats:
    """Convert (n, 3) lat_deg, lon_deg, alt_m to (n, 3) north, east, down (m) from `origin`."""
    if not len(geodetic):
        return np.zeros((0, 3))
    n, e, d = pymap3d.geodetic2ned(geodetic[:, 0], geodetic[:, 1], geodetic[:, 2], *origin)
    return np.column_stack([n, e, d])


def _positions(fixes: Floats, origin: Vec3) -> Floats:
    """Return the NED positions (n, 3) of fixes; more than one block of them goes to a temporary file."""
    found = spilled(
        (to_ned(fixes[at : at + BLOCK, 1:4], origin) for at in range(0, len(fixes), BLOCK)), columns=3
    )
    release(fixes)
    return found


def from_frame(position_ned_m: Floats, frame_origin: Vec3, origin: Vec3) -> Floats:
    """Convert (n, 3) NED positions (m) from the frame at `frame_origin` to the frame at `origin`."""
    if frame_origin == origin or not len(position_ned_m):
        return position_ned_m
    n, e, d = position_ned_m.T
    return to_ned(np.column_stack(pymap3d.ned2geodetic(n, e, d, *frame_origin)), origin)


def fixes_of(record: AircraftRecord) -> Floats:
    """Return (n, 8) as `Facts.fixes`."""
    facts = record.facts
    return facts.fixes if len(facts.fixes) else facts.decided


def _separation(first: Path, second: Path, line: Line | None) -> Separation:
    required = first.radius_m + second.radius_m
    least: tuple[float, float] | None = None
    lines = [(_ZERO, _ZERO)]
    for time, relative in _relative(first, second):
        distance = np.linalg.norm(relative, axis=1)
        if line is not None:
            # The first sample of a part is the last one of the part before.
            joint = int(len(lines) > 1)
            lines.append(line(time[joint:], distance[joint:]))
        if not np.isnan(distance).all():
            found = _closest(time, relative)
            least = found if least is None else min(least, found)
        release(first.position_ned_m)
        release(second.position_ned_m)
    time, distance = (np.concatenate(rows) for rows in zip(*lines, strict=True))
    least_m, least_s = least or (None, None)
    return Separation(first.name, second.name, time, distance, least_m, least_s, required)


def _relative(first: Path, second: Path) -> Iterator[tuple[Floats, Floats]]:
    """Yield (n,) times and the (n, 3) position of the first relative to the second.

    The time in which both were recorded is covered in parts. The position is NaN if either aircraft's
    position is unknown or either is on the ground.
    """
    start = max(first.time_s[0], second.time_s[0])
    end = min(first.time_s[-1], second.time_s[-1])
    ground = np.concatenate([first.on_ground_s, second.on_ground_s])
    begin, last = start, max(end, np.nextafter(start, np.inf))
    while start <= end and begin < last:
        # Parts before the next position of either are unknown. A clock that was set can make years of them.
        known = max(path.time_s[np.searchsorted(path.time_s, begin)] for path in (first, second))
        if known > begin + PART_S:
            skipped, begin = begin, begin + (known - begin) // PART_S * PART_S
            yield np.array([skipped, begin]), np.full((2, 3), np.nan)
            continue
        stop = min(begin + PART_S, end)
        near = between(first, begin, stop), between(second, begin, stop)
        # The samples are included, so that the closest approach does not fall between two grid points.
        samples = np.concatenate([*(path.time_s for path in near), [stop]])
        time = np.union1d(np.arange(begin, stop, GRID_S), samples[(samples >= begin) & (samples <= stop)])
        relative = at(near[0], time) - at(near[1], time)
        for start_s, end_s in ground[(ground[:, 0] <= stop) & (ground[:, 1] >= begin)]:
            relative[(time >= start_s) & (time <= end_s)] = np.nan
        yield time, relative
        begin += PART_S


def between(path: Path, start_s: float, end_s: float) -> Path:
    """Return a path from its last sample at or before `start_s` to its first at or after `end_s`."""
    first = max(int(np.searchsorted(path.time_s, start_s, "right")) - 1, 0)
    last = int(np.searchsorted(path.time_s, end_s, "left")) + 1
    return replace(path, time_s=path.time_s[first:last], position_ned_m=path.position_ned_m[first:last])


def place(path: Path, time_s: float) -> Floats:
    """Return the position (3,) at a time; before or after the path, the position of its nearest end."""
    near = between(path, time_s, time_s)
    return np.array([np.interp(time_s, near.time_s, axis) for axis in near.position_ned_m.T])


def _closest(time_s: Floats, relative_m: Floats) -> tuple[float, float]:
    """Return the smallest distance and its time. Between two samples the relative motion is straight."""
    step = np.diff(relative_m, axis=0)
    length2 = np.maximum(np.einsum("ij,ij->i", step, step), 1e-12)
    share = np.clip(-np.einsum("ij,ij->i", relative_m[:-1], step) / length2, 0.0, 1.0)
    places = np.vstack([relative_m, relative_m[:-1] + share[:, None] * step])
    times = np.concatenate([time_s, time_s[:-1] + share * np.diff(time_s)])
    distance = np.linalg.norm(places, axis=1)
    closest = int(np.nanargmin(distance))
    return float(distance[closest]), float(times[closest])


def gap_s(time_s: Floats) -> float:
    """Return the longest time between two of these samples over which a line between them may be drawn."""
    return max(MAX_GAP_S, _SPARSE * float(np.median(np.diff(time_s)))) if len(time_s) > 1 else MAX_GAP_S


def unbroken(time_s: Floats, longest_s: float) -> list[slice]:
    """Return the spans of samples (n,), in their order, within which none is more than `longest_s` after the
    one before it."""
    ends = (np.flatnonzero(np.diff(time_s) > longest_s) + 1).tolist()
    return [slice(first, end) for first, end in itertools.pairwise((0, *ends, len(time_s)))]


def at(path: Path, time_s: Floats) -> Floats:
    """Return the positions (n, 3) at times inside the path's time span; NaN inside gaps."""
    position = np.column_stack([np.interp(time_s, path.time_s, axis) for axis in path.position_ned_m.T])
    after = np.clip(np.searchsorted(path.time_s, time_s), 1, max(len(path.time_s) - 1, 1))
    if len(path.time_s) > 1:
        gap = path.time_s[after] - path.time_s[after - 1]
        position[gap > MAX_GAP_S] = np.nan
    return position
