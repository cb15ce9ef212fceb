"""A run as a Rerun recording (.rrd): all aircraft in one 3D view, their separations, authority and events.

The recording is written in columns (`send_columns`), not call by call: a long run converts in seconds. The
local frame is drawn as x east, y north, z up (m). rerun is imported on use: its import takes seconds, and it
is an optional dependency.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.avoidance.alerts import Level
from companion.errors import ConfigError
from companion.events import (
    AlertChanged,
    AuthorityChanged,
    Decision,
    ModeRefused,
    RemoteIdHeard,
    Say,
    Severity,
    Vec3,
    VehicleText,
)
from companion.remote_id.messages import Location
from ground_tools.inspect.blueprint import ENCOUNTER, WHOLE, blueprint, encounter_time
from ground_tools.inspect.flown import (
    Array,
    Flown,
    Separation,
    flown,
    from_frame,
    least_of,
    separations,
    to_ned,
)
from ground_tools.inspect.palette import LIMIT, colour
from ground_tools.inspect.read_run import AircraftRecord, Run

MAX_PAIRS_DRAWN = 45
"""Closest pairs with a line of their own: ten aircraft in full."""

SHOWN_S = 3.0
"""A position is drawn until the next one, and no longer than this."""
_PAIR = (150, 150, 150)

LogLine = tuple[float, str, str]
"""Time (s), level, text."""


def write(run: Run, path: Path) -> None:
    """Write the recording of `run` to `path`.

    Raises:
        ConfigError: rerun is not installed, no aircraft recorded a position, or `path` cannot be written.
    """
    ways = flown(run)
    pairs = [pair for pair in separations(ways.paths) if pair.minimum_m is not None][:MAX_PAIRS_DRAWN]
    rr = _rerun()
    stream = rr.RecordingStream("dmuca", recording_id=run.name)
    try:
        stream.save(path, default_blueprint=blueprint(ways, pairs))
    except (OSError, RuntimeError) as error:
        raise ConfigError(f"{path}: cannot be written: {error}") from error
    writer = _Writer(rr, stream, ways, pairs[0].minimum_time_s if pairs else None)
    writer.world()
    for index, record in enumerate(run.aircraft):
        writer.aircraft(record, colour(index))
    if pairs:
        writer.separations(pairs)
    # Without this the end of the file is written at some later time, or never if the process is killed.
    stream.disconnect()


def _rerun() -> Any:
    try:
        import rerun
    except ImportError as error:
        raise ConfigError("rerun is not installed; in the checkout: pip install -e '.[inspect]'") from error
    return rerun


class _Writer:
    """Puts the parts of one run into one recording."""

    def __init__(self, rr: Any, stream: Any, ways: Flown, closest_s: float | None) -> None:
        self._rr = rr
        self._stream = stream
        self._ways = ways
        self._closest_s = closest_s
        self._flown = {path.name: path for path in ways.paths}
        self._own = {path.name: path for path in ways.own}

    def world(self) -> None:
        """Directions, and what the time line is."""
        rr = self._rr
        self._stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        lat, lon, alt = self._ways.origin
        words = (
            f"Origin {lat:.7f}, {lon:.7f}, {alt:.1f} m. Time line: {self._ways.clock}. "
            f"Distances by {self._ways.positions}."
        )
        start = min(path.time_s[0] for path in self._ways.paths)
        self._columns("/events/run", np.array([start]), rr.TextLog.columns(text=[words], level=["INFO"]))

    def aircraft(self, record: AircraftRecord, rgb: tuple[int, int, int]) -> None:
        """Everything of one aircraft."""
        rr = self._rr
        root = f"/aircraft/{self._part(record.name)}"
        if (path := self._flown.get(record.name)) is not None:
            strip = rr.LineStrips3D([_enu(path.position_ned_m)], colors=[rgb], radii=[-1.5])
            self._stream.log(f"{root}/flown", strip, static=True)
        if (own := self._own.get(record.name)) is not None:
            self._points(f"{root}/own", own.time_s, own.position_ned_m, rgb, 1.2, record.name, named=True)
        offset = self._ways.offsets_s[record.name]
        for sender, time, position in _heard(record, self._ways.origin):
            label = f"{sender} as {record.name} heard it"
            self._points(
                f"{root}/heard/{self._part(sender)}", time + offset, position, _pale(rgb), 0.9, label
            )
        for track, time, position in _predicted(record, self._ways.origin):
            label = f"{track} as {record.name} predicts it"
            self._points(f"{root}/predicted/{self._part(track)}", time + offset, position, rgb, 0.7, label)
        self._authority(record, offset)
        self._log(record, offset)

    def separations(self, pairs: list[Separation]) -> None:
        """Every pair's distance, that of whichever two are closest, and the distance that must hold."""
        for pair in pairs:
            known = ~np.isnan(pair.distance_m)
            self._line(
                f"{pair.first} - {pair.second}", pair.time_s[known], pair.distance_m[known], _PAIR, 1.0
            )
        time, least = least_of(pairs)
        self._line("closest two", time, least, colour(0), 3.0)
        required = max(pair.required_m for pair in pairs)
        self._line(f"required {required:g} m", time[[0, -1]], np.full(2, required), LIMIT, 3.0)

    def _line(self, name: str, time_s: Array, values: Array, rgb: tuple[int, int, int], width: float) -> None:
        rr = self._rr
        entity = f"/separation/{self._part(name)}"
        style = rr.SeriesLines(colors=[rgb], widths=[width], names=[name])
        self._stream.log(entity, style, static=True)
        self._columns(entity, time_s, rr.Scalars.columns(scalars=values))

    def _points(
        self,
        entity: str,
        time_s: Array,
        position_ned_m: Array,
        rgb: tuple[int, int, int],
        radius_m: float,
        label: str,
        *,
        named: bool = False,
    ) -> None:
        rr = self._rr
        style = rr.Points3D.from_fields(colors=[rgb], radii=[radius_m], labels=[label], show_labels=named)
        self._stream.log(entity, style, static=True)
        times, lengths = _until_stale(time_s)
        columns = rr.Points3D.columns(positions=_enu(position_ned_m)).partition(lengths)
        self._columns(entity, times, columns)

    def _part(self, name: str) -> str:
        part: str = self._rr.escape_entity_path_part(name)
        return part

    def _authority(self, record: AircraftRecord, offset_s: float) -> None:
        changes = [(now, what) for now, what in record.facts.rare if isinstance(what, AuthorityChanged)]
        if not changes:
            return
        # The state before the first change is known from that change.
        time = np.array([record.facts.start_s, *(now for now, _ in changes)]) + offset_s
        states = [changes[0][1].previous, *(change.state for _, change in changes)]
        self._columns(
            f"/authority/{self._part(record.name)}", time, self._rr.StateChange.columns(state=states)
        )

    def _log(self, record: AircraftRecord, offset_s: float) -> None:
        lines = list(_log_lines(record))
        if lines:
            time = np.array([line[0] for line in lines]) + offset_s
            columns = self._rr.TextLog.columns(
                text=[f"{record.name}: {line[2]}" for line in lines], level=[line[1] for line in lines]
            )
            self._columns(f"/events/{self._part(record.name)}", time, columns)

    def _columns(self, entity: str, time_s: Array, columns: Any) -> None:
        times = [self._rr.TimeColumn(WHOLE, duration=time_s)]
        if self._closest_s is not None:
            around = encounter_time(time_s, self._closest_s)
            times.append(self._rr.TimeColumn(ENCOUNTER, duration=around))
        self._stream.send_columns(entity, times, columns)


def _until_stale(time_s: Array) -> tuple[Array, NDArray[np.int64]]:
    """Rows of one point each, and a row of none where no other follows within SHOWN_S: times and lengths."""
    last = np.append(np.diff(time_s) > SHOWN_S, True)
    times = np.concatenate([time_s, time_s[last] + SHOWN_S])
    lengths = np.concatenate([np.ones(len(time_s), dtype=np.int64), np.zeros(last.sum(), dtype=np.int64)])
    order = np.argsort(times, kind="stable")
    return times[order], lengths[order]


def _heard(record: AircraftRecord, origin: Vec3) -> Iterable[tuple[str, Array, Array]]:
    """By transmitter's address: times (n,) and reported positions (n, 3) in the common frame."""
    undulation = record.facts.undulation_m
    rows: dict[str, list[tuple[float, ...]]] = {}
    heard = (
        (step.now_s, event.address, place)
        for step in record.steps()
        for event in step.events
        if isinstance(event, RemoteIdHeard)
        for place in event.messages
        if isinstance(place, Location)
    )
    for now, address, place in heard:
        if place.lat_deg is not None and place.lon_deg is not None:
            # Without an altitude it is drawn at the origin's.
            altitude = origin[2] if place.alt_geodetic_m is None else place.alt_geodetic_m - undulation
            rows.setdefault(address, []).append((now, place.lat_deg, place.lon_deg, altitude))
    for address, found in rows.items():
        table = np.asarray(found)
        yield address, table[:, 0], to_ned(table[:, 1:], origin)


def _predicted(record: AircraftRecord, origin: Vec3) -> Iterable[tuple[str, Array, Array]]:
    """By track: times (n,) and positions (n, 3) that the law took it for, in the common frame."""
    rows: dict[tuple[str, Vec3], list[tuple[float, ...]]] = {}
    for step in record.steps():
        for command in step.commands:
            if isinstance(command, Decision):
                for track in command.tracks:
                    row = (step.now_s, *track.position_ned_m)
                    rows.setdefault((track.track_id, command.origin), []).append(row)
    for (track_id, frame), found in rows.items():
        table = np.asarray(found)
        yield track_id, table[:, 0], from_frame(table[:, 1:], frame, origin)


def _log_lines(record: AircraftRecord) -> Iterable[LogLine]:
    for now, item in record.facts.rare:
        match item:
            case AuthorityChanged():
                words = f"authority {item.previous} -> {item.state} on {item.trigger}: {item.reason}"
                yield now, "INFO", words
            case AlertChanged():
                yield now, "WARN" if item.level == Level.WARNING else "INFO", item.reason
            case Say():
                yield now, _level(item.severity), f"says: {item.text}"
            case VehicleText():
                yield now, _level(item.severity), f"autopilot: {item.text}"
            case ModeRefused():
                yield now, "WARN", f"mode {item.mode.value} refused: {item.reason}"
            case _:
                pass


def _level(severity: int) -> str:
    if severity <= Severity.CRITICAL:
        return "CRITICAL"
    return {Severity.ERROR: "ERROR", Severity.WARNING: "WARN"}.get(Severity(min(severity, 6)), "INFO")


def _enu(position_ned_m: Array) -> NDArray[np.float32]:
    return np.column_stack([position_ned_m[:, 1], position_ned_m[:, 0], -position_ned_m[:, 2]]).astype(
        np.float32
    )


def _pale(rgb: tuple[int, int, int]) -> tuple[int, int, int]:
    red, green, blue = ((c + 255) // 2 for c in rgb)
    return red, green, blue
