"""What `Control` is handed at each step, and what it hands back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from companion.authority.table import State
from companion.avoidance.law import LawResult
from companion.events import Command
from companion.geometry import Vec3


class Cycle(Protocol):
    """The law and who tells of it, as `Control` asks them: only in the states that need them."""

    def due(self, now_s: float) -> bool:
        """The law's period since it was asked last is over."""

    def decide(self, now_s: float, state: State) -> LawResult:
        """What the law would fly now. Needs a law."""

    def note(self, now_s: float, result: LawResult, state: State) -> list[Command]:
        """What is to be told of what was just decided."""


@dataclass(frozen=True, slots=True)
class Step:
    """What one step brought."""

    commands: list[Command]
    velocity_ned_mps: Vec3 | None = None
    """To be commanded, after them (m/s); None: nothing is."""
    alerts_only: bool = False
    """The law was not asked, and the own state is fit: others may be judged for alerts alone."""
