"""The kinds of attack: their parameters, and the attackers that they make."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np

from companion.errors import ConfigError
from ground_tools.campaign.attacks import copies, crowd, ghosts
from ground_tools.campaign.attacks.attacker import Attacker, Parameter, Values
from ground_tools.campaign.attacks.scene import Scene


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of attack."""

    parameters: tuple[Parameter, ...]
    make: Callable[[Values, Scene, np.random.Generator], Attacker]


KINDS: Final = {
    "crowd": Kind(crowd.PARAMETERS, crowd.Crowd),
    "clone-near": Kind(copies.CLONE, copies.Clone),
    "shadow": Kind(copies.SHADOW, copies.Clone),
    "herd": Kind(ghosts.HERD, ghosts.Herd),
    "adsb": Kind(ghosts.ADSB, ghosts.Adsb),
    "liar": Kind(copies.LIAR, copies.Liar),
    "replay": Kind(copies.REPLAY, copies.Replay),
    "free": Kind(ghosts.FREE, ghosts.Free),
}


class Attack(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One attack: its kind and the value of each of its parameters."""

    kind: str
    values: Values

    def check(self) -> None:
        """Refuse an attack that its kind does not allow.

        Raises:
            ConfigError: names what is wrong and what is allowed.
        """
        if self.kind not in KINDS:
            raise ConfigError(f"kind: {self.kind!r} is unknown; allowed: {', '.join(KINDS)}")
        parameters = KINDS[self.kind].parameters
        if set(self.values) != {p.name for p in parameters}:
            wanted = ", ".join(p.name for p in parameters)
            raise ConfigError(f"values: the names are {', '.join(self.values)}; needed: {wanted}")
        for p in parameters:
            if not p.low <= self.values[p.name] <= p.high:
                value = self.values[p.name]
                raise ConfigError(f"{p.name}: {value:g} is out of range; allowed: {p.low:g} to {p.high:g}")


def attack_at(kind: str, shares: Sequence[float]) -> Attack:
    """The attack at a point of the unit cube, one coordinate for each parameter."""
    parameters = KINDS[kind].parameters
    return Attack(kind, {p.name: round(p.at(s), 4) for p, s in zip(parameters, shares, strict=True)})


def draw_attack(kind: str, seed: int) -> Attack:
    """The attack of a seed, uniform in the ranges."""
    rng = np.random.default_rng([seed, 13])
    return attack_at(kind, rng.random(len(KINDS[kind].parameters)).tolist())
