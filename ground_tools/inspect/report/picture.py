"""`ground-tools picture RUN`: draws the paths around the crossing, and the separation over time.

If there is a run without avoidance (a folder `unavoided` in the run, or --unavoided), both are drawn.
matplotlib is an optional dependency and is imported on use.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from companion.arrays import Floats
from companion.errors import ConfigError
from ground_tools.common.figure import drawn
from ground_tools.inspect.read.flown import (
    Flown,
    Separation,
    crossing,
    flown,
    from_frame,
    least_of,
    separations,
)
from ground_tools.inspect.read.read_run import Run, read_run, read_unavoided
from ground_tools.inspect.viewer.palette import LIMIT, colour, hexadecimal

HALF_WIDTH_M = 120.0
"""Half the width of the view from above, which is centred on the crossing."""
MAX_LABELS = 10
"""If there are more aircraft than this, they are drawn without names."""
_TOP_OF_REQUIRED = 6.0
"""Distances are drawn up to this many times the required one, for the time in which any is below that."""
_WITHOUT = "#7a7a7a"
_WITH = hexadecimal(colour(0))
_LIMIT = hexadecimal(LIMIT)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools picture` to `parser`."""
    parser.description = "Draw the paths of a run around the crossing, and the separation over time."
    parser.epilog = "example: ground-tools picture runs/20260101T000000Z-demo --out encounter.png"
    parser.add_argument("run_folder", type=Path, metavar="RUN", help="run folder")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.png", help="the picture to write")
    parser.add_argument(
        "--unavoided",
        type=Path,
        metavar="RUN",
        help="run folder of the same encounter without avoidance (default: RUN/unavoided)",
    )


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools picture`. Returns 0.

    Raises:
        ConfigError: A folder is not a run, the picture cannot be written, or matplotlib is not installed.
    """
    run = read_run(args.run_folder)
    other = read_run(args.unavoided) if args.unavoided else read_unavoided(args.run_folder)
    avoided, unavoided = flown(run), None if other is None else flown(other)
    draw(avoided, unavoided, args.out, lateness(run))
    print(f"wrote {args.out}; distances from {_positions(avoided, unavoided)}")
    return 0


def lateness(run: Run) -> str:
    """Describe the message delay in a simulated run; empty if its summary does not contain it."""
    match (run.summary or {}).get("delay_s"):
        case [int() | float() as low, int() | float() as high]:
            return f"Remote ID delayed by {low:g} to {high:g} s"
        case _:
            return ""


def draw(avoided: Flown, unavoided: Flown | None, path: Path, words: str = "") -> None:
    """Write the picture to `path`. `words` are added to its title.

    Raises:
        ConfigError: Fewer than two aircraft were in the air at the same time, `path` cannot be written, or
            matplotlib is not installed.
    """
    pairs = _known(avoided)
    before = [] if unavoided is None else _known(unavoided)
    if not pairs:
        raise ConfigError(
            "there is nothing to draw, because no two aircraft of this run were in the air at the same time"
        )
    centre = crossing(avoided, pairs) if unavoided is None or not before else crossing(unavoided, before)
    if unavoided is not None and before:
        centre = from_frame(centre[None, :], unavoided.origin, avoided.origin)[0]
    with drawn(path, (13, 6.6)) as figure:
        figure.suptitle(title(avoided, pairs, before, words), fontsize=16, fontweight="bold")
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.15))
        _view_from_above(left, avoided, unavoided, centre)
        _over_time(right, pairs, before, _positions(avoided, unavoided))


def title(avoided: Flown, pairs: list[Separation], before: list[Separation], words: str) -> str:
    """Return the title, with the closest distances."""
    head = f"{len(avoided.paths)} aircraft" + (f", {words}" if words else "")
    with_avoidance = f"{pairs[0].minimum_m:.1f} m with avoidance"
    without = f", {before[0].minimum_m:.1f} m without" if before else ""
    return f"{head}: closest {with_avoidance}{without}"


def _positions(avoided: Flown, unavoided: Flown | None) -> str:
    """Return the kinds of positions that both runs use."""
    kinds = dict.fromkeys([avoided.positions, *([unavoided.positions] if unavoided else [])])
    return " and ".join(kinds)


def _known(ways: Flown) -> list[Separation]:
    return [pair for pair in separations(ways.paths) if pair.minimum_m is not None]


def _view_from_above(axes: Any, avoided: Flown, unavoided: Flown | None, centre: Floats) -> None:
    axes.set_title("Paths seen from above")
    if unavoided is not None:
        for index, path in enumerate(unavoided.paths):
            track = from_frame(path.position_ned_m, unavoided.origin, avoided.origin) - centre
            label = "without avoidance" if index == 0 else None
            axes.plot(track[:, 1], track[:, 0], color=_WITHOUT, lw=1.2, ls=(0, (4, 3)), label=label, zorder=2)
    for index, path in enumerate(avoided.paths):
        shade = hexadecimal(colour(index))
        track = path.position_ned_m - centre
        label = "flown with avoidance" if index == 0 else None
        axes.plot(track[:, 1], track[:, 0], color=shade, lw=2.2, label=label, zorder=3)
        _ends(axes, track, shade, path.name if len(avoided.paths) <= MAX_LABELS else None)
    axes.plot([], [], "o", color="#444444", mfc="white", mew=1.8, label="enters the view")
    axes.plot([], [], "o", color="#444444", label="leaves the view")
    axes.set(xlim=(-HALF_WIDTH_M, HALF_WIDTH_M), ylim=(-HALF_WIDTH_M, HALF_WIDTH_M), aspect="equal")
    axes.set(xlabel="east of the crossing (m)", ylabel="north of the crossing (m)")
    _legend(axes)


def _legend(axes: Any) -> None:
    """Draw the legend below the axes, where it hides nothing."""
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2, fontsize=13, frameon=False)


def _ends(axes: Any, track: Floats, shade: str, name: str | None) -> None:
    """Draw markers where the path enters and leaves the view, and the aircraft's name where it enters."""
    inside = np.flatnonzero(np.abs(track[:, :2]).max(axis=1) <= HALF_WIDTH_M - 3.0)
    if not len(inside):
        return
    first, last = track[inside[0]], track[inside[-1]]
    axes.plot(first[1], first[0], "o", color=shade, mfc="white", mew=2, ms=8, zorder=4)
    axes.plot(last[1], last[0], "o", color=shade, ms=8, zorder=4)
    if name is not None:
        _name(axes, first, track[inside[min(len(inside) - 1, len(inside) // 6)]] - first, shade, name)


def _name(axes: Any, at: Floats, along: Floats, shade: str, name: str) -> None:
    """Write the aircraft's name next to where its path enters, on the side with more room."""
    heading = along[:2] / max(float(np.hypot(along[0], along[1])), 1e-6)
    north, east = at[:2] + 14.0 * heading
    to_middle = 1.0 if east < 0.0 else -1.0
    # Near the view's edge there is room only towards the middle. In the middle the side does not matter.
    to_east = -to_middle if 0.3 < abs(east) / HALF_WIDTH_M < 0.55 else to_middle
    # A path that is steep in the view has room to its sides, a flat one above or below.
    steep = abs(heading[0]) > 0.6
    offset = (10.0 * to_east, 0.0) if steep else (0.0, -11.0 if north > 0.0 else 11.0)
    side = "left" if to_east > 0.0 else "right"
    axes.annotate(
        name,
        (east, north),
        offset,
        textcoords="offset points",
        ha=side,
        va="center",
        color=shade,
        fontsize=12,
        fontweight="bold",
        path_effects=_halo(),
        zorder=5,
    )


def _over_time(axes: Any, pairs: list[Separation], before: list[Separation], positions: str) -> None:
    axes.set_title("Distance between the two closest aircraft")
    required = max(pair.required_m for pair in pairs)
    top = _TOP_OF_REQUIRED * required
    shown = []
    for found, shade, words in ((before, _WITHOUT, "without avoidance"), (pairs, _WITH, "with avoidance")):
        if not found:
            continue
        time, least = least_of(found)
        axes.plot(time, least, color=shade, lw=2.6, label=words)
        _mark(axes, found[0], shade, words)
        near = time[least <= top]
        shown += list(near[[0, -1]]) if len(near) else [time[0], time[-1]]
    axes.axhline(required, color=_LIMIT, lw=2, ls="--", label=f"required: {required:g} m")
    axes.axhspan(0.0, required, color=_LIMIT, alpha=0.08, lw=0)
    axes.set(xlim=(min(shown), max(shown)), ylim=(0.0, top))
    axes.set(xlabel="time (s)", ylabel=f"distance from {positions} (m)")
    _legend(axes)


def _mark(axes: Any, closest: Separation, shade: str, words: str) -> None:
    """Mark the closest approach of a run, with its distance."""
    at = (closest.minimum_time_s, closest.minimum_m)
    axes.plot(*at, "o", color=shade, ms=7)
    beside = words == "without avoidance"
    axes.annotate(
        f"{closest.minimum_m:.1f} m",
        at,
        (-10, 2) if beside else (0, -9),
        textcoords="offset points",
        ha="right" if beside else "center",
        va="center" if beside else "top",
        color=shade,
        fontweight="bold",
        path_effects=_halo(),
    )


def _halo() -> list[Any]:
    from matplotlib import patheffects

    return [patheffects.withStroke(linewidth=3, foreground="white")]
