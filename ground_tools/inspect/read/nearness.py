"""How near other aircraft came to one aircraft, according to the positions that they reported.

Rows hold one approach a second, so that a day with busy traffic stays small.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from companion.arrays import Floats
from companion.events import AdsbVehicle
from companion.geometry import LocalFrame, Vec3

ADSB_STAMP_S = 0.5
"""Mean error of the age of an ADS-B report, which is whole seconds, rounded down."""
_COLUMNS = 4
_MOST = 2000
"""Most addresses of each kind (ADS-B, Remote ID) kept for one record: the nearest. A log with more of them is
damaged or hostile."""


@dataclass(slots=True)
class Approaches:
    """Collects approaches of one aircraft; keeps the nearest one of each second."""

    values: array[float] = field(default_factory=lambda: array("d"))
    least_m: float = math.inf
    """Least slant distance of all."""

    def add(self, now_s: float, away_ned_m: Vec3, *, vertical_known: bool) -> None:
        """Add one position relative to our own.

        Args:
            now_s: time, not before the last one.
            away_ned_m: other minus own.
            vertical_known: whether the third component is valid.
        """
        aside = math.hypot(away_ned_m[0], away_ned_m[1])
        above = -away_ned_m[2] if vertical_known else math.nan
        row = now_s, math.hypot(aside, above) if vertical_known else aside, aside, above
        self.least_m = min(self.least_m, row[1])
        if not self.values or now_s - math.floor(self.values[-_COLUMNS]) >= 1.0:
            self.values.extend(row)
        elif row[1] < self.values[1 - _COLUMNS]:
            self.values[-_COLUMNS:] = array("d", row)

    def rows(self) -> Floats:
        """(n, 4) now_s, slant distance (m), distance to the side (m), height above us (m).

        The height is NaN if it is unknown; the slant distance is then the distance to the side.
        """
        return np.asarray(self.values).reshape(-1, _COLUMNS)


@dataclass(frozen=True, slots=True)
class HeardAdsb:
    """One aircraft that the autopilot's ADS-B receiver heard."""

    callsign: str
    reports: int
    first_s: float
    last_s: float
    barometric: bool
    """True if any of its altitudes was barometric. These are compared with our height above mean sea level,
    from which they may differ by a hundred metres or more."""
    near: Floats
    """As `Approaches.rows`."""


@dataclass(slots=True)
class Sender:
    """What is collected of one address."""

    reports: int = 0
    near: Approaches = field(default_factory=Approaches)


Address = TypeVar("Address", bound=Hashable)
AnySender = TypeVar("AnySender", bound=Sender)


class NearestSenders(Generic[Address, AnySender]):
    """Senders by their addresses, of which only the nearest are kept."""

    def __init__(self, new: Callable[[], AnySender]) -> None:
        self.kept: dict[Address, AnySender] = {}
        self.left_out = 0
        """Number of reports of senders that were farther away than the `_MOST` that are kept."""
        self._new = new
        self._farthest: tuple[float, Address] | None = None
        """Least distance so far of the farthest kept sender when it was last searched, and its address."""

    def of(self, address: Address, away_m: Vec3 | None) -> AnySender | None:
        """Return the sender of a report, which is counted; None if the sender is not kept.

        Args:
            address: its address.
            away_m: its reported position relative to ours; None if unknown.
        """
        if address not in self.kept and len(self.kept) >= _MOST and not self._make_room(away_m):
            self.left_out += 1
            return None
        if (one := self.kept.get(address)) is None:
            one = self.kept[address] = self._new()
        one.reports += 1
        return one

    def _make_room(self, away_m: Vec3 | None) -> bool:
        """Drop the farthest sender if a new one is nearer; return whether there is room now."""
        if away_m is None:
            return False
        slant_m = math.hypot(*away_m)
        # A kept sender may only have come nearer since the search, so a new one that is farther than its
        # distance then needs no new search.
        if self._farthest is None or slant_m < self._farthest[0]:
            self._farthest = max(
                ((one.near.least_m, address) for address, one in self.kept.items()), key=lambda one: one[0]
            )
        if slant_m >= self._farthest[0]:
            return False
        self.left_out += self.kept.pop(self._farthest[1]).reports
        self._farthest = None
        return True


@dataclass(slots=True)
class _Adsb(Sender):
    first_s: float = math.nan
    callsign: str = ""
    last_s: float = 0.0
    barometric: bool = False


class AdsbTally:
    """Collects the ADS-B reports of one record."""

    def __init__(self) -> None:
        self._senders: NearestSenders[int, _Adsb] = NearestSenders(_Adsb)

    @property
    def left_out(self) -> int:
        """Number of reports of aircraft that are not kept."""
        return self._senders.left_out

    def hear(
        self,
        now_s: float,
        event: AdsbVehicle,
        own: tuple[float, float, float] | None,
        undulation_m: float | None,
    ) -> None:
        """Add a report.

        Args:
            now_s: time of its reception.
            event: the report.
            own: our latitude, longitude (deg) and altitude above mean sea level; None if unknown.
            undulation_m: height of the geoid above the ellipsoid. While it is unknown (None), a geometric
                altitude, which is above the ellipsoid, cannot be compared with ours.
        """
        away_m: Vec3 | None = None
        alt_m = event.alt_m
        if own is not None:
            if event.alt_geometric and alt_m is not None:
                alt_m = None if undulation_m is None else alt_m - undulation_m
            away_m = _away(event, own[2] if alt_m is None else alt_m, own)
        one = self._senders.of(event.icao, away_m)
        if one is None:
            return
        one.first_s, one.last_s = now_s if one.reports == 1 else one.first_s, now_s
        one.callsign = event.callsign.strip() or one.callsign
        one.barometric |= event.alt_m is not None and not event.alt_geometric
        if away_m is not None:
            one.near.add(now_s, away_m, vertical_known=alt_m is not None)

    def heard(self) -> dict[str, HeardAdsb]:
        """The received aircraft, by the ICAO address in hexadecimal digits."""
        return {
            f"{icao:06X}": HeardAdsb(
                one.callsign, one.reports, one.first_s, one.last_s, one.barometric, one.near.rows()
            )
            for icao, one in self._senders.kept.items()
        }


def _away(event: AdsbVehicle, alt_msl_m: float, own: tuple[float, float, float]) -> Vec3:
    """Position of the other aircraft relative to our own, extrapolated over the age of the report."""
    north, east, down = LocalFrame(*own).to_ned(event.lat_deg, event.lon_deg, alt_msl_m)
    age_s = event.age_s + ADSB_STAMP_S
    v = event.velocity_ned_mps or (0.0, 0.0, 0.0)
    return north + v[0] * age_s, east + v[1] * age_s, down + v[2] * age_s
