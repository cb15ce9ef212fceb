"""Finds where a transmitted track and a sensed object are one aircraft, so that it is avoided once.

The sensed object always stays, because it was measured. A transmitted track is left out once it has agreed
with one sensed object, in place and velocity, for `AGREED_S`, and only while that pairing is unambiguous. A
forged track that claims to be at a hovering obstacle therefore gains nothing: the obstacle stays, and the
forged track is avoided again as soon as it leaves. Crewed traffic is never left out, because its separations
are larger.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from companion.avoidance.law import ASIDE, Neighbour
from companion.geometry import Vec3
from companion.traffic.sensed.objects import Followed

AGREED_S: Final = 2.0
_SIGMAS: Final = 3.0
_ROOM_M, _HIGH_M, _ROOM_MPS = 2.0, 20.0, 2.5
_GOOD_MPS: Final = 2.5
"""A sensed object whose velocity has a larger error agrees with no track."""
_MOST_M: Final = 3.0
"""Largest declared error that makes room. An aircraft that declares a larger one is not left out for an
obstacle tens of metres away, around which only the margin of a sensor is kept."""
_OLDEST_S: Final = 3.0

Key = tuple[bool, str]
"""Whether a transmitted track is from ADS-B, and its id."""


class Fusing:
    """Which transmitted tracks are also sensed."""

    def __init__(self) -> None:
        self._since_s: dict[tuple[Key, str], float] = {}
        """Time since which a transmitted track and a sensed object have agreed."""
        self.fused: dict[Key, str] = {}
        """Transmitted tracks that are left out now, and the names of their sensed objects."""
        self.off: dict[str, Vec3] = {}
        """For each of these objects, where its track claims to be, relative to where it is seen (NED, m)."""

    def clear(self) -> None:
        """Forget everything."""
        self._since_s.clear()
        self.fused.clear()
        self.off.clear()

    def look(
        self, now_s: float, heard: Sequence[Neighbour], objects: Sequence[Followed], own_sigma_m: float
    ) -> list[Neighbour]:
        """The transmitted tracks that are to be avoided, in their order.

        Args:
            heard: all transmitted tracks, and other places where they may be.
            objects: sensed objects that are avoided.
            own_sigma_m: error of the own position, one standard deviation for each axis.
        """
        if not objects:
            self.clear()
            return list(heard)
        doubtful = {(o.adsb, o.track_id.partition(ASIDE)[0]) for o in heard if ASIDE in o.track_id}
        pairs = [
            ((other.adsb, other.track_id), one.name)
            for one in objects
            for other in heard
            if (other.adsb, other.track_id) not in doubtful
            and ASIDE not in other.track_id
            and _agree(now_s, other, one, own_sigma_m)
        ]
        before, self._since_s = self._since_s, {}
        for pair in pairs:
            self._since_s[pair] = before.get(pair, now_s)
        keys, names = [key for key, _ in pairs], [name for _, name in pairs]
        self.fused = {
            key: name
            for key, name in pairs
            if keys.count(key) == 1
            and names.count(name) == 1
            and now_s - self._since_s[key, name] >= AGREED_S - 1e-6
        }
        seen, left = {one.name: one for one in objects}, []
        self.off = {}
        for other in heard:
            name = self.fused.get((other.adsb, other.track_id))
            if name is None:
                left.append(other)
            else:
                here, there = seen[name].at(now_s), _predicted(other)
                self.off[name] = there[0] - here[0], there[1] - here[1], there[2] - here[2]
        return left


def _agree(now_s: float, other: Neighbour, one: Followed, own_sigma_m: float) -> bool:
    if other.crewed or other.silent or other.age_s > _OLDEST_S or one.sigma_mps > _GOOD_MPS:
        return False
    here, there = one.at(now_s), _predicted(other)
    room_m = _ROOM_M + one.across_m + _SIGMAS * math.hypot(min(other.sigma_m, _MOST_M), own_sigma_m)
    if math.hypot(here[0] - there[0], here[1] - there[1]) > room_m:
        return False
    if other.vertical_known and one.vertical_known and abs(here[2] - there[2]) > _HIGH_M:
        return False
    velocity = one.velocity if one.moves else (0.0, 0.0, 0.0)
    (vn, ve, _), (on, oe, _) = velocity, other.velocity_ned_mps
    return math.hypot(vn - on, ve - oe) <= _ROOM_MPS


def _predicted(other: Neighbour) -> Vec3:
    (n, e, d), (vn, ve, vd), age = other.position_ned_m, other.velocity_ned_mps, other.age_s
    return n + age * vn, e + age * ve, d + age * vd
