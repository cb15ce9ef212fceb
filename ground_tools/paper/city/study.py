"""What the commands `ground-tools paper city` and `ground-tools paper city-separation` share: options, the
folder of kept runs, and their files."""

from __future__ import annotations

import argparse
import importlib.util
import shutil
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, Final

import msgspec
from rich.console import Console

from companion.errors import ConfigError
from companion.shipped import given, how_to_install
from ground_tools.channel import options
from ground_tools.city import spread
from ground_tools.city.cells import City
from ground_tools.common.figure import drawn
from ground_tools.common.kept_lines import Kept
from ground_tools.common.run_options import seeds_of
from ground_tools.paper.city import runs
from ground_tools.paper.city.grid import Grid

_MOST_AIRCRAFT: Final = 20_000
_PIPED_WIDTH: Final = 200


def add_options(parser: argparse.ArgumentParser, name: str, files: str) -> None:
    """Add the options of both commands.

    Args:
        name: name of the command, and of the default folder.
        files: what the folder holds besides the runs, for the help.
    """
    add, grid = parser.add_argument, Grid()
    seeds, folder = f"{grid.seeds[0]}-{grid.seeds[-1]}", Path("runs/paper") / name
    add("--seeds", default=seeds, metavar="FROM-TO",
        help=f"range of seeds, one run of each cell for each (default: {seeds})")  # fmt: skip
    add("--aircraft", type=int, default=grid.aircraft, metavar="N",
        help="aircraft in the air, which determine the area: a square of 2 to 20 km "
        f"(default: {grid.aircraft})")  # fmt: skip
    add("--minutes", type=float, default=grid.duration_s / 60.0, metavar="N",
        help=f"length of a run (default: {grid.duration_s / 60.0:g})")  # fmt: skip
    add("--settle", type=float, default=grid.settle_s, metavar="S",
        help=f"simulated time at which counting begins (default: {grid.settle_s:g})")  # fmt: skip
    add("--out", type=Path, default=folder, metavar="FOLDER",
        help=f"folder of runs, {files} (default: {folder})")  # fmt: skip
    spread.add_options(parser)
    add("--json", action="store_true", help="print one JSON object per line instead of tables")


def grid_of(args: argparse.Namespace, density_option: str, load_option: str, **cells: Any) -> Grid:
    """The grid that the options describe.

    Args:
        args: options of `add_options`.
        density_option, load_option: names of the options that set them, for messages.
        cells: the other fields of the grid.

    Raises:
        ConfigError: an option is out of range.
    """
    grid = Grid(
        seeds=seeds_of(args.seeds),
        aircraft=args.aircraft,
        duration_s=60.0 * args.minutes,
        settle_s=args.settle,
        **cells,
    )
    for density in grid.densities:
        if not 0.0 < density <= 200.0:
            raise ConfigError(f"{density_option}: {density:g} is out of range; allowed: above 0, up to 200")
    for load in grid.loads:
        if not 0.0 <= load < 1.0:
            raise ConfigError(f"{load_option}: {load:g} is out of range; allowed: at least 0, below 1")
    if not 2 <= grid.aircraft <= _MOST_AIRCRAFT:
        raise ConfigError(f"--aircraft: {grid.aircraft} is out of range; allowed: 2 to {_MOST_AIRCRAFT:,}")
    if not 10.0 <= grid.duration_s <= 86_400.0:
        raise ConfigError(f"--minutes: {args.minutes:g} is out of range; allowed: 1/6 to 1440")
    if not 0.0 <= grid.settle_s < grid.duration_s:
        raise ConfigError(
            f"--settle: {grid.settle_s:g} is out of range; allowed: at least 0, below the run's length"
        )
    try:
        for cell in grid.cells():
            msgspec.convert(msgspec.to_builtins(grid.city(cell)), City)
    except msgspec.ValidationError as error:
        raise ConfigError(f"the options are not allowed: {error}") from error
    return grid


def console_of(args: argparse.Namespace) -> Console:
    """Console for all that is no JSON. Without a terminal its lines are wide enough for the tables."""
    words = Console(stderr=args.json)
    return words if words.is_terminal else Console(stderr=args.json, width=_PIPED_WIDTH)


def opened(out: Path) -> Kept[runs.Run]:
    """The runs in a folder, which is made if it is missing.

    Raises:
        ConfigError: a file or the folder cannot be read or made.
    """
    ours = given(str(out))
    options.make_folder(out)
    if ours != out:  # the runs that are part of an installed copy, or of another checkout
        shutil.copytree(ours, out, dirs_exist_ok=True)
    return runs.kept(out)


def figure(path: Path, size_in: tuple[float, float]) -> AbstractContextManager[Any]:
    """An empty figure that is written to a file at the end; None without matplotlib. It is opened before the
    flights, so that a path that cannot be written is reported before hours of work."""
    return nullcontext() if importlib.util.find_spec("matplotlib") is None else drawn(path, size_in, dpi=80)


def fly(
    file: Kept[runs.Run], missing: list[runs.Work], args: argparse.Namespace, words: Console, command: str
) -> None:
    """Print the expected cost of the missing runs, and fly them.

    Args:
        args: options of `add_options`.
        command: the command without `--out`, for the record.

    Raises:
        ConfigError: an option is wrong, or a file cannot be written.
    """
    if missing:
        words.print(runs.estimate(missing, spread.jobs_of(args)), highlight=False, soft_wrap=True)
        runs.fly_missing(file, missing, args, words, f"{command} --out {args.out}")


def write(path: Path, text: str) -> Path:
    """Write one file. Returns its path.

    Raises:
        ConfigError: it cannot be written.
    """
    try:
        path.write_text(text)
    except OSError as error:
        raise ConfigError(f"--out: {path}: cannot be written: {error.strerror}") from error
    return path


def tell_files(words: Console, made: list[Path], picture: Path) -> None:
    """Print which files were written, and why there is no picture if there is none."""
    draws = importlib.util.find_spec("matplotlib") is not None
    paths = ", ".join(map(str, [*made, *([picture] if draws else [])]))
    words.print(f"wrote {paths}", soft_wrap=True, highlight=False, markup=False)
    if not draws:
        words.print(f"no picture: {how_to_install('matplotlib', 'inspect')}", soft_wrap=True, markup=False)
