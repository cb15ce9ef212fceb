"""Sends Wi-Fi twice a second while nobody is near, and everything at full rate otherwise."""

from companion.atmc.actions import SET_ACTIONS
from companion.atmc.observation import NEIGHBOUR_COLUMNS

CONFLICT = NEIGHBOUR_COLUMNS.index("conflict")
NEAR = 0.1
LOUD, QUIET = SET_ACTIONS.index((10, 0, 10)), SET_ACTIONS.index((0, 0, 2))


class Quiet:
    """The policy of one aircraft. With these actions `ground-tools atmc evaluate` can measure it."""

    actions = SET_ACTIONS

    def choose(self, own_row, neighbour_rows, allowed, current):
        """Index of the action to use now: the wanted one, else the loudest that is allowed."""
        wanted = LOUD if (neighbour_rows[:, CONFLICT] > NEAR).any() else QUIET
        if allowed[wanted]:
            return wanted
        return max((i for i, can in enumerate(allowed) if can), key=lambda i: sum(self.actions[i]))
