"""The command `ground-tools campaign peers`: compares the companion's law with those of others."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console

from companion.errors import ConfigError
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import tables
from ground_tools.campaign.cells import Cell
from ground_tools.campaign.peer_comparison import pareto, search
from ground_tools.campaign.peer_comparison import table as comparison
from ground_tools.campaign.peers.flown import missing
from ground_tools.campaign.runs import add_common, fly_missing, work_of
from ground_tools.common import table_file
from ground_tools.common.run_options import seeds_of

HELD_OUT = "90001-91000"
"""Seeds of the tables; no search uses them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands of `ground-tools campaign peers`."""
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    command = commands.add_parser(
        "search",
        help="find the parameters of each peer",
        description="Fly every candidate of every peer in the same encounters, and name the best of each.",
        epilog="example: ground-tools campaign peers search --out runs/peers "
        "--file results/campaign/peers-search.json",
    )
    _add_options(command, search.SEEDS)
    command.set_defaults(run=run_search)
    command = commands.add_parser(
        "table",
        help="fly the same encounters with each law and print a table",
        description="; ".join(f"{name}: {table.words}" for name, table in comparison.TABLES.items()),
        epilog="example: ground-tools campaign peers table encounters --seeds 90001-90200 --out runs/peers",
    )
    command.add_argument("table", choices=comparison.TABLES, metavar="TABLE",
                         help=f"one of {', '.join(comparison.TABLES)}")  # fmt: skip
    _add_options(command, HELD_OUT)
    command.set_defaults(run=run_table)
    command = commands.add_parser(
        "pareto",
        help="draw losses against deviation, each law over its main parameter",
        description="Fly each law over its main parameter, and draw losses against deviation.",
        epilog="example: ground-tools campaign peers pareto --out runs/peers --picture docs/peers.png",
    )
    _add_options(command, HELD_OUT)
    command.add_argument("--picture", type=Path, metavar="FILE", help="write the picture to this PNG file")
    command.set_defaults(run=run_pareto)


def _add_options(command: argparse.ArgumentParser, seeds: str) -> None:
    add_common(command, seeds)
    command.add_argument("--file", type=Path, metavar="FILE", help="also write all numbers as JSON")
    command.add_argument("--json", action="store_true", help="print one JSON object instead of text")


def run_search(args: argparse.Namespace) -> int:
    """Run `ground-tools campaign peers search`. Returns 0.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read or written.
    """
    lines = _fly(args, search.cells(), search.markdown)
    if not args.json:
        for law in search.best_of(lines).values():
            print(f"best: {law}")
    return 0


def run_table(args: argparse.Namespace) -> int:
    """Run `ground-tools campaign peers table`. Returns 0.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read or written.
    """
    table = comparison.TABLES[args.table]
    _fly(args, table.cells(), lambda lines: comparison.markdown(args.table, lines))
    if not args.json:
        print(f"\nEach entry: {table.legend}.")
    return 0


def run_pareto(args: argparse.Namespace) -> int:
    """Run `ground-tools campaign peers pareto`. Returns 0.

    Raises:
        ConfigError: an option is wrong, a file cannot be read or written, or matplotlib is not installed.
    """
    if args.picture is not None and args.picture.suffix.lower() != ".png":
        raise ConfigError(f"--picture: {args.picture}: the file name must end in .png")
    lines = _fly(args, pareto.cells(), pareto.markdown)
    if args.picture is not None:
        pareto.draw(args.picture, lines)
    return 0


def _fly(
    args: argparse.Namespace, wanted: Sequence[Cell], text: Callable[[Sequence[tables.Line]], str]
) -> list[tables.Line]:
    """Fly cells, print the results as text or JSON, and store them."""
    seeds = seeds_of(args.seeds)
    table_file.check_writable(args.file)
    words = Console(stderr=True)
    absent = {law: why for cell in wanted if (why := missing(law := cell.law)) is not None}
    for why in dict.fromkeys(absent.values()):
        names = ", ".join(sorted({law.partition(":")[0] for law in absent if absent[law] == why}))
        words.print(f"{names}: not flown: {why}", soft_wrap=True, highlight=False)
    wanted = [cell for cell in wanted if cell.law not in absent]
    found, _ = fly_missing(wanted, seeds, args.out, work_of(args, words))
    lines = [
        tables.Line(cell=cell, found=search.figures(found[cell]), first=found[cell][0]) for cell in wanted
    ]
    if args.file is not None:
        state = campaign.software_of(wanted)
        table_file.write(
            args.file, tables.Kept(software=state, seeds=(seeds[0], seeds[-1]), lines=tuple(lines))
        )
    if args.json:
        report = [{"encounter": comparison.words_of(x.cell), "law": x.cell.law, **x.found} for x in lines]
        print(json.dumps({"seeds": args.seeds, "lines": report}, allow_nan=False))
    else:
        print(text(lines), end="")
    return lines
