"""Carrier sense: when a Wi-Fi station that wants to send a beacon really begins to send it.

This is the distributed coordination function of IEEE 802.11 (DCF) for frames without acknowledgement, which
are never repeated. A station begins at once if the medium is idle and has been idle for a DIFS. Otherwise
it waits until the medium has been idle for a DIFS and then counts down a number of backoff slots. The
countdown stops while the medium is busy and continues after the next DIFS. Stations whose countdowns end
together collide, and so do stations that do not hear each other.

Not modelled: the few microseconds needed to notice a transmission and to switch from listening to sending;
the longer wait (EIFS) after a frame that a collision made undecodable; waiting for Bluetooth or for foreign
transmissions. A station senses the channel on which it sends, at all times.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Hashable
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.arrays import Bools, Floats, Indices

DIFS_MS: Final = 0.05
BACKOFF_SLOT_MS: Final = 0.02
MAX_BACKOFF: Final = 31
"""CWmin. Without acknowledgements the contention window stays constant. All three values are those of DSSS;
OFDM that shares the band with DSSS differs by its CWmin of 15.
"""

_ROUNDING = 1e-6
"""Tolerance as a share of a backoff slot. A station that begins at the end of the others' nth slot reduces
their countdown by n slots.
"""


@dataclass(frozen=True, slots=True)
class Beacon:
    """A beacon that a station wants to send. Times are in any unit, the same for all."""

    number: int
    """Number given by the caller."""
    station: Hashable
    channel: int
    wanted: float
    """Time at which it would begin if the medium were idle."""
    duration: float
    heard_by: AbstractSet[Hashable]
    """Stations that sense it."""
    backoff: int
    """Slots to count down if the station must wait, drawn by the caller uniformly from 0 to `MAX_BACKOFF`."""


@dataclass(slots=True)
class _Waiting:
    """A station that counts down."""

    beacon: Beacon
    left: int
    """Backoff slots left at `since`."""
    since: float
    """Time at which the countdown continues: a DIFS after the medium became idle."""
    begin: float
    """Time at which the countdown ends if the medium stays idle."""


class WifiAccess:
    """Access of all stations to the medium over time. The result depends only on the beacons that are wanted.

    A station waits with one beacon at a time. If it wants to send the next one before the current one could
    be sent, the newer one takes the older one's place in the countdown, and the older one is never sent.

    Args:
        difs: length of a DIFS, in the unit of all times.
        backoff_slot: length of a backoff slot, in the same unit.
    """

    def __init__(self, difs: float, backoff_slot: float) -> None:
        self._difs, self._slot = difs, backoff_slot
        self._wanted: list[tuple[float, int, Beacon]] = []
        self._waiting: dict[Hashable, _Waiting] = {}
        self._sent: list[tuple[float, Beacon]] = []
        """Beacons that were sent, with their end times. Those that ended a DIFS ago or earlier are
        dropped.
        """
        self._until = -math.inf

    def want(self, beacon: Beacon) -> None:
        """Add a beacon. Beacons wanted at the same time are processed in the order of their numbers.

        Raises:
            ValueError: the beacon is wanted before a time up to which everything was decided.
        """
        if beacon.wanted < self._until:
            raise ValueError(
                f"beacon {beacon.number}: it is wanted at {beacon.wanted}, but everything before "
                f"{self._until} is already decided"
            )
        heapq.heappush(self._wanted, (beacon.wanted, beacon.number, beacon))

    def advance(self, until: float) -> list[tuple[int, float | None]]:
        """Decide everything that happens before a time. No beacon wanted before that time may be added later.

        Returns:
            In time order, the numbers of the beacons that begin before `until`, each with its start time.
            Beacons that newer ones replaced are included with None.
        """
        decided: list[tuple[int, float | None]] = []
        while (now := self._next()) < until:
            over = next((w.beacon for w in self._waiting.values() if w.begin == now), None)
            if over is not None:
                del self._waiting[over.station]
                decided.append((over.number, now))
                self._send(over, now)
                continue
            beacon = heapq.heappop(self._wanted)[2]
            waiting = self._waiting.get(beacon.station)
            busy_until = self._busy_until(beacon)
            if waiting is not None:
                decided.append((waiting.beacon.number, None))
                waiting.beacon = beacon
            elif busy_until > now - self._difs:
                since = busy_until + self._difs
                begin = since + beacon.backoff * self._slot
                self._waiting[beacon.station] = _Waiting(beacon, beacon.backoff, since, begin)
            else:
                decided.append((beacon.number, now))
                self._send(beacon, now)
        self._until = max(self._until, until)
        return decided

    def next_time(self) -> float | None:
        """Earliest time at which something may happen, as far as is known. None if no beacon is wanted."""
        time = self._next()
        return None if math.isinf(time) else time

    def _next(self) -> float:
        wanted = self._wanted[0][0] if self._wanted else math.inf
        return min(wanted, min((w.begin for w in self._waiting.values()), default=math.inf))

    def _busy_until(self, beacon: Beacon) -> float:
        """Time until which the medium at the station is or was busy."""
        heard = (
            end
            for end, other in self._sent
            if other.channel == beacon.channel
            and (beacon.station in other.heard_by or beacon.station == other.station)
        )
        return max(heard, default=-math.inf)

    def _send(self, beacon: Beacon, now: float) -> None:
        """Send a beacon. Stations that hear it stop counting, unless their countdown ends at the same
        time.
        """
        end = now + beacon.duration
        self._sent = [sent for sent in self._sent if sent[0] > now - self._difs]
        self._sent.append((end, beacon))
        for station, waiting in self._waiting.items():
            same_channel = waiting.beacon.channel == beacon.channel
            if not same_channel or station not in beacon.heard_by or waiting.begin <= now:
                continue
            if now > waiting.since:
                waiting.left -= math.floor((now - waiting.since) / self._slot + _ROUNDING)
            waiting.since = max(waiting.since, end + self._difs)
            waiting.begin = waiting.since + waiting.left * self._slot


def defer(
    wanted: Floats,
    station: Indices,
    channel: Indices,
    duration: float,
    hears: Bools,
    slot_ms: float,
    rng: np.random.Generator,
) -> Floats:
    """Start times of beacons, shape (beacons,); NaN for those that newer ones of the same station replaced.

    Args:
        wanted: shape (beacons,), in any order, in slots of the channel model.
        station: shape (beacons,): row of `hears`.
        channel: shape (beacons,).
        duration: duration of each beacon (slots).
        hears: shape (stations, stations): whether the station in the column senses the transmitter in the
            row.
        slot_ms: length of a slot of the channel model.
        rng: draws one backoff for each beacon, whether it has to wait or not.
    """
    heard_by = [frozenset(np.nonzero(row)[0].tolist()) for row in hears]
    access = WifiAccess(DIFS_MS / slot_ms, BACKOFF_SLOT_MS / slot_ms)
    backoff = rng.integers(0, MAX_BACKOFF, len(wanted), endpoint=True)
    rows = zip(wanted.tolist(), station.tolist(), channel.tolist(), backoff.tolist(), strict=True)
    for number, (at, sender, on, slots) in enumerate(rows):
        access.want(Beacon(number, sender, on, at, duration, heard_by[sender], slots))
    begin = np.full(len(wanted), np.nan)
    for number, time in access.advance(math.inf):
        if time is not None:
            begin[number] = time
    return begin
