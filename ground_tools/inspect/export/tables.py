"""Tracks, encounters and manoeuvres of a run as tables: what other software reads as CSV or Parquet.

Rows come in blocks of columns, so that a long run is never in memory at once.
"""

from __future__ import annotations

import csv
import json
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d

from companion.errors import ConfigError
from companion.events import AdsbVehicle, AnyEvent, RemoteIdHeard
from companion.geometry import Vec3
from companion.remote_id.messages import Location
from ground_tools.inspect.explain.manoeuvres import Manoeuvre
from ground_tools.inspect.read.flown import TRUE, Array, Flown, Separation, fixes_of, to_ned
from ground_tools.inspect.read.read_run import AircraftRecord, Run

BLOCK = 20_000
"""Rows in memory at a time."""
_TRACK_NUMBERS = (
    "time_s",
    "lat_deg",
    "lon_deg",
    "alt_msl_m",
    "north_m",
    "east_m",
    "down_m",
    "velocity_north_mps",
    "velocity_east_mps",
    "velocity_down_mps",
)
TRACK_COLUMNS = ("time_utc", "name", "source", "by", *_TRACK_NUMBERS)
"""`source`: flown (where the aircraft took itself to be), true (where the simulation had it), heard (what
`by` received of it, at the time of reception). NED is from the run's origin; `time_s` is the run's time
line. Empty: not known."""
ENCOUNTER_COLUMNS = (
    "time_utc",
    "first",
    "second",
    "time_s",
    "separation_m",
    "required_m",
    "kept",
    "start_s",
    "end_s",
)
"""A row for every time that a pair was closer than required, from `start_s` to `end_s`, and the closest
approach of a pair that never was."""
_NED = ("north", "east", "down")
MANOEUVRE_COLUMNS = (
    "time_utc",
    "name",
    "time_s",
    "end_s",
    "regained_s",
    "guarded",
    "track",
    "time_to_closest_s",
    "closest_m",
    *(f"wanted_{axis}_mps" for axis in _NED),
    *(f"chosen_{axis}_mps" for axis in _NED),
    *(f"most_wanted_{axis}_mps" for axis in _NED),
    *(f"most_chosen_{axis}_mps" for axis in _NED),
    "half_spaces",
    "tracks",
    "limits",
    "feasible",
    "nearest_track",
    "nearest_m",
    "nearest_s",
    "deviation_m",
    "why",
    "done",
    "came",
)
"""A row for every manoeuvre, `manoeuvres.Manoeuvre` says what they are; times are the run's time line.
`wanted` and `chosen` are of its start, as are the `half_spaces` that were active then; `most` are of the
decision that left the wanted velocity the farthest. `half_spaces`, `tracks` and `limits` are JSON lists."""
ALTERNATIVE_COLUMNS = (
    "time_utc",
    "name",
    "time_s",
    "alternative",
    *(f"velocity_{axis}_mps" for axis in _NED),
    "closest_track",
    "closest_m",
    "closest_in_s",
    "from_wanted_mps",
    "enters",
    "excluded_by",
)
"""What could have been flown when a manoeuvre began, a row each; `name` and `time_s` are the manoeuvre's.
`enters` is a JSON list of tracks, `excluded_by` a JSON object of constraints and what they lack (m/s)."""
_FLAGS = frozenset({"kept", "guarded", "feasible"})
_WORDS = frozenset(
    {
        *("name", "source", "by", "first", "second", "track", "tracks", "limits", "half_spaces"),
        *("nearest_track", "why", "done", "came", "alternative", "closest_track", "enters", "excluded_by"),
    }
)

Rows = dict[str, list[Any]]


def tracks(run: Run, ways: Flown) -> Iterator[Rows]:
    """Blocks of TRACK_COLUMNS, aircraft by aircraft."""
    true = {path.name: path for path in ways.paths} if ways.positions == TRUE else {}
    for record in run.aircraft:
        fixes = fixes_of(record)
        offset = ways.offsets_s[record.name]
        for at in range(0, len(fixes), BLOCK):
            rows = fixes[at : at + BLOCK]
            ned = to_ned(rows[:, 1:4], ways.origin)
            numbers = np.column_stack([rows[:, 0] + offset, rows[:, 1:4], ned, rows[:, 4:7]])
            yield _block(ways, [record.name] * len(rows), "flown", "", numbers)
        if record.name in true:
            path = true[record.name]
            for at in range(0, len(path.time_s), BLOCK):
                ned = path.position_ned_m[at : at + BLOCK]
                numbers = np.full((len(ned), len(_TRACK_NUMBERS)), np.nan)
                numbers[:, 0] = path.time_s[at : at + BLOCK]
                numbers[:, 1:4] = to_geodetic(ned, ways.origin)
                numbers[:, 4:7] = ned
                yield _block(ways, [record.name] * len(ned), "true", "", numbers)
        yield from _heard(record, ways, offset)


def encounters(ways: Flown, pairs: list[Separation]) -> Rows:
    """ENCOUNTER_COLUMNS."""
    found: list[tuple[Any, ...]] = []
    for pair in pairs:
        if pair.minimum_m is None or pair.minimum_time_s is None:
            continue
        spans = _below(pair)
        if not spans:
            at_s = pair.minimum_time_s
            spans = [(at_s, at_s, at_s, pair.minimum_m)]
        for start_s, end_s, at_s, least_m in spans:
            kept = least_m >= pair.required_m
            utc = _utc(ways, at_s)
            found.append((utc, pair.first, pair.second, at_s, least_m, pair.required_m, kept, start_s, end_s))
    return _rows(found, ENCOUNTER_COLUMNS)


def manoeuvres(ways: Flown, done: Mapping[str, Sequence[Manoeuvre]]) -> Rows:
    """MANOEUVRE_COLUMNS.

    Args:
        done: by aircraft.
    """
    found = []
    for name, every in done.items():
        offset = ways.offsets_s[name]
        for one in every:
            active = [
                {"cause": space.cause, "normal_ned": space.normal_ned, "least_mps": space.least_mps}
                for space in one.half_spaces
                if space.active
            ]
            found.append(
                (
                    *_begun(ways, name, one),
                    one.end_s + offset,
                    None if one.regained_s is None else one.regained_s + offset,
                    one.guarded,
                    one.track,
                    one.time_to_closest_s,
                    one.closest_m,
                    *one.decision.wanted_ned_mps,
                    *one.decision.chosen_ned_mps,
                    *one.strongest.wanted_ned_mps,
                    *one.strongest.chosen_ned_mps,
                    json.dumps(active),
                    json.dumps(one.tracks),
                    json.dumps(one.limits),
                    one.feasible,
                    one.nearest_track,
                    one.nearest_m,
                    None if one.nearest_s is None else one.nearest_s + offset,
                    one.deviation_m,
                    one.why,
                    one.done,
                    one.came,
                )
            )
    return _rows(found, MANOEUVRE_COLUMNS)


def alternatives(ways: Flown, done: Mapping[str, Sequence[Manoeuvre]]) -> Rows:
    """ALTERNATIVE_COLUMNS.

    Args:
        done: by aircraft.
    """
    found = [
        (
            *_begun(ways, name, one),
            other.name,
            *other.velocity_ned_mps,
            other.closest_track,
            other.closest_m,
            other.closest_in_s,
            other.from_wanted_mps,
            json.dumps(other.enters),
            json.dumps(dict(other.excluded_by)),
        )
        for name, every in done.items()
        for one in every
        for other in one.alternatives
    ]
    return _rows(found, ALTERNATIVE_COLUMNS)


def _begun(ways: Flown, name: str, one: Manoeuvre) -> tuple[float | None, str, float]:
    """The first three columns."""
    at_s = one.start_s + ways.offsets_s[name]
    return _utc(ways, at_s), name, at_s


def _rows(found: Sequence[tuple[Any, ...]], columns: tuple[str, ...]) -> Rows:
    return {name: [row[k] for row in found] for k, name in enumerate(columns)}


def write_csv(blocks: Iterator[Rows], columns: tuple[str, ...], path: Path) -> int:
    """Write blocks of columns. Returns how many rows.

    Raises:
        ConfigError: it cannot be written.
    """
    count = 0
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            for rows in blocks:
                cells = [[_cell(name, value) for value in rows[name]] for name in columns]
                writer.writerows(zip(*cells, strict=True))
                count += len(cells[0])
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
    return count


def write_parquet(blocks: Iterator[Rows], columns: tuple[str, ...], path: Path) -> int:
    """Write blocks of columns; times are UTC in microseconds. Returns how many rows.

    Raises:
        ConfigError: pyarrow is not installed, or it cannot be written.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise ConfigError("pyarrow is not installed; in the checkout: pip install -e '.[inspect]'") from error
    kinds = {"time_utc": pa.timestamp("us", tz="UTC")}
    kinds |= dict.fromkeys(_FLAGS, pa.bool_()) | dict.fromkeys(_WORDS, pa.string())
    schema = pa.schema([(name, kinds.get(name, pa.float64())) for name in columns])
    count = 0
    try:
        with pq.ParquetWriter(path, schema) as writer:
            for rows in blocks:
                cells = dict(rows)
                cells["time_utc"] = [None if t is None else round(t * 1e6) for t in rows["time_utc"]]
                arrays = [
                    pa.array(cells[name], schema.field(name).type, from_pandas=True) for name in columns
                ]
                writer.write_table(pa.table(arrays, schema=schema))
                count += len(rows["time_utc"])
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error}") from error
    return count


def iso(utc_s: float) -> str:
    """2026-01-01T00:00:00.000Z, to the millisecond."""
    whole, thousandths = divmod(round(utc_s * 1e3), 1000)
    return f"{time.strftime('%Y-%m-%dT%H:%M:%S', time.gmtime(whole))}.{thousandths:03d}Z"


def to_geodetic(position_ned_m: Array, origin: Vec3) -> Array:
    """(n, 3) NED (m) from `origin` to (n, 3) of lat_deg, lon_deg, alt_m."""
    return np.column_stack(pymap3d.ned2geodetic(*position_ned_m.T, *origin))


def _utc(ways: Flown, time_s: float) -> float | None:
    return None if ways.utc_at_zero_s is None else time_s + ways.utc_at_zero_s


def _cell(column: str, value: Any) -> Any:
    if not isinstance(value, float):
        return value
    if column == "time_utc":
        return iso(value)
    return "" if np.isnan(value) else f"{value:.10g}"


def _block(ways: Flown, names: list[str], source: str, by: str, numbers: Array) -> Rows:
    """`numbers` in the order of _TRACK_NUMBERS, NaN where not known."""
    zero = ways.utc_at_zero_s
    utc = [None] * len(numbers) if zero is None else (numbers[:, 0] + zero).tolist()
    count = len(numbers)
    rows: Rows = {"time_utc": utc, "name": names, "source": [source] * count, "by": [by] * count}
    return rows | {name: numbers[:, k].tolist() for k, name in enumerate(_TRACK_NUMBERS)}


def _heard(record: AircraftRecord, ways: Flown, offset_s: float) -> Iterator[Rows]:
    """What one aircraft received of others, in the order of reception."""
    names: list[str] = []
    numbers: list[tuple[float, ...]] = []
    for step in record.steps():
        for event in step.events:
            for name, place in _places(event, record):
                names.append(name)
                numbers.append((step.now_s + offset_s, *place))
        if len(names) >= BLOCK:
            yield _heard_block(ways, record, names, numbers)
            names, numbers = [], []
    if names:
        yield _heard_block(ways, record, names, numbers)


def _heard_block(
    ways: Flown, record: AircraftRecord, names: list[str], numbers: list[tuple[float, ...]]
) -> Rows:
    table = np.array(numbers)
    ned = to_ned(table[:, 1:4], ways.origin)
    return _block(ways, names, "heard", record.name, np.column_stack([table[:, :4], ned, table[:, 4:]]))


def _places(event: AnyEvent, record: AircraftRecord) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Name, then lat_deg, lon_deg, alt_msl_m and velocity north, east, down (m/s) of whoever was heard."""
    undulation_m = record.facts.undulation_m
    if isinstance(event, AdsbVehicle):
        altitude = math.nan if event.alt_m is None else event.alt_m - event.alt_geometric * undulation_m
        velocity = event.velocity_ned_mps or (math.nan,) * 3
        yield event.callsign or f"{event.icao:06X}", (event.lat_deg, event.lon_deg, altitude, *velocity)
    elif isinstance(event, RemoteIdHeard):
        for place in event.messages:
            if not isinstance(place, Location) or place.lat_deg is None or place.lon_deg is None:
                continue
            altitude = math.nan if place.alt_geodetic_m is None else place.alt_geodetic_m - undulation_m
            identities = record.facts.heard[event.address].uas_ids
            name = identities[0] if identities else event.address
            yield name, (place.lat_deg, place.lon_deg, altitude, *_velocity(place))


def _velocity(place: Location) -> tuple[float, float, float]:
    down = math.nan if place.vertical_speed_mps is None else -place.vertical_speed_mps
    if place.speed_mps is None or place.direction_deg is None:
        return math.nan, math.nan, down
    course = math.radians(place.direction_deg)
    return place.speed_mps * math.cos(course), place.speed_mps * math.sin(course), down


def _below(pair: Separation) -> list[tuple[float, float, float, float]]:
    """Every stretch closer than required: start, end, time and distance of its closest approach."""
    inside = np.concatenate([[False], pair.distance_m < pair.required_m, [False]])
    edges = np.flatnonzero(np.diff(inside))
    found = []
    for first, after in edges.reshape(-1, 2):
        start_s, end_s = float(pair.time_s[first]), float(pair.time_s[after - 1])
        closest = first + int(np.argmin(pair.distance_m[first:after]))
        at_s, least_m = float(pair.time_s[closest]), float(pair.distance_m[closest])
        exact_s = pair.minimum_time_s
        if exact_s is not None and pair.minimum_m is not None and start_s <= exact_s <= end_s:
            # It may lie between two points of the line.
            at_s, least_m = exact_s, pair.minimum_m
        found.append((start_s, end_s, at_s, least_m))
    return found
