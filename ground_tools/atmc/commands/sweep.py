"""`ground-tools atmc sweep`: trains each of the paper's algorithms with several settings and one budget.

Every algorithm gets as many configurations, episodes and seeds as the others. The first configuration of each
is that of `ground-tools atmc train`. The runs are lines of one file (`ground_tools.common.kept_lines`).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta
from rich import box
from rich.table import Table

from companion.errors import ConfigError
from companion.shipped import shipped
from ground_tools.atmc.commands import kept_runs
from ground_tools.atmc.commands.results import NAMES
from ground_tools.atmc.commands.train import seed_range
from ground_tools.atmc.env.torch_setup import set_up_torch
from ground_tools.common.kept_lines import Kept, read_lines
from ground_tools.common.run_options import processes_of

KEPT: Final = shipped("results/atmc/sweep.jsonl")
"""The kept runs."""
_LOG_NOW: Final[dict[str, Any]] = {"reward": "log", "discount": 0.0}
Algorithm = Literal["madqn", "maddpg", "iac"]
CONFIGURATIONS: Final[dict[Algorithm, tuple[dict[str, Any], ...]]] = {
    "madqn": (
        {},
        {"discount": 0.0},
        {"reward": "log"},
        _LOG_NOW,
        {**_LOG_NOW, "soft_update": 0.001},
        {**_LOG_NOW, "learning_rate": 1e-3},
    ),
    "maddpg": (
        {},
        {"discount": 0.95},
        {"reward": "standardised"},
        {"reward": "standardised", "discount": 0.95},
        {"first_entropy": 0.05},
        {"policy_gradient": "gumbel"},
    ),
    "iac": (
        {},
        {"discount": 0.0},
        {"reward": "log"},
        _LOG_NOW,
        {**_LOG_NOW, "entropy": 0.05},
        {**_LOG_NOW, "learning_rate": 1e-3},
    ),
}
"""Configurations of each algorithm, as differences from its default settings."""
VALIDATE_EVERY: Final = 10
"""Episodes between two validations."""
JUDGED: Final = 5
"""Number of last validations whose mean judges a run. A single one varies by several per cent."""


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One training run."""

    algorithm: Algorithm
    configuration: int
    """Index into `CONFIGURATIONS`."""
    changes: dict[str, Any]
    """Differences from the default settings."""
    seed: int
    validation: Annotated[tuple[tuple[int, float], ...], Meta(min_length=1)]
    """Episode, and system delay (ms) of the policy without exploration on the validation set."""
    cpu_s: float
    """Processor time of the run."""

    @property
    def delay_ms(self) -> float:
        """Mean of the last `JUDGED` validations, ms."""
        last = [ms for _, ms in self.validation[-JUDGED:]]
        return sum(last) / len(last)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools atmc sweep`."""
    parser.description = (
        "Train MADQN-ATMC, MADDPG and IAC with six settings each (reward, discount, entropy, rates), all\n"
        "with the same number of episodes, and print a table of their delays at the end. With --winners the\n"
        "best settings of each are trained anew with other seeds, which had no part in the choice."
    )
    parser.epilog = "example: ground-tools atmc sweep --algorithms iac --winners 1-5 --out sweep.jsonl"
    kept_runs.add_options(parser, CONFIGURATIONS, seeds="101-101", kept=KEPT)
    parser.add_argument(
        "--episodes", type=int, default=400, metavar="N",
        help=f"episodes of each run, a multiple of {VALIDATE_EVERY} (default: 400)",
    )  # fmt: skip
    parser.add_argument(
        "--winners", metavar="A-B",
        help="seeds with which the best settings of each algorithm are trained anew (default: none)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools atmc sweep`. Returns 0.

    Raises:
        ConfigError: An option is wrong, PyTorch is missing, or the file cannot be used.
    """
    seeds = seed_range(args.seeds)
    others = range(0) if args.winners is None else seed_range(args.winners, "--winners")
    if set(others) & set(seeds):
        raise ConfigError(
            f"--winners: {args.winners} has seeds of --seeds; allowed: seeds that chose nothing"
        )
    if args.episodes < VALIDATE_EVERY or args.episodes % VALIDATE_EVERY:
        raise ConfigError(
            f"--episodes: {args.episodes} is not allowed; allowed: multiples of {VALIDATE_EVERY}"
        )
    processes = processes_of(args.processes)
    set_up_torch()
    kept = Kept(args.out, {"task": "paper", "episodes": args.episodes}, Row, _number)
    everything = [(name, number) for name in args.algorithms for number in range(len(CONFIGURATIONS[name]))]
    _train_missing(kept, everything, seeds, args.episodes, processes)
    if others:
        best = [(name, winner(kept.rows.values(), name, seeds)) for name in args.algorithms]
        _train_missing(kept, best, others, args.episodes, processes)
    kept_runs.show(table(kept.rows.values()), _drawn, as_json=args.json)
    return 0


def _train_missing(
    kept: Kept[Row],
    configurations: Iterable[tuple[Algorithm, int]],
    seeds: range,
    episodes: int,
    processes: int,
) -> None:
    """Train each configuration with each seed, unless the file has that run."""
    wanted = {
        _key(name, number, seed): (name, number, seed, episodes)
        for seed in seeds
        for name, number in configurations
    }
    kept_runs.train_missing(kept, wanted, train, processes)


def winner(rows: Iterable[Row], algorithm: Algorithm, seeds: range) -> int:
    """Index of the configuration of an algorithm with the least mean delay at the end, over these seeds."""
    delays_ms: dict[int, list[float]] = {}
    for row in rows:
        if row.algorithm == algorithm and row.seed in seeds:
            delays_ms.setdefault(row.configuration, []).append(row.delay_ms)
    return min(delays_ms, key=lambda number: sum(delays_ms[number]) / len(delays_ms[number]))


def train(one: tuple[Algorithm, int, int, int]) -> Row:
    """Train one run.

    Args:
        one: algorithm, index of its configuration, seed, and number of episodes.
    """
    set_up_torch()
    import torch

    from ground_tools.atmc.learners.algorithms import ALGORITHMS

    algorithm, configuration, seed, episodes = one
    begun = time.process_time()
    parts = ALGORITHMS[algorithm].parts()
    changes = CONFIGURATIONS[algorithm][configuration]
    settings = msgspec.structs.replace(parts.settings, **changes)
    learner = parts.make(settings, seed, torch.device("cpu"))
    validation = []
    for episode in range(1, episodes + 1):
        learner.train()
        if episode % VALIDATE_EVERY == 0:
            validation.append((episode, round(learner.validate()["score"], 1)))
    return Row(
        algorithm=algorithm,
        configuration=configuration,
        changes=changes,
        seed=seed,
        validation=tuple(validation),
        cpu_s=round(time.process_time() - begun, 1),
    )


def sample(path: Path) -> list[str]:
    """Train the beginning of each algorithm's first run again. Returns the differences, as text.

    Raises:
        ConfigError: the file cannot be read.
    """
    firsts: dict[Algorithm, Row] = {}
    for row in read_lines(path, Row)[1]:
        firsts.setdefault(row.algorithm, row)
    if len(firsts) < len(CONFIGURATIONS):
        return ["the file lacks the runs of an algorithm"]
    found = []
    for row in firsts.values():
        again = train((row.algorithm, row.configuration, row.seed, VALIDATE_EVERY)).validation[0]
        if again != row.validation[0]:
            found.append(f"{row.algorithm}, seed {row.seed}: {row.validation[0]}, now {again}")
    return found


def table(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """The runs in the order of `CONFIGURATIONS`, each with its delay at the end (ms).

    Raises:
        ConfigError: there is no run.
    """
    found = [
        {
            "algorithm": row.algorithm,
            "changes": row.changes,
            "seed": row.seed,
            "delay_ms": round(row.delay_ms, 1),
            "cpu_s": row.cpu_s,
        }
        for row in sorted(rows, key=_number)
    ]
    if not found:
        raise ConfigError("--out: the file holds no run")
    return found


def _number(row: Row) -> int:
    return _key(row.algorithm, row.configuration, row.seed)


def _key(algorithm: Algorithm, configuration: int, seed: int) -> int:
    return (100 * list(CONFIGURATIONS).index(algorithm) + configuration) * 10**9 + seed


def _drawn(found: list[dict[str, Any]]) -> Table:
    drawn = Table(
        title=f"System delay (ms): mean of the last {JUDGED} validations",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    for index, head in enumerate(("algorithm", "settings", "seed", "delay", "CPU minutes")):
        drawn.add_column(head, justify="left" if index < 2 else "right")
    for line in found:
        changes = ", ".join(f"{name} {value}" for name, value in line["changes"].items()) or "default"
        drawn.add_row(
            NAMES[line["algorithm"]],
            changes,
            str(line["seed"]),
            f"{line['delay_ms']:,.0f}",
            f"{line['cpu_s'] / 60.0:.1f}",
        )
    return drawn
