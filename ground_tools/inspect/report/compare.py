"""Comparison of two or more runs: differences in the configuration, and in the results.

Runs are aligned as in the recording. Times count from the start of the timed paths if every run has one, and
otherwise from the first take-off. Aircraft, and therefore pairs, are matched by name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
from rich.console import Console

from companion.config import public
from companion.errors import ConfigError
from ground_tools.inspect.read import align
from ground_tools.inspect.read.flown import placed
from ground_tools.inspect.read.read_run import Run
from ground_tools.inspect.report.summary import describe
from ground_tools.inspect.report.terminal import Rows, as_text, line, number, show_table

_WHOLE = frozenset({"path", "fence"})
"""Parts of the configuration whose values are not shown; only the fact that they differ is."""
_OF_RECORDS = "configuration, manoeuvres, alerts and own Remote ID"


def compare(runs: Sequence[Run]) -> dict[str, Any]:
    """Return the differences between runs, ready for JSON. Each list of values has one per run, in order.

    Raises:
        ConfigError: There are fewer than two runs.
    """
    if len(runs) < 2:
        raise ConfigError("--compare needs at least two runs that can be read")
    described = [describe(run) for run in runs]
    ways = [placed(run) for run in runs]
    zeros, zero = align.zeros(runs, ways)
    return {
        "runs": align.names(runs),
        "zero": zero,
        "positions": [figures["positions"] for figures in described],
        "config": _config(runs),
        "pairs": _pairs(described, zeros),
        "figures": [
            {"what": what, "values": [value(figures) for figures in described]} for what, value in _FIGURES
        ],
        "problems": [
            {"run": name, "text": words}
            for name, figures in zip(align.names(runs), described, strict=True)
            for words in (*figures["problems"], *_missing(figures))
        ],
    }


def _missing(figures: dict[str, Any]) -> list[str]:
    """Describe what cannot be compared for a run."""
    found = []
    if figures["positions"] is None:
        found.append("separations, distances and speeds are not compared, because there are no positions")
    elif len(figures["aircraft"]) < 2:
        found.append("separations are not compared, because there is one aircraft")
    silent = [one["name"] for one in figures["aircraft"] if one["software"] is None]
    if silent:
        found.append(
            f"{_OF_RECORDS} are not compared, because {', '.join(silent)} has no record of a companion"
        )
    return found


# ---------------------------------------------------------------- configuration


def _config(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return the keys that differ between runs. If the aircraft of a run differ, list each one's value."""
    tables = [_by_key(run) for run in runs]
    found = []
    for key in sorted({key for table in tables for key in table}):
        values = [table.get(key, {}) for table in tables]
        if all(one == values[0] for one in values):
            continue
        whole = key.split(".")[0] in _WHOLE
        found.append({"key": key, "values": ["differs" if whole else _of_run(one) for one in values]})
    return found


def _by_key(run: Run) -> dict[str, dict[str, Any]]:
    """Return, for each key, the value of each aircraft."""
    found: dict[str, dict[str, Any]] = {}
    for record in run.aircraft:
        if record.header is None:
            continue
        for key, value in _flat(msgspec.to_builtins(public(record.header.config))).items():
            found.setdefault(key, {})[record.name] = value
    return found


def _flat(value: Any, name: str = "") -> dict[str, Any]:
    if not isinstance(value, dict) or not value or name in _WHOLE:
        return {name: value}
    found: dict[str, Any] = {}
    for key, inner in value.items():
        found |= _flat(inner, f"{name}.{key}" if name else key)
    return found


def _of_run(values: dict[str, Any]) -> Any:
    """Return a single value if all aircraft have the same one, otherwise the value of each."""
    kinds = list(values.values())
    if not kinds:
        return None
    return kinds[0] if all(kind == kinds[0] for kind in kinds) else values


# ---------------------------------------------------------------- figures


def _pairs(described: Sequence[dict[str, Any]], zeros: Sequence[float]) -> list[dict[str, Any]]:
    """Return the smallest separation of every pair; the pair that came closest in any run is first."""
    tables = [{tuple(sorted(row["pair"])): row for row in figures["separations"]} for figures in described]
    found = []
    for pair in sorted({pair for table in tables for pair in table}):
        rows = [table.get(pair) for table in tables]
        least = [None if row is None else row["minimum_m"] for row in rows]
        times = [
            None if row is None or row["minimum_time_s"] is None else row["minimum_time_s"] - zero
            for row, zero in zip(rows, zeros, strict=True)
        ]
        found.append(
            {
                "pair": list(pair),
                "minimum_m": least,
                "time_s": times,
                "required_m": [None if row is None else row["required_m"] for row in rows],
                "kept": [None if row is None else row["kept"] for row in rows],
            }
        )
    return sorted(found, key=lambda row: min((m for m in row["minimum_m"] if m is not None), default=np.inf))


def _total(of: Callable[[dict[str, Any]], float | None]) -> Callable[[dict[str, Any]], float | None]:
    """Return a function that sums a figure over all aircraft for which it is known."""

    def total(figures: dict[str, Any]) -> float | None:
        known = [value for one in figures["aircraft"] if (value := of(one)) is not None]
        return sum(known) if known else None

    return total


def _most(of: Callable[[dict[str, Any]], Sequence[float | None]]) -> Callable[[dict[str, Any]], float | None]:
    """Return a function that gives the largest value of a figure of any aircraft."""

    def most(figures: dict[str, Any]) -> float | None:
        return max((v for one in figures["aircraft"] for v in of(one) if v is not None), default=None)

    return most


def _least_separation(figures: dict[str, Any]) -> float | None:
    return min((r["minimum_m"] for r in figures["separations"] if r["minimum_m"] is not None), default=None)


def _median_age(figures: dict[str, Any]) -> float | None:
    ages = [row["median_s"] for one in figures["aircraft"] for row in one["remote_id"]["ages"]]
    return float(np.median(ages)) if ages else None


def _lost_percent(figures: dict[str, Any]) -> float | None:
    rows = [row for one in figures["aircraft"] for row in one["remote_id"]["heard"] if row["lost_of"]]
    return 100.0 * sum(row["lost"] for row in rows) / sum(row["lost_of"] for row in rows) if rows else None


_FIGURES: tuple[tuple[str, Callable[[dict[str, Any]], float | None]], ...] = (
    ("least separation (m)", _least_separation),
    ("pairs that lost separation", lambda f: sum(row["kept"] is False for row in f["separations"])),
    ("longest record (s)", _most(lambda one: [one["duration_s"]])),
    ("flown, all aircraft (m)", _total(lambda one: one["flight"]["distance_m"])),
    ("fastest (m/s)", _most(lambda one: [one["flight"]["max_speed_mps"]])),
    ("manoeuvres", _total(lambda one: len(one["manoeuvres"]))),
    (
        "time in manoeuvres, all aircraft (s)",
        _total(lambda one: sum(row["end_s"] - row["start_s"] for row in one["manoeuvres"])),
    ),
    ("off the path in manoeuvres (m)", _most(lambda one: [row["deviation_m"] for row in one["manoeuvres"]])),
    ("decisions without a feasible velocity", _total(lambda one: one["infeasible"])),
    ("cautions", _total(lambda one: one["cautions"])),
    ("warnings", _total(lambda one: one["warnings"])),
    ("broadcasts sent", _total(lambda one: one["broadcasts"])),
    ("longest gap between Locations (s)", _most(lambda one: _location_gaps(one))),
    ("Remote ID not legal (s)", _total(lambda one: one["remote_id"]["not_legal_s"])),
    ("frames heard", _total(lambda one: one["heard"])),
    ("frames lost, by their counters (%)", _lost_percent),
    ("median age of information, median over the tracks (s)", _median_age),
    (
        "95 % age of information, worst track (s)",
        _most(lambda one: [row["p95_s"] for row in one["remote_id"]["ages"]]),
    ),
    ("worst age of information (s)", _most(lambda one: [row["worst_s"] for row in one["remote_id"]["ages"]])),
    ("faults and warnings", _total(lambda one: len(one["faults"]))),
)


def _location_gaps(one: dict[str, Any]) -> list[float | None]:
    return [row["longest_s"] for row in one["remote_id"]["sent"] if row["message"] == "Location"]


# ---------------------------------------------------------------- in the terminal


def show(figures: dict[str, Any], console: Console) -> None:
    """Print the result of `compare`."""
    line(console, f"Time 0 is {figures['zero']}", "bold")
    for row in figures["problems"]:
        line(console, f"  problem: {row['run']}: {row['text']}", "yellow")
    head = list(figures["runs"])
    for title, rows in (
        ("Configuration that differs", _config_rows(figures, head)),
        ("Results", _figure_rows(figures, head)),
        ("Least separation", _pair_rows(figures, head)),
    ):
        if len(rows) > 1:
            show_table(console, title, rows)


def text(figures: dict[str, Any]) -> str:
    """Return what `show` prints if the output is not a terminal."""
    return as_text(show, figures)


def _config_rows(figures: dict[str, Any], head: list[str]) -> Rows:
    return [["key", *head]] + [
        [row["key"], *("-" if value is None else str(value) for value in row["values"])]
        for row in figures["config"]
    ]


def _figure_rows(figures: dict[str, Any], head: list[str]) -> Rows:
    rows = [["", *head, *(["difference"] if len(head) == 2 else [])]]
    for row in figures["figures"]:
        values = row["values"]
        apart = []
        if len(values) == 2:
            apart = ["-" if None in values else f"{values[1] - values[0]:+.{_digits(values[1])}f}"]
        rows.append([row["what"], *(number(value, _digits(value)) for value in values), *apart])
    return rows


def _digits(value: float | None) -> int:
    return 0 if isinstance(value, int) else 2


def _pair_rows(figures: dict[str, Any], head: list[str]) -> Rows:
    rows = [["pair", *head]]
    for row in figures["pairs"]:
        cells = []
        for least, at_s, kept in zip(row["minimum_m"], row["time_s"], row["kept"], strict=True):
            lost = "" if kept is not False else "LOST "
            cells.append("-" if least is None else f"{lost}{least:.2f} m at {at_s:.1f} s")
        rows.append([" - ".join(row["pair"]), *cells])
    return rows
