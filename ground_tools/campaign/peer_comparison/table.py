"""Tables that compare laws: one line for each encounter, one column for each law."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from ground_tools.campaign.cells import Cell
from ground_tools.campaign.peers.laws import PEERS
from ground_tools.campaign.scenarios.missions import MISSIONS
from ground_tools.campaign.tables import Line

DELAY_S: Final = (2.0, 3.0)
MISSION_DELAY_S: Final = (1.0, 2.0)
CALM: Final = "dmuca:acceleration_mps2=1,recovery_s=10"
"""The companion's law with a lower acceleration limit and a faster return; both are configurable."""
WIDE: Final = "orca-constant:radius_m=22,horizon_s=20"
"""A constant radius larger than the search found, with a margin for encounters that the search did not
try."""
_OTHERS: Final = tuple(name for name in PEERS if name not in ("orca", "orca-constant"))
TURNING: Final = 0.2
"""Share of aircraft that turn at random, in encounters with such aircraft."""
COOPERATIVE: Final = (
    "S1", "S2", "S3", "head-on", "crossing", "overtaking", "circle", "wall", "funnel", "random",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Table:
    """What a table compares."""

    words: str
    """Description of the encounters in words."""
    laws: tuple[str, ...]
    encounters: tuple[Cell, ...]
    """Flown by each of the laws."""
    show: Callable[[dict[str, Any]], str]
    """Text of one cell."""
    legend: str
    """Explanation of the text in a cell."""

    def cells(self) -> list[Cell]:
        """All cells, by encounter and then by law."""
        return [msgspec.structs.replace(cell, law=law) for cell in self.encounters for law in self.laws]


def separation(found: dict[str, Any]) -> str:
    """Text with lost flights, least separation (m) and deviation (m)."""
    return (
        f"{found['losses_of_separation']} / {found['min_separation_m']:.1f} / "
        f"{found['median_max_deviation_m']:.1f}"
    )


def _encounters() -> tuple[Cell, ...]:
    plain = [Cell(generator=name, aircraft=5, delay_s=DELAY_S) for name in COOPERATIVE]
    turning = Cell(generator="circle", aircraft=5, delay_s=DELAY_S, intruders=TURNING, intruder="turning")
    return (*plain, turning, Cell(generator="S2", aircraft=5, delay_s=(0.0, 1.0), loss=0.8))


def _missions() -> tuple[Cell, ...]:
    """Encounters of one avoiding aircraft and one intruder on a mission."""
    return tuple(
        Cell(generator="cruise", aircraft=2, delay_s=MISSION_DELAY_S, intruders=0.5, intruder=name)
        for name in MISSIONS
    )


def _hits(found: dict[str, Any]) -> str:
    return f"{found['losses_of_separation']} / {found['collisions']} / {found['median_max_deviation_m']:.1f}"


TABLES: Final[dict[str, Table]] = {
    "encounters": Table(
        "5 aircraft at 5 m/s, delays of 2 to 3 s unless said otherwise; all that avoid fly the same law",
        ("none", "dmuca", "paper", "orca", "orca-constant", WIDE, *_OTHERS),
        _encounters(),
        separation,
        "flights with a pair below 10 m / least separation (m) / median of each flight's largest "
        "deviation (m)",
    ),
    "missions": Table(
        "one aircraft that avoids and one on a mission that does not, delays of 1 to 2 s",
        ("none", "dmuca", CALM, "orca-growth", WIDE, "mvp", "fly-away", "daidalus"),
        _missions(),
        _hits,
        "flights with a pair below 10 m / below 2 m / median of each flight's largest deviation (m)",
    ),
}


def words_of(cell: Cell) -> str:
    """Description of an encounter."""
    words = cell.generator
    if cell.on_missions:
        return cell.intruder
    if cell.intruders:
        words += f", {cell.intruders:.0%} {cell.intruder}"
    if cell.loss:
        words += f", {cell.loss:.0%} of messages lost, delays of {cell.delay_s[0]:g} to {cell.delay_s[1]:g} s"
    return words


def markdown(name: str, lines: Sequence[Line]) -> str:
    """A table as Markdown.

    Args:
        name: a key of `TABLES`.
        lines: one for each of its cells, except those of laws that were not flown.
    """
    table, found = TABLES[name], {line.cell: line.found for line in lines}
    flown = {cell.law for cell in found}
    laws = [law for law in table.laws if law in flown]
    rows = [["encounter", *laws], ["---"] * (1 + len(laws))]
    for encounter in table.encounters:
        of = [found[msgspec.structs.replace(encounter, law=law)] for law in laws]
        rows.append([words_of(encounter), *map(table.show, of)])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)
