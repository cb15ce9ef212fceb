"""The command `ground-tools paper closed-loop`: from the policy through the radio channel to the separation.

The paper draws the delays of its avoidance experiment from fixed intervals. Here the delays result from the
policy and the transmitted packets in each encounter. All methods fly the same encounters.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shutil
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from companion.config import AtmcConfig, names_file
from companion.errors import ConfigError
from companion.runtime.warm import warm_up
from companion.shipped import given, how_to_install, shipped
from ground_tools.channel import options
from ground_tools.common.figure import drawn
from ground_tools.common.kept_lines import Kept
from ground_tools.common.progress import progress
from ground_tools.common.workers import in_parallel
from ground_tools.paper.closed_loop import table
from ground_tools.paper.closed_loop.cells import cell
from ground_tools.paper.closed_loop.flights import (
    ATMC,
    CONDITIONS,
    DENSE,
    METHODS,
    SEPARATION_M,
    UNAVOIDED,
    Flight,
    Row,
    rows_of,
)
from sitl_mocks.channel import parameters
from sitl_mocks.encounters import scenario_file
from sitl_mocks.encounters.choosing import read_policy
from sitl_mocks.encounters.draw import MAX_SIDE_BY_SIDE

Cells = dict[tuple[str, str], Kept[Row]]
"""Stored results, by condition and method."""

NAME: Final = "closed-loop"
_CHANNEL: Final = "config/channel/standard.toml"
_POLICY: Final = "config/policies/atmc.safetensors"
_REGION: Final = "config/regions/us.toml"
ENCOUNTERS: Final = 200
CROWD: Final = 12
_PIPED_WIDTH: Final = 120
_MAX_ENCOUNTERS: Final = 100_000
_COLOURS: Final = {"sparse": "#2a78d6", "dense": "#e34948", "loaded": "#eda100"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that only closed-loop has."""
    group = parser.add_argument_group(NAME)
    group.add_argument(
        "--encounters",
        type=int,
        default=ENCOUNTERS,
        metavar="N",
        help=f"encounters for each method and condition (default: {ENCOUNTERS})",
    )
    group.add_argument("--conditions", nargs="+", choices=CONDITIONS, default=list(CONDITIONS), metavar="C",
                       help=f"conditions out of {', '.join(CONDITIONS)} (default: all)")  # fmt: skip
    group.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS), metavar="M",
                       help=f"methods out of {', '.join(METHODS)} (default: all)")  # fmt: skip
    group.add_argument(
        "--policy",
        type=given,
        default=shipped(_POLICY),
        metavar="FILE|plugin:NAME",
        help=f"policy of the method {ATMC} (default: {_POLICY})",
    )
    group.add_argument(
        "--region",
        type=given,
        default=shipped(_REGION),
        metavar="FILE",
        help=f"region that defines the legal sets (default: {_REGION})",
    )
    group.add_argument(
        "--crowd",
        type=int,
        default=CROWD,
        metavar="N",
        help=f"encounters side by side in the condition {DENSE} (default: {CROWD}, about 36 aircraft)",
    )


def run(args: argparse.Namespace) -> int:
    """Fly the missing encounters and show all results; no picture without matplotlib. Returns 0.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read or written.
    """
    _check(args)
    folder = args.out / NAME
    kept = given(str(args.out))
    options.make_folder(folder)
    if kept != args.out:  # the kept flights of an installed copy, or of a checkout elsewhere
        shutil.copytree(kept / NAME, folder, dirs_exist_ok=True)
    cells, missing = plan(args, folder)
    words = Console(stderr=args.json)
    if not words.is_terminal:
        words = Console(stderr=args.json, width=_PIPED_WIDTH)
    path = args.out / f"{NAME}.png"
    draws = importlib.util.find_spec("matplotlib") is not None
    with drawn(path, (15, 6.5)) if draws else nullcontext() as figure:
        if missing:
            _fly(cells, missing, args.processes or os.cpu_count() or 1, words)
        rows = _shown(args, cells)
        if draws:
            _draw(figure, rows)
    if args.json:
        for row in table.json_rows(rows):
            print(json.dumps(row, allow_nan=False))
    else:
        table.show(rows, words)
    _write(folder / "table.md", table.markdown(rows))
    table_file = folder / "table.md"
    done = (
        f"{path}, {table_file}"
        if draws
        else f"{table_file}; no picture: {how_to_install('matplotlib', 'inspect')}"
    )
    words.print(f"wrote {done}", soft_wrap=True, highlight=False, markup=False)
    return 0


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text)
    except OSError as error:
        raise ConfigError(f"--out: {path}: cannot be written: {error.strerror}") from error


def _check(args: argparse.Namespace) -> None:
    options.check_seed(args.seed)
    for key, value, most in (
        ("encounters", args.encounters, _MAX_ENCOUNTERS),
        ("crowd", args.crowd, MAX_SIDE_BY_SIDE),
    ):
        if not 1 <= value <= most:
            raise ConfigError(f"--{key}: {value} is out of range; allowed: 1 to {most}")


def plan(args: argparse.Namespace, folder: Path) -> tuple[Cells, list[tuple[tuple[str, str], Flight]]]:
    """The requested cells, and the flights that they lack, each with the key of its cell.

    Raises:
        ConfigError: a file cannot be read, or is wrong.
    """
    cells: Cells = {}
    missing = []
    for condition in args.conditions:
        for method in args.methods:
            flights = flights_of(args, condition, method)
            kept = cells[condition, method] = cell(folder, flights[0], _side_by_side(args, condition))
            missing += [((condition, method), f) for f in flights if not set(f.seeds) <= kept.rows.keys()]
    return cells, missing


def flights_of(args: argparse.Namespace, condition: str, method: str) -> list[Flight]:
    """All runs of a condition and a method.

    Raises:
        ConfigError: a file cannot be read, or is wrong.
    """
    region = scenario_file.load_region(args.region)
    channel = parameters.load(shipped(_CHANNEL))
    policy = plugin = None
    kept = METHODS[method].kept
    if kept is not None:
        policy = read_policy(scenario_file.Scenario(atmc=AtmcConfig(policy=str(shipped(kept)))))
    elif method == ATMC:
        wanted = scenario_file.Scenario(atmc=AtmcConfig(policy=str(args.policy)), region=region)
        plugin = None if names_file(wanted.atmc.policy) else wanted.atmc.policy
        try:
            policy = read_policy(wanted)
        except ConfigError as error:
            raise ConfigError(f"--policy: {error}; --methods without {ATMC} needs no policy") from error
    # Without avoidance the radio environment has no effect on the flight.
    size = 1 if method == UNAVOIDED else _side_by_side(args, condition)
    runs = seeds_of(args.seed, args.encounters, size)
    return [Flight(condition, method, seeds, region, channel, policy, plugin) for seeds in runs]


def _side_by_side(args: argparse.Namespace, condition: str) -> int:
    """Number of encounters that share one radio environment."""
    return int(args.crowd) if condition == DENSE else 1


def seeds_of(seed: int, encounters: int, size: int) -> list[tuple[int, ...]]:
    """Seeds of the encounters of each run. The last run may have more encounters than requested."""
    first = seed * _MAX_ENCOUNTERS
    return [tuple(range(first + at, first + at + size)) for at in range(0, encounters, size)]


def _shown(args: argparse.Namespace, cells: Cells) -> dict[tuple[str, str], list[Row]]:
    """The results of the requested encounters, in the order of the encounters."""
    first = args.seed * _MAX_ENCOUNTERS
    wanted = range(first, first + args.encounters)
    return {key: [cell.rows[n] for n in wanted if n in cell.rows] for key, cell in cells.items()}


# ---------------------------------------------------------------- flying


def _fly(
    cells: Cells,
    missing: Sequence[tuple[tuple[str, str], Flight]],
    processes: int,
    words: Console,
) -> None:
    """Fly with several processes. Each run is stored as soon as it is finished."""
    warm_up()
    with progress("runs", len(missing)) as advance:
        for (key, _), rows in in_parallel(_rows, missing, processes, words):
            cells[key].add(rows)
            advance()


def _rows(item: tuple[tuple[str, str], Flight]) -> list[Row]:
    return rows_of(item[1])


# ---------------------------------------------------------------- the picture


def _draw(figure: Any, cells: table.Rows) -> None:
    """Draw three panels: age of information, least separation, and share of encounters with a loss."""
    figure.suptitle(
        "Closed loop: choice of transports, age of information, separation", fontsize=16, fontweight="bold"
    )
    methods = list(dict.fromkeys(method for _, method in cells))
    conditions = list(dict.fromkeys(condition for condition, _ in cells))
    by_key = {measure.key: measure for measure in table.MEASURES}
    panels = figure.subplots(1, 3, sharey=True)
    for axes, key in zip(panels, ("age_mean_s", "separation_m", "lost_share"), strict=True):
        measure = by_key[key]
        for index, condition in enumerate(conditions):
            shift = 0.22 * (index - (len(conditions) - 1) / 2.0)
            _points(axes, cells, condition, methods, measure, shift)
        axes.set_xlabel(measure.title)
        axes.set_xlim(left=0.0)
    panels[1].axvline(SEPARATION_M, color="black", lw=1.2)
    panels[0].set_yticks(range(len(methods)), [METHODS[method].words for method in methods])
    panels[0].invert_yaxis()
    handles, labels = panels[1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(conditions), frameon=False)


def _points(
    axes: Any,
    cells: table.Rows,
    condition: str,
    methods: Sequence[str],
    measure: table.Measure,
    shift: float,
) -> None:
    """Draw the values of one condition with their intervals."""
    label: str | None = condition
    for place, method in enumerate(methods):
        rows = cells.get((condition, method))
        found = table.number(rows, measure) if rows else None
        if found is None or found.value is None:
            continue
        colour = _COLOURS[condition]
        if found.interval is not None:
            axes.plot(
                [measure.scale * value for value in found.interval], [place + shift] * 2, color=colour, lw=2.2
            )
        axes.plot([measure.scale * found.value], [place + shift], "o", color=colour, ms=6, label=label)
        label = None
