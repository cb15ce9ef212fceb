"""The air between simulated aircraft: real frames in, the same frames out later, or never, as a channel says.

Pure: no clock and no socket; time and the random generator are passed in, and one generator with one order of
calls gives one air. It carries (address, transport, frame), which is what a radio reports about a reception.
The channel decides about each frame at each receiver, at once or later; until then the frame waits here.
Distances come from the positions a simulator tells (`place`); for a pair of which nobody told both, from the
Location messages that the two last put on the air.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np
import pymap3d

from companion.geometry import Vec3
from companion.radio.frames_io import FrameReceiver
from companion.remote_id.messages import Location
from sitl_mocks.air.pair_statistics import PairStats
from sitl_mocks.channel.air import Channel, Outcome, Transmission

MAX_PENDING = 100_000
"""Messages under way at once; more are dropped and counted."""
MAX_PAIRS = 10_000
"""Pairs with statistics of their own; the rest share one."""
MAX_CARRIED = 10_000
"""Senders whose last carried position is kept."""
REST = ("*", "*")
"""The pair under which the pairs beyond `MAX_PAIRS` are counted."""


@dataclass(frozen=True, slots=True)
class Delivery:
    """One frame arriving at one receiver."""

    receiver: str
    sender: str
    transport: str
    frame: bytes
    sent_s: float
    address: str
    """Radio address of the transmitter."""


@dataclass(slots=True)
class _OnAir:
    """A frame whose fate the channel has not told for every receiver."""

    sender: str
    transport: str
    frame: bytes
    address: str
    sent_s: float
    brings_position: bool
    undecided: set[str]


@dataclass(slots=True)
class _UnderWay:
    """A delivery, and whether it brings a position."""

    delivery: Delivery
    brings_position: bool


class Ether:
    """One shared air.

    Args:
        channel: decides delay and loss of every message for every receiver.
        rng: what the channel draws from.
        max_pending: bound on the messages under way.
    """

    def __init__(self, channel: Channel, rng: np.random.Generator, *, max_pending: int = MAX_PENDING) -> None:
        self._channel = channel
        self._rng = rng
        self._max_pending = max_pending
        self._receivers: dict[str, None] = {}  # a set that keeps the order of joining
        self._on_air: dict[int, _OnAir] = {}
        self._undecided = 0
        self._transmissions = 0
        self._queue: list[tuple[float, int, _UnderWay]] = []
        self._number = 0
        self._begin_s: float | None = None
        self._now_s = 0.0
        """Since the first call that told the time, as all ages of information are counted."""
        self._told: dict[str, Vec3] = {}
        # On the ellipsoid and Earth-centred, so that two positions need no common origin; and the altitude.
        self._carried: dict[str, tuple[Vec3, float | None]] = {}
        self._stats: dict[tuple[str, str], PairStats] = {}
        self._reader = FrameReceiver()

    def join(self, receiver: str) -> None:
        """From now on `receiver` hears what others send. Joining twice changes nothing."""
        self._receivers.setdefault(receiver)

    def leave(self, receiver: str) -> None:
        """`receiver` hears nothing more; what is under way to it is lost and its positions are forgotten.

        What it knew of others, and others of it, ages no further; frames of its own that are still under way
        arrive, but begin no new age.
        """
        self._receivers.pop(receiver, None)
        self._told.pop(receiver, None)
        self._carried.pop(receiver, None)
        for number, on_air in list(self._on_air.items()):
            if on_air.sender == receiver:
                on_air.brings_position = False
            if receiver in on_air.undecided:
                self._pair(on_air.sender, receiver).lost += 1
                self._close(number, receiver)
        kept = []
        for entry in self._queue:
            delivery = entry[2].delivery
            if delivery.receiver == receiver:
                self._pair(delivery.sender, receiver).lost += 1
                continue
            if delivery.sender == receiver:
                entry[2].brings_position = False
            kept.append(entry)
        heapq.heapify(kept)
        self._queue = kept
        for pair, stats in self._stats.items():
            if receiver in pair:
                stats.end(self._now_s)

    def place(self, name: str, position_ned_m: Vec3) -> None:
        """The simulator tells where `name` is (one common local NED frame for all, m).

        Raises:
            ValueError: not three finite numbers.
        """
        if len(position_ned_m) != 3 or not all(map(math.isfinite, position_ned_m)):
            raise ValueError(f"position of {name}: {position_ned_m} is not three finite numbers")
        self._told[name] = position_ned_m

    def transmit(
        self,
        now_s: float,
        sender: str,
        transport: str,
        frame: bytes,
        position_ned_m: Vec3 | None = None,
        *,
        address: str | None = None,
    ) -> None:
        """Put one frame on the air at `now_s`; every receiver but the sender itself may hear it.

        Args:
            now_s: time of sending (s).
            sender: name of the aircraft.
            transport: `companion.radio.radio` name.
            frame: the bytes on the air, unchanged to the receivers.
            position_ned_m: where the sender is, like `place`; None leaves what is known.
            address: the transmitter's radio address; the sender's name where there is none.

        Raises:
            ValueError: `now_s` or the position is not finite, the transport is none, or the channel let a
                frame arrive before it was sent.
        """
        if not math.isfinite(now_s):
            raise ValueError(f"time of sending: {now_s}")
        self._tell_time(now_s)
        if position_ned_m is not None:
            self.place(sender, position_ned_m)
        address = sender if address is None else address
        brings_position = self._read_position(sender, transport, address, frame)
        distance_m: dict[str, float | None] = {}
        for receiver in self._receivers:
            if receiver == sender:
                continue
            pair = self._pair(sender, receiver)
            pair.count_sent(transport)
            if self._undecided + len(distance_m) >= self._max_pending:
                pair.overflowed += 1
                continue
            distance_m[receiver] = away = self.distance_m(sender, receiver)
            if away is None:
                pair.unknown_distance += 1
        number = self._transmissions
        self._transmissions += 1
        if distance_m:
            self._on_air[number] = _OnAir(
                sender, transport, frame, address, now_s, brings_position, set(distance_m)
            )
            self._undecided += len(distance_m)
        # Also when nobody is there to hear it: it may collide with what others send.
        self._channel.transmit(Transmission(number, now_s, sender, transport, distance_m), self._rng)
        self._settle(now_s)

    def due(self, now_s: float) -> list[Delivery]:
        """What has arrived by `now_s`, in order of arrival; what arrives together, in order of sending.

        A frame that the channel decided late stands behind what an earlier call gave.
        """
        self._tell_time(now_s)
        self._settle(now_s)
        arrived = []
        while self._queue and self._queue[0][0] <= now_s:
            under_way = heapq.heappop(self._queue)[2]
            delivery = under_way.delivery
            pair = self._pair(delivery.sender, delivery.receiver)
            pair.count_delivery(delivery.transport, now_s - delivery.sent_s)
            # The pair of the rest is many pairs: what one heard is not what another knows.
            if under_way.brings_position and pair is not self._stats.get(REST):
                pair.refresh(self._now_s, self._now_s - (now_s - delivery.sent_s))
            arrived.append(delivery)
        return arrived

    def next_due_s(self) -> float | None:
        """When `due` may have something to give; None when nothing is under way."""
        times = [self._queue[0][0]] if self._queue else []
        decision_s = self._channel.next_s()
        return min(times if decision_s is None else [*times, decision_s], default=None)

    def finish(self, now_s: float) -> None:
        """The run is over: the ages of information in `stats` are counted up to now."""
        self._tell_time(now_s)
        for stats in self._stats.values():
            stats.end(self._now_s)

    def distance_m(self, first: str, second: str) -> float | None:
        """Slant distance of two aircraft (m); None when not known."""
        if first in self._told and second in self._told:
            return math.dist(self._told[first], self._told[second])
        if first in self._carried and second in self._carried:
            return _carried_distance_m(self._carried[first], self._carried[second])
        return None

    def information_age_s(self, sender: str, receiver: str) -> float | None:
        """Age (s), at the last time told, of what `receiver` knows of `sender`; None before any news."""
        stats = self._stats.get((sender, receiver))
        freshest_s = None if stats is None else stats.freshest_s
        return None if freshest_s is None else self._now_s - freshest_s

    @property
    def receivers(self) -> tuple[str, ...]:
        """Who listens, in order of joining."""
        return tuple(self._receivers)

    @property
    def stats(self) -> dict[tuple[str, str], PairStats]:
        """Statistics by (sender, receiver). Frames count as delivered at the moment `due` hands them over."""
        return self._stats

    def _tell_time(self, now_s: float) -> None:
        if self._begin_s is None:
            self._begin_s = now_s
        self._now_s = now_s - self._begin_s

    def _settle(self, now_s: float) -> None:
        for outcome in self._channel.settle(now_s, self._rng):
            on_air = self._on_air.get(outcome.number)
            # Not there any more when the receiver left, which counted it.
            if on_air is not None and outcome.receiver in on_air.undecided:
                self._take(outcome, on_air)
                self._close(outcome.number, outcome.receiver)

    def _take(self, outcome: Outcome, on_air: _OnAir) -> None:
        """One frame's fate at one receiver is known."""
        pair = self._pair(on_air.sender, outcome.receiver)
        if outcome.arrival_s is None:
            pair.lost += 1
            return
        if not on_air.sent_s <= outcome.arrival_s < math.inf:
            raise ValueError(f"the channel gave arrival at {outcome.arrival_s} s, sent at {on_air.sent_s} s")
        if len(self._queue) >= self._max_pending:
            pair.overflowed += 1
            return
        delivery = Delivery(
            outcome.receiver, on_air.sender, on_air.transport, on_air.frame, on_air.sent_s, on_air.address
        )
        # The running number settles ties, so that deliveries themselves are never compared.
        entry = (outcome.arrival_s, self._number, _UnderWay(delivery, on_air.brings_position))
        heapq.heappush(self._queue, entry)
        self._number += 1

    def _close(self, number: int, receiver: str) -> None:
        """Nothing more is to be told about a frame at a receiver."""
        undecided = self._on_air[number].undecided
        undecided.remove(receiver)
        self._undecided -= 1
        if not undecided:
            del self._on_air[number]

    def _pair(self, sender: str, receiver: str) -> PairStats:
        key = (sender, receiver)
        found = self._stats.get(key)
        if found is not None:
            return found
        if len(self._stats) >= MAX_PAIRS:
            key = REST
        return self._stats.setdefault(key, PairStats())

    def _read_position(self, sender: str, transport: str, address: str, frame: bytes) -> bool:
        """Whether a frame brings a position; it is noted for a sender of whom nobody tells it."""
        heard = self._reader.receive(transport, address, frame)
        found = False
        for message in heard.messages if heard is not None else ():
            if isinstance(message, Location) and message.lat_deg is not None and message.lon_deg is not None:
                found = True
                if sender not in self._told and (sender in self._carried or len(self._carried) < MAX_CARRIED):
                    x, y, z = pymap3d.geodetic2ecef(message.lat_deg, message.lon_deg, 0.0)
                    self._carried[sender] = (float(x), float(y), float(z)), message.alt_geodetic_m
        return found


def _carried_distance_m(first: tuple[Vec3, float | None], second: tuple[Vec3, float | None]) -> float:
    """Slant distance (m); horizontal only where an altitude is missing."""
    level = math.dist(first[0], second[0])
    if first[1] is None or second[1] is None:
        return level
    return math.hypot(level, first[1] - second[1])
