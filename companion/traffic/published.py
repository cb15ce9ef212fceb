"""Traffic heard by Remote ID, as ADSB_VEHICLE for the maps of ground stations.

ADSB_VEHICLE has no target, so an autopilot takes it too and may avoid such traffic by itself. It is published
only if the configuration says so.

Each report has an address that no aircraft uses: ICAO 24-bit addresses that begin with 1011 belong to no
state (ICAO Annex 10, Volume III, chapter 9, table 9-1: reserved). The callsign is "RID" and the last five
letters or digits of the identity. Address and callsign together mark the source: an ADSB_VEHICLE that has
both is never read as traffic, whichever companion published it.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable

from companion.avoidance.law import ASIDE, Neighbour
from companion.events import AdsbVehicle, TrafficReport
from companion.geometry import LocalFrame, Vec3

BLOCK, BLOCK_BITS = 0xB00000, 20
MARK = "RID"
MOST = 10
"""Most aircraft that are published at a time, the nearest ones; Mission Planner's uplink has the same."""
PERIOD_S = 1.0
"""Least time between two reports of one aircraft."""
_APART_S = PERIOD_S / MOST
"""Least time between any two reports: 500 bytes a second at most."""
_OLDEST_S = 10.0
"""Aircraft whose last message is older are not published. QGroundControl refuses reports of 15 s and more."""
_EPSILON_S = 1e-6
_HOVERS_MPS = 0.3
_LETTERS = 5


def is_published(event: AdsbVehicle) -> bool:
    """Whether a companion has published this report, so that it is no ADS-B."""
    return event.icao >> BLOCK_BITS == BLOCK >> BLOCK_BITS and event.callsign.startswith(MARK)


class Publication:
    """Chooses which aircraft is published next: at most one report each `_APART_S`, and at most `MOST`
    aircraft."""

    def __init__(self) -> None:
        self._sent_s: dict[str, float] = {}
        self._addresses: dict[str, int] = {}
        """Address of each aircraft that has one, and is still heard."""
        self._last_s = -math.inf

    def ready(self, now_s: float) -> bool:
        """Whether the time for the next report has come."""
        return now_s - self._last_s >= _APART_S - _EPSILON_S

    def due(
        self, now_s: float, here: Vec3, frame: LocalFrame, heard: Iterable[Neighbour]
    ) -> list[TrafficReport]:
        """The next report, if one is due.

        Args:
            here: own position (local NED, m).
            frame: local frame; its altitudes are above mean sea level.
            heard: all aircraft heard by Remote ID. Places where one is only suspected are left out.
        """
        if not self.ready(now_s):
            return []
        near = sorted(
            (_horizontal_m(other, here), other.track_id, other)
            for other in heard
            if ASIDE not in other.track_id and other.age_s <= _OLDEST_S
        )[:MOST]
        shown = {name: other for _, name, other in near}
        self._sent_s = {name: at_s for name, at_s in self._sent_s.items() if name in shown}
        self._addresses = {name: icao for name, icao in self._addresses.items() if name in shown}
        waits = [(self._sent_s.get(name, -math.inf), name) for _, name, _ in near]
        waits = [wait for wait in waits if now_s - wait[0] >= PERIOD_S - _EPSILON_S]
        if not waits:
            return []
        name = min(waits)[1]
        self._last_s = self._sent_s[name] = now_s
        return [_report(shown[name], frame, self._address(name))]

    def _address(self, name: str) -> int:
        """Address of an aircraft: the same on every companion, unless two of those shown would share it."""
        if name not in self._addresses:
            digest = hashlib.sha256(name.encode("utf-8", "replace")).digest()
            number, taken = int.from_bytes(digest[:4], "big"), set(self._addresses.values())
            while BLOCK + number % (1 << BLOCK_BITS) in taken:
                number += 1
            self._addresses[name] = BLOCK + number % (1 << BLOCK_BITS)
        return self._addresses[name]


def _horizontal_m(other: Neighbour, here: Vec3) -> float:
    return math.hypot(other.position_ned_m[0] - here[0], other.position_ned_m[1] - here[1])


def _report(other: Neighbour, frame: LocalFrame, icao: int) -> TrafficReport:
    lat_deg, lon_deg, alt_msl_m = frame.to_geodetic(*other.position_ned_m)
    return TrafficReport(
        icao=icao,
        callsign=MARK + re.sub("[^0-9A-Z]", "", other.track_id.upper())[-_LETTERS:],
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        alt_msl_m=alt_msl_m if other.vertical_known else None,
        velocity_ned_mps=other.velocity_ned_mps,
        hovers=math.hypot(*other.velocity_ned_mps[:2]) < _HOVERS_MPS,
        age_s=max(0.0, other.age_s),
    )
