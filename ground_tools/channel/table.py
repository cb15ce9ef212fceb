"""The command `ground-tools channel table`: delay and loss of the fixed modes, as tables or as JSON lines."""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.table import Table

from ground_tools.channel import options
from ground_tools.channel.fixed_modes import Row, batches_of, evaluate, name_of
from ground_tools.common.progress import progress

_LEGEND = (
    "System delay (ms): the sum over the aircraft of each one's mean delay to those\n"
    "it reaches, 0 if it reaches nobody. ±: Monte Carlo standard error.\n"
    "Loss (%): mean over the links in range; -: nobody is in range."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools channel table`."""
    parser.description = (
        "Compute system delay and loss with the channel model's equations. All aircraft use the same mode\n"
        "and rate. Wi-Fi has two variants: all aircraft send on one channel (shared), or each one sends on\n"
        "1, 6 or 11 at random (random). BLE has no such variants.\n" + options.LISTS
    )
    parser.epilog = (
        "example: ground-tools channel table --sides 500,1000 --rates 9-10 --modes ble4,wifi --json"
    )
    options.add_arguments(parser)
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object per line instead of tables"
    )


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools channel table`. Returns 0.

    Raises:
        ConfigError: an option or the parameter file is wrong.
    """
    settings = options.settings_of(args)
    steps = len(settings.sigmas_db) * len(settings.sides_m) * len(batches_of(settings))
    with progress("fixed modes", steps) as advance:
        sides = list(evaluate(settings, advance))
    if args.json:
        for row in (row for rows in sides for row in rows):
            print(json_line(row))
        return 0
    console = Console()
    for rows in sides:
        console.print(table_of(rows))
    print(_LEGEND)
    return 0


def json_line(row: Row) -> str:
    """One row as one JSON object."""
    return json.dumps(dataclasses.asdict(row), allow_nan=False)


def table_of(rows: Sequence[Row]) -> Table:
    """Table of the rows of one side and sigma: a line for each rate, columns for each mode."""
    first = rows[0]
    title = (
        f"Side {first.side_m:,g} m, sigma {first.sigma_db:g} dB, {first.uavs} aircraft, "
        f"{first.samples:,} environments; delays in ms, losses in %"
    )
    table = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
    )
    table.add_column("rate", justify="right")
    modes = list(dict.fromkeys((row.mode, row.wifi_channels) for row in rows))
    for mode in modes:
        table.add_column(name_of(*mode).replace("Wi-Fi ", "Wi-Fi\n"), justify="right", no_wrap=True)
        table.add_column("loss", justify="right", no_wrap=True)
    cells = {(row.rate, row.mode, row.wifi_channels): row for row in rows}
    for rate in sorted({row.rate for row in rows}):
        line = [str(rate)]
        for mode in modes:
            row = cells.get((rate, *mode))
            line += ["", ""] if row is None else [delay_cell(row), loss_cell(row)]
        table.add_row(*line)
    return table


def delay_cell(row: Row) -> str:
    """The text of a system delay with its error; "never" if some message never arrives."""
    if row.system_delay_ms is None or row.system_delay_se_ms is None:
        return "never"
    return with_error(row.system_delay_ms, row.system_delay_se_ms)


def with_error(value: float, error: float) -> str:
    """The text of a value and its error, with the digits that the error justifies and at most one decimal."""
    whole = error >= 10.0
    return f"{value:.{0 if whole or value >= 1000.0 else 1}f} ±{error:.{0 if whole else 1}f}"


def loss_cell(row: Row) -> str:
    """The text of a loss in percent; "-" if no aircraft is in range of another."""
    return "-" if row.loss is None else f"{100.0 * row.loss:.2f}"
