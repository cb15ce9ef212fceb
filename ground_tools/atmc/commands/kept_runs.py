"""What `ground-tools atmc sweep` and `crosscheck` share: options, and runs that are kept line by line."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from rich.console import Console
from rich.table import Table

from companion.shipped import CHECKOUT
from ground_tools.common.kept_lines import Kept
from ground_tools.common.progress import progress
from ground_tools.common.workers import in_parallel

Item = TypeVar("Item")
Row = TypeVar("Row", bound=msgspec.Struct)


def add_options(
    parser: argparse.ArgumentParser, algorithms: Iterable[str], *, seeds: str, kept: Path
) -> None:
    """Add the options that both commands have.

    Args:
        algorithms: names that may be trained; all are by default.
        seeds: default of `--seeds`.
        kept: file of the kept runs. In a checkout it is the default of `--out`; an installed copy writes to
            the working folder, and its own results stay unchanged.
    """
    names = list(algorithms)
    out = Path(kept.name) if CHECKOUT is None else kept
    parser.add_argument(
        "--algorithms", nargs="+", choices=names, default=names, metavar="NAME",
        help=f"algorithms to train (default: {' '.join(names)})",
    )  # fmt: skip
    parser.add_argument(
        "--seeds", default=seeds, metavar="A-B", help=f"one run for each seed (default: {seeds})"
    )
    parser.add_argument(
        "--processes", type=int, metavar="N", help="runs at the same time (default: one per core)"
    )
    parser.add_argument(
        "--out", type=Path, default=out, metavar="FILE",
        help=f"file of the runs; runs in it are not repeated (default: {out})",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print the table as JSON")


def train_missing(
    kept: Kept[Row], missing: Mapping[int, Item], train: Callable[[Item], Row], processes: int
) -> None:
    """Train the runs that the file lacks, in parallel, and keep each as soon as it is finished.

    Args:
        missing: runs by their number in the file; those that it holds are left out.
        train: trains one run, a top-level function of a module.
        processes: greatest number of runs at the same time.

    Raises:
        ConfigError: the file cannot be written, or a worker was killed from outside.
    """
    kept.add([])  # A file that cannot be written is refused before hours of training.
    items = [item for number, item in missing.items() if number not in kept.rows]
    with progress("runs", len(items)) as advance:
        for _, row in in_parallel(train, items, processes, Console(stderr=True)):
            kept.add([row])
            advance()


def show(found: Any, drawn: Callable[[Any], Table], *, as_json: bool) -> None:
    """Print a table, or the same as JSON."""
    if as_json:
        print(json.dumps(found, indent=1))
    else:
        Console().print(drawn(found))
