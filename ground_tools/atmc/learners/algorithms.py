"""The algorithms of `ground-tools atmc train`.

To add an algorithm, add a function here and an entry in `ALGORITHMS`. PyTorch is imported only when it is
needed, because every `ground-tools` command reads this table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import msgspec

if TYPE_CHECKING:
    import torch

    from ground_tools.atmc.learners.learner import Learner


@dataclass(frozen=True, slots=True)
class Parts:
    """The parts of an algorithm."""

    settings: msgspec.Struct
    """Default settings. Their type is the schema of the configuration file. `--episodes` sets `episodes`."""
    make: Callable[[Any, int, torch.device], Learner]
    """Makes the learner from settings, seed and device."""


@dataclass(frozen=True, slots=True)
class Algorithm:
    """An entry in the table of algorithms."""

    words: str
    """Description for the help text."""
    parts: Callable[[], Parts]
    """Imports the algorithm and returns its parts."""
    validate_every: int = 10
    """Rounds between two validations."""
    checkpoint_every: int = 50
    """Rounds between two checkpoints."""


def _madqn() -> Parts:
    from ground_tools.atmc.learners.madqn import Madqn, MadqnSettings

    return Parts(MadqnSettings(), Madqn)


def _madqn_shared() -> Parts:
    from ground_tools.atmc.learners.madqn import Madqn, SharedMadqnSettings

    return Parts(SharedMadqnSettings(), Madqn)


def _maddpg() -> Parts:
    from ground_tools.atmc.learners.maddpg import Maddpg, MaddpgSettings

    return Parts(MaddpgSettings(), Maddpg)


def _iac() -> Parts:
    from ground_tools.atmc.learners.iac import Iac, IacSettings

    return Parts(IacSettings(), Iac)


def _flying() -> Parts:
    from ground_tools.atmc.learners.flying_policy import FlyingLearner, FlyingSettings

    return Parts(FlyingSettings(), FlyingLearner)


def _city() -> Parts:
    from ground_tools.atmc.learners.city_policy import CityLearner, city_settings

    return Parts(city_settings(), CityLearner)


def _set_paper() -> Parts:
    from ground_tools.atmc.learners.flying_policy import PAPER_FLEETS, FlyingLearner, FlyingSettings

    return Parts(FlyingSettings(objective="paper", fleets=PAPER_FLEETS, episodes=40), FlyingLearner)


ALGORITHMS: Final[dict[str, Algorithm]] = {
    "madqn": Algorithm("the paper's MADQN-ATMC, with one network per aircraft", _madqn),
    "madqn-shared": Algorithm("MADQN-ATMC with one network for all aircraft", _madqn_shared),
    "maddpg": Algorithm("the paper's MADDPG baseline, with critics that see all aircraft", _maddpg),
    "iac": Algorithm("the paper's IAC baseline, with independent actors and critics", _iac),
    "flying": Algorithm(
        "the set network for flight, trained for awareness; any number of neighbours", _flying, 2, 2
    ),
    "city": Algorithm(
        "the set network trained on cut-outs of a city, for the room that old information costs", _city, 4, 4
    ),
    "set-paper": Algorithm("the set network trained for the paper's objective", _set_paper, 2, 2),
}
