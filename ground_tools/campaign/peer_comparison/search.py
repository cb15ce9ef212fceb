"""Finds the parameters of each peer: every candidate of its grid flies the same encounters.

Every law that is searched has the same budget: `laws.CANDIDATES` candidates, in the encounters of ENCOUNTERS,
with the same seeds, which no table uses. The best candidate loses separation in the fewest flights. Ties are
decided by the least mean of the encounters' median deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from ground_tools.campaign import cells as campaign
from ground_tools.campaign.cells import Cell, Row
from ground_tools.campaign.peers.laws import PEERS, Parameters
from ground_tools.campaign.tables import Line

ENCOUNTERS: Final = ("S2", "head-on", "overtaking", "random")
DELAY_S: Final = (2.0, 3.0)
AIRCRAFT: Final = 5
SEEDS: Final = "80001-80025"


def searched() -> list[str]:
    """Names of the laws that are searched."""
    return [name for name, peer in PEERS.items() if peer.grid]


def cells() -> list[Cell]:
    """Every candidate of every law in every encounter."""
    return [
        Cell(generator=encounter, aircraft=AIRCRAFT, law=whole(name, tried), delay_s=DELAY_S)
        for name in searched()
        for tried in PEERS[name].candidates()
        for encounter in ENCOUNTERS
    ]


def whole(name: str, parameters: Parameters) -> str:
    """A law's name with all of its parameters, so that the name of a cell does not depend on `Peer.best`."""
    return name + ":" + ",".join(f"{key}={value:g}" for key, value in parameters._asdict().items())


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    """The figures that a line of a search or of a table of peers reports."""
    return {
        "runs": len(rows),
        "losses_of_separation": campaign.lost(rows),
        "collisions": campaign.collided(rows),
        "min_separation_m": min(row.separation_m for row in rows),
        "median_max_deviation_m": campaign.median([row.deviation_m for row in rows]),
    }


def scores(lines: Sequence[Line]) -> dict[str, tuple[int, float]]:
    """What the search minimises, for each candidate: the number of lost flights, then the mean deviation
    (m)."""
    found: dict[str, list[dict[str, Any]]] = {}
    for line in lines:
        found.setdefault(line.cell.law, []).append(line.found)
    return {
        law: (
            sum(one["losses_of_separation"] for one in flown),
            sum(one["median_max_deviation_m"] for one in flown) / len(flown),
        )
        for law, flown in found.items()
    }


def best_of(lines: Sequence[Line]) -> dict[str, str]:
    """The best candidate of each law, by the law's name."""
    found = scores(lines)
    return {
        name: min((law for law in found if law.partition(":")[0] == name), key=lambda law: found[law])
        for name in dict.fromkeys(law.partition(":")[0] for law in found)
    }


def markdown(lines: Sequence[Line]) -> str:
    """The three best candidates of each law, the best first, as Markdown."""
    found, rows = scores(lines), ["| candidate | lost flights | mean deviation (m) |", "| --- | --- | --- |"]
    for name in dict.fromkeys(law.partition(":")[0] for law in found):
        ranked = sorted((law for law in found if law.partition(":")[0] == name), key=lambda law: found[law])
        rows += [f"| `{law}` | {found[law][0]} | {found[law][1]:.1f} |" for law in ranked[:3]]
    return "".join(row + "\n" for row in rows)
