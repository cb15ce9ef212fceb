"""Figure "Average system-wide transmission delays for different communication methods across various airspace
densities": the fixed modes, each at its best rate.

High density is the mean over squares of 100, 500 and 1,000 m, low density the mean over 3,000, 5,000 and
10,000 m, and dynamic density the mean over all six.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from companion.remote_id.transports import BLE4, WIFI_BEACON
from ground_tools.channel.fixed_modes import Row
from ground_tools.channel.options import SIDES_M
from ground_tools.channel.plot import COLOURS
from ground_tools.common.figure import drawn
from ground_tools.paper.report import Comparison, Report
from ground_tools.paper.study import LARGE_M, SIGMA_PAPER_DB, SMALL_M, Study, curves_of

DENSITIES = {"high": SMALL_M, "low": LARGE_M, "dynamic": SIDES_M}
SIGMAS_DB = (0.0, SIGMA_PAPER_DB)
PUBLISHED_MS = {
    (WIFI_BEACON, "high"): 1865.07,
    (WIFI_BEACON, "low"): 1487.69,
    (WIFI_BEACON, "dynamic"): 1671.77,
    (BLE4, "low"): 232.38,
    (BLE4, "dynamic"): 1544.65,
}


def report(study: Study) -> Report:
    """The numbers of the figure."""
    return Report(
        title="Average system-wide transmission delays of the fixed modes across various airspace densities",
        notes=(
            "System delay in ms. ±: Monte Carlo standard error. ratio: ours divided by the published number.",
            "rate: the rate of least mean delay over all six sizes, by our numbers.",
            f"{study.samples:,} environments of each size. A sigma of 2.449 dB is a variance of 6 dB.",
        ),
        comparisons=tuple(c for sigma_db in SIGMAS_DB for c in comparisons(study.rows(sigma_db))),
    )


def comparisons(rows: Sequence[Row]) -> list[Comparison]:
    """Our numbers next to the published ones, for the rows of one sigma."""
    sigma_db = rows[0].sigma_db
    found = []
    for curve in curves_of(rows).values():
        rate = curve.best_rate(SIDES_M)
        for density, sides_m in DENSITIES.items():
            ours_ms, error_ms = curve.mean_ms(sides_m, rate)
            labels: dict[str, str | float] = {
                "mode": curve.mode,
                "wifi_channels": curve.reading,
                "rate": rate,
                "sigma_db": sigma_db,
                "density": density,
            }
            published = PUBLISHED_MS.get((curve.mode, density))
            found.append(Comparison(curve.name, labels, ours_ms, error_ms, published))
    return found


def draw(study: Study, path: Path) -> None:
    """Draw a group of bars for each density, with a line for each number that the paper gives.

    Raises:
        ConfigError: `path` cannot be written, or matplotlib is missing.
    """
    with drawn(path, (13, 6.5)) as figure:
        axes = figure.subplots()
        figure.suptitle("System delay of the fixed modes at their best rates", fontsize=16, fontweight="bold")
        bars = [
            (f"{name}, sigma {sigma_db:.3g} dB", [c for c in found if c.name == name])
            for sigma_db in SIGMAS_DB
            for found in (comparisons(study.rows(sigma_db)),)
            for name in curves_of(study.rows(sigma_db))
        ]
        bars.sort(key=lambda bar: bar[0])
        for index, (label, values) in enumerate(bars):
            _bars(axes, index, len(bars), label, values)
        axes.plot([], [], color="black", lw=2.5, label="published")
        axes.set_xticks(range(len(DENSITIES)), [f"{density} density" for density in DENSITIES])
        axes.set_ylabel("system delay (ms)")
        axes.grid(visible=False, axis="x")
        figure.legend(loc="outside lower center", ncols=3, frameon=False)


def _bars(axes: Any, index: int, number: int, label: str, values: Sequence[Comparison]) -> None:
    """Draw the bars of one mode, channel assignment and sigma over all densities."""
    width = 0.86 / number
    first = values[0].labels
    hollow = first["wifi_channels"] == "random"
    colour = COLOURS[str(first["mode"])]
    places = [group + (index - (number - 1) / 2.0) * width for group in range(len(values))]
    axes.bar(
        places,
        [c.ours_ms for c in values],
        0.92 * width,
        yerr=[c.error_ms for c in values],
        color="white" if hollow else colour,
        edgecolor=colour,
        linewidth=1.6,
        alpha=1.0 if first["sigma_db"] == 0.0 else 0.55,
        label=label,
    )
    for place, c in zip(places, values, strict=True):
        if c.published_ms is not None:
            axes.plot([place - width / 2, place + width / 2], [c.published_ms] * 2, color="black", lw=2.5)
