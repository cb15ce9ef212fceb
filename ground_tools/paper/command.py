"""The command `ground-tools paper`: recomputes the paper's figures and compares them with its statements.

To add a figure, write a module with `report` and `draw` and add an entry to `FIGURES`.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rich.console import Console

from companion.errors import ConfigError
from companion.shipped import how_to_install
from ground_tools.channel import options
from ground_tools.common.progress import progress
from ground_tools.paper import page
from ground_tools.paper.city import command as city
from ground_tools.paper.city import cutouts as city_policy
from ground_tools.paper.city import separation as city_separation
from ground_tools.paper.closed_loop import command as closed_loop
from ground_tools.paper.figures import (
    convergence,
    decision_time,
    delay_rate,
    dmuca,
    dmuca_flights,
    dmuca_picture,
    dmuca_sweep,
    fixed_modes,
    packet_loss,
    readings,
    schematics,
    system_delay,
    uav_delay,
)
from ground_tools.paper.report import Report, json_rows, show
from ground_tools.paper.study import Study

_MAX_PROCESSES: Final = 1024
_PIPED_WIDTH: Final = 160
"""Width of tables that do not go to a terminal, so that no column is cut."""


@dataclass(frozen=True, slots=True)
class Figure:
    """One published figure."""

    name: str
    """Name on the command line and of the picture's file."""
    words: str
    """Description for the help."""
    report: Callable[[Study], Report]
    draw: Callable[[Study, Path], None]
    sigmas: int
    """Number of sigmas of the study that the figure uses. 0: none, and the study is not evaluated."""
    steps: int = 0
    """Calls of the study's `advance` while the figure is drawn, in addition to those for the sigmas."""


FIGURES: Final = (
    Figure(
        "framework",
        "drawing of the framework",
        lambda _: schematics.framework_report(),
        lambda _, path: schematics.draw_framework(path),
        0,
    ),
    Figure(
        "radio-modes",
        "drawing of the three radio modes, to scale",
        lambda _: schematics.modes_report(),
        lambda _, path: schematics.draw_modes(path),
        0,
    ),
    Figure("delay-rate", "delay against rate for each size", delay_rate.report, delay_rate.draw, 1),
    Figure("packet-loss", "loss against rate for each size", packet_loss.report, packet_loss.draw, 1),
    Figure(
        "fixed-modes",
        "system delay of the fixed modes by density",
        fixed_modes.report,
        fixed_modes.draw,
        len(fixed_modes.SIGMAS_DB),
    ),
    Figure(
        "readings",
        "the published delays under each reading of the channel model",
        lambda study: readings.report(study.samples, study.seed),
        lambda study, path: readings.draw(study.samples, study.seed, path, study.advance),
        0,
        len(readings.ALTERNATIVES),
    ),
    Figure(
        "convergence",
        "learning curves of MADQN-ATMC and its baselines, from stored runs",
        lambda _: convergence.report(),
        lambda _, path: convergence.draw(path),
        0,
    ),
    Figure(
        "system-delay",
        "system delay of all methods by density",
        lambda study: system_delay.report(study.samples, study.seed),
        lambda study, path: system_delay.draw(study.samples, study.seed, path),
        0,
    ),
    Figure(
        "uav-delay",
        "delay of each aircraft at dynamic density",
        lambda study: uav_delay.report(study.samples, study.seed),
        lambda study, path: uav_delay.draw(study.samples, study.seed, path),
        0,
    ),
    Figure(
        "decision-time",
        "time of one decision of the supplied policies; --samples: number of decisions",
        lambda study: decision_time.report(study.samples, study.seed),
        lambda study, path: decision_time.draw(study.samples, study.seed, path),
        0,
    ),
    Figure(
        "dmuca",
        "paths and separations of five aircraft; --samples: number of flights, "
        f"at most {dmuca_flights.MOST_FLIGHTS}",
        lambda study: dmuca.report(study.samples, study.seed),
        lambda study, path: dmuca_picture.draw(study.samples, study.seed, path, study.advance),
        0,
        len(dmuca_flights.CASES),
    ),
)

_DRAWINGS: Final = ("framework", "radio-modes")
"""Figures without numbers."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the figures of `ground-tools paper`, each a subcommand."""
    parser.description = (
        "Compute the paper's figures with the channel model's equations and with simulated flights, and\n"
        "compare them with the paper's statements. A statement that does not hold is a result, not an\n"
        f"error: the exit code is 0. {closed_loop.NAME}, {city.NAME}, {city_separation.NAME} and\n"
        f"{city_policy.NAME} are experiments beyond the paper, with options of their own; they take hours,\n"
        "so that all does not include them, and keep what is finished."
    )
    parser.epilog = (
        "examples: ground-tools paper fixed-modes --samples 10000; "
        "ground-tools paper closed-loop --encounters 20 --methods wifi rule;\n"
        "ground-tools paper city --densities 10 100 --methods policy perfect none"
    )
    figures = parser.add_subparsers(dest="figure", required=True, metavar="FIGURE")
    for figure in FIGURES:
        _add_common(figures.add_parser(figure.name, help=figure.words))
    _add_common(figures.add_parser("all", help="all figures above, on one page"))
    words = "transports chosen in flight, simulated packets, and avoidance by what is received"
    loop = figures.add_parser(closed_loop.NAME, help=words)
    _add_common(loop)
    closed_loop.add_arguments(loop)
    words = "losses, conflicts, ages and load of hundreds of aircraft against density"
    city.add_arguments(figures.add_parser(city.NAME, help=words))
    words = "the room that each method needs for the same safety in such a city"
    city_separation.add_arguments(figures.add_parser(city_separation.NAME, help=words))
    words = "policies trained for a city, beside every fixed legal set, on cut-outs of it"
    city_policy.add_arguments(figures.add_parser(city_policy.NAME, help=words))


def _add_common(parser: argparse.ArgumentParser) -> None:
    """Add the options of all figures except the one over density."""
    options.add_sampling(parser)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/paper"),
        metavar="FOLDER",
        help="folder in which to write FIGURE.png, and for all a page with everything (default: runs/paper)",
    )
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object per line instead of tables"
    )
    parser.add_argument(
        "--sweep",
        action="store_true",
        help=f"dmuca: fly {len(dmuca_sweep.READINGS)} readings of what the paper leaves open, and draw a map "
        "of those under which its figure comes out; finished readings are kept in --out",
    )
    parser.add_argument(
        "--processes",
        type=int,
        metavar="N",
        help=f"--sweep and {closed_loop.NAME}: worker processes (default: one per core)",
    )


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools paper`. Returns 0.

    Raises:
        ConfigError: an option is wrong, a picture cannot be written, or matplotlib is missing for figures
            that are more than numbers.
    """
    if args.sweep and args.figure != "dmuca":
        raise ConfigError(f"--sweep: only the figure dmuca has one, not {args.figure}")
    if args.processes is not None and not 1 <= args.processes <= _MAX_PROCESSES:
        raise ConfigError(f"--processes: {args.processes} is out of range; allowed: 1 to {_MAX_PROCESSES}")
    if args.figure == closed_loop.NAME:
        return closed_loop.run(args)
    options.check_sampling(args.samples, args.seed)
    if args.sweep:
        options.make_folder(args.out)
        words, processes = _console(args), args.processes or os.cpu_count() or 1
        path, swept = dmuca_sweep.run(args.out, args.samples, args.seed, processes, words)
        _print(args, dmuca_sweep.NAME, swept, path, words)
        return 0
    chosen = [figure for figure in FIGURES if args.figure in (figure.name, "all")]
    # The numbers of one figure need no picture.
    drawn = args.figure in ("all", *_DRAWINGS) or importlib.util.find_spec("matplotlib") is not None
    study = Study(args.samples, args.seed)
    options.make_folder(args.out)
    steps = max(figure.sigmas for figure in chosen) * study.steps()
    steps += sum(figure.steps for figure in chosen)
    with progress("environments", steps) as advance:
        study.advance = advance
        found = []
        for figure in chosen:
            path = args.out / f"{figure.name}.png"
            # The picture comes first, so that a missing matplotlib is reported before the computation.
            if drawn:
                figure.draw(study, path)
            found.append((figure, figure.report(study), path))
    words = _console(args)
    for figure, report, path in found:
        _print(args, figure.name, report, path if drawn else None, words)
    if args.figure == "all":
        command = f"ground-tools paper %s --samples {args.samples} --seed {args.seed}"
        sections = [page.Section(f.name, command % f.name, report, path) for f, report, path in found]
        for path in page.write(args.out, sections):
            words.print(f"wrote {path}", soft_wrap=True, highlight=False)
    return 0


def _console(args: argparse.Namespace) -> Console:
    words = Console(stderr=args.json)
    return words if words.is_terminal else Console(stderr=args.json, width=_PIPED_WIDTH)


def _print(args: argparse.Namespace, name: str, report: Report, path: Path | None, words: Console) -> None:
    if args.json:
        for row in json_rows(name, report):
            print(json.dumps(row, allow_nan=False))
    else:
        show(report, words)
    done = f"no picture: {how_to_install('matplotlib', 'inspect')}" if path is None else f"wrote {path}"
    words.print(done, soft_wrap=True, highlight=False, markup=False)
