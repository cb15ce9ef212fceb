"""The picture of losses against deviation: a curve for each law over its main parameter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from companion.errors import ConfigError
from ground_tools.campaign.cells import Cell
from ground_tools.campaign.peer_comparison.table import DELAY_S, TURNING, separation
from ground_tools.campaign.peers.laws import PEERS
from ground_tools.campaign.tables import Line
from ground_tools.common.figure import drawn

OWN: Final = ("growth", (0.0, 0.25, 0.5, 1.0, 1.5))
"""Main parameter of the companion's own law, and its values: the factor on a track's growth."""
ENCOUNTERS: Final = (
    Cell(generator="S2", aircraft=5, delay_s=DELAY_S),
    Cell(generator="circle", aircraft=5, delay_s=DELAY_S, intruders=TURNING, intruder="turning"),
)
_TITLES: Final = ("S2, all avoid", "circle, 1 in 5 turns at random and avoids nobody")
_MARKS: Final = "os^vDP"
_ZERO: Final = 0.5
"""Height at which a point without a loss is drawn on the logarithmic axis, in lost flights."""


def laws() -> dict[str, list[str]]:
    """The variants of each law, by the law's name."""
    found = {"dmuca": [f"dmuca:{OWN[0]}={value:g}" for value in OWN[1]]}
    for name, peer in PEERS.items():
        if peer.main:
            found[name] = [f"{name}:{peer.main}={value:g}" for value in peer.values]
    return found


def cells() -> list[Cell]:
    """All cells of the picture."""
    return [
        msgspec.structs.replace(encounter, law=law)
        for encounter in ENCOUNTERS
        for variants in laws().values()
        for law in variants
    ]


def draw(path: Path, lines: Sequence[Line]) -> None:
    """Draw the picture to a PNG file, without the laws that were not flown at all.

    Raises:
        ConfigError: matplotlib is not installed, a line is missing, or the file cannot be written.
    """
    found = {line.cell: line.found for line in lines}
    flown = _names(found)
    if missing := [cell.name for cell in cells() if cell not in found and _name(cell) in flown]:
        raise ConfigError(f"the picture needs {len(missing)} cells that were not flown, such as {missing[0]}")
    with drawn(path, (13.0, 6.0)) as figure:
        for axes, encounter, title in zip(figure.subplots(1, 2), ENCOUNTERS, _TITLES, strict=True):
            _panel(axes, encounter, found)
            axes.set_title(title)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)


def _panel(axes: Any, encounter: Cell, found: dict[Cell, dict[str, Any]]) -> None:
    for mark, (name, variants) in zip(_MARKS, laws().items(), strict=True):
        if name not in _names(found):
            continue
        of = [found[msgspec.structs.replace(encounter, law=law)] for law in variants]
        main = OWN[0] if name == "dmuca" else PEERS[name].main
        axes.plot(
            [one["median_max_deviation_m"] for one in of],
            [100.0 * max(one["losses_of_separation"], _ZERO) / one["runs"] for one in of],
            marker=mark,
            linewidth=2.5 if name == "dmuca" else 1.2,
            label=f"{name} ({main} {variants[0].partition('=')[2]} to {variants[-1].partition('=')[2]})",
        )
    axes.set_yscale("log")
    axes.set_xlabel("median of the largest deviation (m)")
    axes.set_ylabel("flights that lost separation (%); lowest: none")


def _name(cell: Cell) -> str:
    return cell.law.partition(":")[0]


def _names(found: dict[Cell, dict[str, Any]]) -> set[str]:
    """Names of the laws that were flown."""
    return {_name(cell) for cell in found}


def markdown(lines: Sequence[Line]) -> str:
    """The points of the picture as a Markdown table, except those of laws that were not flown."""
    found = {line.cell: line.found for line in lines}
    rows = ["| law | " + " | ".join(_TITLES) + " |", "| --- | --- | --- |"]
    for name, variants in laws().items():
        for law in variants if name in _names(found) else ():
            of = [found[msgspec.structs.replace(encounter, law=law)] for encounter in ENCOUNTERS]
            rows.append(f"| `{law}` | " + " | ".join(map(separation, of)) + " |")
    return "".join(row + "\n" for row in rows)
