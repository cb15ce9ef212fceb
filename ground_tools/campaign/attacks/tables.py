"""Summarises attacked flights and the same flights without the attack, as numbers and as a Markdown table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ground_tools.campaign.attacks.outcome import HIT_M, SEPARATION_M, Row, quantiles
from ground_tools.common.intervals import wilson

_HEAD = (
    "| attack | flights | lost | hit | least, m | 1 % / 5 % / median, m | above 10 m (95 %) | held, s "
    "| aside, m | up, m | down, m | beyond fence, m | without the attack: lost, least |"
)


def summary(rows: Sequence[Row], quiet: Sequence[Row]) -> dict[str, Any]:
    """Outcome of the flights of a kind.

    Args:
        rows: attacked flights, at least one.
        quiet: the same flights without the attack.
    """
    found = {**_summary(rows), "without": _summary(quiet)}
    found["by"] = {
        met: _summary([row for row in rows if row.met == met]) for met in sorted({row.met for row in rows})
    }
    return found


def _summary(rows: Sequence[Row]) -> dict[str, Any]:
    met = [row for row in rows if row.separation_m is not None]
    kept = sum(not row.lost for row in met)
    separations = np.array([row.separation_m for row in met], float)
    beyond = [row.beyond_m for row in rows if row.beyond_m is not None]
    return {
        "flights": len(rows),
        "met": len(met),
        "lost": len(met) - kept,
        "hit": sum(row.hit for row in met),
        "separation_m": quantiles(separations) if met else None,
        "above": kept / len(met) if met else None,
        "above_interval": wilson(kept, len(met)) if met else None,
        "longest_held_s": max(row.longest_s for row in rows),
        "median_held_s": float(np.median([row.held_s for row in rows])),
        "aside_m": max(row.aside_m for row in rows),
        "up_m": max(row.up_m for row in rows),
        "down_m": max(row.down_m for row in rows),
        "lowest_m": min(row.lowest_m for row in rows),
        "beyond_m": max(beyond, default=None),
        "worst_seeds": [row.seed for row in sorted(met, key=lambda row: row.separation_m or 0.0)[:5]],
    }


def markdown(found: dict[str, dict[str, Any]]) -> str:
    """A table with a line for each kind.

    Args:
        found: summaries by the name of the line.
    """
    lines = [_HEAD, "|" + "---|" * (_HEAD.count("|") - 1)]
    lines += [_line(name, one) for name, one in found.items()]
    note = (
        f"Lost: nearer than {SEPARATION_M:g} m to an honest aircraft; hit: nearer than {HIT_M:g} m. "
        "Held, aside, up and down are the largest of any flight."
    )
    return "\n".join([*lines, "", note, ""])


def _line(name: str, one: dict[str, Any]) -> str:
    quiet, away = one["without"], one["separation_m"]
    least, shares, above, without = "-", "-", "-", f"{quiet['lost']}, -"
    if away is not None:
        low, high = one["above_interval"]
        least = f"{away['least']:.2f}"
        shares = f"{away['p1']:.1f} / {away['p5']:.1f} / {away['median']:.1f}"
        above = f"{100 * one['above']:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
        without = f"{quiet['lost']}, {quiet['separation_m']['least']:.2f} m"
    beyond = "-" if one["beyond_m"] is None else f"{one['beyond_m']:.1f}"
    return (
        f"| {name} | {one['flights']} | {one['lost']} | {one['hit']} | {least} | {shares} | {above} "
        f"| {one['longest_held_s']:.0f} | {one['aside_m']:.0f} | {one['up_m']:.0f} | {one['down_m']:.0f} "
        f"| {beyond} | {without} |"
    )
