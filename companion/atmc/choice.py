"""Interface of everything that chooses transports: it returns one of its actions, or why it cannot choose."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Protocol

from companion.arrays import AnyFloats, Bools
from companion.atmc.actions import Action


class Why(enum.Enum):
    """Why no action could be chosen."""

    NOTHING_ALLOWED = "nothing_allowed"
    """No action is both legal and possible with the present radios."""
    TOO_MANY = "too_many"
    """There are more neighbours than in training."""
    OUTSIDE = "outside"
    """A value of the observation lies outside the range seen in training, or is not a number."""
    NO_NUMBER = "no_number"
    """The network returned a value that is not finite."""
    BROKEN = "broken"
    """The policy of a plug-in raised an exception, or chose what is not allowed."""


@dataclass(frozen=True, slots=True)
class Choice:
    """The chosen action."""

    index: int
    action: Action


@dataclass(frozen=True, slots=True)
class Refused:
    """No action can be chosen; the caller has to use the fall-back."""

    why: Why
    text: str


class Mind(Protocol):
    """Something that chooses an action from an observation: a policy or a rule."""

    @property
    def actions(self) -> tuple[Action, ...]:
        """All actions that it can choose."""
        ...

    def choose(
        self,
        own_row: AnyFloats,
        neighbour_rows: AnyFloats,
        allowed: Bools,
        current: int | None,
        agent: int = 0,
    ) -> Choice | Refused:
        """Choose the action to use now.

        Args:
            own_row: shape (own columns,), from `observation.own_row`.
            neighbour_rows: shape (neighbours, neighbour columns), from `observation.neighbour_rows`.
            allowed: shape (actions,); True for the actions that may be chosen.
            current: index of the action in use now; None if it is not one of `actions`.
            agent: index of this aircraft, for policies with one network per aircraft.
        """
        ...
