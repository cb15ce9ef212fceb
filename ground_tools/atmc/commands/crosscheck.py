"""`ground-tools atmc crosscheck`: trains learners of another library on the paper's task, and compares them.

The runs are lines of one file (`ground_tools.common.kept_lines`). The table puts them beside this project's
learners, whose curves come from the kept training runs.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterable, Sequence
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta
from rich import box
from rich.table import Table

from companion.errors import ConfigError
from companion.shipped import how_to_install, shipped
from ground_tools.atmc.commands import collect, kept_runs, results
from ground_tools.atmc.commands.train import seed_range
from ground_tools.atmc.env.torch_setup import needs_torch
from ground_tools.common.kept_lines import Kept, read_lines
from ground_tools.common.provenance import CannotSampleError
from ground_tools.common.run_options import processes_of

KEPT: Final = shipped("results/atmc/crosscheck.jsonl")
"""The kept runs."""
Learner = Literal["iql", "ippo", "masac"]
NAMES: Final[dict[Learner, str]] = {"iql": "IQL", "ippo": "IPPO", "masac": "MASAC"}
"""Display names of the library's learners."""
_LIBRARY: Final = ("benchmarl", "torchrl", "tensordict", "torch")
_PAPER_SHARE: Final = 0.68
"""The paper's learner has 32 % less delay than the best fixed mode."""
_STEPS_PER_EPISODE: Final = 100
_BETWEEN: Final = 2000
_AIRCRAFT: Final = 10


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One training run."""

    algorithm: Learner
    seed: int
    curve: Annotated[tuple[tuple[int, float], ...], Meta(min_length=1)]
    """Steps of the fleet so far, and system delay (ms) on the validation set."""
    last: dict[str, float]
    """Delays (ms) of the last policy on new environments; see `paper_task.measure`."""
    cpu_s: float
    """Processor time of the run."""
    library: str
    """The library's packages and their versions."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools atmc crosscheck`."""
    parser.description = (
        "Train IQL, IPPO and MASAC of the library BenchMARL on the paper's task, with the library's default\n"
        "settings, and print a table of them beside the learners of this project. Needs the extra crosscheck."
    )
    parser.epilog = "example: ground-tools atmc crosscheck --seeds 1-3 --out crosscheck.jsonl"
    kept_runs.add_options(parser, NAMES, seeds="1-3", kept=KEPT)
    parser.add_argument(
        "--steps", type=int, default=60_000, metavar="N",
        help=f"steps of the fleet to learn from, a multiple of {_BETWEEN} (default: 60000)",
    )  # fmt: skip


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools atmc crosscheck`. Returns 0.

    Raises:
        ConfigError: An option is wrong, the library is missing, or the file cannot be used.
    """
    seeds = seed_range(args.seeds)
    if args.steps < _BETWEEN or args.steps % _BETWEEN:
        raise ConfigError(f"--steps: {args.steps} is not allowed; allowed: multiples of {_BETWEEN}")
    processes = processes_of(args.processes)
    kept = Kept(args.out, {"task": "paper", "steps": args.steps}, Row, _number)
    wanted = {_key(name, seed): (name, seed, args.steps) for seed in seeds for name in args.algorithms}
    if not wanted.keys() <= kept.rows.keys():
        _needs_library()
    kept_runs.train_missing(kept, wanted, train, processes)
    kept_runs.show(table(kept.rows.values()), _drawn, as_json=args.json)
    return 0


def train(one: tuple[Learner, int, int]) -> Row:
    """Train one run and measure its last policy.

    Args:
        one: algorithm, seed, and steps of the fleet.
    """
    algorithm, seed, steps = one
    begun = time.process_time()
    learned = _outside().train(algorithm, seed, steps)
    last = collect.measured(learned.choose, _AIRCRAFT, 10_000)
    return Row(
        algorithm=algorithm,
        seed=seed,
        curve=learned.curve,
        last={key: round(value, 1) for key, value in last.delays_ms.items()},
        cpu_s=round(time.process_time() - begun, 1),
        library=", ".join(f"{name} {metadata.version(name)}" for name in _LIBRARY),
    )


def table(rows: Iterable[Row]) -> dict[str, Any]:
    """Compare runs with this project's kept ones.

    Returns:
        "best_fixed_ms": system delay of the best fixed mode on the validation set; "lines": for each learner
        its name, and for each seed the steps at which it first was 32 % below ("first"; None if never), the
        delay (ms) on the validation set at the runs' common budget ("at_budget_ms"), and that of the last
        policy on new environments ("last_ms"); "steps": the common budget.
    """
    rows = sorted(rows, key=_number)
    if not rows:
        raise ConfigError("--out: the file holds no run")
    steps = min(row.curve[-1][0] for row in rows)
    best_ms = best_fixed_ms()
    curves = [(NAMES[row.algorithm], row.seed, row.curve, row.last["delay_ms"]) for row in rows]
    for own in results.read().runs:
        curve = tuple((_STEPS_PER_EPISODE * episode, ms) for episode, ms in own.validation)
        curves.append((results.NAMES[own.algorithm], own.seed, curve, own.last["delay_ms"]))
    lines: dict[str, dict[str, Any]] = {}
    for name, seed, curve, last_ms in curves:
        line = lines.setdefault(
            name, {"name": name, "seeds": [], "first": [], "at_budget_ms": [], "last_ms": []}
        )
        line["seeds"].append(seed)
        line["first"].append(next((at for at, ms in curve if ms <= _PAPER_SHARE * best_ms), None))
        line["at_budget_ms"].append([ms for at, ms in curve if at <= steps][-1])
        line["last_ms"].append(last_ms)
    return {"best_fixed_ms": round(best_ms, 1), "steps": steps, "lines": list(lines.values())}


def best_fixed_ms() -> float:
    """System delay (ms) of the best fixed mode on the validation set."""
    with needs_torch():
        import torch
    from ground_tools.atmc.env.paper_task import PaperTask, TaskSettings

    task = PaperTask(TaskSettings(), torch.Generator().manual_seed(1))

    def all_take(action: int) -> float:
        return task.validate(lambda seen: torch.full(seen.shape[:-1], action))["score"]

    return min(map(all_take, range(len(task.actions))))


def sample(path: Path) -> list[str]:
    """Train the beginning of the first run of each learner again. Returns the differences, as text.

    Raises:
        ConfigError: The file cannot be read.
        CannotSampleError: The library is not installed.
    """
    _, rows = read_lines(path, Row)
    if not rows:
        return ["the file holds no run"]
    missing = _missing_package()
    if missing is not None:
        raise CannotSampleError(f"{missing} is not installed")
    firsts: dict[str, Row] = {}
    for row in rows:
        firsts.setdefault(row.algorithm, row)
    found = []
    for algorithm, row in firsts.items():
        again = _outside().train(algorithm, row.seed, row.curve[-1][0], until=_BETWEEN).curve[0]
        if again != row.curve[0]:
            found.append(f"{algorithm}, seed {row.seed}: {row.curve[0]}, now {again}")
    return found


def _number(row: Row) -> int:
    return _key(row.algorithm, row.seed)


def _key(algorithm: Learner, seed: int) -> int:
    return 1000 * list(NAMES).index(algorithm) + seed


def _outside() -> ModuleType:
    """The module that needs the library."""
    # The library sets PyTorch's number of threads to that of OpenMP. Two threads are slower than one.
    os.environ["OMP_NUM_THREADS"] = "1"
    from ground_tools.atmc.learners import outside

    return outside


def _missing_package() -> str | None:
    """A package of the library that is not installed; None if all are."""
    for package in _LIBRARY:
        try:
            metadata.version(package)
        except metadata.PackageNotFoundError:
            return package
    return None


def _needs_library() -> None:
    package = _missing_package()
    if package is not None:
        raise ConfigError(how_to_install(package, "crosscheck"))


def _drawn(found: dict[str, Any]) -> Table:
    table = Table(
        title=f"System delay; the best fixed mode has {found['best_fixed_ms']:,.0f} ms",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
    )
    steps = f"at {found['steps']:,} steps"
    for index, head in enumerate(
        ("learner", "seeds", "steps to 32 % below", f"{steps} (ms)", "at its end (ms)")
    ):
        table.add_column(head, justify="right" if index else "left")
    for line in found["lines"]:
        first = ", ".join("never" if at is None else f"{at:,}" for at in line["first"])
        table.add_row(
            line["name"],
            str(len(line["seeds"])),
            first,
            _spread(line["at_budget_ms"]),
            _spread(line["last_ms"]),
        )
    return table


def _spread(values: Sequence[float]) -> str:
    return f"{sum(values) / len(values):,.0f} ({min(values):,.0f} to {max(values):,.0f})"
