"""Input and output types of `Control.step`."""

from __future__ import annotations

from typing import Protocol

import msgspec

from companion.authority.table import State
from companion.avoidance.law import LawResult
from companion.events import Command
from companion.geometry import Vec3


class Cycle(Protocol):
    """The law and its reporting, as `Control` calls them in the states that need them."""

    def due(self, now_s: float) -> bool:
        """Whether the law's period since its last decision is over."""

    def decide(self, now_s: float, state: State) -> LawResult:
        """Decide what the law would fly now. Needs a law."""

    @property
    def hold(self) -> str | None:
        """Why the latest decision requires that the vehicle is asked to hold, in words; None if it does
        not."""

    def note(self, now_s: float, result: LawResult, state: State) -> list[Command]:
        """Alerts, messages and log entries about the decision just made."""


class Step(msgspec.Struct, frozen=True):
    """Result of one step."""

    commands: list[Command]
    velocity_ned_mps: Vec3 | None = None
    """Velocity to command after `commands` (NED, m/s); None to command none."""
    alerts_only: bool = False
    """True if the law made no decision but the own state is usable, so that only alerts can be judged."""
