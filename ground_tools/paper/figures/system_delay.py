"""Figure "Average system-wide transmission delays for different communication methods across various airspace
densities", with all methods: the paper's learners from their stored runs, all others measured anew.

High density is the mean over squares of 100, 500 and 1,000 m, low density the mean over 3,000, 5,000 and
10,000 m, and dynamic density the mean over all six.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from ground_tools.atmc.commands.results import CONVERGENCE, Results, read
from ground_tools.channel import plot
from ground_tools.common.figure import drawn
from ground_tools.paper.delays import DENSITIES, SET, Delays
from ground_tools.paper.figures import convergence, fixed_modes
from ground_tools.paper.methods import LEARNERS, SET_POLICY, Learner, absent, learner, measured, not_measured
from ground_tools.paper.report import Comparison, Report, Statement

PUBLISHED_MS: Final = {**fixed_modes.PUBLISHED_MS, **convergence.PUBLISHED_MS}
"""Published delays, by method and density."""
PAPERS: Final = (*LEARNERS, BLE4, BLE5, WIFI_BEACON, "random")
"""Methods in the paper's figure."""
NEAR: Final = 0.1
"""Relative difference up to which two delays count as close; beyond it, one counts as significantly
higher."""
_WIDTH: Final = 0.88
"""Width of a group of bars."""
COLOURS: Final = {
    **convergence.COLOURS,
    **plot.COLOURS,
    SET: "#56b4e9",
    "random": "#b4b4b4",
    "rule": "#5a5a5a",
    "search": "#000000",
}


@dataclass(frozen=True, slots=True)
class Bar:
    """Delay of a method at one density."""

    ms: float
    error_ms: float
    """Standard error; NaN if there is none."""
    low_ms: float
    high_ms: float
    """End of the 95 % interval that begins at `low_ms`. Without an interval, both are the value itself."""


Table = dict[str, dict[str, Bar]]
"""Bars by method and density, in the order of the picture."""


def report(samples: int, seed: int, path: Path = CONVERGENCE, policy: Path = SET_POLICY) -> Report:
    """The statements and numbers of the figure.

    Args:
        samples: number of fleets in each of the six squares, for the methods that are measured anew.
        seed: seed of their draw.

    Raises:
        ConfigError: the file of results does not exist, or the policy is not one for this task.
    """
    results = read(path)
    found = measured(samples, seed, policy)
    learners = _learners(results)
    table = table_of(learners, found)
    return Report(
        title="Average system-wide transmission delays across various airspace densities, 10 aircraft",
        notes=(
            *(one.words for one in learners),
            *absent(results),
            *not_measured(found, policy),
            f"Learners: the networks at the end of the runs, {results.configurations:,} environments of each "
            "size. ±: bootstrap error over seeds; one seed gives none. Those of the best validation of each "
            "run, chosen afterwards, are a row of their own (best) and a circle in the picture.",
            f"Other methods: {samples:,} environments of each size. ±: Monte Carlo standard error.",
            "All Wi-Fi on one channel, sigma 0 dB. rate: the rate of least mean delay over all six sizes.",
        ),
        statements=tuple(statements(table)),
        comparisons=tuple(comparisons(table, learners, found)),
    )


def _learners(results: Results) -> list[Learner]:
    found = [learner(results, key) for key in LEARNERS]
    return [one for one in found if one is not None]


def table_of(learners: Sequence[Learner], found: Sequence[Delays]) -> Table:
    """The bars of all methods."""
    table: Table = {}
    for one in learners:
        table[one.key] = {
            density: Bar(ms, one.error[density], *one.interval.get(density, (ms, ms)))
            for density, ms in one.system.items()
        }
    for method in sorted(found, key=lambda method: method.key != SET):
        table[method.key] = {
            density: Bar(ms, error, ms - 1.96 * error, ms + 1.96 * error)
            for density, (ms, error) in method.system.items()
        }
    return table


def statements(table: Table) -> list[Statement]:
    """The paper's statements about the figure, without those about methods that are absent."""
    found = [
        _lowest(table, "high", "MADQN-ATMC has the lowest delay at high density"),
        _closeness(table, WIFI_BEACON, "high", "MADQN-ATMC is close to fixed Wi-Fi at high density"),
        _higher(table, ("maddpg", "iac"), 0.0, "MADDPG and IAC are slower than MADQN-ATMC at high density"),
        _higher(
            table, (BLE5, "random"), NEAR, "BLE 5 and random are much slower than MADQN-ATMC at high density"
        ),
        _closeness(table, BLE4, "low", "MADQN-ATMC is near fixed BLE 4 at low density"),
        _faster_than_wifi(table),
        _lowest(table, "low", "MADQN-ATMC has the lowest delay at low density"),
        _lowest(table, "dynamic", "MADQN-ATMC has the lowest delay at dynamic density"),
        _reduction(table, (BLE4, WIFI_BEACON, BLE5), 0.32, "at least 32 % below the best fixed mode"),
        _reduction(table, ("maddpg",), 0.19, "at least 19 % below MADDPG"),
    ]
    return [statement for statement in found if statement is not None and statement.checks]


def _lowest(table: Table, density: str, words: str) -> Statement | None:
    others = [key for key in PAPERS if key in table and key != "madqn"]
    if "madqn" not in table or not others:
        return None
    mine = table["madqn"][density].ms
    least = min(others, key=lambda key: table[key][density].ms)
    return Statement(
        words,
        f"{mine:,.0f} ms; the best other is {least} with {table[least][density].ms:,.0f} ms",
        {f"against {key}": mine < table[key][density].ms for key in others},
    )


def _closeness(table: Table, key: str, density: str, words: str) -> Statement | None:
    if not {"madqn", key} <= table.keys():
        return None
    mine, other = table["madqn"][density].ms, table[key][density].ms
    return Statement(
        words,
        f"{mine:,.0f} against {other:,.0f} ms, {mine / other - 1.0:+.1%}",
        {density: abs(mine / other - 1.0) <= NEAR},
    )


def _higher(table: Table, keys: Sequence[str], by: float, words: str) -> Statement | None:
    if "madqn" not in table:
        return None
    mine = table["madqn"]["high"].ms
    there = {key: table[key]["high"].ms for key in keys if key in table}
    return Statement(words, _listed(there), {key: ms > (1.0 + by) * mine for key, ms in there.items()})


def _faster_than_wifi(table: Table) -> Statement | None:
    if WIFI_BEACON not in table:
        return None
    limit = table[WIFI_BEACON]["low"].ms
    there = {str(key): table[key]["low"].ms for key in ("maddpg", "iac") if key in table}
    return Statement(
        "MADDPG and IAC are faster than fixed Wi-Fi at low density",
        f"{_listed(there)}; Wi-Fi {limit:,.0f} ms",
        {key: ms < limit for key, ms in there.items()},
    )


def _reduction(table: Table, keys: Sequence[str], least: float, words: str) -> Statement | None:
    there = {key: table[key]["dynamic"].ms for key in keys if key in table}
    if "madqn" not in table or not there:
        return None
    key = min(there, key=lambda key: there[key])
    below = 1.0 - table["madqn"]["dynamic"].ms / there[key]
    return Statement(
        f"MADQN-ATMC, dynamic: {words}",
        f"{below:.1%} below {key}, {there[key]:,.0f} ms",
        {key: below >= least},
    )


def _listed(values: dict[str, float]) -> str:
    return ", ".join(f"{key} {ms:,.0f}" for key, ms in values.items()) + " ms"


def comparisons(table: Table, learners: Sequence[Learner], found: Sequence[Delays]) -> list[Comparison]:
    """Our numbers for all methods and densities, next to the published ones if there are any."""
    names: dict[str, tuple[str, int | str, int | None]] = {
        **{one.key: (one.name, "-", one.seeds) for one in learners},
        **{method.key: (method.name, method.rate, None) for method in found},
    }
    best = {one.key: one for one in learners}
    rows = []
    for key, bars in table.items():
        name, rate, seeds = names[key]
        for density, bar in bars.items():
            labels: dict[str, str | float] = {
                "mode": key,
                "wifi_channels": "shared",
                "rate": rate,
                "sigma_db": 0.0,
                "density": density,
            }
            if seeds is not None:
                labels["seeds"] = seeds
                if seeds > 1:
                    labels |= {"low_ms": bar.low_ms, "high_ms": bar.high_ms}
            rows.append(Comparison(name, labels, bar.ms, bar.error_ms, PUBLISHED_MS.get((key, density))))
            if key in best:
                labels = {k: v for k, v in labels.items() if k not in ("low_ms", "high_ms")}
                chosen = best[key].best[density]
                rows.append(
                    Comparison(f"{name}, best", {**labels, "networks": "best"}, chosen, math.nan, None)
                )
    return rows


def draw(samples: int, seed: int, path: Path, source: Path = CONVERGENCE, policy: Path = SET_POLICY) -> None:
    """Draw a group of bars for each density, with a line for each number that the paper gives.

    Raises:
        ConfigError: `path` cannot be written, matplotlib is missing, the file of results does not exist, or
            the policy is not one for this task.
    """
    with drawn(path, (14, 7)) as figure:
        results = read(source)
        learners, found = _learners(results), measured(samples, seed, policy)
        table = table_of(learners, found)
        names = {one.key: f"{one.name} ({one.seeds} seed{'s' * (one.seeds > 1)})" for one in learners}
        names |= {method.key: method.name for method in found}
        axes = figure.subplots()
        figure.suptitle("System delay; thin lines: 95 % intervals", fontsize=16, fontweight="bold")
        for index, (key, bars) in enumerate(table.items()):
            _bars(axes, index, len(table), key, names[key], list(bars.values()))
            for one in learners:
                if one.key == key:
                    places = _places(index, len(table), len(one.best))
                    axes.plot(places, list(one.best.values()), "o", ms=5, mfc="none", mec="black", mew=1.2)
        axes.plot([], [], color="black", lw=2.5, label="published")
        axes.plot([], [], "o", ms=5, mfc="none", mec="black", mew=1.2, label="best validation")
        axes.set_xticks(range(len(DENSITIES)), [f"{density} density" for density in DENSITIES])
        axes.set_yscale("log")
        axes.set_ylabel("system delay (ms, log scale)")
        axes.grid(visible=False, axis="x")
        missing = [*absent(results), *not_measured(found, policy)]
        if missing:
            axes.set_title("\n".join(missing), fontsize=10, fontweight="normal")
        figure.legend(loc="outside lower center", ncols=5, frameon=False)


def _places(index: int, number: int, groups: int) -> list[float]:
    """Positions of a method's bars, one in each group of `number` bars."""
    return [group + (index - (number - 1) / 2.0) * _WIDTH / number for group in range(groups)]


def _bars(axes: Any, index: int, number: int, key: str, name: str, bars: Sequence[Bar]) -> None:
    """Draw the bars of one method over all densities."""
    width, places = _WIDTH / number, _places(index, number, len(bars))
    axes.bar(
        places,
        [bar.ms for bar in bars],
        0.9 * width,
        yerr=[[bar.ms - bar.low_ms for bar in bars], [bar.high_ms - bar.ms for bar in bars]],
        color=COLOURS[key],
        label=name,
    )
    for place, density in zip(places, DENSITIES, strict=True):
        published = PUBLISHED_MS.get((key, density), math.nan)
        axes.plot([place - width / 2, place + width / 2], [published] * 2, color="black", lw=2.5)
