"""Runs that are laid beside each other: their names, and the time that each counts from."""

from __future__ import annotations

from collections.abc import Sequence

from companion.events import Heartbeat, Landed, LandedState
from ground_tools.inspect.flown import Flown
from ground_tools.inspect.read_run import AircraftRecord, Run

_IN_AIR = frozenset({Landed.IN_AIR, Landed.TAKEOFF})


def names(runs: Sequence[Run]) -> list[str]:
    """Each run's own name, told apart where two folders are called the same."""
    found = [run.name for run in runs]
    return [
        name if name not in found[:index] else f"{name} ({found[:index].count(name) + 1})"
        for index, name in enumerate(found)
    ]


def zeros(runs: Sequence[Run], every: Sequence[Flown]) -> tuple[list[float], str]:
    """When each run begins to count, on its own common time line, and what that moment is, in words.

    The start of the timed paths where every run has one; otherwise the first take-off.
    """
    if all(ways.from_path for ways in every):
        return [0.0] * len(runs), "the start of the timed paths"
    return [_take_off(run, ways) for run, ways in zip(runs, every, strict=True)], "the first take-off"


def _take_off(run: Run, ways: Flown) -> float:
    """When the first aircraft was armed and in the air; where none tells, when the first path begins."""
    found = [
        now_s + ways.offsets_s[record.name]
        for record in run.aircraft
        if (now_s := _in_air_s(record)) is not None
    ]
    return min(found, default=min(float(path.time_s[0]) for path in ways.paths))


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
