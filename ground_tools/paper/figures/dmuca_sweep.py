"""`ground-tools paper dmuca --sweep`: finds readings of the paper that reproduce its figure of separations.

The paper draws one flight for each delay: no pair below 10 m at [0, 1] s, two at [1, 2] s, six at [2, 3] s.
It names neither the paths nor the parameters of its law. The sweep flies many values of both, without
navigation errors. For each it determines whether the mean number of pairs below 10 m grows with the delay,
and how often one encounter has 0, 2 and 6 such pairs.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, get_args

import msgspec
import numpy as np
from rich.console import Console

from companion.config import AvoidanceConfig
from ground_tools.campaign.cells import SEPARATION_M
from ground_tools.common import sources
from ground_tools.common.figure import drawn
from ground_tools.common.intervals import Z, wilson
from ground_tools.common.kept_lines import Kept
from ground_tools.common.progress import progress
from ground_tools.common.workers import in_parallel
from ground_tools.paper.figures.dmuca_flights import DELAYS_S, IN, MOST_FLIGHTS, flown
from ground_tools.paper.report import Numbers, Report, Statement, Value
from sitl_mocks.encounters.scenario import Kind

NAME: Final = "dmuca-sweep"
PERIODS_S: Final = (0.1, 0.2, 0.5, 1.0)
HORIZONS_S: Final = (5.0, 10.0, 20.0, 30.0)
CYCLES: Final = (10, 75)
RECOVERIES_S: Final = (1.0, 10.0)
PUBLISHED: Final = (0, 2, 6)
"""Pairs below 10 m in the paper's flight at each of `DELAYS_S`."""
_MODULE: Final = "ground_tools.paper.figures.dmuca_flights"
"""Module whose code, including its imports, makes the rows."""
_COLOURS: Final = {"grows": "#2a78d6", "mean": "#a8c8ee", "not": "#e6e6e6"}


class Reading(msgspec.Struct, frozen=True, kw_only=True):
    """One choice of what the paper leaves open."""

    geometry: Kind
    """Set of paths (`sitl_mocks.encounters.scenario`)."""
    period_s: float
    """T_ORCA, the period of decisions."""
    horizon_s: float
    """tau, the time horizon."""
    cycles: int
    """n_noncollide, the number of decisions without conflict before the recovery."""
    recovery_s: float
    """T, the recovery time."""

    @property
    def avoidance(self) -> AvoidanceConfig:
        """The paper's law with these parameters."""
        return AvoidanceConfig(
            law="paper",
            period_s=self.period_s,
            horizon_s=self.horizon_s,
            n_noncollide=self.cycles,
            recovery_time_s=self.recovery_s,
        )


READINGS: Final = tuple(
    Reading(geometry=geometry, period_s=period, horizon_s=horizon, cycles=cycles, recovery_s=recovery)
    for geometry, cycles, recovery, period, horizon in itertools.product(
        get_args(Kind), CYCLES, RECOVERIES_S, PERIODS_S, HORIZONS_S
    )
)
"""All readings that are flown."""


class Row(msgspec.Struct, frozen=True):
    """All flights of a reading."""

    number: int
    """Index in `READINGS`."""
    below: tuple[tuple[int, ...], ...]
    """Numbers of pairs below 10 m: for each delay, one number for each flight in the order of seeds."""
    least_m: tuple[float, ...]
    """Least separation of all flights of each delay."""

    @property
    def means(self) -> tuple[float, ...]:
        """Mean number of pairs below 10 m, for each delay."""
        return tuple(float(np.mean(counts)) for counts in self.below)

    @property
    def intervals(self) -> tuple[tuple[float, float], ...]:
        """95 % interval of each mean (normal approximation)."""
        halves = [Z * float(np.std(counts, ddof=1)) / math.sqrt(len(counts)) for counts in self.below]
        return tuple((mean - half, mean + half) for mean, half in zip(self.means, halves, strict=True))

    @property
    def trend(self) -> str:
        """ "grows": each mean is above the one before, and their intervals do not overlap. "mean": only the
        means grow. "not": neither."""
        if all(after[0] > before[1] for before, after in itertools.pairwise(self.intervals)):
            return "grows"
        return "mean" if all(b > a for a, b in itertools.pairwise(self.means)) else "not"

    @property
    def as_published(self) -> int:
        """Number of encounters with exactly the published numbers of pairs at all three delays."""
        return sum(counts == PUBLISHED for counts in zip(*self.below, strict=True))

    @property
    def six(self) -> int:
        """Number of flights with six pairs below 10 m at the longest delays."""
        return sum(count == PUBLISHED[-1] for count in self.below[-1])


def row_of(number: int, flights: int, seed: int) -> Row:
    """Fly all flights of a reading.

    Args:
        flights: number for each delay, at least 2.
        seed: first of the consecutive seeds, which are the same for all delays and readings.
    """
    reading = READINGS[number]
    law, world = reading.avoidance, IN["exact"]
    least = np.array(
        [
            [flown(law, world, delay_s, one, reading.geometry)[1] for one in range(seed, seed + flights)]
            for delay_s in DELAYS_S
        ]
    )
    below = (least < SEPARATION_M).sum(axis=2)
    return Row(number, tuple(map(tuple, below.tolist())), tuple(least.min(axis=(1, 2)).tolist()))


def run(out: Path, samples: int, seed: int, processes: int, words: Console) -> tuple[Path, Report]:
    """Fly the missing readings and draw the map. Returns the picture's path and the report.

    Args:
        out: folder of the picture and of the finished readings.
        samples: flights for each reading and delay; 2 to MOST_FLIGHTS are flown.
        processes: greatest number of worker processes.
        words: console for a message about Ctrl-C.

    Raises:
        ConfigError: the kept file was made with other settings or software, or cannot be read or written, or
            matplotlib is missing.
    """
    flights = max(2, min(samples, MOST_FLIGHTS))
    made_with = {"sweep": "dmuca", "flights": flights, "seed": seed}
    kept = Kept(out / f"{NAME}.jsonl", made_with, Row, lambda row: row.number, sources.digest([_MODULE]))
    missing = [number for number in range(len(READINGS)) if number not in kept.rows]
    path = out / f"{NAME}.png"
    with drawn(path, (13.0, 11.0)) as figure:
        items = [(number, flights, seed) for number in missing]
        with progress("readings", len(items)) as advance:
            for _, row in in_parallel(_row, items, processes, words):
                kept.add([row])
                advance()
        rows = [kept.rows[number] for number in range(len(READINGS))]
        _draw(figure, rows)
    return path, report(rows, seed)


def _row(item: tuple[int, int, int]) -> Row:
    return row_of(*item)


def report(rows: Sequence[Row], seed: int) -> Report:
    """The verdict and the table of all readings.

    Args:
        rows: one for each of `READINGS`, in that order.
    """
    flights = len(rows[0].below[0])
    growing = [row for row in rows if row.trend == "grows"]
    in_mean = [row for row in rows if row.trend != "not"]
    encounters, exact = flights * len(rows), sum(row.as_published for row in rows)
    six, sixes = max(rows, key=lambda row: row.six), sum(row.six for row in rows)
    low, high = (100.0 * bound for bound in wilson(exact, encounters))
    return Report(
        title="DMUCA: readings of the paper under which more delay brings more pairs below 10 m",
        notes=(
            f"The paper's law, five aircraft, {flights} encounters for each reading and delay (seeds from "
            f"{seed} on), no navigation errors. S1 and S2: crossing points in a ball of 30 m and 8 m; S3: "
            "exactly through one point.",
            "grows: each mean is above that of the shorter delay, and their 95 % intervals do not overlap. "
            "mean: only the means grow.",
        ),
        statements=(
            Statement(
                "more pairs below 10 m with more delay",
                f"grows under {len(growing)} of {len(rows)} readings, in the mean under {len(in_mean)}",
                {_name(READINGS[row.number]): row.trend == "grows" for row in rows},
            ),
            Statement(
                "0, 2 and 6 pairs below 10 m at [0, 1], [1, 2] and [2, 3] s",
                f"{exact} of {encounters} encounters ({low:.2g} to {high:.2g} %)",
                {_name(READINGS[row.number]): row.as_published > 0 for row in rows},
            ),
            Statement(
                "six pairs below 10 m at [2, 3] s",
                f"{sixes} of {encounters} flights; most often, {six.six} of {flights}, with "
                f"{_name(READINGS[six.number])}",
                {_name(READINGS[row.number]): row.six > 0 for row in rows},
            ),
        ),
        numbers=(_table(rows),),
    )


def _table(rows: Sequence[Row]) -> Numbers:
    shown: list[dict[str, Value]] = []
    for row in rows:
        reading = READINGS[row.number]
        entry: dict[str, Value] = {
            "geometry": reading.geometry,
            "period_s": reading.period_s,
            "horizon_s": reading.horizon_s,
            "cycles": reading.cycles,
            "recovery_s": reading.recovery_s,
        }
        for name, mean, interval, least_m in zip(
            ("0_1", "1_2", "2_3"), row.means, row.intervals, row.least_m, strict=True
        ):
            entry[f"pairs_{name}"], entry[f"interval_{name}"] = mean, interval
            entry[f"least_{name}_m"] = least_m
        shown.append({**entry, "trend": row.trend, "as_published": row.as_published, "six": row.six})
    columns = {
        "geometry": "paths",
        "period_s": "T_ORCA\ns",
        "horizon_s": "tau\ns",
        "cycles": "n",
        "recovery_s": "T\ns",
        "pairs_0_1": "pairs\n[0,1]",
        "pairs_1_2": "pairs\n[1,2]",
        "pairs_2_3": "pairs\n[2,3]",
        "least_0_1_m": "least\n[0,1]",
        "least_1_2_m": "least\n[1,2]",
        "least_2_3_m": "least\n[2,3]",
        "trend": "trend",
        "as_published": "0/2/6",
        "six": "six",
    }
    title = (
        "Mean number of pairs below 10 m in a flight and least separation of all flights (m), by delay (s). "
        "0/2/6: encounters with these numbers of pairs. six: flights with six pairs at [2, 3] s."
    )
    return Numbers(title, columns, tuple(shown))


def _name(reading: Reading) -> str:
    return (
        f"{reading.geometry}, T_ORCA {reading.period_s:g} s, tau {reading.horizon_s:g} s, "
        f"n {reading.cycles}, T {reading.recovery_s:g} s"
    )


def _draw(figure: Any, rows: Sequence[Row]) -> None:
    """Draw the map: a panel for each set of paths and each n and T; in it T_ORCA against tau."""
    columns = tuple(itertools.product(CYCLES, RECOVERIES_S))
    panels = figure.subplots(len(get_args(Kind)), len(columns), sharex=True, sharey=True)
    by_reading = {READINGS[row.number]: row for row in rows}
    for line, geometry in enumerate(get_args(Kind)):
        for place, (cycles, recovery) in enumerate(columns):
            axes = panels[line, place]
            for x, period in enumerate(PERIODS_S):
                for y, horizon in enumerate(HORIZONS_S):
                    row = by_reading[
                        Reading(
                            geometry=geometry,
                            period_s=period,
                            horizon_s=horizon,
                            cycles=cycles,
                            recovery_s=recovery,
                        )
                    ]
                    axes.fill_between([x - 0.5, x + 0.5], y - 0.5, y + 0.5, color=_COLOURS[row.trend])
                    words = "\n".join(f"{mean:.2f}" for mean in row.means)
                    colour = "white" if row.trend == "grows" else "black"
                    axes.text(x, y, words, ha="center", va="center", fontsize=7, color=colour)
            axes.set_xticks(range(len(PERIODS_S)), [f"{period:g}" for period in PERIODS_S])
            axes.set_yticks(range(len(HORIZONS_S)), [f"{horizon:g}" for horizon in HORIZONS_S])
            axes.set_title(f"{geometry}, n {cycles}, T {recovery:g} s", fontsize=10)
            if line == len(get_args(Kind)) - 1:
                axes.set_xlabel("T_ORCA (s)")
            if place == 0:
                axes.set_ylabel("tau (s)")
    figure.suptitle(
        "Pairs below 10 m in a flight, at delays of [0, 1], [1, 2] and [2, 3] s (top to bottom).\n"
        "Dark blue: they grow with the delay, intervals apart. Light blue: the means grow. Grey: no growth.",
        fontsize=12,
    )
