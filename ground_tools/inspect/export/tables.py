"""Writes tracks, encounters and manoeuvres of a run as tables (CSV or Parquet) for other software.

Rows are produced in blocks of columns, so that a long run is never in memory as a whole.
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

from companion.arrays import Floats
from companion.errors import ConfigError
from companion.events import AdsbVehicle, AnyEvent, RemoteIdHeard
from companion.geometry import Vec3
from companion.remote_id.messages import Location
from companion.shipped import how_to_install
from ground_tools.inspect.explain.manoeuvres import Manoeuvre
from ground_tools.inspect.read.flown import TRUE, Flown, Separation, fixes_of, to_ned
from ground_tools.inspect.read.read_run import AircraftRecord, Run

BLOCK = 20_000
"""Number of rows in memory at a time."""
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
"""Columns of the table of tracks.

`source` is flown (the aircraft's own position), true (its position in the simulation) or heard (what `by`
received from it, at the time of reception). NED is relative to the run's origin; `time_s` is on the run's
time line. An empty cell means unknown.
"""
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
"""Columns of the table of encounters.

There is one row for every time span (`start_s` to `end_s`) in which a pair was closer than required. A pair
that never was has one row with its closest approach.
"""
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
"""Columns of the table of manoeuvres, with one row for every manoeuvre.

`manoeuvres.Manoeuvre` explains the values. Times are on the run's time line. `wanted` and `chosen` are the
velocities at the start; `half_spaces` are those active at the start. `most_wanted` and `most_chosen` belong
to the decision whose chosen velocity was farthest from the wanted one. `half_spaces`, `tracks` and `limits`
are JSON lists.
"""
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
"""Columns of the table of alternatives, with one row for every velocity that could have been flown when a
manoeuvre began.

`name` and `time_s` are those of the manoeuvre. `enters` is a JSON list of tracks. `excluded_by` is a JSON
object with the violated constraints and by how much the velocity violates them (m/s).
"""
_FLAGS = frozenset({"kept", "guarded", "feasible"})
_WORDS = frozenset(
    {
        *("name", "source", "by", "first", "second", "track", "tracks", "limits", "half_spaces"),
        *("nearest_track", "why", "done", "came", "alternative", "closest_track", "enters", "excluded_by"),
    }
)

Rows = dict[str, list[Any]]


def tracks(run: Run, ways: Flown) -> Iterator[Rows]:
    """Yield the table with TRACK_COLUMNS in blocks, aircraft by aircraft."""
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
        if record.facts.heard or record.facts.adsb:  # otherwise the record is not read once more
            yield from _heard(record, ways, offset)


def encounters(ways: Flown, pairs: list[Separation]) -> Rows:
    """Return the table with ENCOUNTER_COLUMNS."""
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
    """Return the table with MANOEUVRE_COLUMNS.

    Args:
        ways: Paths and time line of the run.
        done: Manoeuvres by aircraft.
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
    """Return the table with ALTERNATIVE_COLUMNS.

    Args:
        ways: Paths and time line of the run.
        done: Manoeuvres by aircraft.
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
    """Return the values of the first three columns."""
    at_s = one.start_s + ways.offsets_s[name]
    return _utc(ways, at_s), name, at_s


def _rows(found: Sequence[tuple[Any, ...]], columns: tuple[str, ...]) -> Rows:
    return {name: [row[k] for row in found] for k, name in enumerate(columns)}


def write_csv(blocks: Iterator[Rows], columns: tuple[str, ...], path: Path) -> int:
    """Write blocks of columns as CSV. Returns the number of rows.

    Raises:
        ConfigError: The file cannot be written.
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
    """Write blocks of columns as Parquet; `time_utc` is UTC in microseconds. Returns the number of rows.

    Raises:
        ConfigError: pyarrow is not installed, or the file cannot be written.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise ConfigError(how_to_install("pyarrow", "inspect")) from error
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
    """Format a UTC time (Unix seconds) like 2026-01-01T00:00:00.000Z."""
    whole, thousandths = divmod(round(utc_s * 1e3), 1000)
    return f"{time.strftime('%Y-%m-%dT%H:%M:%S', time.gmtime(whole))}.{thousandths:03d}Z"


def to_geodetic(position_ned_m: Floats, origin: Vec3) -> Floats:
    """Convert (n, 3) NED (m) relative to `origin` to (n, 3) lat_deg, lon_deg, alt_m."""
    return np.column_stack(pymap3d.ned2geodetic(*position_ned_m.T, *origin))


def _utc(ways: Flown, time_s: float) -> float | None:
    return None if ways.utc_at_zero_s is None else time_s + ways.utc_at_zero_s


def _cell(column: str, value: Any) -> Any:
    if not isinstance(value, float):
        return value
    if column == "time_utc":
        return iso(value)
    return "" if np.isnan(value) else f"{value:.10g}"


def _block(ways: Flown, names: list[str], source: str, by: str, numbers: Floats) -> Rows:
    """Return a block of the table of tracks. `numbers` has the columns _TRACK_NUMBERS; NaN means unknown."""
    zero = ways.utc_at_zero_s
    utc = [None] * len(numbers) if zero is None else (numbers[:, 0] + zero).tolist()
    count = len(numbers)
    rows: Rows = {"time_utc": utc, "name": names, "source": [source] * count, "by": [by] * count}
    return rows | {name: numbers[:, k].tolist() for k, name in enumerate(_TRACK_NUMBERS)}


def _heard(record: AircraftRecord, ways: Flown, offset_s: float) -> Iterator[Rows]:
    """Yield the positions that one aircraft received from others, in the order of reception."""
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
    """Yield each received aircraft: name, then lat_deg, lon_deg, alt_msl_m and NED velocity (m/s)."""
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
            sender = record.facts.heard.get(event.address)  # None if it is left out
            name = sender.uas_ids[0] if sender is not None and sender.uas_ids else event.address
            yield name, (place.lat_deg, place.lon_deg, altitude, *_velocity(place))


def _velocity(place: Location) -> tuple[float, float, float]:
    down = math.nan if place.vertical_speed_mps is None else -place.vertical_speed_mps
    if place.speed_mps is None or place.direction_deg is None:
        return math.nan, math.nan, down
    course = math.radians(place.direction_deg)
    return place.speed_mps * math.cos(course), place.speed_mps * math.sin(course), down


def _below(pair: Separation) -> list[tuple[float, float, float, float]]:
    """Return every span closer than required: start, end, time and distance of its closest approach."""
    inside = np.concatenate([[False], pair.distance_m < pair.required_m, [False]])
    edges = np.flatnonzero(np.diff(inside))
    found = []
    for first, after in edges.reshape(-1, 2):
        start_s, end_s = float(pair.time_s[first]), float(pair.time_s[after - 1])
        closest = first + int(np.argmin(pair.distance_m[first:after]))
        at_s, least_m = float(pair.time_s[closest]), float(pair.distance_m[closest])
        exact_s = pair.minimum_time_s
        if exact_s is not None and pair.minimum_m is not None and start_s <= exact_s <= end_s:
            # The exact minimum may lie between two samples.
            at_s, least_m = exact_s, pair.minimum_m
        found.append((start_s, end_s, at_s, least_m))
    return found
