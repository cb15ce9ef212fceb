"""What every chooser of transports answers: one of its actions, or why it cannot say."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from companion.atmc.actions import Action, Bools

Floats = NDArray[np.floating[Any]]


class Why(enum.Enum):
    """Kinds of refusal."""

    NOTHING_ALLOWED = "nothing_allowed"
    """No action is legal and can be sent."""
    TOO_MANY = "too_many"
    """More neighbours than in training."""
    OUTSIDE = "outside"
    """An observation that training never saw, or that is no number."""
    NO_NUMBER = "no_number"
    """The network's answer is not finite."""


@dataclass(frozen=True, slots=True)
class Choice:
    """The action to take."""

    index: int
    action: Action


@dataclass(frozen=True, slots=True)
class Refused:
    """No choice can be made; the fall-back is to be taken."""

    why: Why
    text: str


class Mind(Protocol):
    """Chooses an action from what is seen."""

    @property
    def actions(self) -> tuple[Action, ...]:
        """What it can choose."""
        ...

    def choose(
        self, own_row: Floats, neighbour_rows: Floats, allowed: Bools, current: int | None, agent: int = 0
    ) -> Choice | Refused:
        """The action for now.

        Args:
            own_row: shape (own columns,), from `observation.own_row`.
            neighbour_rows: shape (neighbours, neighbour columns), from `observation.neighbour_rows`.
            allowed: shape (actions,); others are never chosen.
            current: index of the present action; None where it is none of them.
            agent: which aircraft this is, for networks that are not shared; aboard always 0.
        """
        ...
