"""The command `ground-tools campaign`: flies thousands of encounters and reports the performance of the
law."""

from __future__ import annotations

import argparse
import functools
import json
import time
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

from rich.console import Console

from companion.errors import ConfigError
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import fences, run_folder, tables
from ground_tools.campaign.attacks import command as attacks
from ground_tools.campaign.cells import Cell
from ground_tools.campaign.encounters import command as encounters
from ground_tools.campaign.generators import NAMES
from ground_tools.campaign.peer_comparison import command as peers
from ground_tools.campaign.peers.laws import PEERS
from ground_tools.campaign.peers.omniscient import NAME as OMNISCIENT
from ground_tools.campaign.runs import add_common, fly_missing, summary, work_of
from ground_tools.campaign.scenario_measures import command as scenarios
from ground_tools.campaign.scenarios.layouts import SCENARIOS
from ground_tools.campaign.sensed import command as sensed
from ground_tools.common import table_file
from ground_tools.common.progress import progress
from ground_tools.common.run_options import processes_of, seeds_of
from ground_tools.common.workers import in_parallel

_MOST_AIRCRAFT = 200
_MOST_WORST = 1000
_LAW_EXAMPLE = "mvp:radius_m=16,look_s=30"
_FENCES_AT_ONCE = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands of `ground-tools campaign`."""
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    command = commands.add_parser(
        "run",
        help="fly one kind of encounter, with and without avoidance",
        description="Fly random encounters with avoidance and, for the risk ratio, the same ones without it.",
        epilog="example: ground-tools campaign run --generator S2 --aircraft 5 --delay 1 2 --seeds 1-1000",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_run(command)
    command = commands.add_parser(
        "table",
        help="fly the encounters of a table and print it as Markdown",
        description="Fly all encounters of a table with and without avoidance; print a line for each kind.",
        epilog="example: ground-tools campaign table generators --seeds 1-1000 --out runs/campaign",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_table(command)
    command = commands.add_parser(
        "fences",
        help="attack fences: random areas, and neighbours that push the aircraft out",
        description="Fly single aircraft in random fences, with no, honest, turning or invented neighbours.",
        epilog="example: ground-tools campaign fences --seeds 1-2000 --noisy",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _add_fences(command)
    command = commands.add_parser(
        "attacks",
        help="attack the companion with a forging transmitter",
        description="Fly the companion's own core against forged Remote ID and ADS-B, with and without them.",
        epilog="example: ground-tools campaign attacks --kind crowd --seeds 1-1000 --out runs/attacks",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    attacks.add_arguments(command)
    command = commands.add_parser(
        "peers",
        help="compare the law with those of others",
        description="Fly the same encounters with the companion's law and with those of others.",
        epilog="example: ground-tools campaign peers table encounters --out runs/peers",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    peers.add_arguments(command)
    command = commands.add_parser(
        "scenarios",
        help="fly everyday traffic: lanes, formations, landings, merging, or files of others",
        description="Fly everyday traffic, or files of others, and measure who arrives and who deviates for "
        "nothing.",
        epilog="examples:\n"
        "  ground-tools campaign scenarios lanes-15 parking --laws dmuca orca-constant\n"
        "  ground-tools campaign scenarios --scn super8.scn wall.scn --laws none dmuca omniscient",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    scenarios.add_arguments(command)
    command = commands.add_parser(
        "encounters",
        help="meet crewed aircraft drawn from MIT Lincoln Laboratory's encounter models",
        description="Draw crewed aircraft from a published encounter model, meet them with and without "
        "avoidance, and report the risk ratio and the ratio of losses of well clear.",
        epilog="example: ground-tools campaign encounters --model uncor_1200only_rotorcraft_v1p2.txt "
        "--own 10 --seeds 1-1000",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    encounters.add_arguments(command)
    command = commands.add_parser(
        "sensed",
        help="fly towards poles, walls and aircraft that transmit nothing, with a sensor aboard",
        description="Fly the companion's own core, with a simulated sensor, towards what transmits nothing.",
        epilog="example: ground-tools campaign sensed --kind unheard --range 20 40 80 --seeds 1-100",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    sensed.add_arguments(command)


def _add_run(command: argparse.ArgumentParser) -> None:
    names = (*NAMES, *SCENARIOS)
    command.add_argument("--generator", required=True, choices=names, metavar="NAME",
                         help=f"kind of encounter: {', '.join(names)}")  # fmt: skip
    command.add_argument(
        "--aircraft", type=int, default=5, metavar="N", help="number of aircraft (default: 5)"
    )
    command.add_argument("--delay", type=float, nargs=2, default=(0.0, 1.0), metavar=("A", "B"),
                         help="delay of each message, drawn from A to B seconds (default: 0 1)")  # fmt: skip
    command.add_argument(
        "--law",
        default="dmuca",
        metavar="NAME",
        help="avoidance law: ours (dmuca), the paper's (paper), none, or another one: "
        f"{', '.join(PEERS)}, a plug-in's, or MODULE:CLASS; parameters of its own as in {_LAW_EXAMPLE}; or "
        f"{OMNISCIENT}, which knows everybody's future (default: dmuca)",
    )
    command.add_argument(
        "--speed", type=float, default=5.0, metavar="M/S", help="greatest speed (default: 5)"
    )
    command.add_argument("--loss", type=float, default=0.0, metavar="SHARE",
                         help="share of messages that are lost, 0 to 1 (default: 0)")  # fmt: skip
    command.add_argument("--intruders", type=float, default=0.0, metavar="SHARE",
                         help="share of aircraft that are intruders, 0 to 1 (default: 0)")  # fmt: skip
    command.add_argument("--intruder", choices=campaign.KINDS, default="blind", metavar="KIND",
                         help=f"kind of intruder: {', '.join(campaign.KINDS)} (default: blind)")  # fmt: skip
    command.add_argument("--world", choices=campaign.WORLDS, default="calm", metavar="NAME",
                         help=f"conditions: {', '.join(campaign.WORLDS)} (default: calm)")  # fmt: skip
    command.add_argument("--rate", type=int, default=1, metavar="N",
                         help="messages of each aircraft in a second, 1 to 20 (default: 1)")  # fmt: skip
    command.add_argument("--signal", action="store_true",
                         help="let aircraft weigh the signal strength of messages")  # fmt: skip
    command.add_argument(
        "--no-reserve", action="store_true", help="limit every aircraft to its planned speed"
    )
    add_common(command, "1-100")
    command.add_argument("--worst", type=int, default=0, metavar="N",
                         help="write run folders of the N encounters of least separation")  # fmt: skip
    command.add_argument(
        "--runs",
        type=Path,
        default=Path("runs"),
        metavar="FOLDER",
        help="parent of the run folders of --worst (default: runs)",
    )
    command.add_argument("--json", action="store_true", help="print one JSON object instead of text")
    command.set_defaults(run=run)


def _add_table(command: argparse.ArgumentParser) -> None:
    command.add_argument("table", choices=tables.TABLES, metavar="TABLE",
                         help=f"one of {', '.join(tables.TABLES)}")  # fmt: skip
    add_common(command, "1-1000")
    command.add_argument("--file", type=Path, metavar="FILE", help="also write the table's numbers as JSON")
    command.set_defaults(run=run_table)


def _add_fences(command: argparse.ArgumentParser) -> None:
    command.add_argument("--seeds", default="1-2000", metavar="FROM-TO",
                         help="range of seeds, one flight each (default: 1-2000)")  # fmt: skip
    command.add_argument("--noisy", action="store_true", help="simulate the position error of GNSS")
    command.add_argument("--outside", action="store_true", help="let the aircraft begin outside the fence")
    command.add_argument(
        "--processes", type=int, metavar="N", help="worker processes (default: one per core)"
    )
    command.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    command.set_defaults(run=run_fences)


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools campaign run`. Returns 0.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read or written.
    """
    cell, seeds = _cell(args), seeds_of(args.seeds)
    meaning = campaign.flown_by(cell)
    _check_worst(args)
    _check_combined(args, cell)
    if args.worst and (meaning.peer or meaning.changed or meaning.plugin):
        raise ConfigError(
            f"--worst cannot be combined with --law {cell.law}: a run folder holds the configuration of a "
            f"companion, which knows {', '.join(campaign.LAWS)}"
        )
    words = Console(stderr=True)
    began = time.perf_counter()
    unavoided = campaign.baseline(cell)
    found, new = fly_missing([cell, unavoided], seeds, args.out, work_of(args, words))
    report = summary(found[cell], found[unavoided])
    report["wall_s"] = round(time.perf_counter() - began, 3)
    report["flight_s"] = new * campaign.duration_s(cell)
    report |= campaign.flagged(cell, found[cell])
    worst = sorted(found[cell], key=attrgetter("separation_m"))[: args.worst]
    report["worst"] = []
    with progress("run folders", len(worst)) as advance:
        for row in worst:
            folder = run_folder.write(args.runs, cell, row.seed, time.time())
            report["worst"].append(
                {"seed": row.seed, "separation_m": row.separation_m, "folder": str(folder)}
            )
            advance()
    if args.json:
        print(json.dumps(report, allow_nan=False))
    else:
        _show(cell, report, Console())
    return 0


def run_table(args: argparse.Namespace) -> int:
    """Run `ground-tools campaign table`. Returns 0.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read or written.
    """
    seeds, wanted = seeds_of(args.seeds), tables.TABLES[args.table]()
    table_file.check_writable(args.file)
    with_unavoided = dict.fromkeys(c for cell in wanted for c in (cell, campaign.baseline(cell)))
    found, _ = fly_missing(list(with_unavoided), seeds, args.out, work_of(args, Console(stderr=True)))
    lines = [
        tables.Line(
            cell=cell, found=summary(found[cell], found[campaign.baseline(cell)]), first=found[cell][0]
        )
        for cell in wanted
    ]
    if args.file is not None:
        ends = (seeds[0], seeds[-1])
        state = campaign.software_of(wanted)
        table_file.write(args.file, tables.Kept(software=state, seeds=ends, lines=tuple(lines)))
    print(tables.markdown(lines), end="")
    return 0


def run_fences(args: argparse.Namespace) -> int:
    """Run `ground-tools campaign fences`. Returns 0.

    Raises:
        ConfigError: an option is wrong.
    """
    seeds, processes = seeds_of(args.seeds), processes_of(args.processes)
    fly = functools.partial(_fly_fences, noisy=args.noisy, outside=args.outside)
    parts = [seeds[at : at + _FENCES_AT_ONCE] for at in range(0, len(seeds), _FENCES_AT_ONCE)]
    rows: list[fences.Row] = []
    with progress("flights", len(parts)) as advance:
        for _, found in in_parallel(fly, parts, processes, Console(stderr=True)):
            rows += found
            advance()
    rows.sort(key=attrgetter("seed"))
    report = fences.summary_outside(rows) if args.outside else fences.summary(rows)
    if args.json:
        print(json.dumps(report, allow_nan=False))
    else:
        print(fences.markdown_outside(report) if args.outside else fences.markdown(report), end="")
    return 0


def _fly_fences(seeds: Sequence[int], *, noisy: bool, outside: bool) -> list[fences.Row]:
    return [fences.fly(seed, noisy=noisy, outside=outside) for seed in seeds]


def _cell(args: argparse.Namespace) -> Cell:
    low, high = args.delay
    for key, value, least, most in (
        ("aircraft", args.aircraft, 2, _MOST_AIRCRAFT),
        ("speed", args.speed, 1.0, 50.0),
        ("loss", args.loss, 0.0, 1.0),
        ("intruders", args.intruders, 0.0, 1.0),
        ("rate", args.rate, 1, 20),
    ):
        if not least <= value <= most:
            raise ConfigError(f"--{key}: {value:g} is out of range; allowed: {least:g} to {most:g}")
    if not 0.0 <= low <= high <= 60.0:
        raise ConfigError(
            f"--delay: {low:g} {high:g} is not allowed; allowed: two rising numbers from 0 to 60"
        )
    return Cell(
        generator=args.generator,
        aircraft=args.aircraft,
        law=args.law,
        speed_mps=args.speed,
        delay_s=(low, high),
        loss=args.loss,
        intruders=args.intruders,
        intruder=args.intruder,
        world=args.world,
        reserve=not args.no_reserve,
        rate=args.rate,
        signal=args.signal,
    )


def _check_worst(args: argparse.Namespace) -> None:
    if not 0 <= args.worst <= _MOST_WORST:
        raise ConfigError(f"--worst: {args.worst} is out of range; allowed: 0 to {_MOST_WORST}")
    if args.worst and args.aircraft > run_folder.MOST_AIRCRAFT:
        raise ConfigError(
            f"--worst: a run folder of {args.aircraft} aircraft is too large; "
            f"allowed: up to {run_folder.MOST_AIRCRAFT} aircraft"
        )


def _check_combined(args: argparse.Namespace, cell: Cell) -> None:
    if args.worst and cell.signal:
        raise ConfigError("--worst cannot be combined with --signal: a run folder does not hold powers")
    if not cell.twins:
        return
    if cell.signal:
        raise ConfigError(f"--signal cannot be combined with --intruder {cell.intruder}")
    if args.worst:
        raise ConfigError(
            f"--worst cannot be combined with --intruder {cell.intruder}: a run folder cannot tell "
            "the tracks of such intruders apart"
        )
    if campaign.WORLDS[cell.world].blackout_s > 0.0:
        raise ConfigError(f"--world {cell.world} cannot be combined with --intruder {cell.intruder}")


def _show(cell: Cell, report: dict[str, Any], words: Console) -> None:
    """Print the report as text."""
    low, high = cell.delay_s
    r = report
    lines = [
        f"{cell.generator}, {cell.aircraft} aircraft, law {cell.law}, delays {low:g} to {high:g} s: "
        f"{r['runs']} runs",
        f"runs that lost separation ({campaign.SEPARATION_M:g} m): {r['losses_of_separation']}, with a "
        f"collision: {r['collisions']}; without avoidance: {r['unavoided_losses_of_separation']} and "
        f"{r['unavoided_collisions']}",
    ]
    if r["risk_ratio"] is not None:
        at_least, at_most = r["risk_ratio_interval"]
        lines.append(f"risk ratio: {r['risk_ratio']:.4f} (95 % interval: {at_least:.4f} to {at_most:.4f})")
    if r["mean_severity"] is not None:
        lines.append(f"severity of the losses: mean {r['mean_severity']:.2f}, worst {r['max_severity']:.2f}")
    lines += [
        f"least separation: {r['min_separation_m']:.2f} m (seed {r['worst_seed']}), "
        f"median {r['median_min_separation_m']:.2f} m; median without avoidance "
        f"{r['unavoided_median_min_separation_m']:.2f} m",
        f"medians: largest deviation {r['median_max_deviation_m']:.1f} m, "
        f"away from the path for {r['median_away_s']:.1f} s, path delayed by {r['median_lost_s']:.1f} s, "
        f"distance flown {r['median_path_ratio']:.3f} of the planned distance",
        f"return to the timed point: {_seconds(r['median_recovery_s'])} after the last conflict (median); "
        f"no return in {r['not_recovered']} runs",
        f"pairs in conflict: {r['alerts']:,}; of these false (also apart without avoidance): "
        f"{r['false_alerts']:,}",
        f"{r['flight_s']:,.0f} s of flight computed in {r['wall_s']:.1f} s",
    ]
    if cell.signal:
        lines.append(
            f"signal flags: {r['flagged_intruders']:,} of intruders, {r['flagged_others']:,} of others"
        )
    lines += [f"seed {w['seed']}: {w['separation_m']:.2f} m: {w['folder']}" for w in r["worst"]]
    for line in lines:
        words.print(line, highlight=False, soft_wrap=True)


def _seconds(value: float | None) -> str:
    return "never" if value is None else f"{value:.1f} s"
