"""Alignment of runs for a comparison: a distinct name and a time zero for each run."""

from __future__ import annotations

from collections.abc import Sequence

from companion.events import Heartbeat, Landed, LandedState
from ground_tools.inspect.read.flown import Flown
from ground_tools.inspect.read.read_run import AircraftRecord, Run

_IN_AIR = frozenset({Landed.IN_AIR, Landed.TAKEOFF})


def names(runs: Sequence[Run]) -> list[str]:
    """Return the name of each run. If several runs share a name, the later ones get a number."""
    found = [run.name for run in runs]
    return [
        name if name not in found[:index] else f"{name} ({found[:index].count(name) + 1})"
        for index, name in enumerate(found)
    ]


def zeros(runs: Sequence[Run], every: Sequence[Flown]) -> tuple[list[float], str]:
    """Return the time zero of each run, on that run's common time line, and a description of that moment.

    If every run has a start of its timed paths, that is time zero. Otherwise it is the first take-off. A run
    without a recorded take-off uses the first sample of its earliest path or, without positions, the start
    of its earliest record.
    """
    if all(ways.from_path for ways in every):
        return [0.0] * len(runs), "the start of the timed paths"
    found = [_take_off(run, ways) for run, ways in zip(runs, every, strict=True)]
    words = "the first take-off"
    silent = [name for name, known in zip(names(runs), found, strict=True) if known is None]
    if silent:
        words += f" (the beginning for {', '.join(silent)}, without a recorded take-off)"
    begun = [_beginning(run, ways) for run, ways in zip(runs, every, strict=True)]
    return [first if known is None else known for known, first in zip(found, begun, strict=True)], words


def _take_off(run: Run, ways: Flown) -> float | None:
    """Return when the first aircraft was armed and in the air; None if no record shows this."""
    found = [
        now_s + ways.offsets_s[record.name]
        for record in run.aircraft
        if (now_s := _in_air_s(record)) is not None
    ]
    return min(found, default=None)


def _beginning(run: Run, ways: Flown) -> float:
    if ways.paths:
        return min(float(path.time_s[0]) for path in ways.paths)
    return min(record.facts.start_s + ways.offsets_s[record.name] for record in run.aircraft)


def _in_air_s(record: AircraftRecord) -> float | None:
    armed = in_air = False
    for now_s, what in record.facts.rare:
        match what:
            case Heartbeat():
                armed = what.armed
            case LandedState():
                in_air = what.landed in _IN_AIR
        if armed and in_air:
            return now_s
    return None
