"""Results for one published figure: statements that hold or not, and numbers next to published ones."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from rich import box
from rich.console import Console
from rich.table import Table

from ground_tools.channel.table import with_error

Value = str | float | tuple[float, float] | None
"""A value in a table: text, a number, a range, or None if it is unknown."""


@dataclass(frozen=True, slots=True)
class Statement:
    """A published statement and whether our numbers confirm it."""

    published: str
    ours: str
    """Short text of what our numbers show."""
    checks: dict[str, bool]
    """Whether the statement holds, for each checked condition (a size, a rate)."""

    @property
    def holds(self) -> bool:
        """Whether the statement holds under every condition."""
        return all(self.checks.values())

    @property
    def verdict(self) -> str:
        """The result as text."""
        held = sum(self.checks.values())
        if held in (0, len(self.checks)):
            return "holds" if held else "does not hold"
        return f"holds at {held} of {len(self.checks)}"


@dataclass(frozen=True, slots=True)
class Comparison:
    """One of our numbers, with the published number if there is one."""

    name: str
    """Display name of the mode."""
    labels: dict[str, str | float]
    """Conditions of the number: `mode`, `wifi_channels`, `rate`, `sigma_db`, `density`."""
    ours_ms: float
    error_ms: float
    """Monte Carlo standard error; NaN if it is unknown."""
    published_ms: float | None

    @property
    def ratio(self) -> float | None:
        """Our number divided by the published one."""
        return None if self.published_ms is None else self.ours_ms / self.published_ms


@dataclass(frozen=True, slots=True)
class Numbers:
    """A table with its own columns, for numbers that are not delays."""

    title: str
    columns: dict[str, str]
    """Column headings, by key."""
    rows: tuple[dict[str, Value], ...]
    """Values by key. Values whose key is not a column appear only in the JSON output."""


@dataclass(frozen=True, slots=True)
class Report:
    """All results for one figure."""

    title: str
    notes: tuple[str, ...]
    """Explanations of the terms and of how the numbers were obtained."""
    statements: tuple[Statement, ...] = ()
    comparisons: tuple[Comparison, ...] = ()
    numbers: tuple[Numbers, ...] = ()


@dataclass(frozen=True, slots=True)
class Printed:
    """A table as text."""

    title: str
    """Title; empty if the columns are self-explanatory."""
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: bool
    """Whether all columns but the first hold numbers."""


def tables(report: Report) -> list[Printed]:
    """All tables of a report: statements, comparisons, numbers."""
    found = []
    if report.statements:
        rows = tuple((s.published, s.ours, s.verdict) for s in report.statements)
        found.append(Printed("", ("published", "ours", "verdict"), rows, False))
    if report.comparisons:
        compared = tuple(
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
        )
        columns = ("mode", "rate", "sigma dB", "density", "published", "ours", "ratio")
        found.append(Printed("", columns, compared, True))
    for table in report.numbers:
        words = tuple(tuple(_words(row[key]) for key in table.columns) for row in table.rows)
        found.append(Printed(table.title, tuple(table.columns.values()), words, True))
    return found


def show(report: Report, console: Console) -> None:
    """Print a report on the terminal."""
    console.print(report.title, style="bold", highlight=False, markup=False, soft_wrap=True)
    for note in report.notes:
        console.print(note, style="dim", highlight=False, markup=False, soft_wrap=True)
    for table in tables(report):
        if table.title:
            console.print(table.title, style="bold", highlight=False, markup=False, soft_wrap=True)
        console.print(_table(table.columns, table.rows, right=table.numbers))


def _words(value: Value) -> str:
    """The text of a table's value. Floating-point numbers have two decimals."""
    if value is None:
        return "-"
    if isinstance(value, tuple):
        return f"{value[0]:g}-{value[1]:g}"
    if isinstance(value, float):
        return f"{value:.2f}"
    return str(value)


def _ours(c: Comparison) -> str:
    """The text of our number, with its error if it is known."""
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
    """The report for JSON: one object for each statement and number; numbers that are not finite are None."""
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
