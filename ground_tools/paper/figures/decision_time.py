"""The paper's "average protocol switching time" of 3.84 ms: the time of one decision aboard, computed with
NumPy.

The time is measured for every policy file in the repository, and for set policies also how often they change
the transports. The times are those of this machine, including the effect of other processes that run on it.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from companion.atmc.choice import Refused
from companion.atmc.observation import NEIGHBOUR_COLUMNS
from companion.atmc.policy import Policy, load
from companion.errors import ConfigError
from ground_tools.atmc.env.torch_setup import set_up_torch
from ground_tools.channel.options import UAVS
from ground_tools.common.figure import drawn
from ground_tools.paper.methods import POLICIES, has_torch
from ground_tools.paper.report import Comparison, Report, Statement

PUBLISHED_MS: Final = 3.84
NEIGHBOURS: Final = {"flat": (9,), "set": (9, 50)}
"""Numbers of neighbours for which a policy is timed, by the kind of the policy."""
_UNTIMED: Final = 20


@dataclass(frozen=True, slots=True)
class Timing:
    """Times of one policy with a given number of neighbours."""

    policy: str
    neighbours: int
    median_ms: float
    p99_ms: float
    """99th percentile of the elapsed time, including delays by other processes."""
    p99_busy_ms: float
    """99th percentile of the processor time, without such delays."""

    @property
    def name(self) -> str:
        """Display name."""
        return f"{self.policy}, {self.neighbours} neighbours"


@dataclass(frozen=True, slots=True)
class Found:
    """Results for all policy files of a folder."""

    timings: tuple[Timing, ...]
    notes: tuple[str, ...]
    """Notes about policies that could not be timed, and about switches per minute."""


def report(decisions: int, seed: int, folder: Path = POLICIES) -> Report:
    """The statements and numbers of the figure.

    Args:
        decisions: number of decisions for each policy and number of neighbours.
        seed: seed of the flights in which switches are counted.

    Raises:
        ConfigError: the folder holds no policy, or a file is not a policy.
    """
    found = timed(decisions, seed, folder)
    return Report(
        title="Time of one decision aboard (NumPy, one thread)",
        notes=(
            *found.notes,
            f"Median and 99th percentile (p99) of {decisions:,} decisions in ms, on this machine with its "
            "other load. p99 busy: processor time only. ratio: ours divided by the published average.",
            "The paper calls switches rare, without a number.",
        ),
        statements=tuple(statements(found.timings)),
        comparisons=tuple(comparisons(found.timings)),
    )


def statements(timings: Sequence[Timing]) -> list[Statement]:
    """Statements on whether decisions take at most the published average time."""
    found = []
    for words, values in (
        ("median", {t.name: t.median_ms for t in timings}),
        ("99th percentile", {t.name: t.p99_ms for t in timings}),
        ("99th percentile of processor time", {t.name: t.p99_busy_ms for t in timings}),
    ):
        if values:
            span = f"{min(values.values()):.3g} to {max(values.values()):.3g} ms"
            checks = {name: ms <= PUBLISHED_MS for name, ms in values.items()}
            found.append(Statement(f"a decision takes {PUBLISHED_MS} ms or less ({words})", span, checks))
    return found


def comparisons(timings: Sequence[Timing]) -> list[Comparison]:
    """The numbers of all policies next to the published one."""
    rows = []
    for timing in timings:
        numbers = {"median": timing.median_ms, "p99": timing.p99_ms, "p99 busy": timing.p99_busy_ms}
        for words, ms in numbers.items():
            labels: dict[str, str | float] = {
                "mode": timing.policy,
                "rate": "-",
                "sigma_db": 0.0,
                "density": "-",
                "neighbours": timing.neighbours,
                "quantity": words,
            }
            rows.append(Comparison(f"{timing.name}, {words}", labels, ms, math.nan, PUBLISHED_MS))
    return rows


def draw(decisions: int, seed: int, path: Path, folder: Path = POLICIES) -> None:
    """Draw two bars for each policy and number of neighbours.

    Raises:
        ConfigError: `path` cannot be written, matplotlib is missing, the folder holds no
            policy, or a file is not a policy.
    """
    with drawn(path, (11, 6)) as figure:
        timings = timed(decisions, seed, folder).timings
        axes = figure.subplots()
        axes.set_title("Time of one decision aboard")
        places = list(range(len(timings)))
        axes.barh([y - 0.2 for y in places], [t.median_ms for t in timings], 0.36, label="median")
        axes.barh([y + 0.2 for y in places], [t.p99_ms for t in timings], 0.36, label="99th percentile")
        axes.axvline(PUBLISHED_MS, color="black", lw=2, label=f"published average, {PUBLISHED_MS} ms")
        axes.set_yticks(places, [t.name for t in timings])
        axes.invert_yaxis()
        axes.set_xscale("log")
        axes.set_xlabel("ms, log scale")
        figure.legend(loc="outside lower center", ncols=3, frameon=False)


# ------------------------------------------------------------ numbers


@functools.lru_cache(maxsize=4)
def timed(decisions: int, seed: int, folder: Path = POLICIES) -> Found:
    """Time every policy of a folder. The result is cached, so that picture and table show the same times.

    Raises:
        ConfigError: the folder holds no policy, or a file is not a policy.
    """
    timings, notes = [], []
    paths = sorted(folder.glob("*.safetensors"))
    if not paths:
        raise ConfigError(f"{folder}: there is no policy file (*.safetensors) in it, so nothing can be timed")
    for path in paths:
        data = _bytes(path)
        policy = load(data, str(path))
        for neighbours in NEIGHBOURS[policy.metadata.kind]:
            times = times_ms(policy, neighbours, decisions)
            if isinstance(times, Refused):
                notes.append(f"{path.stem}, {neighbours} neighbours: the policy was refused, {times.text}")
                continue
            (median, p99), (_, busy) = np.percentile(times, (50, 99), axis=0).T.tolist()
            timings.append(Timing(path.stem, neighbours, median, p99, busy))
        if policy.metadata.kind == "set":
            notes.append(f"{path.stem}: {_switches(data, path, policy, seed)}")
    return Found(tuple(timings), tuple(notes))


def times_ms(policy: Policy, neighbours: int, decisions: int) -> list[tuple[float, float]] | Refused:
    """Elapsed time and processor time (ms) of each of the given number of decisions.

    The input rows are those of the policy's own golden cases, repeated up to the number of neighbours.

    Returns:
        The times, or the refusal if the policy refuses to decide.
    """
    golden = policy.metadata.golden
    own = np.array(golden[0].own)
    rows = np.array([row for case in golden for row in case.rows]).reshape(-1, len(NEIGHBOUR_COLUMNS))
    shape = (neighbours, len(NEIGHBOUR_COLUMNS))
    rows = np.resize(rows, shape) if len(rows) else np.zeros(shape)
    allowed = np.ones(len(policy.actions), bool)
    times = []
    for number in range(-_UNTIMED, decisions):
        busy, began = time.thread_time(), time.perf_counter()
        choice = policy.choose(own, rows, allowed, 0)
        took = (1e3 * (time.perf_counter() - began), 1e3 * (time.thread_time() - busy))
        if isinstance(choice, Refused):
            return choice
        if number >= 0:
            times.append(took)
    return times


def _switches(data: bytes, path: Path, policy: Policy, seed: int) -> str:
    """Text about how often an aircraft of a flying fleet changes its transports."""
    if not has_torch():
        return "switches are not counted, because torch is not installed"
    set_up_torch()
    from ground_tools.atmc.commands.evaluate import Frozen, Question, objective_of, switches_per_minute

    objective, actions = objective_of(policy.metadata.objective)
    if policy.metadata.actions != tuple(actions):
        return "switches are not counted, because its actions are not those of its objective"
    question = Question(policy.metadata.objective, uavs=min(UAVS, policy.metadata.neighbours + 1), seed=seed)
    rate = switches_per_minute(question, objective, Frozen(data, str(path)))
    return f"{rate:.2f} switches per minute and aircraft with {question.uavs} in flight, all densities"


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
