"""The common time line of a run's aircraft.

In a lock-step run, and among companions on one machine, `now_s` of the steps is one clock for all. Elsewhere
each companion counts from its own boot: there, UTC of the autopilots (SYSTEM_TIME) puts them together, to
within the latency of the links and the error of the autopilots' clocks. Where all fly timed paths that start
at one UTC, the line counts from that start, as the paths do. `words` says which it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ground_tools.inspect.read_run import Run

SHARED_CLOCK_S = 0.05
"""Clocks that agree with UTC alike to within this are one clock."""


@dataclass(frozen=True, slots=True)
class TimeLine:
    """How each aircraft's clock, and UTC, lie on the common line."""

    offsets_s: dict[str, float]
    """What to add to an aircraft's `now_s`."""
    utc_at_zero_s: float | None
    """None where not every aircraft knew UTC."""
    words: str


def time_line(run: Run) -> TimeLine:
    """The time line of a run."""
    to_utc = {record.name: record.facts.utc_offset_s for record in run.aircraft}
    known = {name: offset for name, offset in to_utc.items() if offset is not None}
    if len(known) < len(to_utc):
        words = "the companion's own clock"
        if len(to_utc) > 1:
            silent = ", ".join(name for name in to_utc if name not in known)
            words = f"one clock taken for granted: no UTC from {silent}"
        return TimeLine(dict.fromkeys(to_utc, 0.0), None, words)
    values = list(known.values())
    if max(values) - min(values) <= SHARED_CLOCK_S:
        zero = float(np.median(values))
        known = dict.fromkeys(known, zero)
        words = "one clock shared by all aircraft" if len(known) > 1 else "the companion's own clock"
    else:
        words = "UTC of the autopilots"
        # Small numbers plot better: the line counts from the start of the first aircraft.
        zero = min(record.facts.start_s + known[record.name] for record in run.aircraft)
    start = _start_of_paths(run)
    if start is not None:
        zero, words = start, f"{words}; 0 is the start of the timed paths"
    return TimeLine({name: offset - zero for name, offset in known.items()}, zero, words)


def _start_of_paths(run: Run) -> float | None:
    """UTC at which the timed paths of all aircraft start; None where that is not one moment."""
    starts = {
        record.header.config.flight.start_utc_s
        if record.header is not None and record.header.config.flight.start == "utc"
        else None
        for record in run.aircraft
    }
    return starts.pop() if len(starts) == 1 else None
