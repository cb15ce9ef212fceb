"""All avoidance laws by name. A new law is added here; everything else about it is in its own file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class LawKind:
    """What the configuration knows of one law. A configuration is read without loading any law, so the class
    is named here instead of imported."""

    made_by: str
    """The law's class, as "module:class": `companion.avoidance.law.Law` or a subclass."""
    avoids: bool = True
    """Whether the law avoids other aircraft."""
    keeps_fence: bool = False
    """Whether the law keeps a fence."""


LawName = Literal["dmuca", "paper", "none"]
LAWS: dict[LawName, LawKind] = {
    "dmuca": LawKind("companion.avoidance.law:Law", keeps_fence=True),
    "paper": LawKind("companion.avoidance.law:Law"),
    "none": LawKind("companion.avoidance.law:Law", avoids=False),
}
