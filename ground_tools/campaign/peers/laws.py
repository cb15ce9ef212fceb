"""The laws of `peers` by name, with their parameters and the values that a search may try.

A law is named as in `--law mvp`, or with some of its parameters as in `--law mvp:radius_m=16,look_s=30`; the
others are those of `Peer.best`. Some numbers of the companion's own law can be changed in the same way
(`VARIED`), as in `--law dmuca:growth=0.5`, to measure their effect.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, cast

from ground_tools.campaign.flight import Loop
from ground_tools.campaign.peers import daidalus, fly_away, mvp, orca
from ground_tools.campaign.peers.daidalus import Daidalus
from ground_tools.campaign.peers.fly_away import FlyAway
from ground_tools.campaign.peers.mvp import Mvp
from ground_tools.campaign.peers.orca import Orca

Parameters = Orca | Mvp | FlyAway | Daidalus
CANDIDATES: Final = 24
"""Budget of a search: number of candidates for each law that has a `Peer.grid`."""
_PERIOD_S: Final = 0.2
"""Time between two decisions, which is the time step of RVO2-3D in the campaign."""
_LEAST: Final = 1e-3
_MOST: Final = 1e4

VARIED: Final = (
    "radius_m", "sigmas", "quantum_mps", "growth", "horizon_s", "overlap_s", "look_s", "right_rad",
    "acceleration_mps2", "recovery_s",
)  # fmt: skip
"""Fields of `kernels.Settings` that `--law dmuca:...` may change."""


@dataclass(frozen=True, slots=True)
class Peer:
    """A law that is compared with the companion's own."""

    words: str
    """Description of the law in words."""
    loop: Loop
    """Function that flies an encounter with this law (`flight.Loop`)."""
    best: Parameters
    """Parameters with which the law flies: the search's result, or the published ones."""
    grid: dict[str, tuple[float, ...]] = field(default_factory=dict)
    """Values of the parameters that a search combines; empty: the parameters are not searched."""
    main: str = ""
    """Parameter that trades deviation for safety, and its values for the picture; empty: the law is not in
    the picture."""
    values: tuple[float, ...] = ()
    needs: Callable[[], str] | None = None
    """Loads what the law needs beside this project. Returns a digest of it; raises ConfigError if it is not
    there."""

    def candidates(self) -> list[Parameters]:
        """Parameter sets that a search tries, in a fixed order."""
        tried = itertools.product(*self.grid.values()) if self.grid else ()
        return [self.best._replace(**dict(zip(self.grid, values, strict=True))) for values in tried]


PEERS: Final[dict[str, Peer]] = {
    "orca": Peer(
        "ORCA as published: R is the required separation; tau is that of RVO2-3D's example",
        cast(Loop, orca.fly),
        Orca(radius_m=10.0, horizon_s=10.0, overlap_s=_PERIOD_S, predicted=1.0, own_volume=0.0, growth=0.0),
        main="horizon_s",
        values=(5.0, 10.0, 20.0, 30.0),
    ),
    "orca-constant": Peer(
        "ORCA with a larger constant radius",
        cast(Loop, orca.fly),
        Orca(radius_m=20.0, horizon_s=30.0, overlap_s=_PERIOD_S, predicted=1.0, own_volume=0.0, growth=0.0),
        grid={
            "radius_m": (12.0, 14.0, 16.0, 18.0, 20.0, 22.0, 25.0, 28.0),
            "horizon_s": (10.0, 20.0, 30.0),
        },
        main="radius_m",
        values=(14.0, 18.0, 20.0, 22.0, 25.0, 28.0),
    ),
    "orca-margin": Peer(
        "ORCA with the radius of the companion's own law less its growth",
        cast(Loop, orca.fly),
        Orca(radius_m=10.0, horizon_s=20.0, overlap_s=_PERIOD_S, predicted=1.0, own_volume=1.0, growth=0.0),
    ),
    "orca-growth": Peer(
        "ORCA with the radius of the companion's own law",
        cast(Loop, orca.fly),
        Orca(radius_m=10.0, horizon_s=20.0, overlap_s=_PERIOD_S, predicted=1.0, own_volume=1.0, growth=1.0),
    ),
    "mvp": Peer(
        "Modified Voltage Potential (BlueSky)",
        cast(Loop, mvp.fly),
        Mvp(radius_m=20.0, height_m=16.0, look_s=30.0, level=1.0, margin=1.01, head_on_m=10.0, predicted=1.0),
        grid={
            "radius_m": (12.0, 16.0, 20.0),
            "look_s": (15.0, 30.0),
            "level": (0.0, 1.0),
            "head_on_m": (1.0, 10.0),
        },
        main="radius_m",
        values=(12.0, 16.0, 20.0, 25.0),
    ),
    "fly-away": Peer(
        "fly away from the most serious threat (ArduPilot's AP_Avoidance)",
        cast(Loop, fly_away.fly),
        FlyAway(f_dist_xy_m=15.0, f_dist_z_m=15.0, f_time_s=5.0, level=0.0, predicted=0.0),
        grid={
            "f_dist_xy_m": (10.0, 15.0, 20.0),
            "f_time_s": (5.0, 10.0),
            "level": (0.0, 1.0),
            "predicted": (0.0, 1.0),
        },
        main="f_dist_xy_m",
        values=(10.0, 15.0, 20.0, 30.0),
    ),
    "daidalus": Peer(
        "follow the nearest advice of NASA's DAIDALUS",
        cast(Loop, daidalus.fly),
        Daidalus(radius_m=30.0, look_s=30.0, directions_first=1.0, predicted=1.0, collision_m=20.0),
        grid={
            "radius_m": (20.0, 25.0, 30.0, 40.0),
            "look_s": (20.0, 30.0),
            "collision_m": (10.0, 15.0, 20.0),
        },
        main="collision_m",
        values=(10.0, 20.0, 25.0),
        needs=daidalus.load,
    ),
}


def of(text: str) -> tuple[Peer, Parameters]:
    """The peer law that a name refers to, and its parameters.

    Raises:
        ValueError: the name or a parameter is not known, or a value is not allowed.
    """
    name, _, given = text.partition(":")
    if name not in PEERS:
        raise ValueError(f"{name} is unknown; allowed: {', '.join(PEERS)}")
    peer = PEERS[name]
    return peer, peer.best._replace(**_given(name, given, peer.best._fields))


def varied(text: str) -> dict[str, float]:
    """The numbers of the companion's own law that a text such as "dmuca:growth=0.5" changes.

    Raises:
        ValueError: a number is not known, or a value is not allowed.
    """
    name, _, given = text.partition(":")
    return _given(name, given, VARIED)


def text_of(name: str, parameters: Parameters) -> str:
    """The shortest text that `of` reads as this law with these parameters."""
    best: dict[str, Any] = PEERS[name].best._asdict()
    other = [f"{key}={value:g}" for key, value in parameters._asdict().items() if value != best[key]]
    return name + (":" + ",".join(other) if other else "")


def _given(name: str, given: str, known: Sequence[str]) -> dict[str, float]:
    found = {}
    for part in given.split(",") if given else ():
        key, _, value = part.partition("=")
        if key not in known:
            raise ValueError(f"{name}: parameter {key!r} is unknown; allowed: {', '.join(known)}")
        found[key] = _number(name, key, value)
    return found


def _number(name: str, key: str, text: str) -> float:
    switch = key in ("predicted", "own_volume", "level", "directions_first") or (
        key == "growth" and name in PEERS
    )
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if switch and value not in (0.0, 1.0):
        raise ValueError(f"{name}: {key}={text} is not allowed; allowed: 0 or 1")
    least = 0.0 if switch or key in ("sigmas", "quantum_mps", "growth", "right_rad") else _LEAST
    if not least <= value <= _MOST:
        raise ValueError(f"{name}: {key}={text} is not allowed; allowed: {least:g} to {_MOST:g}")
    return value
