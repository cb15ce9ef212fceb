"""The gate's rules in the order of their numbers. `docs/gate.md` says what each of them requires."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class _Text:
    number: int
    name: str
    ends: Literal["nothing", "fault", "authority"] = "fault"
    """What breaking the rule ends, as in `GateRefused.ends`."""


class Rule(enum.Enum):
    """Condition that a frame must meet to be sent."""

    WHOLE = _Text(1, "whole")
    KIND = _Text(2, "kind")
    TARGET = _Text(3, "target")
    USE = _Text(4, "use")
    CURRENT = _Text(5, "current", ends="nothing")
    AUTHORITY = _Text(6, "authority", ends="authority")
    MODE = _Text(7, "mode")
    AGE = _Text(8, "age", ends="nothing")
    FORM = _Text(9, "form")
    SPEED = _Text(10, "speed")
    CHANGE = _Text(11, "change")
    HEIGHT = _Text(12, "height")
    FENCE = _Text(13, "fence")
    ANSWER = _Text(14, "answer")

    @property
    def number(self) -> int:
        """Number of the rule in documents and messages."""
        return self.value.number

    @property
    def ends(self) -> Literal["nothing", "fault", "authority"]:
        """What breaking the rule ends, as in `GateRefused.ends`."""
        return self.value.ends

    def __str__(self) -> str:
        """Text for messages, with the rule's number and name."""
        return f"gate rule {self.value.number} ({self.value.name})"


class Broken(Exception):  # noqa: N818 - it is no error of this program
    """Raised when a frame breaks a rule and must not be sent."""

    def __init__(self, rule: Rule, why: str) -> None:
        super().__init__(f"{rule}: {why}")
        self.rule = rule
        self.why = why
