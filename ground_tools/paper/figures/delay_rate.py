"""Figure "Average transmission delay across different spatial sizes using fixed protocol modes".

The figure has two parts, for sizes of 100 to 1,000 m and of 3,000 to 10,000 m. The paper gives no numbers,
only statements about what the figure shows. It is computed without shadowing, because this reproduces the
paper's published delays.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from ground_tools.channel import plot
from ground_tools.channel.fixed_modes import Row
from ground_tools.channel.options import SIDES_M
from ground_tools.common.figure import drawn
from ground_tools.paper.report import Report, Statement
from ground_tools.paper.study import LARGE_M, SMALL_M, Curve, Study, curves_of, of_mode, trios

_JUMPS = {BLE4: (5, 10), WIFI_BEACON: (4, 7, 8)}
_BEST = {BLE4: 9, BLE5: 10, WIFI_BEACON: 10}


def report(study: Study) -> Report:
    """The statements of the figure."""
    return Report(
        title="Average transmission delay across different spatial sizes using fixed protocol modes",
        notes=(
            "A jump at rate r: delay(r) > delay(r - 1). All statements are checked for each size.",
            "Fastest and slowest mode: all three at their best rates in that size.",
            f"{study.samples:,} environments of each size, no shadowing, both Wi-Fi variants.",
        ),
        statements=tuple(statements(study.rows(0.0))),
    )


def draw(study: Study, path: Path) -> None:
    """Draw both parts, one above the other.

    Raises:
        ConfigError: `path` cannot be written, or matplotlib is missing.
    """
    with drawn(path, plot.size_of(len(SIDES_M))) as figure:
        plot.draw(figure, study.rows(0.0), "delay")


def statements(rows: Sequence[Row]) -> list[Statement]:
    """The paper's statements about the figure, checked for these rows."""
    curves = curves_of(rows)
    found = []
    for mode, published in _JUMPS.items():
        for curve in of_mode(curves, mode):
            found += [_jump(curve, rate) for rate in published]
            found.append(_no_other_jump(curve, published))
    found += [_smooth(curve) for curve in of_mode(curves, BLE5)]
    found += [_best(curve, rate) for mode, rate in _BEST.items() for curve in of_mode(curves, mode)]
    for ble4, ble5, wifi in trios(curves):
        trio = (ble4, ble5, wifi)
        for words, wanted, sides_m, slowest in (
            (f"{wifi.name} is fastest in small sizes", wifi, SMALL_M, False),
            (f"BLE 5 is slowest in small sizes ({wifi.name})", ble5, SMALL_M, True),
            (f"BLE 4 is fastest in large sizes ({wifi.name})", ble4, LARGE_M, False),
        ):
            found.append(_extreme(words, trio, wanted, sides_m, slowest=slowest))
    return found


def jumps(curve: Curve, side_m: float) -> tuple[int, ...]:
    """The rates r with delay(r) > delay(r - 1)."""
    return tuple(
        rate
        for before, rate in pairwise(curve.rates)
        if curve.delay_ms(side_m, rate) > curve.delay_ms(side_m, before)
    )


def _at(side_m: float) -> str:
    return f"{side_m:,g} m"


def _jump(curve: Curve, rate: int) -> Statement:
    changes = [
        100.0 * (curve.delay_ms(side_m, rate) / curve.delay_ms(side_m, rate - 1) - 1.0)
        for side_m in SIDES_M
        if curve.delay_ms(side_m, rate - 1) > 0.0
    ]
    return Statement(
        f"{curve.name} jumps at rate {rate}",
        f"{_span(changes)} %" if changes else "nobody in range",
        {_at(side_m): rate in jumps(curve, side_m) for side_m in SIDES_M},
    )


def _no_other_jump(curve: Curve, published: tuple[int, ...]) -> Statement:
    others = {side_m: [rate for rate in jumps(curve, side_m) if rate not in published] for side_m in SIDES_M}
    seen = sorted({rate for rates in others.values() for rate in rates})
    return Statement(
        f"{curve.name} jumps at no other rate",
        f"also at {', '.join(map(str, seen))}" if seen else "none",
        {_at(side_m): not rates for side_m, rates in others.items()},
    )


def _smooth(curve: Curve) -> Statement:
    seen = sorted({rate for side_m in SIDES_M for rate in jumps(curve, side_m)})
    return Statement(
        f"{curve.name} falls at every rate",
        f"jumps at {', '.join(map(str, seen))}" if seen else "no jump",
        {_at(side_m): not jumps(curve, side_m) for side_m in SIDES_M},
    )


def _best(curve: Curve, published: int) -> Statement:
    best = {side_m: curve.best_rate((side_m,)) for side_m in SIDES_M}
    return Statement(
        f"{curve.name} is fastest at rate {published}",
        f"fastest at {' or '.join(map(str, sorted(set(best.values()))))}",
        {_at(side_m): rate == published for side_m, rate in best.items()},
    )


def _extreme(
    published: str, curves: Sequence[Curve], wanted: Curve, sides_m: Sequence[float], *, slowest: bool
) -> Statement:
    """Whether one of three modes is the slowest or the fastest, each at its best rate for the size."""
    found = {}
    for side_m in sides_m:
        delays = {curve.name: curve.delay_ms(side_m, curve.best_rate((side_m,))) for curve in curves}
        found[side_m] = (max if slowest else min)(delays, key=delays.__getitem__)
    return Statement(
        published,
        " or ".join(dict.fromkeys(found.values())),
        {_at(side_m): name == wanted.name for side_m, name in found.items()},
    )


def _span(values: Sequence[float]) -> str:
    low, high = f"{min(values):+.0f}", f"{max(values):+.0f}"
    return low if low == high else f"{low} to {high}"
