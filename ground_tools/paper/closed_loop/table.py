"""The table of the closed loop: each method under each condition, and ATMC compared with the best legal set.

Differences are computed for each encounter, because all methods fly the same encounters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from companion.arrays import Floats
from ground_tools.common.intervals import bootstrap, wilson
from ground_tools.paper.closed_loop.flights import ATMC, BEST_SET, METHODS, SEPARATION_M, Row

Interval = tuple[float, float]
Rows = Mapping[tuple[str, str], Sequence[Row]]
"""Rows of the encounters, by condition and method."""


@dataclass(frozen=True, slots=True)
class Measure:
    """One column of the table."""

    key: str
    title: str
    value: Callable[[Row], float | None]
    statistic: Callable[[Floats], Floats]
    """Statistic of the values over the last axis."""
    digits: int
    scale: float = 1.0


def _mean(values: Floats) -> Floats:
    return np.asarray(values.mean(axis=-1))


def _low(values: Floats) -> Floats:
    return np.asarray(np.percentile(values, 5.0, axis=-1))


LOST: Final = Measure(
    "lost_share", "with a loss (%)", lambda r: float(r.least_separation_m < SEPARATION_M), _mean, 1, 100.0
)
MEASURES: Final = (
    Measure("age_mean_s", "age of information (s)", lambda r: r.age_mean_s, _mean, 3),
    Measure("age_p95_s", "95th percentile (s)", lambda r: r.age_p95_s, _mean, 2),
    Measure("age_max_s", "largest (s)", lambda r: r.age_max_s, _mean, 2),
    Measure("separation_m", "least separation (m)", lambda r: r.least_separation_m, _mean, 1),
    Measure("separation_p5_m", "5th percentile (m)", lambda r: r.least_separation_m, _low, 1),
    LOST,
    Measure("deviation_m", "deviation (m)", lambda r: r.deviation_m, _mean, 1),
    Measure("switches_per_minute", "switches a minute", lambda r: r.switches_per_minute, _mean, 2),
    Measure("fallback_share", "on the fall-back (%)", lambda r: r.fallback_share, _mean, 1, 100.0),
)


_SHOWN: Final = ("age_mean_s", "separation_m", "lost_share", "deviation_m")
"""Keys of the measures that fit on a terminal. The file table.md and the JSON output have all measures."""


@dataclass(frozen=True, slots=True)
class Number:
    """A value with its 95 % interval; None for one that does not exist."""

    value: float | None
    interval: Interval | None

    def words(self, digits: int, scale: float = 1.0) -> str:
        """The number as text for people."""
        if self.value is None:
            return "-"
        text = f"{scale * self.value:.{digits}f}"
        if self.interval is None:
            return text
        return f"{text} ({scale * self.interval[0]:.{digits}f} to {scale * self.interval[1]:.{digits}f})"


def number(rows: Sequence[Row], measure: Measure) -> Number:
    """One measure of a cell. The value is None if the measure does not apply to some row."""
    if any(measure.value(row) is None for row in rows):
        return Number(None, None)
    values = _by_run(rows, measure)
    value = float(measure.statistic(np.concatenate(values)))
    if measure is LOST and (len(values) == len(rows) or value in (0.0, 1.0)):
        # A bootstrap of equal values has no width. The share of the runs bounds that of the encounters.
        return Number(value, wilson(round(value * len(values)), len(values)))
    return Number(value, bootstrap(values, measure.statistic))


def difference(first: Sequence[Row], second: Sequence[Row], measure: Measure) -> Number:
    """Mean of `first` minus `second` over the encounters that both have."""
    other = {row.encounter: measure.value(row) for row in second}
    runs: dict[int, list[float]] = {}
    for row in first:
        ours, theirs = measure.value(row), other.get(row.encounter)
        if ours is not None and theirs is not None:
            runs.setdefault(row.run, []).append(ours - theirs)
    values = [np.array(run) for run in runs.values()]
    if not values:
        return Number(None, None)
    if measure is LOST and not any(run.any() for run in values):
        most = wilson(0, len(values))[1]
        return Number(0.0, (-most, most))
    return Number(float(_mean(np.concatenate(values))), bootstrap(values, _mean))


def _by_run(rows: Sequence[Row], measure: Measure) -> list[Floats]:
    runs: dict[int, list[float]] = {}
    for row in rows:
        value = measure.value(row)
        if value is not None:
            runs.setdefault(row.run, []).append(value)
    return [np.array(run) for run in runs.values()]


def main_sets(rows: Sequence[Row], most: int = 2) -> str:
    """Text of the most used transport sets with their shares of the time."""
    total: dict[str, float] = {}
    for row in rows:
        for name, seconds in row.seconds.items():
            total[name] = total.get(name, 0.0) + seconds
    whole_s = sum(total.values()) or 1.0
    ranked = sorted(total.items(), key=lambda item: (-item[1], item[0]))[:most]
    return ", ".join(f"{name}: {100.0 * seconds / whole_s:.0f} %" for name, seconds in ranked)


def json_rows(cells: Rows) -> list[dict[str, Any]]:
    """The results for JSON: one object for each cell and one for each difference."""
    found: list[dict[str, Any]] = []
    for (condition, method), rows in cells.items():
        head = {"figure": "closed-loop", "kind": "cell", "condition": condition, "method": method}
        numbers = {m.key: _plain(number(rows, m)) for m in MEASURES}
        runs = len({row.run for row in rows})
        found.append({**head, "encounters": len(rows), "runs": runs, **numbers, "sets": main_sets(rows, 5)})
    for condition, pair in _pairs(cells).items():
        head = {"figure": "closed-loop", "kind": "difference", "condition": condition}
        measures = [m for m in MEASURES if m.statistic is _mean]
        numbers = {m.key: _plain(difference(*pair, m)) for m in measures}
        found.append({**head, "methods": [ATMC, BEST_SET], **numbers})
    return found


def _plain(found: Number) -> dict[str, Any]:
    return {"value": found.value, "interval": None if found.interval is None else list(found.interval)}


def _pairs(cells: Rows) -> dict[str, tuple[Sequence[Row], Sequence[Row]]]:
    """The rows of ATMC and of the best legal set, for each condition that has both."""
    conditions = dict.fromkeys(condition for condition, _ in cells)
    return {
        c: (cells[c, ATMC], cells[c, BEST_SET])
        for c in conditions
        if {(c, ATMC), (c, BEST_SET)} <= cells.keys()
    }


def markdown(cells: Rows) -> str:
    """The tables as Markdown."""
    lines = []
    titles = ["condition", "method", "encounters", *(m.title for m in MEASURES), "sets"]
    lines += ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    for (condition, method), rows in cells.items():
        words = [number(rows, m).words(m.digits, m.scale) for m in MEASURES]
        cell = [condition, METHODS[method].words, str(len(rows)), *words, main_sets(rows)]
        lines.append("| " + " | ".join(cell) + " |")
    measures = [m for m in MEASURES if m.statistic is _mean]
    titles = ["ATMC minus best legal set", *(m.title for m in measures)]
    if pairs := _pairs(cells):
        lines += ["", "| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    for condition, pair in pairs.items():
        words = [difference(*pair, m).words(m.digits, m.scale) for m in measures]
        lines.append("| " + " | ".join([condition, *words]) + " |")
    return "\n".join(lines) + "\n"


def show(cells: Rows, console: Console) -> None:
    """Print the tables for people."""
    measures = [m for m in MEASURES if m.key in _SHOWN]
    for condition in dict.fromkeys(condition for condition, _ in cells):
        table = Table(title=f"{condition} (intervals of 95 %)", box=box.SIMPLE_HEAD, pad_edge=False)
        for title in ("method", "n", *(m.title for m in measures)):
            table.add_column(
                title, justify="left" if title == "method" else "right", no_wrap=title == "method"
            )
        for (where, method), rows in cells.items():
            if where == condition:
                words = [number(rows, m).words(m.digits, m.scale) for m in measures]
                table.add_row(METHODS[method].words, str(len(rows)), *words)
        console.print(table)
    for condition, pair in _pairs(cells).items():
        words = [f"{m.title} {difference(*pair, m).words(m.digits, m.scale)}" for m in measures]
        console.print(f"{condition}, ATMC minus best legal set: {'; '.join(words)}", highlight=False)
