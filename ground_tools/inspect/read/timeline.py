"""The common time line of the aircraft of a run, and the merging of several runs on one time line.

In a lock-step run, and for companions on one machine, `now_s` of the steps is one clock shared by all.
Otherwise each companion counts from its own boot. Its times are then aligned by the UTC of the autopilots
(SYSTEM_TIME), to within the latency of the links and the error of the autopilots' clocks. A telemetry log has
its own UTC, an onboard log that of the vehicle's GNSS receiver. If all aircraft fly timed paths that start at
the same UTC, time 0 is that start, as it is for the paths. `TimeLine.words` states which case applies.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ground_tools.inspect.read.facts import UTC_NOISE_S
from ground_tools.inspect.read.read_run import AircraftRecord, Run

SHARED_CLOCK_S = 0.05
"""Clocks whose offsets to UTC agree to within this are treated as one clock."""


@dataclass(frozen=True, slots=True)
class TimeLine:
    """Relation of each aircraft's clock, and of UTC, to the common time line."""

    offsets_s: dict[str, float]
    """For each aircraft, the offset from its `now_s` to the common time line."""
    utc_at_zero_s: float | None
    """UTC at time 0; None if not every aircraft knew UTC."""
    words: str
    """Description of the time line."""
    from_path: bool = False
    """True if time 0 is the start of the timed paths."""
    problems: tuple[str, ...] = ()
    """Which aircraft are placed wrongly for a part of their records, one line each."""


def time_line(run: Run) -> TimeLine:
    """Return the common time line of a run."""
    return replace(_time_line(run), problems=tuple(map(_clock_set, filter(clock_set_s, run.aircraft))))


def clock_set_s(record: AircraftRecord) -> float | None:
    """Return by how much (s) a clock was set within the record; None if it was not.

    One offset to UTC is then wrong for a part of the record.
    """
    return record.facts.utc_off_s if record.facts.utc_off_s > UTC_NOISE_S else None


def _clock_set(record: AircraftRecord) -> str:
    return (
        f"{record.name}: the clock of its record, or the vehicle's UTC, was set by about "
        f"{record.facts.utc_off_s:.0f} s; a part of the record is placed wrongly by that on the time line, "
        "and separations there are not those that were flown"
    )


def _time_line(run: Run) -> TimeLine:
    to_utc = {record.name: record.facts.utc_offset_s for record in run.aircraft}
    known = {name: offset for name, offset in to_utc.items() if offset is not None}
    if len(known) < len(to_utc):
        words = "the companion's own clock"
        if run.aircraft[0].log:
            words = "the vehicle's clock, since it started"
        if len(to_utc) > 1:
            silent = ", ".join(name for name in to_utc if name not in known)
            words = f"one clock, assumed to be common because {silent} recorded no UTC"
        return TimeLine(dict.fromkeys(to_utc, 0.0), None, words)
    values = list(known.values())
    # The time line starts at the earliest step, because small numbers are easier to read in plots.
    if any(record.log for record in run.aircraft):
        words = _utc_of_logs(run.aircraft)
        zero = _first_start(run.aircraft)
    elif max(values) - min(values) <= SHARED_CLOCK_S:
        known = dict.fromkeys(known, float(np.median(values)))
        zero = min(record.facts.start_s for record in run.aircraft) + float(np.median(values))
        words = "one clock shared by all aircraft" if len(known) > 1 else "the companion's own clock"
    else:
        words = "UTC of the autopilots"
        zero = _first_start(run.aircraft)
    start = _start_of_paths(run)
    if start is not None:
        zero, words = start, f"{words}; 0 is the start of the timed paths"
    offsets = {name: offset - zero for name, offset in known.items()}
    return TimeLine(offsets, zero, words, from_path=start is not None)


def _utc_of_logs(aircraft: Sequence[AircraftRecord]) -> str:
    """Describe the source of UTC if at least one aircraft was read from a log."""
    onboard = sum(record.log == "onboard" for record in aircraft)
    if onboard == len(aircraft):
        return "UTC of the vehicles' GNSS receivers, as logged on board"
    stamped = [record.name for record in aircraft if record.stamped]
    told = "UTC that the vehicles sent (SYSTEM_TIME)"
    if onboard:
        told += " or logged on board (GNSS)"
    own = "the log's own time stamps" if len(stamped) == 1 else "their logs' own time stamps"
    if not stamped:
        return told
    if len(stamped) == len(aircraft):
        return f"UTC of {own}, because no vehicle sent it"
    return f"{told}; for {', '.join(stamped)}, that of {own}"


def _first_start(aircraft: Sequence[AircraftRecord]) -> float:
    """Return the UTC of the earliest step. Every aircraft must know UTC."""
    return min(record.facts.start_s + (record.facts.utc_offset_s or 0.0) for record in aircraft)


def _start_of_paths(run: Run) -> float | None:
    """Return the UTC at which the timed paths of all aircraft start; None if there is no common start."""
    starts = {
        record.header.config.flight.start_utc_s
        if record.header is not None and record.header.config.flight.start == "utc"
        else None
        for record in run.aircraft
    }
    return starts.pop() if len(starts) == 1 else None


def together(runs: Sequence[Run]) -> Run:
    """Merge several runs into one, with all aircraft on one UTC time line and with distinct names.

    An aircraft that does not know UTC gets the median UTC offset of the others in its run, as if they shared
    a clock. A run in which no aircraft knows UTC is left out. `problems` lists both cases, and runs that do
    not overlap in time with any other run. A run that is given twice is used once.
    """
    given: dict[Path, Run] = {}
    twice = [run for run in runs if given.setdefault(run.folder.resolve(), run) is not run]
    runs = list(given.values())
    if len(runs) == 1:
        return replace(runs[0], problems=(*runs[0].problems, *map(_twice, twice)))
    problems = [_twice(run) for run in twice]
    problems += [f"{run.name}: {problem}" for run in runs for problem in run.problems]
    notes = [f"{run.name}: {note}" for run in runs for note in run.notes]
    placed: list[tuple[Run, list[AircraftRecord]]] = []
    for run in runs:
        offsets = [one.facts.utc_offset_s for one in run.aircraft if one.facts.utc_offset_s is not None]
        if offsets:
            common = float(np.median(offsets))
            placed.append((run, [_with_utc(one, common, run.name, problems) for one in run.aircraft]))
        else:
            problems.append(f"{run.name}: the run is left out because none of its aircraft knows UTC")
    if not placed:
        placed = [(runs[0], list(runs[0].aircraft))]
    spans = [(run.name, *_span(aircraft)) for run, aircraft in placed]
    for name, start, end in spans:
        others = [one for one in spans if one[0] != name]
        if others and all(end < other[1] or other[2] < start for other in others):
            problems.append(
                f"{name}: the run ({utc_words(start)} to {utc_words(end)}) does not overlap with the others"
            )
    return Run(
        runs[0].folder,
        None,
        None,
        _distinct([(run, one) for run, aircraft in placed for one in aircraft]),
        tuple(problems),
        tuple(notes),
        len(runs) - 1,
    )


def _twice(run: Run) -> str:
    return f"{run.folder}: the run is given more than once and shown once"


def _with_utc(record: AircraftRecord, common_s: float, run: str, problems: list[str]) -> AircraftRecord:
    if record.facts.utc_offset_s is not None:
        return record
    problems.append(
        f"{run}: {record.name}: it knows no UTC; its clock is assumed to be that of the others in this run"
    )
    return replace(record, facts=replace(record.facts, utc_offset_s=common_s))


def _span(aircraft: Sequence[AircraftRecord]) -> tuple[float, float]:
    """Return the UTC of the first and of the last step."""
    ends = [one.facts.end_s + (one.facts.utc_offset_s or 0.0) for one in aircraft]
    return _first_start(aircraft), max(ends)


def utc_words(utc_s: float) -> str:
    """Format a time (Unix seconds) as date and UTC time, to the second."""
    return time.strftime("%Y-%m-%d %H:%M:%SZ", time.gmtime(utc_s))


def _distinct(aircraft: Sequence[tuple[Run, AircraftRecord]]) -> tuple[AircraftRecord, ...]:
    """Make names distinct: a shared name gets the run's name appended and, if still needed, a number."""
    names = [one.name for _, one in aircraft]
    taken: set[str] = set()
    found = []
    for run, one in aircraft:
        name = wanted = one.name if names.count(one.name) == 1 else f"{one.name} ({run.name})"
        number = 1
        while name in taken:
            number += 1
            name = f"{wanted} {number}"
        taken.add(name)
        found.append(replace(one, name=name))
    return tuple(found)
