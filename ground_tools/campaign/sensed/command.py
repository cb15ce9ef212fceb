"""The command `ground-tools campaign sensed`: flies towards poles, walls and aircraft that transmit
nothing."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Final

import msgspec

from companion.errors import ConfigError
from ground_tools.campaign.sensed import cells, flight
from ground_tools.campaign.sensed.flight import Row
from ground_tools.campaign.sensed.scene import KINDS, Cell
from ground_tools.channel import options
from ground_tools.common import table_file
from ground_tools.common.kept_lines import Kept
from ground_tools.common.missing_flights import fly_missing
from ground_tools.common.run_options import processes_of, seeds_of

SENSED, UNHEARD = "sensed", "unheard"
_GROUPS: Final = {SENSED: ("pole", "wall"), UNHEARD: ("unheard-5", "unheard-10")}
"""Groups of kinds: stationary obstacles, and aircraft at 5 and 10 m/s."""

Part = tuple[Cell, list[int]]


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools campaign sensed`."""
    cell = Cell(kind="pole")
    add = command.add_argument
    add("--kind", action="append", choices=(*_GROUPS, *KINDS), metavar="KIND",
        help=f"what is in the way, may be repeated: {', '.join(KINDS)}; {SENSED}: pole and wall; "
        f"{UNHEARD}: both aircraft (default: all)")  # fmt: skip
    add("--range", type=float, nargs="+", default=[cell.range_m], metavar="M",
        help=f"how far the sensor sees, m; several fly a line each (default: {cell.range_m:g})")  # fmt: skip
    add("--message", choices=("scan", "points", "tracks", "proximity"), default=cell.message,
        help="what the sensor sends: OBSTACLE_DISTANCE, OBSTACLE_DISTANCE_3D, ADSB_VEHICLE, or "
        "DISTANCE_SENSOR of an ArduPilot to which it is wired (default: scan)")  # fmt: skip
    add("--fov", type=float, default=cell.fov_deg, metavar="DEG",
        help="field of view around the nose (default: 360)")  # fmt: skip
    add("--speed", type=float, default=cell.speed_mps, metavar="MPS",
        help="greatest speed of the own aircraft, of which it plans 0.5 to 0.75 (default: 5)")  # fmt: skip
    add("--acceleration", type=float, default=cell.acceleration_mps2, metavar="MPS2",
        help="greatest change of its command (default: 2)")  # fmt: skip
    add("--seeds", default="1-100", metavar="FROM-TO",
        help="range of seeds, one flight each (default: 1-100)")  # fmt: skip
    add("--processes", type=int, metavar="N", help="worker processes (default: one per core)")
    add("--out", type=Path, metavar="FOLDER",
        help="keep results in this folder, and do not repeat flights whose results are there")  # fmt: skip
    add("--file", type=Path, metavar="FILE", help="also write all numbers as JSON")
    add("--json", action="store_true", help="print one JSON object instead of a table")
    command.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools campaign sensed`. Returns 0.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read or written.
    """
    seeds, processes = seeds_of(args.seeds), processes_of(args.processes)
    wanted = _cells(args)
    table_file.check_writable(args.file)
    files: dict[Cell, Kept[Row]] = {}
    if args.out is not None:
        options.make_folder(args.out)
        files = {cell: cells.kept(args.out, cell) for cell in wanted}
    rows = fly_missing(_fly, wanted, seeds, files, lambda row: row.seed, processes)
    found = {cell: cells.summary(rows[cell]) for cell in wanted}
    if args.file is not None:
        stored = tuple(cells.Line(cell=cell, found=found[cell], first=rows[cell][0]) for cell in wanted)
        table_file.write(
            args.file, cells.Table(software=cells.software(), seeds=(seeds[0], seeds[-1]), lines=stored)
        )
    if args.json:
        lines = [{**msgspec.to_builtins(cell), **one} for cell, one in found.items()]
        print(json.dumps({"cells": lines}, allow_nan=False))
    else:
        print(cells.markdown(found), end="")
    return 0


def _cells(args: argparse.Namespace) -> list[Cell]:
    kinds: list[str] = []
    for kind in args.kind or list(KINDS):
        kinds += _GROUPS.get(kind, (kind,))
    try:
        return [
            msgspec.convert(
                {
                    "kind": kind,
                    "range_m": range_m,
                    "message": args.message,
                    "fov_deg": args.fov,
                    "speed_mps": args.speed,
                    "acceleration_mps2": args.acceleration,
                },
                Cell,
            )
            for kind in dict.fromkeys(kinds)
            for range_m in args.range
        ]
    except msgspec.ValidationError as error:
        raise ConfigError(f"campaign sensed: {error}") from error


def _fly(part: Part) -> list[Row]:
    cell, seeds = part
    return [flight.fly(cell, seed) for seed in seeds]
