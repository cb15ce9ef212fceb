"""Figure "Convergence performance of different algorithms", and the delays that the paper gives for them.

Because training takes hours, the figure is drawn from stored results of training runs in results/atmc
(`ground-tools atmc collect`). A curve is the interquartile mean over the seeds, and its band is a 95 %
bootstrap interval; both are of means over 10 episodes. The reward (s) is the sum over the aircraft, averaged
over the steps, while the algorithm explores.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from companion.arrays import Floats
from ground_tools.atmc.commands.results import CONVERGENCE, NAMES, UAV_EVERY, Results, Run, read
from ground_tools.common.figure import drawn
from ground_tools.paper.report import Comparison, Report, Statement
from ground_tools.paper.seed_means import interquartile_mean, resampled

PUBLISHED_MS: Final = {
    ("madqn", "high"): 1855.28,
    ("madqn", "low"): 246.82,
    ("madqn", "dynamic"): 1050.46,
    ("maddpg", "dynamic"): 1302.18,
}
CONVERGED_BY: Final = {"madqn": 500, "maddpg": 800}
"""Episodes after which the algorithms have converged, as published."""
WITHIN: Final = 0.1
"""Threshold, as a fraction of the difference between first and last reward. A reward that is nearer than this
to the last one has converged. An aircraft whose reward ends farther below the aircraft's median has
failed."""
_KEYS: Final = {"high": "high_ms", "low": "low_ms", "dynamic": "delay_ms"}
COLOURS: Final = {"madqn": "#d55e00", "madqn-shared": "#5a5a5a", "maddpg": "#a06e28", "iac": "#cc79a7"}
"""Colours of the algorithms. They differ from those of the protocols, next to which other figures show
them."""
_PANELS: Final = ("madqn", "maddpg", "iac")
_END: Final = 10
"""Number of last points of a curve that are averaged for its end value: 100 episodes."""


def report(path: Path = CONVERGENCE) -> Report:
    """The statements of the figure, and our delays next to the published ones.

    Raises:
        ConfigError: the file of results does not exist.
    """
    results = read(path)
    return Report(
        title="Convergence performance of different algorithms, 10 aircraft",
        notes=(
            f"Seeds: {', '.join(f'{NAMES[a]} {len(results.of(a))}' for a in _present(results))}.",
            "Converged: the reward (mean of 10 episodes) stays nearer to the last reward than "
            f"{WITHIN:.0%} of the difference between first and last. Statements are checked for each seed.",
            "An aircraft fails if its reward ends below the fleet's median by more than that.",
            "Delays in ms: networks at the end of the run (last) and of the best validation (best), "
            "interquartile mean over seeds, ±: its bootstrap error, none for one seed; "
            f"{results.configurations:,} environments of each size. Statements are judged on the last.",
        ),
        statements=tuple(statements(results)),
        comparisons=tuple(comparisons(results)),
    )


def statements(results: Results) -> list[Statement]:
    """The paper's statements about the figure, checked for each seed."""
    found = []
    for algorithm, by in CONVERGED_BY.items():
        runs = results.of(algorithm)
        episodes = {run.seed: converged_at(run) for run in runs}
        found.append(
            Statement(
                f"{NAMES[algorithm]} converges within {by} episodes",
                f"at {_span(list(episodes.values()))}",
                {f"seed {seed}": episode <= by for seed, episode in episodes.items()},
            )
        )
    reached = [run.last["delay_ms"] for run in results.of("madqn")]
    ends = {run.seed: run.last["delay_ms"] for run in results.of("iac")}
    worst = max(reached, default=math.nan)
    found.append(
        Statement(
            "IAC does not converge to what MADQN-ATMC reaches",
            f"{_span(list(ends.values()))} ms at the end",
            {f"seed {seed}": delay > (1.0 + WITHIN) * worst for seed, delay in ends.items() if reached},
        )
    )
    for algorithm, words, wanted in (
        ("madqn", "all 10 aircraft reach the optimum", range(1)),
        ("maddpg", "two aircraft fail", range(2, 3)),
        ("iac", "most aircraft fail", range(6, 11)),
    ):
        failed = {run.seed: failures(run) for run in results.of(algorithm)}
        found.append(
            Statement(
                f"{NAMES[algorithm]}: {words}",
                f"{_span(list(failed.values()))} fail",
                {f"seed {seed}": number in wanted for seed, number in failed.items()},
            )
        )
    return [statement for statement in found if statement.checks]


def comparisons(results: Results) -> list[Comparison]:
    """Delays of every algorithm, by density, with the last networks and with those of the best validation.
    The delays with the last networks are compared with the published ones."""
    found = []
    for algorithm, networks, (density, key) in itertools.product(
        _present(results), ("last", "best"), _KEYS.items()
    ):
        last = networks == "last"
        values = np.array([[(run.last if last else run.best)[key]] for run in results.of(algorithm)])
        labels: dict[str, str | float] = {
            "mode": algorithm,
            "networks": networks,
            "wifi_channels": "shared",
            "rate": "-",
            "sigma_db": 0.0,
            "density": density,
        }
        ours, error = float(interquartile_mean(values)[0]), math.nan
        if len(values) > 1:
            error = float(resampled(values).std(0)[0])
        published = PUBLISHED_MS.get((algorithm, density)) if last else None
        found.append(Comparison(f"{NAMES[algorithm]}, {networks}", labels, ours, error, published))
    return found


def draw(path: Path, source: Path = CONVERGENCE) -> None:
    """Draw four panels: one of all algorithms, and three of the single aircraft of one algorithm each.

    Raises:
        ConfigError: `path` cannot be written, matplotlib is missing, or the file of results does not exist.
    """
    with drawn(path, (15, 10)) as figure:
        results = read(source)
        panels = figure.subplots(2, 2).ravel()
        _system(panels[0], results)
        for axes, algorithm, letter in zip(panels[1:], _PANELS, "bcd", strict=True):
            if runs := results.of(algorithm):
                _aircraft(axes, min(runs, key=lambda run: min(ms for _, ms in run.validation)), letter)
            else:
                axes.set_title(f"({letter}) {NAMES[algorithm]}: no run is kept")


def _system(axes: Any, results: Results) -> None:
    """Draw the fleet's reward for all algorithms."""
    for algorithm in _present(results):
        curves = np.array([binned(run.reward) for run in results.of(algorithm)])
        episodes = UAV_EVERY * (np.arange(curves.shape[1]) + 0.5)
        low, high = np.percentile(resampled(curves), (2.5, 97.5), axis=0)
        colour = COLOURS[algorithm]
        axes.fill_between(episodes, low, high, color=colour, alpha=0.22, lw=0)
        axes.plot(
            episodes,
            interquartile_mean(curves),
            color=colour,
            lw=1.8,
            label=f"{NAMES[algorithm]} ({len(curves)} seed{'s' * (len(curves) > 1)})",
        )
    axes.set_title("(a) fleet, interquartile mean and 95 % interval over seeds")
    axes.set_xlabel("episode")
    axes.set_ylabel("reward of a step (s)")
    axes.legend(loc="lower right", frameon=False)


def _aircraft(axes: Any, run: Run, letter: str) -> None:
    """Draw the reward of each aircraft of one run."""
    for number, values in enumerate(run.reward_uav):
        episodes = UAV_EVERY * (np.arange(len(values)) + 0.5)
        axes.plot(episodes, values, lw=1.1, color=f"C{number}", label=f"{number + 1}")
    axes.set_title(f"({letter}) aircraft of {NAMES[run.algorithm]}, seed {run.seed}")
    axes.set_xlabel("episode")
    axes.set_ylabel("reward of a step (s)")
    axes.legend(loc="lower right", frameon=False, ncols=5, fontsize=10)


# ------------------------------------------------------------ numbers


def converged_at(run: Run) -> int:
    """Episode after which the fleet's reward stays near its final value; the last episode if it does not."""
    curve = binned(run.reward)
    end = float(curve[-_END:].mean())
    far = np.abs(curve - end) > WITHIN * abs(end - curve[0])
    return UAV_EVERY * (int(np.flatnonzero(far)[-1]) + 1 if far.any() else 0)


def failures(run: Run) -> int:
    """Number of aircraft whose reward ends far below the fleet's median."""
    curves = np.array(run.reward_uav)
    ends = curves[:, -_END:].mean(1)
    way = abs(float(np.median(ends)) - float(curves[:, 0].mean()))
    return int((ends < np.median(ends) - WITHIN * way).sum())


def binned(values: Sequence[float]) -> Floats:
    """Means over `UAV_EVERY` episodes each. An incomplete group at the end is dropped."""
    whole = len(values) // UAV_EVERY * UAV_EVERY
    found: Floats = np.array(values[:whole], float).reshape(-1, UAV_EVERY).mean(1)
    return found


def _present(results: Results) -> list[str]:
    return [algorithm for algorithm in NAMES if results.of(algorithm)]


def _span(values: Sequence[float]) -> str:
    if not values:
        return "-"
    low, high = f"{min(values):,.0f}", f"{max(values):,.0f}"
    return low if low == high else f"{low} to {high}"
