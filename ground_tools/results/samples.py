"""Flies a sample of the kept flights again."""

from __future__ import annotations

import argparse
from pathlib import Path

from ground_tools.campaign import cells as campaign
from ground_tools.campaign import tables
from ground_tools.campaign.peers.flown import missing
from ground_tools.common import table_file
from ground_tools.common.kept_lines import read_lines
from ground_tools.common.provenance import CannotSampleError
from ground_tools.paper.closed_loop import command as closed_loop
from ground_tools.paper.closed_loop.flights import Row, rows_of


def campaign_table(path: Path) -> list[str]:
    """Fly the first seed of every line of a campaign's table again. Returns the differences, as text.

    Raises:
        CannotSampleError: some lines need what is not there; all others are the same.
    """
    table = table_file.read(path, tables.Kept)
    if not table.lines:
        return ["the file holds no line"]
    wanted = tables.TABLES.get(path.stem)
    if wanted is not None and [line.cell for line in table.lines] != wanted():
        return [f"the file holds other cells than the table's; it has {len(table.lines)} of {len(wanted())}"]
    runs = 1 + table.seeds[1] - table.seeds[0]
    found, absent = [], []
    for line in table.lines:
        if line.first is None:
            return ["the file holds no single flight to compare with"]
        if line.found.get("runs") != runs:
            found.append(
                f"{line.cell.name}: {line.found.get('runs')} flights; seeds {table.seeds} are {runs}"
            )
        if (why := missing(line.cell.law)) is not None:
            absent.append(why)
            continue
        (again,) = campaign.fly(line.cell, [line.first.seed])
        if again != line.first:
            found.append(
                f"{line.cell.name}, seed {line.first.seed}: least separation {line.first.separation_m:g} m, "
                f"now {again.separation_m:g} m"
            )
    if absent and not found:
        raise CannotSampleError(
            f"{len(absent)} of {len(table.lines)} lines, of which {absent[0]}; the others are the same"
        )
    return found


def closed_loop_cell(path: Path) -> list[str]:
    """Fly the first run of a file of the closed loop again. Returns the differences, as text."""
    condition, _, method = path.stem.partition("-")
    parser = argparse.ArgumentParser()
    closed_loop.add_arguments(parser)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(["--conditions", condition, "--methods", method])
    _, lines = read_lines(path, Row)
    kept = {row.encounter: row for row in lines}
    flights = closed_loop.flights_of(args, condition, method)
    first = flights[0].seeds[0]
    missing = sum(seed not in kept for seed in range(first, first + args.encounters))
    if missing:
        return [f"{missing} of {args.encounters} encounters are missing"]
    found = []
    for again in rows_of(flights[0]):
        row = kept.get(again.encounter)
        if row != again:
            before = "missing" if row is None else f"least separation {row.least_separation_m:.2f} m"
            found.append(f"encounter {again.encounter}: {before}, now {again.least_separation_m:.2f} m")
    return found
