"""Carrier sense: when a Wi-Fi station that wants to send a beacon really begins to send it.

The distributed coordination function of IEEE 802.11 (DCF) for frames without acknowledgement, which are sent
once and never again. A station that finds the medium idle, and idle for a DIFS before, begins at once. Else
it waits until the medium has been idle for a DIFS and then counts down a number of backoff slots, which stops
while the medium is busy and goes on after the next DIFS. Stations whose countdowns end together collide, and
so do stations that do not hear each other.

Left out: the few microseconds that it takes to notice a transmission and to turn from listening to sending;
the longer wait (EIFS) after a frame that a collision made illegible; that a station waits for Bluetooth or
for foreign transmissions. A station senses the channel on which it sends, at all times.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Hashable
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Bools = NDArray[np.bool_]

DIFS_MS: Final = 0.05
BACKOFF_SLOT_MS: Final = 0.02
MAX_BACKOFF: Final = 31
"""CWmin; without acknowledgements the contention window stays. All three as for DSSS; OFDM that shares the
band with DSSS differs by its CWmin of 15."""

_ROUNDING = 1e-6
"""Of a backoff slot: a station that begins at the end of the others' nth slot leaves them n slots on."""


@dataclass(frozen=True, slots=True)
class Beacon:
    """What a station wants to send. Times in any unit, the same for all."""

    number: int
    """The caller's."""
    station: Hashable
    channel: int
    wanted: float
    """When it would begin if the medium were idle."""
    duration: float
    heard_by: AbstractSet[Hashable]
    """The stations that sense it."""
    backoff: int
    """Slots to count down if it must wait, uniform in 0 to `MAX_BACKOFF`. Drawn by the caller."""


@dataclass(slots=True)
class _Waiting:
    """A station that counts down."""

    beacon: Beacon
    left: int
    """Backoff slots left at `since`."""
    since: float
    """When the countdown goes on: a DIFS after the medium became idle."""
    begin: float
    """When it will be over if the medium stays idle."""


class WifiAccess:
    """The stations' access to the medium, through time. A pure function of what is wanted.

    A station waits with one beacon at a time: where it wants the next one before it could send, the newer
    takes the older one's place in the countdown and the older one is never sent.

    Args:
        difs: in the unit of all times.
        backoff_slot: likewise.
    """

    def __init__(self, difs: float, backoff_slot: float) -> None:
        self._difs, self._slot = difs, backoff_slot
        self._wanted: list[tuple[float, int, Beacon]] = []
        self._waiting: dict[Hashable, _Waiting] = {}
        self._sent: list[tuple[float, Beacon]] = []
        """With their ends; those that ended less than a DIFS ago, or later."""
        self._until = -math.inf

    def want(self, beacon: Beacon) -> None:
        """Take up a beacon. Those wanted at one time get their turns in the order of their numbers.

        Raises:
            ValueError: it is wanted before a time up to which all was decided.
        """
        if beacon.wanted < self._until:
            raise ValueError(f"beacon {beacon.number}: wanted {beacon.wanted} before {self._until}")
        heapq.heappush(self._wanted, (beacon.wanted, beacon.number, beacon))

    def advance(self, until: float) -> list[tuple[int, float | None]]:
        """Decide all that happens before a time: nothing wanted before it may come later.

        Returns:
            By time, the numbers of the beacons that begin before `until`, each with its beginning; and those
            that newer ones replaced, with None.
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
        """When something may happen next, as far as is known; None when nothing is wanted."""
        time = self._next()
        return None if math.isinf(time) else time

    def _next(self) -> float:
        wanted = self._wanted[0][0] if self._wanted else math.inf
        return min(wanted, min((w.begin for w in self._waiting.values()), default=math.inf))

    def _busy_until(self, beacon: Beacon) -> float:
        """Until when the medium is busy, or was, where the station is."""
        heard = (
            end
            for end, other in self._sent
            if other.channel == beacon.channel
            and (beacon.station in other.heard_by or beacon.station == other.station)
        )
        return max(heard, default=-math.inf)

    def _send(self, beacon: Beacon, now: float) -> None:
        """The stations that hear it stop counting, but for those whose countdown ends at this very time."""
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
    """When beacons begin, shape (beacons,); NaN for those that newer ones of the same station replaced.

    Args:
        wanted: shape (beacons,), in any order, in slots of the channel model.
        station: shape (beacons,): row of `hears`.
        channel: shape (beacons,).
        duration: of each (slots).
        hears: shape (stations, stations): whether the transmitter (row) is sensed by the other (column).
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
