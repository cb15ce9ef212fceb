"""The picture for `ground_tools.paper.figures.dmuca`: one flight by each law, then all flights."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from companion.arrays import Floats
from ground_tools.campaign.cells import SEPARATION_M, Law
from ground_tools.campaign.outcome import COLLISION_M
from ground_tools.common.figure import drawn
from ground_tools.paper.figures.dmuca import NAMES, PAIR_NAMES, PUBLISHED_BELOW, interval
from ground_tools.paper.figures.dmuca_flights import (
    AIRCRAFT,
    CASES,
    DELAYS_S,
    Air,
    Case,
    Table,
    fly,
    gaps,
    table_of,
)
from sitl_mocks.encounters.scenario import CROSSING_S, encounter

AIRCRAFT_COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000")
DELAY_COLOURS: Final = dict(zip(DELAYS_S, ("#9ecae1", "#4292c6", "#08306b"), strict=True))
_AROUND_M: Final = 90.0
"""Half the width of the view from above, which is centred on the crossing."""
_POINTS_S: Final = 20.0
"""Time between two marked points on a path."""
_STEP: Final = 5
"""Only every fifth position is drawn."""
_LAWS: Final[tuple[Law, ...]] = ("paper", "dmuca")


def draw(samples: int, seed: int, path: Path, advance: Callable[[], None] = lambda: None) -> None:
    """Draw the picture.

    A row for each law shows the flight of `seed` with delays of 0 to 1 s: from above, in 3D, and its
    separations. The row below shows the pairs with all delays and the least separations of all flights.

    Args:
        samples, seed: as in `dmuca.report`.
        advance: called after each case that was flown.

    Raises:
        ConfigError: `path` cannot be written, or matplotlib is missing.
    """
    with drawn(path, (20, 15), dpi=75) as figure:
        table = table_of(samples, seed, advance)
        first = interval(DELAYS_S[0])
        figure.suptitle(
            f"Five aircraft on S2. Above: seed {seed}, delays {first} s; below: all delays, the pairs of "
            f"seed {seed} and {len(table[CASES[0]])} flights",
            fontsize=17,
            fontweight="bold",
        )
        grid = figure.add_gridspec(3, 12)
        for row, law in enumerate(_LAWS):
            times, places = fly(Case(law, DELAYS_S[0], "exact"), seed)
            _from_above(figure.add_subplot(grid[row, 0:3]), law, times, places, seed)
            _in_3d(figure.add_subplot(grid[row, 3:6], projection="3d"), law, times, places)
            _separations(figure.add_subplot(grid[row, 6:9]), law, times, places)
            _closest(figure.add_subplot(grid[row, 9:12]), law, times, places)
        top = 1.35 * max(table[case][0].max() for case in table if case.law in _LAWS and case.air == "exact")
        for column, law in enumerate(_LAWS):
            _pairs(figure.add_subplot(grid[2, 4 * column : 4 * column + 4]), law, table, top)
        _all_flights(figure.add_subplot(grid[2, 8:12]), table)


def _from_above(axes: Any, law: Law, times: Floats, places: Floats, seed: int) -> None:
    """Draw the middle of the paths from above, with the planned paths thin and dashed."""
    axes.set_title(f"{NAMES[law]}: the crossing from above")
    near = np.abs(times - CROSSING_S) < 150.0
    marked = near & (np.abs(times % _POINTS_S) < 1e-6)
    for i, planned in enumerate(encounter("S2", AIRCRAFT, seed)):
        colour = AIRCRAFT_COLOURS[i]
        axes.plot(planned[:, 2], planned[:, 1], color=colour, lw=0.9, ls=(0, (5, 5)))
        axes.plot(places[near, i, 1], places[near, i, 0], color=colour, lw=2.0)
        axes.plot(places[marked, i, 1], places[marked, i, 0], "o", color=colour, ms=5)
    axes.plot([], [], color="#707070", lw=0.9, ls=(0, (5, 5)), label="planned")
    axes.plot([], [], "o", color="#707070", ms=5, label=f"every {_POINTS_S:g} s")
    axes.set_xlim(-_AROUND_M, _AROUND_M)
    axes.set_ylim(-_AROUND_M, _AROUND_M)
    axes.set_aspect("equal")
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.legend(fontsize=10, loc="upper right", framealpha=0.9)


def _in_3d(axes: Any, law: Law, times: Floats, places: Floats) -> None:
    """Draw the whole flight in 3D and mark the positions at the time of the planned crossing."""
    axes.set_title(f"{NAMES[law]}: the whole flight")
    at = int(np.argmin(np.abs(times - CROSSING_S)))
    for i, colour in enumerate(AIRCRAFT_COLOURS):
        north, east, height = places[::_STEP, i, 0], places[::_STEP, i, 1], -places[::_STEP, i, 2]
        axes.plot(east, north, height, color=colour, lw=1.6, label=f"UAV{i + 1}")
        axes.scatter(places[at, i, 1], places[at, i, 0], -places[at, i, 2], color=colour, s=22)
    axes.plot([], [], "o", color="#707070", ms=5, label=f"at {CROSSING_S:g} s")
    axes.set_xlabel("east (m)", labelpad=8)
    axes.set_ylabel("north (m)", labelpad=8)
    axes.set_zlabel("height (m)", labelpad=6)
    axes.tick_params(labelsize=10)
    axes.set_box_aspect(None, zoom=0.82)
    axes.legend(fontsize=10, loc="upper left")


def _separations(axes: Any, law: Law, times: Floats, places: Floats) -> None:
    """Draw the separation of every pair over time."""
    axes.set_title(f"{NAMES[law]}: separation of each pair")
    _lines(axes, times, places)
    axes.set_yscale("log")
    axes.set_ylim(5.0, 1500.0)
    axes.set_yticks(
        [5, 10, 20, 50, 100, 200, 500, 1000], ["5", "10", "20", "50", "100", "200", "500", "1000"]
    )
    axes.minorticks_off()
    axes.set_ylabel("separation (m, log scale)")


def _closest(axes: Any, law: Law, times: Floats, places: Floats) -> None:
    """Draw the separation of every pair around the time of the crossing."""
    axes.set_title(f"{NAMES[law]}: around the crossing")
    _lines(axes, times, places)
    axes.set_xlim(CROSSING_S - 50.0, CROSSING_S + 50.0)
    axes.set_ylim(0.0, 100.0)
    axes.set_ylabel("separation (m)")
    axes.legend(fontsize=9, ncols=2, loc="upper right", framealpha=0.9)


def _lines(axes: Any, times: Floats, places: Floats) -> None:
    """Draw the separation of each pair and the required separation."""
    distances = np.linalg.norm(gaps(places), axis=2)
    for index, name in enumerate(PAIR_NAMES):
        axes.plot(times[::_STEP], distances[::_STEP, index], color=f"C{index}", lw=1.6, label=name)
    axes.axhline(SEPARATION_M, color="black", lw=1.6, ls="--", label=f"{SEPARATION_M:g} m")
    axes.set_xlabel("time (s)")


def _pairs(axes: Any, law: Law, table: Table, top_m: float) -> None:
    """Draw each pair's least separation in the pictured flight, with each delay and without avoidance."""
    axes.set_title(f"{NAMES[law]}: least separation of each pair")
    places, width = np.arange(len(PAIR_NAMES)), 0.27
    for index, delay_s in enumerate(DELAYS_S):
        axes.bar(
            places + (index - 1) * width,
            table[Case(law, delay_s, "exact")][0],
            0.92 * width,
            color=DELAY_COLOURS[delay_s],
            label=f"{interval(delay_s)} s (published: {PUBLISHED_BELOW[delay_s]} of 10 below)",
        )
    unavoided = table[Case("none", DELAYS_S[0], "exact")][0]
    axes.plot(places, unavoided, "x", color="#d55e00", ms=9, mew=2.2, label="unavoided")
    axes.axhline(SEPARATION_M, color="black", lw=1.6, ls="--", label=f"{SEPARATION_M:g} m")
    axes.set_xticks(places, [name.replace("UAV", "") for name in PAIR_NAMES])
    axes.set_ylim(0.0, top_m)
    axes.set_xlabel("pair of UAVs")
    axes.set_ylabel("least separation (m)")
    axes.grid(visible=False, axis="x")
    axes.legend(fontsize=10, ncols=2, loc="upper left")


def _all_flights(axes: Any, table: Table) -> None:
    """Draw the distribution of the flights' least separations. Whiskers reach the extremes."""
    axes.set_title("least separation of each flight")
    airs: tuple[tuple[Air, str], ...] = (("exact", ""), ("noisy", ", noisy"))
    colours = {("paper", "exact"): "#d55e00", ("paper", "noisy"): "#f5b183",
               ("dmuca", "exact"): "#0072b2", ("dmuca", "noisy"): "#9ecae1"}  # fmt: skip
    groups = [(law, air, words) for law in _LAWS for air, words in airs]
    for number, (law, air, words) in enumerate(groups):
        boxes = axes.boxplot(
            [table[Case(law, delay_s, air)].min(axis=1) for delay_s in DELAYS_S],
            positions=[group + (number - 1.5) * 0.2 for group in range(len(DELAYS_S))],
            widths=0.16,
            whis=(0, 100),
            patch_artist=True,
            medianprops={"color": "black"},
            manage_ticks=False,
        )
        for box in boxes["boxes"]:
            box.set(facecolor=colours[law, air], edgecolor=colours[law, air])
        for line in (*boxes["whiskers"], *boxes["caps"]):
            line.set(color=colours[law, air], linewidth=2.0)
        axes.bar([0], [0], color=colours[law, air], label=f"{NAMES[law]}{words}")
    axes.axhline(SEPARATION_M, color="black", lw=1.6, ls="--", label=f"{SEPARATION_M:g} m")
    published = "published, one flight: > 10, 9.75, 2 to 10 m"
    axes.plot([-0.45], [SEPARATION_M + 0.3], "^", color="black", ms=9)
    axes.plot([0.55], [9.75], "D", color="black", ms=8, label=published)
    axes.plot([1.55, 1.55], [COLLISION_M, SEPARATION_M], color="black", lw=4)
    axes.set_xticks(range(len(DELAYS_S)), [f"{interval(delay_s)} s" for delay_s in DELAYS_S])
    axes.set_ylim(0.0, 1.3 * max(least_m.min(axis=1).max() for least_m in table.values()))
    axes.set_xlabel("delay of messages")
    axes.set_ylabel("least separation (m)")
    axes.grid(visible=False, axis="x")
    axes.legend(fontsize=9.5, loc="upper left", ncols=2)
