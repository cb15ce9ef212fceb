"""`ground-tools atmc train`: one training run per seed, in parallel, with progress on the terminal."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import queue
import re
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import msgspec
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from companion.errors import ConfigError
from companion.toml_reader import decode_toml
from ground_tools.atmc.env.torch_setup import needs_torch
from ground_tools.atmc.learners.algorithms import ALGORITHMS
from ground_tools.channel.options import check_seed

if TYPE_CHECKING:
    from ground_tools.atmc.learners.training import Job

_WAIT_S = 0.5
_MAX_SEEDS = 1000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools atmc train`."""
    lines = [f"  {name:14s} {algorithm.words}" for name, algorithm in ALGORITHMS.items()]
    parser.description = (
        "Train a policy. Each seed gets a run folder with metrics, a checkpoint for --resume, and\n"
        "policy.safetensors, the policy with the best result on a fixed validation set.\n\n"
        "algorithms:\n" + "\n".join(lines)
    )
    parser.epilog = (
        "examples:\n  ground-tools atmc train --algorithm madqn --seeds 1-5\n"
        "  ground-tools atmc train --resume runs/atmc/20260101T000000Z-madqn-seed1"
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--algorithm", choices=list(ALGORITHMS), metavar="NAME", help="one of the algorithms above"
    )
    what.add_argument("--resume", type=Path, metavar="FOLDER", help="continue an earlier run")
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="settings as TOML (default: the algorithm's own); config.toml of a run folder lists them all",
    )
    parser.add_argument(
        "--episodes", type=int, metavar="N", help="number of episodes (default: that of the settings)"
    )
    seeds = parser.add_mutually_exclusive_group()
    seeds.add_argument("--seed", type=int, metavar="S", help="seed of all random draws (default: 1)")
    seeds.add_argument("--seeds", metavar="A-B", help="one run for each seed from A to B")
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="runs at the same time (default: one per processor)"
    )
    parser.add_argument(
        "--device",
        choices=("cpu", "cuda"),
        help="device for PyTorch (default: cpu, or that of the resumed run)",
    )
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help="parent of the run folders (default: runs/atmc)"
    )


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools atmc train`. Returns 0 on success, 130 after Ctrl-C, another code if a run failed.

    Raises:
        ConfigError: An option or the configuration is wrong, or PyTorch is missing.
    """
    with needs_torch():
        from ground_tools.atmc.learners import training
    if args.device is not None:
        training.device_of(args.device)
    if args.resume is not None:
        _refuse_with_resume(args)
        jobs = [training.resumed_job(args.resume, args.device, _episodes(args))]
    else:
        seeds = _seeds(args.seed, args.seeds)
        at_once = _jobs(args.jobs, len(seeds))
        settings = _settings(args)
        root = args.out or Path("runs/atmc")
        jobs = [
            training.new_job(args.algorithm, settings, seed, args.device or "cpu", root) for seed in seeds
        ]
    if len(jobs) == 1:
        with _display(jobs) as display:
            whole = training.train(jobs[0], lambda *now: display.show(0, *now))
        code = 0 if whole else 130
    else:
        code = _side_by_side(jobs, at_once)
    for job in jobs:
        print(job.folder)
    if code == 130 and any((job.folder / "checkpoint.pt").exists() for job in jobs):
        print("stopped; to continue a run: --resume FOLDER", file=sys.stderr)
    return code


# ------------------------------------------------------------ options


def _settings(args: argparse.Namespace) -> msgspec.Struct:
    """The algorithm's settings, from the configuration file if one is given."""
    default = ALGORITHMS[args.algorithm].parts().settings
    settings = default if args.config is None else decode_toml(args.config, type(default))
    episodes = _episodes(args)
    return settings if episodes is None else msgspec.structs.replace(settings, episodes=episodes)


def _episodes(args: argparse.Namespace) -> int | None:
    if args.episodes is not None and args.episodes < 1:
        raise ConfigError(f"--episodes: {args.episodes} is out of range; allowed: 1 or more")
    episodes: int | None = args.episodes
    return episodes


def _refuse_with_resume(args: argparse.Namespace) -> None:
    for option in ("config", "seed", "seeds", "jobs", "out"):
        if getattr(args, option) is not None:
            raise ConfigError(
                f"--{option} cannot be combined with --resume, which takes it from the run folder"
            )


def _seeds(seed: int | None, seeds: str | None) -> Sequence[int]:
    if seeds is not None:
        return seed_range(seeds)
    seed = 1 if seed is None else seed
    check_seed(seed)
    return [seed]


def seed_range(text: str, option: str = "--seeds") -> range:
    """The seeds of an option such as `--seeds 1-5`.

    Args:
        option: name of the option, for the error.

    Raises:
        ConfigError: the text is not a rising range of at most 1,000 seeds.
    """
    span = re.fullmatch(r"([0-9]{1,9})-([0-9]{1,9})", text)
    if span is None or not 0 <= int(span[2]) - int(span[1]) < _MAX_SEEDS:
        raise ConfigError(
            f"{option}: {text} is not allowed; "
            f"allowed: a rising range of at most {_MAX_SEEDS:,} seeds, such as 1-5"
        )
    return range(int(span[1]), int(span[2]) + 1)


def _jobs(given: int | None, runs: int) -> int:
    if given is not None and given < 1:
        raise ConfigError(f"--jobs: {given} is out of range; allowed: 1 or more")
    return min(given or os.cpu_count() or 1, runs)


# ------------------------------------------------------------ many runs


class _Sink(Protocol):
    def put(self, item: Any) -> None: ...


def _worker(job: Job, index: int, sink: _Sink) -> None:
    """Run one job in a separate process."""
    from ground_tools.atmc.learners import training

    try:
        whole = training.train(job, lambda *now: sink.put((index, now)))
    except ConfigError as error:
        sink.put((index, str(error)))
        sys.exit(2)
    except KeyboardInterrupt:  # Ctrl-C before training began
        sys.exit(130)
    sys.exit(0 if whole else 130)


def _side_by_side(jobs: Sequence[Job], at_once: int) -> int:
    """Run all jobs, `at_once` of them at a time. Returns the exit code."""
    context = multiprocessing.get_context("spawn")
    sink: Any = context.Queue()
    waiting = [context.Process(target=_worker, args=(job, i, sink)) for i, job in enumerate(jobs)]
    running: list[Any] = []
    codes: list[int] = []
    stopped = False
    with _display(jobs) as display, _sigterm_as_ctrl_c():
        while running or (waiting and not stopped):
            try:
                while waiting and not stopped and len(running) < at_once:
                    process = waiting.pop(0)
                    process.start()
                    running.append(process)
                _drain(sink, display)
            except KeyboardInterrupt:
                # On a terminal the workers have received Ctrl-C too; SIGTERM in addition does no harm.
                stopped = True
                for process in running:
                    process.terminate()
            codes += [process.exitcode for process in running if process.exitcode is not None]
            running = [process for process in running if process.exitcode is None]
    if stopped or 130 in codes:
        return 130
    return max((code if code >= 0 else 1 for code in codes), default=0)


@contextmanager
def _sigterm_as_ctrl_c() -> Iterator[None]:
    """Handle SIGTERM like Ctrl-C. A parent that simply ended would leave its runs behind."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _drain(sink: Any, display: _Display) -> None:
    """Show all messages until none arrives for `_WAIT_S`."""
    try:
        while True:
            index, now = sink.get(timeout=_WAIT_S)
            if isinstance(now, str):
                print(f"ground-tools: {now}", file=sys.stderr)
            else:
                display.show(index, *now)
    except queue.Empty:
        pass


# ------------------------------------------------------------ the terminal


class _Display:
    """A progress line for each run: rounds, delay, best validation, time left."""

    def __init__(self, progress: Progress, jobs: Sequence[Job]) -> None:
        self._progress = progress
        self._best: dict[int, float] = {}
        self._tasks: list[TaskID] = [
            progress.add_task(f"{job.algorithm}, seed {job.seed}", total=None, figures="") for job in jobs
        ]

    def show(self, index: int, done: int, rounds: int, row: Mapping[str, float | None]) -> None:
        """Show a finished round of a run."""
        words = []
        if (delay := row.get("delay_ms")) is not None:
            words.append(f"delay {delay:,.0f} ms")
        if (score := row.get("validation_score")) is not None:
            self._best[index] = min(score, self._best.get(index, score))
            words.append(f"validation {score:,.0f}")
        if index in self._best:
            words.append(f"best {self._best[index]:,.0f}")
        self._progress.update(self._tasks[index], completed=done, total=rounds, figures=", ".join(words))


@contextmanager
def _display(jobs: Sequence[Job]) -> Iterator[_Display]:
    """Show progress on stderr, only if it is a terminal."""
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TextColumn("{task.fields[figures]}"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=not sys.stderr.isatty(),
        redirect_stdout=False,
        redirect_stderr=False,
    )
    with progress:
        yield _Display(progress, jobs)
