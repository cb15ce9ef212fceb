"""What is found for one published figure: statements that hold or not, numbers beside published ones."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from rich import box
from rich.console import Console
from rich.table import Table

from ground_tools.channel.table import with_error

Value = str | float | tuple[float, float] | None
"""Of a table: words, a number, from a number to another, or nothing known."""


@dataclass(frozen=True, slots=True)
class Statement:
    """A published statement and, place by place, whether our numbers bear it out."""

    published: str
    ours: str
    """What our numbers say, in a few words."""
    checks: dict[str, bool]
    """Whether it holds, by place (a size, a rate)."""

    @property
    def holds(self) -> bool:
        """At every place."""
        return all(self.checks.values())

    @property
    def verdict(self) -> str:
        """In words."""
        held = sum(self.checks.values())
        if held in (0, len(self.checks)):
            return "holds" if held else "does not hold"
        return f"holds at {held} of {len(self.checks)}"


@dataclass(frozen=True, slots=True)
class Comparison:
    """A number of ours; beside it the published one where there is one."""

    name: str
    """Of the mode, for people."""
    labels: dict[str, str | float]
    """What it is: `mode`, `wifi_channels`, `rate`, `sigma_db`, `density`."""
    ours_ms: float
    error_ms: float
    """Monte Carlo standard error; NaN where none is known."""
    published_ms: float | None

    @property
    def ratio(self) -> float | None:
        """Ours by the published one."""
        return None if self.published_ms is None else self.ours_ms / self.published_ms


@dataclass(frozen=True, slots=True)
class Numbers:
    """A table with columns of its own, for what is no delay."""

    title: str
    columns: dict[str, str]
    """Heads for people, by key."""
    rows: tuple[dict[str, Value], ...]
    """Values by key; those of other keys than the columns' are for machines alone."""


@dataclass(frozen=True, slots=True)
class Report:
    """All of one figure."""

    title: str
    notes: tuple[str, ...]
    """How words are meant, how numbers came about."""
    statements: tuple[Statement, ...] = ()
    comparisons: tuple[Comparison, ...] = ()
    numbers: tuple[Numbers, ...] = ()


def show(report: Report, console: Console) -> None:
    """Print for people."""
    console.print(report.title, style="bold", highlight=False, soft_wrap=True)
    for note in report.notes:
        console.print(note, style="dim", highlight=False, soft_wrap=True)
    if report.statements:
        rows = [(s.published, s.ours, s.verdict) for s in report.statements]
        console.print(_table(("published", "ours", "verdict"), rows))
    if report.comparisons:
        numbers = [
            (
                c.name,
                f"{c.labels['rate']}",
                f"{c.labels['sigma_db']:.4g}",
                f"{c.labels['density']}",
                "-" if c.published_ms is None else f"{c.published_ms:.2f}",
                _ours(c),
                "-" if c.ratio is None else f"{c.ratio:.3f}",
            )
            for c in report.comparisons
        ]
        columns = ("mode", "rate", "sigma dB", "density", "published", "ours", "ratio")
        console.print(_table(columns, numbers, right=True))
    for table in report.numbers:
        console.print(table.title, style="bold", highlight=False, soft_wrap=True)
        words = [tuple(_words(row[key]) for key in table.columns) for row in table.rows]
        console.print(_table(tuple(table.columns.values()), words, right=True))


def _words(value: Value) -> str:
    """Of a table's value: whole numbers as they are, others with two decimals."""
    if value is None:
        return "-"
    if isinstance(value, tuple):
        return f"{value[0]:g}-{value[1]:g}"
    if isinstance(value, float):
        return f"{value:.2f}"
    return str(value)


def _ours(c: Comparison) -> str:
    """Our number, with its error where one is known."""
    if not math.isnan(c.error_ms):
        return with_error(c.ours_ms, c.error_ms)
    return f"{c.ours_ms:.1f}" if c.ours_ms >= 10.0 else f"{c.ours_ms:.3g}"


def _table(columns: tuple[str, ...], rows: Iterable[tuple[str, ...]], *, right: bool = False) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for index, column in enumerate(columns):
        table.add_column(column, justify="right" if right and index else "left")
    for row in rows:
        table.add_row(*row)
    return table


def json_rows(figure: str, report: Report) -> list[dict[str, object]]:
    """For machines, one object for each statement and number; what is not finite is null."""
    statements: list[dict[str, object]] = [
        {
            "figure": figure,
            "kind": "statement",
            "published": s.published,
            "ours": s.ours,
            "holds": s.holds,
            "checks": s.checks,
        }
        for s in report.statements
    ]
    numbers: list[dict[str, object]] = [
        {
            "figure": figure,
            "kind": "number",
            **c.labels,
            "published_ms": c.published_ms,
            "ours_ms": _finite(c.ours_ms),
            "ours_se_ms": _finite(c.error_ms),
            "ratio": _finite(c.ratio),
        }
        for c in report.comparisons
    ]
    tables: list[dict[str, object]] = [
        {"figure": figure, "kind": "number", **row} for table in report.numbers for row in table.rows
    ]
    return statements + numbers + tables


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
