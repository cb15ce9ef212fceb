"""Figure "Average packet loss rates across different spatial sizes using fixed protocol modes", six panels.

The paper gives no numbers, only statements about what the figure shows. It is computed without shadowing, as
the figure of the delays is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from companion.remote_id.transports import BLE4
from ground_tools.channel import plot
from ground_tools.channel.fixed_modes import Row
from ground_tools.channel.options import SIDES_M
from ground_tools.common.figure import drawn
from ground_tools.paper.report import Report, Statement
from ground_tools.paper.study import LARGE_M, SMALL_M, Curve, Study, curves_of, of_mode, trios

UNCHANGED = 0.01
"""Largest change of a loss (1 percentage point) that looks unchanged in a figure."""
NEAR_ZERO = 0.01


def report(study: Study) -> Report:
    """The statements of the figure."""
    return Report(
        title="Average packet loss rates across different spatial sizes using fixed protocol modes",
        notes=(
            "Unchanged: a change of at most 1 percentage point. Near zero: below 1 %.",
            "Statements are checked for each rate, or for each size or step of sizes at every rate.",
            f"{study.samples:,} environments of each size, no shadowing, both Wi-Fi variants.",
        ),
        statements=tuple(statements(study.rows(0.0))),
    )


def draw(study: Study, path: Path) -> None:
    """Draw the six panels.

    Raises:
        ConfigError: `path` cannot be written, or matplotlib is missing.
    """
    with drawn(path, plot.size_of(len(SIDES_M))) as figure:
        plot.draw(figure, study.rows(0.0), "loss")


def statements(rows: Sequence[Row]) -> list[Statement]:
    """The paper's statements about the figure, checked for these rows."""
    curves = curves_of(rows)
    ble4 = of_mode(curves, BLE4)[0]
    others = [curve for curve in curves.values() if curve.mode != BLE4]
    found = [_unchanged(curve, SMALL_M) for curve in others]
    found.append(_falls(ble4, SIDES_M, f"{ble4.name} falls with the size"))
    found.append(_near_zero(ble4, LARGE_M))
    for _, ble5, wifi in trios(curves):
        found.append(_highest(ble5, (ble4, wifi), SMALL_M))
    found += [_falls(curve, LARGE_M, f"{curve.name} falls in large sizes") for curve in others]
    return found


def _percent(values: Sequence[float]) -> str:
    """Text of losses in percent. NaN stands for a size in which no aircraft is in range of another."""
    return ", ".join("-" if math.isnan(value) else f"{100.0 * value:.2g}" for value in values) + " %"


def _unchanged(curve: Curve, sides_m: Sequence[float]) -> Statement:
    changes = {}
    for rate in curve.rates:
        losses = [curve.loss(side_m, rate) for side_m in sides_m]
        changes[rate] = max(losses) - min(losses)
    return Statement(
        f"{curve.name} is unchanged in small sizes",
        f"by up to {100.0 * max(changes.values()):.2f} points",
        {f"rate {rate}": change <= UNCHANGED for rate, change in changes.items()},
    )


def _falls(curve: Curve, sides_m: Sequence[float], words: str) -> Statement:
    last = curve.rates[-1]
    return Statement(
        words,
        f"{_percent([curve.loss(side_m, last) for side_m in sides_m])} at rate {last}",
        {
            f"{before:,g} to {after:,g} m": all(
                curve.loss(after, rate) < curve.loss(before, rate) for rate in curve.rates
            )
            for before, after in pairwise(sides_m)
        },
    )


def _near_zero(curve: Curve, sides_m: Sequence[float]) -> Statement:
    largest = {side_m: max(curve.loss(side_m, rate) for rate in curve.rates) for side_m in sides_m}
    return Statement(
        f"{curve.name} is near zero in large sizes",
        f"at most {_percent(list(largest.values()))}",
        {f"{side_m:,g} m": loss < NEAR_ZERO for side_m, loss in largest.items()},
    )


def _highest(curve: Curve, others: Sequence[Curve], sides_m: Sequence[float]) -> Statement:
    last = curve.rates[-1]
    beside = " and ".join(other.name for other in others)
    losses = [each.loss(sides_m[0], last) for each in (curve, *others)]
    return Statement(
        f"{curve.name} is above {beside} in small sizes",
        f"{_percent(losses)} at {sides_m[0]:,g} m, rate {last}",
        {
            f"{side_m:,g} m": all(
                curve.loss(side_m, rate) > other.loss(side_m, rate)
                for other in others
                for rate in curve.rates
            )
            for side_m in sides_m
        },
    )
