"""The tables of docs/safety.md: many cells of a campaign, one line for each cell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import msgspec

from ground_tools.campaign.cells import LAWS, WORLDS, Cell, Row
from ground_tools.campaign.generators import NAMES
from ground_tools.campaign.vehicles import INTRUDERS, TWINS

_NOTHING: Final = "-"
FULL_MPS: Final = 26.6
"""Greatest speed for which the generators plan up to 20 m/s, which is three quarters of it."""
_ENCOUNTERS: Final = {"fence": ("head-on", "overtaking"), "layer": ("lift", "S2")}
"""Encounters for the worlds that do not affect every encounter."""
DELAYS_S: Final = ((0.0, 1.0), (1.0, 2.0), (2.0, 3.0))


def _generators() -> list[Cell]:
    """Every generator, flown by our law and the paper's law with the longest delays."""
    return [
        Cell(generator=name, aircraft=5, law=law, delay_s=DELAYS_S[-1])
        for name in NAMES
        for law in LAWS
        if law != "none"
    ]


def _laws() -> list[Cell]:
    """The sets of encounters S1 to S3, flown by both laws with each delay; then harder conditions."""
    rows = [
        Cell(generator=name, aircraft=5, law=law, delay_s=delay_s)
        for law in LAWS
        if law != "none"
        for name in ("S1", "S2", "S3")
        for delay_s in DELAYS_S
    ]
    rows += [Cell(generator="S2", aircraft=10, delay_s=delay_s) for delay_s in DELAYS_S]
    rows += [
        Cell(generator=name, aircraft=5, intruders=0.2, delay_s=delay_s)
        for name in ("S1", "S2", "S3")
        for delay_s in DELAYS_S
    ]
    return rows + [Cell(generator=name, aircraft=5, loss=0.8) for name in ("S1", "S2", "S3")]


def _twenty() -> list[Cell]:
    """Twenty aircraft: each flight takes as long to compute as ten flights of five aircraft."""
    return [Cell(generator="S2", aircraft=20, delay_s=delay_s) for delay_s in DELAYS_S]


def _fast() -> list[Cell]:
    """Every generator at 20 m/s: first planned below the greatest speed, then as fast as aircraft can fly."""
    delay_s = DELAYS_S[-1]
    rows = [Cell(generator=name, aircraft=5, speed_mps=20.0, delay_s=delay_s) for name in NAMES]
    return rows + [
        Cell(generator=name, aircraft=5, speed_mps=FULL_MPS, delay_s=delay_s, reserve=False)
        for name in NAMES
        if name != "lift"  # this generator only climbs and descends, far below any speed limit
    ]


def _open_ground() -> list[Cell]:
    """Cases that are open problems: every kind of intruder, every world, and 50 aircraft."""
    rows = [
        Cell(generator=name, aircraft=5, intruders=0.2, intruder=kind, delay_s=DELAYS_S[1])
        for kind in INTRUDERS
        for name in ("S2", "crossing", "circle", "random")
    ]
    rows += [
        Cell(generator=name, aircraft=5, world=world, delay_s=DELAYS_S[1])
        for world in WORLDS
        for name in _ENCOUNTERS.get(world, ("S2", "crossing", "circle", "random"))
    ]
    rows.append(Cell(generator="head-on", aircraft=5, world="fence", speed_mps=20.0, delay_s=DELAYS_S[1]))
    return [*rows, Cell(generator="streams", aircraft=50, delay_s=DELAYS_S[1])]


def _twins() -> list[Cell]:
    """Two aircraft that send the same identity."""
    return [_twin(kind, DELAYS_S[1], 0.0) for kind in ("twin", "own-twin")]


def _twins_lost() -> list[Cell]:
    """Twins with four of five messages lost, so that one aircraft may be mistaken for the other."""
    return [_twin(kind, DELAYS_S[0], 0.8) for kind in TWINS]


def _twin(kind: str, delay_s: tuple[float, float], loss: float) -> Cell:
    return Cell(generator="circle", aircraft=5, intruders=0.2, intruder=kind, delay_s=delay_s, loss=loss)


TABLES: Final[dict[str, Callable[[], list[Cell]]]] = {
    "generators": _generators,
    "laws": _laws,
    "twenty": _twenty,
    "fast": _fast,
    "open-ground": _open_ground,
    "twins": _twins,
    "twins-lost": _twins_lost,
}


class Line(msgspec.Struct, frozen=True, kw_only=True):
    """A cell and its results."""

    cell: Cell
    found: dict[str, Any]
    """The result of `runs.summary`."""
    first: Row | None = None
    """The flight of the first seed, for comparison with a flight by other software."""


class Kept(msgspec.Struct, frozen=True, kw_only=True):
    """A table as it is stored in a file."""

    software: str
    """Digest of the software that flew the table (`cells.software`)."""
    seeds: tuple[int, int]
    """First and last seed of the flights."""
    lines: tuple[Line, ...]


def markdown(lines: Sequence[Line]) -> str:
    """The table as Markdown, one line for each cell. Conditions equal in all cells have no column."""
    columns: list[tuple[str, Callable[[Line], str]]] = [
        ("encounter", lambda line: line.cell.generator),
        ("aircraft", lambda line: str(line.cell.aircraft)),
        ("law", lambda line: line.cell.law),
        ("m/s", lambda line: f"{line.cell.speed_mps:g}"),
        ("delay (s)", lambda line: "{:g} to {:g}".format(*line.cell.delay_s)),
        ("intruders", lambda line: _intruders(line.cell)),
        ("world", lambda line: line.cell.world),
        ("lost messages", lambda line: f"{line.cell.loss:.0%}"),
        ("speed reserve", lambda line: "yes" if line.cell.reserve else "no"),
    ]
    shown = [c for c in columns if len({c[1](line) for line in lines}) > 1]
    columns = [
        ("runs", lambda line: f"{line.found['runs']:,}"),
        ("below 10 m", lambda line: f"{line.found['losses_of_separation']:,}"),
        ("collisions", lambda line: f"{line.found['collisions']:,}"),
        (
            "unavoided: below 10 m, collisions",
            lambda line: "{unavoided_losses_of_separation:,}, {unavoided_collisions:,}".format(**line.found),
        ),
        ("risk ratio (95 %)", _risk),
        ("least separation (m)", lambda line: f"{line.found['min_separation_m']:.2f}"),
        ("mean severity", _severity),
        ("deviation (m)", lambda line: f"{line.found['median_max_deviation_m']:.0f}"),
        ("return (s)", _return),
        (
            "late, median and worst (s)",
            lambda line: "{median_lost_s:.0f}, {max_lost_s:.0f}".format(**line.found),
        ),
        ("crewed traffic lost: ours, unavoided", _crewed),
    ]
    # A column without any value is omitted, such as the severity if no flight lost separation.
    shown += [c for c in columns if any(c[1](line) != _NOTHING for line in lines)]
    rows = [[title for title, _ in shown], ["---"] * len(shown)]
    rows += [[value(line) for _, value in shown] for line in lines]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _intruders(cell: Cell) -> str:
    return f"{cell.intruders:.0%} {cell.intruder}" if cell.intruders else "none"


def _severity(line: Line) -> str:
    severity = line.found.get("mean_severity")
    return _NOTHING if severity is None else f"{severity:.2f}"


def _return(line: Line) -> str:
    recovery = line.found["median_recovery_s"]
    return _NOTHING if recovery is None else f"{recovery:.0f}"


def _crewed(line: Line) -> str:
    if line.found["min_crewed_separations"] is None:
        return _NOTHING
    return "{crewed_losses:,}, {unavoided_crewed_losses:,}".format(**line.found)


def _risk(line: Line) -> str:
    ratio, interval = line.found["risk_ratio"], line.found["risk_ratio_interval"]
    if ratio is None:
        return _NOTHING
    return f"{ratio:.4f} ({interval[0]:.4f} to {interval[1]:.4f})"
