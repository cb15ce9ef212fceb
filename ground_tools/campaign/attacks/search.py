"""Searches for the worst attack of a kind with CMA-ES (N. Hansen, "The CMA Evolution Strategy", 2016).

The search runs in the unit cube, one coordinate for each parameter of the kind, so that no attack leaves its
transmitter's physical limits. Every evaluation flies one encounter. The same scene and seed give the same
search.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, Final, Literal

import msgspec
import numpy as np

from companion.errors import ConfigError
from companion.shipped import how_to_install
from ground_tools.campaign.attacks import flight
from ground_tools.campaign.attacks.kinds import KINDS, Attack, attack_at, draw_attack
from ground_tools.campaign.attacks.outcome import Row
from ground_tools.campaign.attacks.scene import Cell
from ground_tools.common.kept_lines import Kept

Harm = Literal["separation", "held", "aside", "height", "fence"]
HARMS: Final = ("separation", "held", "aside", "height", "fence")
_FIRST_SIGMA: Final = 0.3
_ALONE_M: Final = 1000.0
"""Separation that counts for an aircraft that meets nobody."""


Flight = tuple[Cell, int, Attack]
"""Cell and seed of an encounter, and the attack that is flown in it."""


class Flown(msgspec.Struct, frozen=True):
    """Outcome of one flight of a search, as stored in a results file."""

    number: int
    """Index of the flight in the search, from 0."""
    row: Row


class Found(msgspec.Struct, frozen=True):
    """Worst attack that a search found."""

    cell: Cell
    seed: int
    harm: Harm
    evaluations: int
    drawn: float
    """Harm of the attack that the seed draws, in the unit of the harm."""
    attack: Attack
    row: Row


def harm_of(row: Row, harm: Harm) -> float:
    """Harm of a flight; larger is worse. In m, or in s for "held"."""
    match harm:
        case "separation":
            return -(_ALONE_M if row.separation_m is None else row.separation_m)
        case "held":
            return row.longest_s
        case "aside":
            return row.aside_m
        case "height":
            return max(row.up_m, row.down_m)
        case "fence":
            return row.beyond_m or 0.0


def worst(
    cell: Cell, seed: int, harm: Harm, budget: int, told: Callable[[Found], None] | None = None
) -> Generator[list[Flight], list[Row], Found]:
    """Search for the attack of the cell's kind that does the most harm in the encounter of a seed.

    Yields the flights of each generation, receives their rows, and returns the worst.

    Args:
        budget: number of flights.
        told: callback, called after each generation with the worst attack so far.

    Raises:
        ConfigError: the package `cma` is not installed.
    """
    try:
        import cma
    except ImportError as error:
        raise ConfigError(how_to_install("cma", "search")) from error
    count = len(KINDS[cell.kind].parameters)
    (row,) = yield [(cell, seed, draw_attack(cell.kind, seed))]
    drawn = round(harm_of(row, harm), 3)
    best: Found | None = None
    options: dict[str, Any] = {
        "bounds": [0.0, 1.0], "seed": seed + 1, "maxfevals": budget, "verbose": -9, "verb_log": 0,
    }  # fmt: skip
    start = np.random.default_rng([seed, 23]).random(count)
    flown = 0
    while flown < budget:
        strategy = cma.CMAEvolutionStrategy(start, _FIRST_SIGMA, options)
        while not strategy.stop() and flown < budget:
            points = strategy.ask()
            attacks = [attack_at(cell.kind, point.tolist()) for point in points]
            rows = yield [(cell, seed, attack) for attack in attacks]
            flown += len(rows)
            for attack, row in zip(attacks, rows, strict=True):
                if best is None or harm_of(row, harm) > harm_of(best.row, harm):
                    best = Found(cell, seed, harm, flown, drawn, attack, row)
            assert best is not None
            best = msgspec.structs.replace(best, evaluations=flown)
            strategy.tell(points, [-harm_of(row, harm) for row in rows])
            if told is not None:
                told(best)
        # A search that has converged restarts from another point.
        start = np.random.default_rng([seed, 23, flown]).random(count)
        options["seed"] += 1
    assert best is not None
    return best


def resumed(
    work: Generator[list[Flight], list[Row], Found], file: Kept[Flown]
) -> Generator[list[Flight], list[Row], Found]:
    """Use the outcomes that a results file already has, and add those of new flights to it.

    A search depends only on its seed and the outcomes. Therefore a search that was interrupted, or that ended
    with fewer evaluations, continues where it stopped.

    Raises:
        ConfigError: the file cannot be written.
    """
    number, rows = 0, None
    while True:
        try:
            flights = next(work) if rows is None else work.send(rows)
        except StopIteration as end:
            found: Found = end.value
            return found
        numbers = range(number, number + len(flights))
        if all(n in file.rows for n in numbers):
            rows = [file.rows[n].row for n in numbers]
        else:
            rows = yield flights
            file.add([Flown(n, row) for n, row in zip(numbers, rows, strict=True)])
        number += len(flights)


def fly(flight_: Flight) -> Row:
    """Fly one attack in the encounter of a seed."""
    return flight.fly(*flight_)
