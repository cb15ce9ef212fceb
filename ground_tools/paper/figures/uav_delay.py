"""Figure "Individual transmission delays of 10 UAVs in dynamic airspace density across different
communication methods": the learners from their stored runs, fixed modes and random choice measured anew.

If all aircraft begin alike, chance decides which of them falls behind. Statements that name aircraft are
checked as published, and the number of such aircraft is given as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from ground_tools.atmc.commands.results import CONVERGENCE, NAMES, Results, Run, read
from ground_tools.channel.options import UAVS
from ground_tools.common.figure import drawn
from ground_tools.paper.delays import Delays
from ground_tools.paper.figures.system_delay import COLOURS
from ground_tools.paper.methods import LEARNERS, SET_POLICY, best_run, measured, not_measured
from ground_tools.paper.report import Comparison, Report, Statement

AROUND: Final = 0.15
"""Largest relative difference from a published delay at which a delay counts as around it."""
MADQN_MS: Final = 100.0
"""Published delay of every aircraft with MADQN-ATMC."""
BEHIND_MS: Final = 200.0
"""Published delay of UAVs 5 and 6 with MADDPG."""
_FIXED: Final = (BLE4, BLE5, WIFI_BEACON)
_PLACES: Final = {"madqn": (1, 10), "maddpg": (5, 6), "iac": (2, 4)}


def report(samples: int, seed: int, path: Path = CONVERGENCE) -> Report:
    """The statements and numbers of the figure.

    Args:
        samples: number of fleets in each of the six squares, for the methods that are measured anew.
        seed: seed of their draw.

    Raises:
        ConfigError: the file of results does not exist.
    """
    results = read(path)
    found = _others(samples, seed)
    return Report(
        title="Individual transmission delays of 10 UAVs in dynamic airspace density",
        notes=(
            *_missing(results, found),
            "Delay of each aircraft's messages in ms, mean over all six sizes. A run gives one mean for each "
            "aircraft, so that the error is unknown.",
            f"The rows of a learner are from its run of the best validation: {_seeds(results)}.",
            f"Fixed modes at their best rates, and random: {samples:,} environments of each size.",
            f"Around: within {AROUND:.0%}. Statements on learners are checked for each seed.",
        ),
        statements=tuple(statements(results, found)),
        comparisons=tuple(comparisons(results, found)),
    )


def _others(samples: int, seed: int) -> list[Delays]:
    """Delays of the fixed modes and of random choice."""
    return [m for m in measured(samples, seed, SET_POLICY) if m.key in (*_FIXED, "random")]


def _runs(results: Results, key: str) -> list[Run]:
    return [run for run in results.of(key) if len(run.best_delay_uav_ms) == UAVS]


def _missing(results: Results, found: Sequence[Delays]) -> list[str]:
    words = [
        f"{NAMES[key]}: no run is stored, so it is not shown" for key in LEARNERS if not _runs(results, key)
    ]
    return words + ([] if found else not_measured(found))


def _seeds(results: Results) -> str:
    there = {key: runs for key in LEARNERS if (runs := _runs(results, key))}
    words = [f"{NAMES[key]} seed {best_run(runs).seed} of {len(runs)}" for key, runs in there.items()]
    return ", ".join(words) or "none is stored"


def statements(results: Results, found: Sequence[Delays]) -> list[Statement]:
    """The paper's statements about the figure, without those about methods that are absent."""
    fixed = {m.key: sum(m.uav_ms) / UAVS for m in found if m.key in _FIXED}
    least = min(fixed.values(), default=math.nan)
    madqn, maddpg, iac = (_runs(results, key) for key in LEARNERS)
    asked = [
        Statement(
            f"MADQN-ATMC: around {MADQN_MS:.0f} ms for every UAV",
            _span(madqn),
            {
                f"seed {run.seed} UAV {n}": abs(ms / MADQN_MS - 1.0) <= AROUND
                for run in madqn
                for n, ms in enumerate(run.best_delay_uav_ms, 1)
            },
        ),
        Statement(
            f"MADDPG: UAVs 5 and 6 approximately {BEHIND_MS:.0f} ms",
            "; ".join(", ".join(f"{run.best_delay_uav_ms[n - 1]:.0f}" for n in (5, 6)) for run in maddpg),
            {
                f"seed {run.seed} UAV {n}": abs(run.best_delay_uav_ms[n - 1] / BEHIND_MS - 1.0) <= AROUND
                for run in maddpg
                for n in (5, 6)
            },
        ),
        Statement(
            "MADDPG: any two UAVs are far behind",
            "; ".join(f"seed {run.seed}: {_named(behind(run))}" for run in maddpg),
            {f"seed {run.seed}": len(behind(run)) == len(_PLACES["maddpg"]) for run in maddpg},
        ),
    ]
    if fixed:
        asked += _against_fixed(madqn, iac, least)
    return [statement for statement in asked if statement.checks]


def _against_fixed(madqn: Sequence[Run], iac: Sequence[Run], least: float) -> list[Statement]:
    """Statements about the fixed modes, the best of which has a delay of `least` ms for an aircraft."""
    below = {run.seed: [n for n, ms in enumerate(run.best_delay_uav_ms, 1) if ms < least] for run in iac}
    words = "; ".join(f"seed {seed}: {_named(them)}" for seed, them in below.items())
    return [
        Statement(
            "IAC: only UAVs 2 and 4 are below the fixed protocols",
            f"{words} below {least:.0f} ms",
            {f"seed {seed}": tuple(them) == _PLACES["iac"] for seed, them in below.items()},
        ),
        Statement(
            "MADQN-ATMC: every UAV is below the fixed protocols",
            f"{_span(madqn)}; best fixed {least:.0f} ms",
            {
                f"seed {run.seed} UAV {n}": ms < least
                for run in madqn
                for n, ms in enumerate(run.best_delay_uav_ms, 1)
            },
        ),
    ]


def behind(run: Run) -> list[int]:
    """Numbers (from 1) of the aircraft that are nearer to the published 200 ms than to the 100 ms."""
    limit = (MADQN_MS + BEHIND_MS) / 2.0
    return [n for n, ms in enumerate(run.best_delay_uav_ms, 1) if ms > limit]


def comparisons(results: Results, found: Sequence[Delays]) -> list[Comparison]:
    """The delays of every aircraft with every method."""
    rows = []
    for key, name, rate, uav_ms in _table(results, found):
        for number, ms in enumerate(uav_ms, 1):
            labels: dict[str, str | float] = {
                "mode": key,
                "wifi_channels": "shared",
                "rate": rate,
                "sigma_db": 0.0,
                "density": "dynamic",
                "uav": number,
            }
            published = MADQN_MS if key == "madqn" else None
            if key == "maddpg" and number in _PLACES[key]:
                published = BEHIND_MS
            rows.append(Comparison(f"{name}, UAV {number}", labels, ms, math.nan, published))
    return rows


def _table(results: Results, found: Sequence[Delays]) -> list[tuple[str, str, int | str, tuple[float, ...]]]:
    """Key, name, rate and the aircraft's delays (ms) for all methods."""
    rows: list[tuple[str, str, int | str, tuple[float, ...]]] = []
    for key in LEARNERS:
        if runs := _runs(results, key):
            run = best_run(runs)
            rows.append((key, NAMES[key], "-", run.best_delay_uav_ms))
    return rows + [(m.key, m.name, m.rate, m.uav_ms) for m in found]


def draw(samples: int, seed: int, path: Path, source: Path = CONVERGENCE) -> None:
    """Draw a group of bars for each aircraft.

    Raises:
        ConfigError: `path` cannot be written, matplotlib is missing, or the file of results does not exist.
    """
    with drawn(path, (14, 7)) as figure:
        results, found = read(source), _others(samples, seed)
        axes = figure.subplots()
        figure.suptitle("Delay of each aircraft at dynamic density", fontsize=16, fontweight="bold")
        table = _table(results, found)
        width = 0.86 / max(1, len(table))
        for index, (key, name, _, uav_ms) in enumerate(table):
            places = [n + (index - (len(table) - 1) / 2.0) * width for n in range(1, UAVS + 1)]
            axes.bar(places, uav_ms, 0.92 * width, color=COLOURS[key], label=name)
        axes.axhline(MADQN_MS, color="black", lw=1.2, ls="--", label="published, MADQN-ATMC")
        axes.set_xticks(range(1, UAVS + 1), [f"UAV {n}" for n in range(1, UAVS + 1)])
        axes.set_yscale("log")
        axes.set_ylabel("delay (ms, log scale)")
        axes.grid(visible=False, axis="x")
        if missing := _missing(results, found):
            axes.set_title("\n".join(missing), fontsize=10, fontweight="normal")
        figure.legend(loc="outside lower center", ncols=4, frameon=False)


def _span(runs: Sequence[Run]) -> str:
    values = [ms for run in runs for ms in run.best_delay_uav_ms]
    return f"{min(values):.0f} to {max(values):.0f} ms" if values else "-"


def _named(numbers: Sequence[int]) -> str:
    if not numbers:
        return "none"
    return f"{len(numbers)} of {UAVS} (UAV {', '.join(map(str, numbers))})"
