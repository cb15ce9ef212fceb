"""Crewed traffic and others heard by ADS-B, through the autopilot's receiver (ADSB_VEHICLE).

Altitudes decide whether an aircraft passes above or below. A geometric one can be compared with our own; a
barometric one cannot: transponders send the pressure altitude of the standard atmosphere, 8 m off for each
hectopascal that the day's pressure differs, and receivers pass it on as it is. It separates only where the
difference is more than any weather makes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.avoidance.law import Neighbour
from companion.events import AdsbVehicle
from companion.geometry import LocalFrame, Vec3
from companion.traffic.right_of_way import CREWED, FREE, share_of

SIGMA_M = 15.0
"""One axis; the message does not tell. NACp 8, the least that most airspace asks for, is 93 m at 95 %; GNSS
receivers of today are a tenth of it."""
SIGMA_MPS = 1.5
"""NACv 2: 3 m/s at 95 %."""
BAROMETRIC_M = 300.0
"""Weather: 37 hPa off the standard atmosphere."""
MOST = 200
EXPIRE_S = 15.0
_MAX_RANGE_M = 50_000.0
_STAMP_S = 0.5
"""Ages come in whole seconds, cut off."""
_REPEATED_S = 5.0
_APART_S = 1.0
_STILL: Vec3 = (0.0, 0.0, 0.0)
_NOT_CREWED = frozenset({14, 17, 18, 19})
"""ADSB_EMITTER_TYPE: UAV, surface vehicles, point obstacle: the separations of drones do."""


@dataclass(slots=True)
class _Seen:
    position: Vec3
    velocity: Vec3
    at_s: float
    vertical_known: bool
    barometric: bool
    crewed: bool
    told: tuple[object, ...]
    anchor: _Seen | None
    """A report a second or more before this one."""


class AdsbTraffic:
    """Aircraft heard by ADS-B, at most `MOST`; of more, the farthest from us are left out.

    Args:
        own_icao: our own transponder's address, which a receiver aboard hears too; None: we have none.
    """

    def __init__(self, own_icao: int | None) -> None:
        self._own_icao = own_icao
        self._seen: dict[int, _Seen] = {}

    def take(
        self,
        event: AdsbVehicle,
        now_s: float,
        frame: LocalFrame,
        separation_m: float | None,
        own_ned_m: Vec3,
    ) -> None:
        """Take in one report.

        Args:
            frame: local frame (its altitude datum is mean sea level).
            separation_m: height of the geoid above the ellipsoid here; None while unknown.
            own_ned_m: own position, which of too many the farthest are told by.
        """
        if event.icao == self._own_icao:
            return
        at_s = now_s - event.age_s - _STAMP_S
        before = self._seen.get(event.icao)
        told = (event.lat_deg, event.lon_deg, event.alt_m, event.velocity_ned_mps)
        # ArduPilot repeats the last report for seconds, with the age that it had at first; one that stands
        # still looks the same.
        repeated = before is not None and told == before.told and at_s - before.at_s <= _REPEATED_S
        if before is not None and (at_s <= before.at_s or (repeated and event.velocity_ned_mps != _STILL)):
            return
        alt_msl_m = event.alt_m
        if event.alt_geometric and alt_msl_m is not None:
            alt_msl_m = None if separation_m is None else alt_msl_m - separation_m
        position = frame.to_ned(event.lat_deg, event.lon_deg, frame.alt_m if alt_msl_m is None else alt_msl_m)
        if math.hypot(position[0], position[1]) > _MAX_RANGE_M:
            return
        self._seen.pop(event.icao, None)
        if len(self._seen) >= MOST and not self._make_room(math.dist(position, own_ned_m), now_s, own_ned_m):
            return
        seen = self._seen[event.icao] = _Seen(
            position=position,
            velocity=event.velocity_ned_mps or (_STILL if before is None else before.velocity),
            at_s=at_s,
            vertical_known=alt_msl_m is not None,
            barometric=not event.alt_geometric,
            crewed=event.emitter not in _NOT_CREWED,
            told=told,
            anchor=before,
        )
        if before is not None:
            # Velocity from positions wants two that are not too near, however often they come.
            anchor = before if before.anchor is None or at_s - before.at_s >= _APART_S else before.anchor
            seen.anchor = anchor
            anchor.anchor = None
            if event.velocity_ned_mps is None and at_s - anchor.at_s >= _APART_S:
                seen.velocity = _between(anchor, seen)

    def _make_room(self, distance_m: float, now_s: float, own_ned_m: Vec3) -> bool:
        """For one at this distance; False: nobody is farther away. The silent ones go first, or who once was
        near would keep others out for ever."""
        self._expire(now_s)
        if len(self._seen) < MOST:
            return True
        away_m = {icao: math.dist(seen.position, own_ned_m) for icao, seen in self._seen.items()}
        farthest = max(away_m, key=away_m.__getitem__)
        if away_m[farthest] <= distance_m:
            return False
        del self._seen[farthest]
        return True

    def _expire(self, now_s: float) -> None:
        for icao in [i for i, seen in self._seen.items() if now_s - seen.at_s > EXPIRE_S]:
            del self._seen[icao]

    def clear(self) -> None:
        """Forget all places: the frame they were given in is no more."""
        self._seen.clear()

    def neighbours(self, now_s: float, own_down_m: float) -> list[Neighbour]:
        """Every live one, as the law takes it.

        Args:
            own_down_m: own NED down, that barometric altitudes are told apart from.
        """
        self._expire(now_s)
        return self.look(now_s, own_down_m)

    def look(self, now_s: float, own_down_m: float) -> list[Neighbour]:
        """The same, forgetting nobody: who only watches must not change what a replay comes to."""
        return [
            _neighbour(icao, seen, now_s, own_down_m)
            for icao, seen in self._seen.items()
            if now_s - seen.at_s <= EXPIRE_S
        ]


def _neighbour(icao: int, seen: _Seen, now_s: float, own_down_m: float) -> Neighbour:
    known = seen.vertical_known
    if seen.barometric:
        known = known and abs(seen.position[2] - own_down_m) > BAROMETRIC_M
    return Neighbour(
        track_id=f"{icao:06X}",
        position_ned_m=seen.position,
        velocity_ned_mps=seen.velocity,
        age_s=max(0.0, now_s - seen.at_s),
        sigma_m=SIGMA_M,
        sigma_mps=SIGMA_MPS,
        share=share_of(FREE, CREWED if seen.crewed else FREE),
        vertical_known=known,
        crewed=seen.crewed,
        adsb=True,
    )


def _between(a: _Seen, b: _Seen) -> Vec3:
    """Velocity from one report to the next; vertical only between heights of one kind."""
    k = 1.0 / (b.at_s - a.at_s)
    alike = a.vertical_known and b.vertical_known and a.barometric == b.barometric
    north, east, down = (k * (q - p) for p, q in zip(a.position, b.position, strict=True))
    return north, east, down if alike else 0.0
