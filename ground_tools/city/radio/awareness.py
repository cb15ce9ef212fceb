"""Age of the information that aircraft have about those near them, in compiled code."""

from __future__ import annotations

from companion.arrays import Floats
from ground_tools.campaign.vehicles import M_TIME
from ground_tools.city.compiled import compiled
from ground_tools.city.loop import State
from ground_tools.city.tables import NOBODY

WITHIN_M = 500.0
"""Distance within which the age counts: two aircraft head-on, at 12.5 m/s each, meet after 20 s."""
OLD_S = 3.0
# Entries of the sums: pairs with a track, their ages (s), those older than OLD_S, pairs without a track.
A_HEARD, A_AGE, A_OLD, A_UNHEARD, AGES = range(5)


@compiled()
def add_ages(now: float, within_m: float, state: State, sums: Floats) -> None:
    """Add the age of each aircraft's information about every other aircraft that is near now.

    Args:
        sums: shape (AGES,); added to.
    """
    craft, air, tracks, links = state.craft, state.air, state.tracks, state.links
    for i in range(len(air.flight)):
        for e in range(links.start[i], links.start[i + 1]):
            j = links.other[e]
            if air.flight[i] == NOBODY or air.flight[j] == NOBODY:
                continue
            square = 0.0
            for c in range(3):
                square += (craft.position[i, c] - craft.position[j, c]) ** 2
            if square > within_m * within_m:
                continue
            row = links.row[e]
            if row == NOBODY or tracks.who[i, row] != air.flight[j]:
                sums[A_UNHEARD] += 1.0
                continue
            age = now - tracks.heard[i, row, M_TIME]
            sums[A_HEARD] += 1.0
            sums[A_AGE] += age
            if age > OLD_S:
                sums[A_OLD] += 1.0
