"""Flies the missing flights of cells, and computes the reported results of one cell."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numba
import numpy as np
from rich.console import Console

from ground_tools.campaign import cells as campaign
from ground_tools.campaign.cells import Cell, Row
from ground_tools.campaign.peers.flown import brought
from ground_tools.channel import options
from ground_tools.common.cluster import on_ray
from ground_tools.common.intervals import wilson
from ground_tools.common.progress import progress
from ground_tools.common.run_options import add_ray, processes_unless_ray
from ground_tools.common.workers import in_parallel

_AIRCRAFT_AT_ONCE = 500
"""Number of aircraft that a worker flies before it returns their results."""
_TWINS_LONGER = 50
"""Computing time of a flight with twins, relative to other flights."""
_BROUGHT_LONGER = 10
"""The same for a law that another project's library computes."""

Part = tuple[Cell, list[int]]
"""One unit of work for a worker: some seeds of a cell."""
Work = Callable[[Sequence[Part]], Iterator[tuple[Part, list[Row]]]]


def add_common(command: argparse.ArgumentParser, seeds: str) -> None:
    """Add the options of every command that flies cells."""
    command.add_argument("--seeds", default=seeds, metavar="FROM-TO",
                         help=f"range of seeds, one encounter each (default: {seeds})")  # fmt: skip
    command.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="keep results in this folder, and do not repeat flights whose results are there",
    )
    command.add_argument(
        "--processes", type=int, metavar="N", help="worker processes (default: one per core)"
    )
    add_ray(command)


def fly_missing(
    wanted: Sequence[Cell], seeds: Sequence[int], folder: Path | None, work: Work
) -> tuple[dict[Cell, list[Row]], int]:
    """Fly the missing rows of every cell. Returns all rows, in the order of the seeds, and the number flown.

    Args:
        folder: folder in which rows are stored and looked up; None: rows are not stored.
        work: function that flies the units of work.

    Raises:
        ConfigError: a file cannot be read or written, or an encounter cannot be drawn.
    """
    rows: dict[Cell, dict[int, Row]] = {cell: {} for cell in wanted}
    files = {}
    if folder is not None:
        options.make_folder(folder)
        files = {cell: campaign.kept(folder, cell) for cell in wanted}
        rows = {cell: dict(file.rows) for cell, file in files.items()}
    parts: list[Part] = []
    for cell in wanted:
        missing = [seed for seed in seeds if seed not in rows[cell]]
        longer = _TWINS_LONGER if cell.twins else _BROUGHT_LONGER if brought(cell.law) is not None else 1
        size = max(1, _AIRCRAFT_AT_ONCE // cell.aircraft // longer)
        parts += [(cell, missing[at : at + size]) for at in range(0, len(missing), size)]
    with progress("flights", len(parts)) as advance:
        for (cell, _), found in work(parts):
            if cell in files:
                files[cell].add(found)
            rows[cell].update((row.seed, row) for row in found)
            advance()
    flown = sum(len(missing) for _, missing in parts)
    return {cell: [rows[cell][seed] for seed in seeds] for cell in wanted}, flown


def work_of(args: argparse.Namespace, words: Console) -> Work:
    """The function that runs the work: in processes on this machine, or on a cluster."""
    processes = processes_unless_ray(args.processes, args.ray)
    if processes is not None:

        def here(parts: Sequence[Part]) -> Iterator[tuple[Part, list[Row]]]:
            first = {cell.law.partition(":")[0]: (cell, seeds) for cell, seeds in reversed(parts)}
            for cell, seeds in first.values():
                campaign.fly(cell, seeds[:1])  # compiles each law once, for all workers
            return in_parallel(_fly, parts, processes, words)

        return here
    return lambda parts: on_ray(_fly, parts, args.ray, _state, words)


def _fly(part: Part) -> list[Row]:
    return campaign.fly(*part)


def _state() -> str:
    """The versions of all software that the rows depend on. Also compiles the flight code once, so that the
    cached result serves the other workers of the machine."""
    campaign.fly(Cell(generator="crossing", aircraft=2), [1])
    state = campaign.software(twins=True, peers=True, planned=True, scenarios=True)
    return f"{state}, numba {numba.__version__}, numpy {np.__version__}"


def summary(rows: Sequence[Row], unavoided: Sequence[Row]) -> dict[str, Any]:
    """The reported results of one cell, compared with the same encounters without avoidance."""
    losses, losses_unavoided = campaign.lost(rows), campaign.lost(unavoided)
    low, high = wilson(losses, len(rows))
    share = losses_unavoided / len(unavoided)
    severities = [row.severity for row in rows if row.severity > 0.0]
    recovery = campaign.median([math.inf if row.recovery_s is None else row.recovery_s for row in rows])
    alerts = sum(len(row.alerts) for row in rows)
    # Both lists of rows are in the order of the seeds.
    false = sum(len(set(row.alerts) - set(other.lost)) for row, other in zip(rows, unavoided, strict=True))
    return {
        "runs": len(rows),
        "collisions": campaign.collided(rows),
        "losses_of_separation": losses,
        "unavoided_collisions": campaign.collided(unavoided),
        "unavoided_losses_of_separation": losses_unavoided,
        "min_separation_m": min(row.separation_m for row in rows),
        "median_min_separation_m": campaign.median([row.separation_m for row in rows]),
        "unavoided_median_min_separation_m": campaign.median([row.separation_m for row in unavoided]),
        "worst_seed": min(rows, key=lambda row: row.separation_m).seed,
        "risk_ratio": losses / len(rows) / share if share else None,
        # Of the share with avoidance only. The share without has an uncertainty of its own, which matters if
        # both are similar and far from 1: the coverage is then 92 to 98 %.
        "risk_ratio_interval": [low / share, high / share] if share else None,
        "median_max_deviation_m": campaign.median([row.deviation_m for row in rows]),
        "median_away_s": campaign.median([row.away_s for row in rows]),
        "median_lost_s": campaign.median([row.lost_s for row in rows]),
        "max_lost_s": max(row.lost_s for row in rows),
        "median_path_ratio": campaign.median([row.path_ratio for row in rows]),
        "mean_severity": float(np.mean(severities)) if severities else None,
        "max_severity": max(severities, default=None),
        "median_recovery_s": recovery if math.isfinite(recovery) else None,
        "not_recovered": sum(row.recovery_s is None for row in rows),
        "alerts": alerts,
        "false_alerts": false,
        "false_alert_share": false / alerts if alerts else None,
        "crewed_losses": _crewed_losses(rows),
        "unavoided_crewed_losses": _crewed_losses(unavoided),
        "min_crewed_separations": min((row.crewed for row in rows if row.crewed is not None), default=None),
        "max_beyond_fence_m": max(row.fence_m for row in rows),
    }


def _crewed_losses(rows: Sequence[Row]) -> int:
    """Number of flights in which both separations from crewed traffic were lost at the same time."""
    return sum(row.crewed is not None and row.crewed < 1.0 for row in rows)
