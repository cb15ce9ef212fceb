"""The command `ground-tools channel plot`: delay against rate, one panel for each side."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from companion.errors import ConfigError
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from ground_tools.channel import options
from ground_tools.channel.fixed_modes import Reading, Row, batches_of, evaluate, name_of
from ground_tools.common.figure import drawn
from ground_tools.common.progress import progress
from ground_tools.inspect.viewer.palette import colour, hexadecimal

Quantity = Literal["delay", "loss"]
COLOURS = {BLE4: hexadecimal(colour(0)), BLE5: hexadecimal(colour(1)), WIFI_BEACON: hexadecimal(colour(2))}
_MARKERS = {BLE4: "o", BLE5: "s", WIFI_BEACON: "^"}
_MAX_PANELS = 12
_COLUMNS = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools channel plot`."""
    parser.description = (
        "Draw the system delay of the fixed modes against the rate, with one panel for each side.\n"
        + options.LISTS
    )
    parser.epilog = "example: ground-tools channel plot --sides 100,1000,10000 --out delay.png"
    options.add_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.png", help="the picture to write")


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools channel plot`. Returns 0.

    Raises:
        ConfigError: an option or the parameter file is wrong, the picture cannot be written, or matplotlib is
            missing.
    """
    settings = options.settings_of(args)
    if len(settings.sigmas_db) > 1:
        raise ConfigError(f"--sigma: {len(settings.sigmas_db)} values are too many; allowed in a picture: 1")
    if len(settings.sides_m) > _MAX_PANELS:
        raise ConfigError(
            f"--sides: {len(settings.sides_m)} values are too many; allowed in a picture: up to {_MAX_PANELS}"
        )
    steps = len(settings.sides_m) * len(batches_of(settings))
    # The figure is opened first, so that a missing requirement is reported before the computation.
    with drawn(args.out, size_of(len(settings.sides_m))) as figure, progress("fixed modes", steps) as advance:
        draw(figure, [row for rows in evaluate(settings, advance) for row in rows], "delay")
    print(f"wrote {args.out}")
    return 0


def size_of(panels: int) -> tuple[float, float]:
    """Width and height (inches) of a picture with the given number of panels."""
    return 1.5 + 4.6 * min(_COLUMNS, panels), 1.8 + 3.5 * math.ceil(panels / _COLUMNS)


def draw(figure: Any, rows: Sequence[Row], quantity: Quantity) -> None:
    """Draw a panel for each side with a line for each mode. All rows must be of one sigma."""
    sides = list(dict.fromkeys(row.side_m for row in rows))
    columns = min(_COLUMNS, len(sides))
    figure.suptitle(_title(rows[0], quantity), fontsize=16, fontweight="bold")
    panels = figure.subplots(
        math.ceil(len(sides) / columns), columns, squeeze=False, sharey="row" if quantity == "loss" else "all"
    )
    for axes, side_m in zip(panels.flat, sides, strict=False):
        axes.set_title(f"side {side_m:,g} m")
        _panel(axes, [row for row in rows if row.side_m == side_m], quantity)
    for axes in panels.flat[len(sides) :]:
        axes.set_visible(False)
    for axes in panels[:, 0]:
        axes.set_ylabel("system delay (ms)" if quantity == "delay" else "loss (%)")
    # If no aircraft reaches another, all delays are 0, which a logarithmic axis cannot show.
    if quantity == "delay" and any(row.system_delay_ms for row in rows):
        panels.flat[0].set_yscale("log")
    handles, labels = panels.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)


def _title(row: Row, quantity: Quantity) -> str:
    what = "System delay" if quantity == "delay" else "Packet loss"
    return f"{what} of {row.uavs} aircraft in the same mode (shadowing {row.sigma_db:g} dB)"


def _panel(axes: Any, rows: Sequence[Row], quantity: Quantity) -> None:
    modes: list[tuple[str, Reading]] = list(dict.fromkeys((row.mode, row.wifi_channels) for row in rows))
    for mode, reading in modes:
        points = [
            (row.rate, *_value(row, quantity))
            for row in rows
            if (row.mode, row.wifi_channels) == (mode, reading)
        ]
        rates, values, errors = zip(*points, strict=True)
        axes.errorbar(
            rates,
            values,
            errors,
            color=COLOURS[mode],
            marker=_MARKERS[mode],
            ls="--" if reading == "random" else "-",
            mfc="white" if reading == "random" else None,
            lw=1.8,
            ms=5,
            capsize=2,
            label=name_of(mode, reading),
        )
    axes.set_xlabel("messages per GNSS period")
    axes.xaxis.get_major_locator().set_params(integer=True, nbins=10)
    if quantity == "loss":
        axes.set_ylim(bottom=0.0)


def _value(row: Row, quantity: Quantity) -> tuple[float, float]:
    """Value and error; NaN for both if there is none, which leaves a gap in the line."""
    found = (row.system_delay_ms, row.system_delay_se_ms) if quantity == "delay" else (row.loss, row.loss_se)
    scale = 1.0 if quantity == "delay" else 100.0
    value, error = found
    return (math.nan, math.nan) if value is None or error is None else (scale * value, scale * error)
