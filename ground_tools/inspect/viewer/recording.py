"""Writes a run, or several runs to compare, as a Rerun recording (.rrd).

Steps are read from the records and written piece by piece (`writer.Writer`), so a long run takes more time
but hardly more memory. What must be known beforehand (the time of the encounter, the closest pairs) comes
from the facts gathered when the run was read.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as File
from typing import Any

import numpy as np
import pymap3d

from companion.arrays import Floats
from companion.autopilot.encoders import AUTOPILOT_COMPONENT
from companion.errors import ConfigError
from companion.event_record import Step
from companion.events import Decision, Heartbeat
from companion.geometry import Vec3
from ground_tools.inspect.explain import manoeuvres
from ground_tools.inspect.read import align
from ground_tools.inspect.read.flown import (
    Flown,
    Path,
    Separation,
    between,
    closest,
    crossing,
    from_frame,
    gap_s,
    place,
    placed,
    separations,
)
from ground_tools.inspect.read.link_health import LinkHealth
from ground_tools.inspect.read.read_run import AircraftRecord, Run
from ground_tools.inspect.read.spill import release
from ground_tools.inspect.viewer.blueprint import Look, blueprint, comparison, nearest_m
from ground_tools.inspect.viewer.drawing import rerun
from ground_tools.inspect.viewer.palette import Rgb, colour
from ground_tools.inspect.viewer.pieces import Note
from ground_tools.inspect.viewer.scene import Aircraft, Encounter, Scene, first_encounter
from ground_tools.inspect.viewer.writer import Writer

MAX_PAIRS_DRAWN = 45
"""Most pairs with a line of their own, the closest first. Ten aircraft have 45 pairs."""
MOST_TAKEN = 40_000
"""Most steps, plus tracks in their decisions, written at once: 600 s among ten aircraft."""
LOOK_M = (60.0, 600.0)
"""Minimum and maximum radius of the volume that a view shows."""
NEAR_M = 10_000.0
"""A compared run is drawn in the first run's frame if their origins are closer together than this."""


_RADIO = (
    "radio signal",
    "radio signal at the far end",
    "radio noise",
    "radio noise at the far end",
    "radio receive errors",
    "radio corrected packets",
    "radio free buffer",
)
"""Names of the columns of `LinkHealth.radio` after the time."""


@dataclass(frozen=True, slots=True)
class _Shown:
    """One run, ready to be written."""

    run: Run
    ways: Flown
    """Paths on the recording's time line, in the scene's frame."""
    pairs: tuple[Separation, ...]
    """Pairs to draw, the closest first. They have the smallest distances, but not the distances over time."""
    scene: Scene


def write(run: Run, path: File) -> None:
    """Write the recording of `run` to `path`. Without any position it has only lanes, plots and texts.

    Raises:
        ConfigError: rerun is not installed, or `path` cannot be written.
    """
    rerun()
    ways = placed(run)
    pairs = _closest_pairs(ways.paths)
    encounter = first_encounter(_conflicts(run, ways.offsets_s), pairs[0] if pairs else None)
    colours = {record.name: colour(index) for index, record in enumerate(run.aircraft)}
    shown = _Shown(run, ways, pairs, _scene(run, ways, colours, encounter))
    look = _look(ways, pairs, encounter)
    plan = blueprint(shown.scene, pairs, look, placed=bool(ways.paths))
    stream = _stream(run.name, path, plan)
    _write_run(stream, shown)
    # Otherwise the end of the file would be written later, or never if the process is killed.
    stream.disconnect()


def write_comparison(runs: Sequence[Run], path: File) -> None:
    """Write several runs into one recording, each under `/runs/<name>`, aligned at take-off.

    Time 0 is the start of the timed paths if every run has one, and the first take-off otherwise. Each run
    has one colour. A run in which no aircraft recorded a position has only lanes, plots and texts.

    Raises:
        ConfigError: As for `write`, or there are fewer than two runs.
    """
    rerun()
    if len(runs) < 2:
        raise ConfigError("a comparison needs at least two runs")
    names = align.names(runs)
    every = [placed(run) for run in runs]
    zeros, zero_words = align.zeros(runs, every)
    every = [_moved(ways, -zero) for ways, zero in zip(every, zeros, strict=True)]
    origin = next((ways.origin for ways in every if ways.paths), every[0].origin)
    every = [_in_frame(ways, origin) if _apart_m(ways.origin, origin) < NEAR_M else ways for ways in every]
    pairs = [_closest_pairs(ways.paths) for ways in every]
    encounter = _joined(
        [
            first_encounter(_conflicts(run, ways.offsets_s), found[0] if found else None)
            for run, ways, found in zip(runs, every, pairs, strict=True)
        ]
    )
    shown = []
    for index, (name, run, ways, found) in enumerate(zip(names, runs, every, pairs, strict=True)):
        colours = {record.name: colour(index) for record in run.aircraft}
        shown.append(_Shown(run, ways, found, _scene(run, ways, colours, encounter, name)))
    looks = [_look(one.ways, one.pairs, encounter) for one in shown]
    required_m = max((pair.required_m for found in pairs for pair in found), default=None)
    plan = comparison(
        dict(zip(names, (one.scene for one in shown), strict=True)),
        looks,
        required_m,
        nearest_m([pair for found in pairs for pair in found]),
        zero_words,
    )
    stream = _stream(" and ".join(names), path, plan)
    for one in shown:
        _write_run(stream, one)
    stream.disconnect()


def _stream(name: str, path: File, plan: Any) -> Any:
    stream = rerun().RecordingStream("dmuca", recording_id=name)
    try:
        stream.save(path, default_blueprint=plan)
    except (OSError, RuntimeError) as error:
        raise ConfigError(f"{path}: cannot be written: {error}") from error
    return stream


def _write_run(stream: Any, shown: _Shown) -> None:
    scene, ways = shown.scene, shown.ways
    writer = Writer(stream, scene)
    start = min(record.facts.start_s + ways.offsets_s[record.name] for record in shown.run.aircraft)
    words = f"Time line: {ways.clock}."
    if ways.paths:
        lat, lon, alt = ways.origin
        start = min(path.time_s[0] for path in ways.paths)
        words = f"Origin {lat:.7f}, {lon:.7f}, {alt:.1f} m. {words} Distances are from {ways.positions}."
    writer.say(start, words)
    for problem in (*shown.run.problems, *ways.problems):
        writer.say(start, problem)
    # Write first what takes the most memory at once. The pieces of steps can then reuse that memory.
    for path in ways.paths:
        longest_s = gap_s(path.time_s)
        for part in _pieces(path, scene):
            n, e, d = part.position_ned_m.T
            geodetic = pymap3d.ned2geodetic(n, e, d, *scene.origin)
            writer.flown(part, np.column_stack(geodetic[:2]), longest_s)
            release(path.position_ned_m)
    _write_distances(writer, shown)
    for record in shown.run.aircraft:
        for steps in _in_pieces(record, scene, ways.offsets_s[record.name]):
            writer.steps(record.name, steps)
        for one in manoeuvres.find(record):
            note = Note(one.start_s + ways.offsets_s[record.name], "WARN", f"manoeuvre: {one.text}", True)
            here = np.array([one.decision.position_ned_m])
            writer.tell(record.name, note, from_frame(here, one.decision.origin, scene.origin)[0])
        if record.link is not None:
            own = next((path for path in ways.own if path.name == record.name), None)
            _write_link(writer, scene, record, record.link.moved(ways.offsets_s[record.name]), own)
    writer.settle()


def _write_link(
    writer: Writer, scene: Scene, record: AircraftRecord, link: LinkHealth, own: Path | None
) -> None:
    name = record.name
    lines = [
        (f"{one.system_id}/{one.component_id} missing frames", one.seconds[:, 0], one.seconds[:, 2])
        for one in link.components
    ]
    lines += [(what, link.radio[:, 0], link.radio[:, column]) for column, what in enumerate(_RADIO, start=1)]
    for what, time, values in lines:
        for piece in scene.pieces(time):
            writer.link(name, what, time[piece], values[piece])
    vehicle = next((beat.system_id for _, beat in record.facts.rare if isinstance(beat, Heartbeat)), None)
    notes = [
        Note(time, "WARN", "link: the vehicle's clock started again from 0", True) for time in link.reboots_s
    ]
    for one in link.components:
        who = f"{one.system_id}/{one.component_id}"
        autopilot = (one.system_id, one.component_id) == (vehicle, AUTOPILOT_COMPONENT)
        for begin, long in one.gaps_s:
            notes.append(
                Note(begin, "WARN", f"link: nothing was received from {who} for {long:.1f} s", autopilot)
            )
            if autopilot and one.seconds[-1, 0] > begin:
                notes.append(
                    Note(begin + long, "INFO", f"link: {who} was received again after {long:.1f} s", True)
                )
    for _, some in itertools.groupby(sorted(notes, key=_time_of), key=lambda note: scene.piece(note.time_s)):
        found = list(some)
        writer.notes(name, found)
        marked = [note for note in found if note.marked]
        if own is not None and marked:
            writer.mark(name, marked, np.array([place(own, note.time_s) for note in marked]))


def _time_of(note: Note) -> float:
    return note.time_s


def _in_pieces(record: AircraftRecord, scene: Scene, offset_s: float) -> Iterator[Iterator[Step]]:
    """Yield the steps of each piece of the time line. A piece with many steps is split into parts."""
    current, taken = (0, False), 0

    def piece(step: Step) -> tuple[int, bool, int]:
        nonlocal current, taken
        if (its := scene.piece(step.now_s + offset_s)) != current:
            current, taken = its, 0
        taken += 1 + sum(len(one.tracks) for one in step.commands if isinstance(one, Decision))
        return *its, taken // MOST_TAKEN

    for _, steps in itertools.groupby(record.steps(), key=piece):
        yield steps


def _write_distances(writer: Writer, shown: _Shown) -> None:
    drawn = {(pair.first, pair.second) for pair in shown.pairs}
    if not drawn:
        return
    paths = shown.ways.paths
    required = max(pair.required_m for pair in shown.pairs)
    times = np.unique(np.concatenate([path.time_s[[0, -1]] for path in paths]))
    edges = np.arange(times[0], times[-1], 1.0)
    for piece in shown.scene.pieces(edges):
        start = edges[piece.start]
        end = edges[piece.stop] if piece.stop < len(edges) else times[-1]
        near = [between(p, start, end) for p in paths if p.time_s[0] <= end and p.time_s[-1] >= start]
        found = [pair for pair in separations(tuple(near)) if (pair.first, pair.second) in drawn]
        writer.distances([pair for pair in found if pair.minimum_m is not None], required)
    by_name = {path.name: path for path in paths}
    for pair in shown.pairs:
        ends = (by_name[pair.first], by_name[pair.second])
        middle = np.mean([place(path, pair.minimum_time_s or 0.0) for path in ends], axis=0)
        writer.closest(pair, middle)


def _pieces(path: Path, scene: Scene) -> list[Path]:
    """Split a path into joined parts. Each part ends with the first sample of the next one."""
    rows = [slice(one.start, one.stop + 1) for one in scene.pieces(path.time_s)]
    return [replace(path, time_s=path.time_s[r], position_ned_m=path.position_ned_m[r]) for r in rows]


def _closest_pairs(paths: tuple[Path, ...]) -> tuple[Separation, ...]:
    return tuple(pair for pair in closest(paths) if pair.minimum_m is not None)[:MAX_PAIRS_DRAWN]


def _conflicts(run: Run, offsets_s: dict[str, float]) -> Floats:
    """Return the times (n,) at which any aircraft was in conflict with any track."""
    found = [
        record.facts.decisions.now_s[record.facts.decisions.conflict] + offsets_s[record.name]
        for record in run.aircraft
    ]
    return np.concatenate(found)


def _scene(
    run: Run, ways: Flown, colours: dict[str, Rgb], encounter: Encounter | None, name: str = ""
) -> Scene:
    root = f"/runs/{rerun().escape_entity_path_part(name)}" if name else ""
    aircraft = tuple(
        Aircraft(
            name=record.name,
            rgb=colours[record.name],
            offset_s=ways.offsets_s[record.name],
            config=record.header.config if record.header else None,
            undulation_m=record.facts.undulation_m,
        )
        for record in run.aircraft
    )
    starts = [record.facts.start_s + ways.offsets_s[record.name] for record in run.aircraft]
    ends = [record.facts.end_s + ways.offsets_s[record.name] for record in run.aircraft]
    return Scene(ways.origin, aircraft, encounter, root, name, (min(starts), max(ends)))


def _look(ways: Flown, pairs: Sequence[Separation], encounter: Encounter | None) -> Look | None:
    """Return a view of where the pairs come closest that includes all aircraft at the start of the encounter.

    Without an encounter it shows everything that was flown. The radius is limited by `LOOK_M`.
    """
    if not ways.paths:
        return None
    if not pairs or encounter is None:
        least = np.min([path.position_ned_m.min(axis=0) for path in ways.paths], axis=0)
        most = np.max([path.position_ned_m.max(axis=0) for path in ways.paths], axis=0)
        for path in ways.paths:
            release(path.position_ned_m)
        return Look((least + most) / 2.0, max(float(np.linalg.norm(most - least)) / 2.0, LOOK_M[0]))
    centre = crossing(ways, pairs)
    away = [np.linalg.norm(place(path, encounter.start_s) - centre) for path in ways.paths]
    return Look(centre, float(np.clip(max(away), *LOOK_M)))


# ---------------------------------------------------------------- several runs


def _moved(ways: Flown, by_s: float) -> Flown:
    """Return a copy with `by_s` added to all times."""
    return replace(
        ways,
        paths=tuple(replace(path, time_s=path.time_s + by_s) for path in ways.paths),
        own=tuple(replace(path, time_s=path.time_s + by_s) for path in ways.own),
        offsets_s={name: offset + by_s for name, offset in ways.offsets_s.items()},
    )


def _in_frame(ways: Flown, origin: Vec3) -> Flown:
    def turned(path: Path) -> Path:
        return replace(path, position_ned_m=from_frame(path.position_ned_m, ways.origin, origin))

    return replace(
        ways, origin=origin, paths=tuple(map(turned, ways.paths)), own=tuple(map(turned, ways.own))
    )


def _apart_m(one: Vec3, other: Vec3) -> float:
    n, e, d = pymap3d.geodetic2ned(*one, *other)
    return float(np.hypot(np.hypot(n, e), d))


def _joined(found: Sequence[Encounter | None]) -> Encounter | None:
    """Return one encounter that spans those of all runs. Its time 0 is the earliest of theirs."""
    known = [one for one in found if one is not None]
    if not known:
        return None
    start, end = min(one.start_s for one in known), max(one.end_s for one in known)
    first = min(known, key=lambda one: one.zero_s)
    return Encounter(start, first.zero_s, end, first.what)
