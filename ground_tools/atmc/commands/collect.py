"""`ground-tools atmc collect`: collect the results of training runs of the paper's algorithms in one file.

The policies are measured as in the paper's section "Performance of MADQN-ATMC": positions are redrawn at
every step, all aircraft decide once at the same time, and there are squares of six sizes.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.table import Table

from companion.errors import ConfigError
from companion.shipped import CHECKOUT
from ground_tools.atmc.commands.results import CONVERGENCE, NAMES, UAV_EVERY, Results, Run, read, write
from ground_tools.atmc.env.torch_setup import set_up_torch
from ground_tools.common.progress import progress

if TYPE_CHECKING:
    from ground_tools.atmc.env.paper_task import Choose, Measured
    from ground_tools.atmc.learners.stack import Stack
    from ground_tools.atmc.learners.training import Job

_OUT = Path(CONVERGENCE.name) if CHECKOUT is None else CONVERGENCE
"""Default of --out. An installed copy writes to the working folder; its own results stay unchanged."""
FLEETS = 250
"""Fleets that are measured at the same time in each square."""
_SEED = 3_000_017
"""Seed of the measurement. No run and no validation set uses it."""
_DIGITS = 4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools atmc collect`."""
    parser.description = (
        "Measure the policies of finished training runs as the paper does. Print a table of all seeds and\n"
        "write the data for the paper's figures to one file."
    )
    parser.epilog = "example: ground-tools atmc collect runs/atmc/*-madqn-seed* --out results.json.gz"
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folder of a finished training run")
    parser.add_argument(
        "--configurations",
        type=int,
        default=10_000,
        metavar="N",
        help="random sets of positions in each of the six squares (default: 10000)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=_OUT,
        metavar="FILE",
        help=f"results file to write (default: {_OUT})",
    )
    parser.add_argument(
        "--add", action="store_true", help="add to the runs in FILE; replace those of the same seed"
    )


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools atmc collect`. Returns 0.

    Raises:
        ConfigError: A folder is not a finished run, the file cannot be written, or --add does not fit it.
    """
    if args.configurations < FLEETS or args.configurations % FLEETS:
        raise ConfigError(
            f"--configurations: {args.configurations} is not allowed; allowed: multiples of {FLEETS}"
        )
    set_up_torch()
    held = _held(args) if args.add else {}
    # Read all runs first, so that errors show before the long measurement.
    found = [_read(folder) for folder in args.runs]
    runs = []
    with progress("policies", len(found)) as advance:
        for trained in found:
            runs.append(_run(trained, args.configurations))
            advance()
    all_runs = held | {_place(run): run for run in runs}
    results = Results(
        configurations=args.configurations, runs=tuple(all_runs[key] for key in sorted(all_runs))
    )
    write(args.out, results)
    Console().print(_table(results.runs))
    print(f"wrote {args.out}")
    return 0


def _held(args: argparse.Namespace) -> dict[tuple[str, int], Run]:
    """The runs in the existing file, to which --add adds."""
    results = read(args.out)
    if results.configurations != args.configurations:
        raise ConfigError(
            f"--add: {args.out} was measured with --configurations {results.configurations}, "
            f"not {args.configurations}"
        )
    return {_place(run): run for run in results.runs}


def _place(run: Run) -> tuple[str, int]:
    return run.algorithm, run.seed


@dataclass(frozen=True, slots=True)
class _Trained:
    """The contents of a finished run's folder."""

    job: Job
    manifest: dict[str, Any]
    rows: list[dict[str, str]]
    best: Stack
    last: Stack


def _read(folder: Path) -> _Trained:
    """Read a run folder.

    Raises:
        ConfigError: It is not a finished run of one of the paper's algorithms, or it has a damaged file.
    """
    try:
        manifest = json.loads((folder / "manifest.json").read_text())
        algorithm = str(manifest["algorithm"])
        with (folder / "metrics.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{folder}: this is not the folder of a training run") from error
    if algorithm not in NAMES:
        raise ConfigError(f"{folder}: this is a run of {algorithm}; allowed: runs of {', '.join(NAMES)}")
    from ground_tools.atmc.learners.stack import thawed
    from ground_tools.atmc.learners.training import resumed_job

    job = resumed_job(folder, "cpu", None)
    if not rows or len(rows) < job.settings.episodes:
        raise ConfigError(
            f"{folder}: the run has finished {len(rows)} of {job.settings.episodes} episodes; "
            "finish it first with: ground-tools atmc train --resume"
        )
    missing = {"seconds", "reward", "delay_ms", "validation_score"} - rows[-1].keys()
    if missing:
        raise ConfigError(f"{folder}: metrics.csv: the column {min(missing)} is missing")
    path = folder / "policy.safetensors"
    try:
        best = thawed(path.read_bytes(), str(path))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    return _Trained(job, manifest, rows, best, _last(job))


def _last(job: Job) -> Stack:
    """The networks at the end of the run, from its checkpoint."""
    import torch

    from ground_tools.atmc.learners.algorithms import ALGORITHMS
    from ground_tools.atmc.learners.stack import thawed

    learner = ALGORITHMS[job.algorithm].parts().make(job.settings, job.seed, torch.device("cpu"))
    path = job.folder / "checkpoint.pt"
    try:
        learner.load(torch.load(path, weights_only=True)["learner"])
    except Exception as error:  # PyTorch raises many kinds for a damaged file.
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    return thawed(learner.frozen("last", {}), "last")


def _run(trained: _Trained, configurations: int) -> Run:
    """Measure one run."""
    job, rows = trained.job, trained.rows
    uavs = range(job.settings.task.uavs)
    best, last = (
        measured(_greedy(stack), job.settings.task.uavs, configurations)
        for stack in (trained.best, trained.last)
    )
    return Run(
        algorithm=job.algorithm,
        seed=job.seed,
        git_commit=trained.manifest["git_commit"],
        settings=_plain(job.settings),
        seconds=round(float(rows[-1]["seconds"]), 1),
        reward=_column(rows, "reward"),
        delay_ms=_column(rows, "delay_ms"),
        reward_uav=tuple(_thinned(_column(rows, f"reward_uav{n}")) for n in uavs),
        validation=tuple(
            (int(row["episode"]), _short(float(row["validation_score"])))
            for row in rows
            if row["validation_score"]
        ),
        best={key: _short(value, 6) for key, value in best.delays_ms.items()},
        last={key: _short(value, 6) for key, value in last.delays_ms.items()},
        best_delay_uav_ms=tuple(_short(value) for value in best.uav_ms),
    )


def _greedy(stack: Stack) -> Choose:
    return lambda seen: stack.of_all(seen).argmax(-1)


def measured(choose: Choose, uavs: int, configurations: int) -> Measured:
    """Measure a policy on environments that were not used in training or validation.

    Args:
        configurations: random sets of positions in each square, a multiple of `FLEETS`.
    """
    import torch

    from ground_tools.atmc.env.paper_task import measure, paper_objective

    objective = paper_objective(torch.device("cpu"))
    return measure(choose, objective, uavs, FLEETS, configurations // FLEETS, _SEED)


def _plain(settings: Any) -> dict[str, object]:
    import msgspec

    plain: dict[str, object] = msgspec.to_builtins(settings)
    return plain


def _column(rows: Sequence[dict[str, str]], key: str) -> tuple[float, ...]:
    return tuple(_short(float(row[key])) for row in rows)


def _thinned(values: Sequence[float]) -> tuple[float, ...]:
    parts = (values[at : at + UAV_EVERY] for at in range(0, len(values), UAV_EVERY))
    return tuple(_short(math.fsum(part) / len(part)) for part in parts)


def _short(value: float, digits: int = _DIGITS) -> float:
    return float(f"{value:.{digits}g}")


def _table(runs: Sequence[Run]) -> Table:
    """Table of all runs: delay of the best policy by density, delay of the last policy, and training time."""
    table = Table(
        title="System delay (ms) of the policy with the best validation; last: of the last policy (dynamic)",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    heads = ("algorithm", "seed", "high", "low", "dynamic", "last", "minutes")
    for index, head in enumerate(heads):
        table.add_column(head, justify="right" if index else "left", no_wrap=True)
    for run in runs:
        numbers = [run.best[key] for key in ("high_ms", "low_ms", "delay_ms")]
        numbers += [run.last["delay_ms"]]
        table.add_row(
            run.algorithm, str(run.seed), *(f"{x:.0f}" for x in numbers), f"{run.seconds / 60.0:.1f}"
        )
    return table
