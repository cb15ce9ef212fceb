"""The command `ground-tools campaign attacks`: flies forging transmitters against the companion."""

from __future__ import annotations

import argparse
import functools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
from rich.console import Console

from companion.errors import ConfigError
from ground_tools.campaign.attacks import flight, kept, search, tables
from ground_tools.campaign.attacks.kinds import KINDS
from ground_tools.campaign.attacks.outcome import Row
from ground_tools.campaign.attacks.scene import MANNERS, USES, Cell, baseline
from ground_tools.channel import options
from ground_tools.common.kept_lines import Kept
from ground_tools.common.missing_flights import fly_missing
from ground_tools.common.progress import progress
from ground_tools.common.run_options import processes_of, seeds_of
from ground_tools.common.workers import rounds_in_parallel

_NAMES: Final = (*KINDS, "worst")

Part = tuple[Cell, list[int]]


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools campaign attacks`."""
    command.add_argument("--kind", action="append", choices=_NAMES, metavar="KIND",
                         help=f"kind of attack, may be repeated: {', '.join(_NAMES)} (default: all but "
                         "worst); worst searches the kinds of --of for the most harm")  # fmt: skip
    command.add_argument("--seeds", default="1-100", metavar="FROM-TO",
                         help="range of seeds, one encounter each (default: 1-100)")  # fmt: skip
    command.add_argument("--use", choices=USES, default="mixed",
                         help="how the own aircraft uses its companion (default: mixed; herd and adsb: "
                         "guard)")  # fmt: skip
    command.add_argument("--intruder", choices=MANNERS, default="mixed",
                         help="how the aircraft on collision course flies (default: mixed)")  # fmt: skip
    command.add_argument(
        "--no-signal", action="store_true", help="receivers do not report the signal strength"
    )
    command.add_argument("--jobs", type=int, metavar="N", help="worker processes (default: one per core)")
    command.add_argument("--out", type=Path, metavar="FOLDER",
                         help="keep results in this folder, and do not repeat flights whose results are "
                         "there; with worst: write each found case there, too")  # fmt: skip
    command.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    command.add_argument("--of", action="append", choices=tuple(KINDS), metavar="KIND",
                         help="worst: kinds to search, may be repeated (default: free)")  # fmt: skip
    command.add_argument("--harm", choices=search.HARMS, default="separation",
                         help="worst: what the attack is to achieve (default: separation)")  # fmt: skip
    command.add_argument(
        "--evaluations",
        type=int,
        default=2000,
        metavar="N",
        help="worst: flights of each search (default: 2000)",
    )
    command.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools campaign attacks`. Returns 0.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read or written.
    """
    seeds, jobs = seeds_of(args.seeds), processes_of(args.jobs, "jobs")
    kinds = args.kind or list(KINDS)
    if "worst" in kinds:
        if len(kinds) > 1:
            raise ConfigError("--kind worst cannot be combined with other kinds; name those with --of")
        return _run_worst(args, seeds, jobs)
    wanted = {kind: _cell(args, kind) for kind in kinds}
    cells = list(dict.fromkeys([*wanted.values(), *map(baseline, wanted.values())]))
    files: dict[Cell, Kept[Row]] = {}
    if args.out is not None:
        options.make_folder(args.out)
        files = {cell: _file(args.out, cell) for cell in cells}
    rows = fly_missing(_fly, cells, seeds, files, lambda row: row.seed, jobs)
    found = {kind: tables.summary(rows[cell], rows[baseline(cell)]) for kind, cell in wanted.items()}
    print(json.dumps(found, allow_nan=False) if args.json else tables.markdown(found), end="")
    return 0


def _fly(part: Part) -> list[Row]:
    cell, seeds = part
    return [flight.fly(cell, seed) for seed in seeds]


def _file(folder: Path, cell: Cell) -> Kept[Row]:
    made_with: dict[str, Any] = {**msgspec.to_builtins(cell), "software": kept.software()}
    name = "-".join(
        [cell.kind, cell.use, cell.intruder, "signal" if cell.signal else "silent"]
        + ([] if cell.attacked else ["quiet"])
    )
    return Kept(folder / f"{name}.jsonl", made_with, Row, lambda row: row.seed)


def _run_worst(args: argparse.Namespace, seeds: Sequence[int], jobs: int) -> int:
    """Search each kind in the encounter of each seed. Prints the attacks found, the worst first."""
    if not 10 <= args.evaluations <= 100_000:
        raise ConfigError(f"--evaluations: {args.evaluations} is out of range; allowed: 10 to 100000")
    if args.out is not None:
        options.make_folder(args.out)
    items = [(_cell(args, kind), seed) for kind in args.of or ["free"] for seed in seeds]
    told = None if args.out is None else functools.partial(_keep, args.out)
    searches = [search.worst(cell, seed, args.harm, args.evaluations, told) for cell, seed in items]
    if args.out is not None:
        files = [_flown_file(args.out, cell, seed, args.harm) for cell, seed in items]
        searches = [search.resumed(work, file) for work, file in zip(searches, files, strict=True)]
    results: list[search.Found] = []
    with progress("searches", len(items)) as advance:
        for _, found in rounds_in_parallel(search.fly, searches, jobs, Console(stderr=True)):
            results.append(found)
            advance()
    results.sort(key=lambda found: -search.harm_of(found.row, found.harm))
    if args.json:
        print(json.dumps(msgspec.to_builtins(results)))
        return 0
    for found in results:
        most = search.harm_of(found.row, found.harm)
        print(
            f"{found.cell.kind}, seed {found.seed}, {found.harm}: {abs(most):.2f} in {found.evaluations} "
            f"flights (drawn: {abs(found.drawn):.2f}); {found.row.use}, {found.row.met}"
        )
    return 0


def _keep(folder: Path, found: search.Found) -> None:
    """Write the worst case that a search has found so far."""
    case = kept.Case(
        about=f"{found.harm}: the worst of {found.evaluations} flights of a search",
        cell=found.cell,
        seed=found.seed,
        attack=found.attack,
        found=found.row,
        found_with=kept.software(),
    )
    kept.write(folder / f"{_search_name(found.cell, found.seed, found.harm)}.json", case)


def _flown_file(folder: Path, cell: Cell, seed: int, harm: str) -> Kept[search.Flown]:
    """Open the file with the flights of a search, by which it can be continued."""
    made_with: dict[str, Any] = {
        **msgspec.to_builtins(cell), "seed": seed, "harm": harm, "software": kept.software(),
    }  # fmt: skip
    path = folder / f"{_search_name(cell, seed, harm)}.jsonl"
    return Kept(path, made_with, search.Flown, lambda flown: flown.number)


def _search_name(cell: Cell, seed: int, harm: str) -> str:
    return f"{cell.kind}-{cell.intruder}-{harm}-{seed}"


def _cell(args: argparse.Namespace, kind: str) -> Cell:
    return Cell(kind=kind, use=args.use, intruder=args.intruder, signal=not args.no_signal)
