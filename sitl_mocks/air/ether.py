"""The air between simulated aircraft: delivers real frames unchanged, later or never, as a channel decides.

This module uses no clock or socket. Time and the random generator are passed in, so the same generator and
the same calls give the same result. The air carries (address, transport, frame), which is what a radio
reports about a reception. The channel decides about each frame at each receiver, at once or later; until then
the frame waits here. Distances come from the positions that a simulator sets (`place`). For a pair without
both positions they come from the latest Location messages that the two aircraft sent.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass

import msgspec
import numpy as np
import pymap3d

from companion.events import RemoteIdHeard
from companion.geometry import Vec3
from companion.radio.frames_io import FrameReceiver
from companion.remote_id.messages import Location
from sitl_mocks.air.pair_statistics import PairStats
from sitl_mocks.channel.air import Channel, Outcome, Transmission

MAX_PENDING = 100_000
"""Largest number of frames in transit. Further frames are dropped and counted."""
MAX_PAIRS = 10_000
"""Number of pairs with statistics of their own. All other pairs share one entry."""
MAX_CARRIED = 10_000
"""Number of senders whose latest Location position is kept."""
REST = ("*", "*")
"""Key of the statistics of all pairs beyond `MAX_PAIRS`."""


class Delivery(msgspec.Struct, frozen=True):
    """One frame that arrives at one receiver."""

    receiver: str
    sender: str
    transport: str
    frame: bytes
    sent_s: float
    address: str
    """Radio address of the transmitter."""


@dataclass(slots=True)
class _OnAir:
    """A frame for which the channel has not yet given the outcome at every receiver."""

    sender: str
    transport: str
    frame: bytes
    address: str
    sent_s: float
    brings_position: bool
    undecided: set[str]


class _UnderWay(msgspec.Struct):
    """A delivery, and whether its frame contains a position."""

    delivery: Delivery
    brings_position: bool


class Ether:
    """One air that all aircraft share.

    Args:
        channel: decides delay and loss of every frame for every receiver.
        rng: random generator for the channel.
        max_pending: largest number of frames in transit.
        read: reads a frame, as `FrameReceiver.receive` does; None: with a receiver of its own.
    """

    def __init__(
        self,
        channel: Channel,
        rng: np.random.Generator,
        *,
        max_pending: int = MAX_PENDING,
        read: Callable[[str, str, bytes], RemoteIdHeard | None] | None = None,
    ) -> None:
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
        """Time since the first call with a time. Ages of information use this time."""
        self._told: dict[str, Vec3] = {}
        # Earth-centred position on the ellipsoid, so that two positions need no common origin, and altitude.
        self._carried: dict[str, tuple[Vec3, float | None]] = {}
        self._stats: dict[tuple[str, str], PairStats] = {}
        self._read = FrameReceiver().receive if read is None else read

    def join(self, receiver: str) -> None:
        """Let `receiver` hear what others send from now on. Joining twice changes nothing."""
        self._receivers.setdefault(receiver)

    def leave(self, receiver: str) -> None:
        """Remove `receiver`. Frames in transit to it are lost, and its positions are forgotten.

        The ages of information of its pairs, as sender or receiver, stop counting. Frames that it sent and
        that are still in transit arrive, but do not restart an age of information.
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
        """Set the position of `name` (m, in one local NED frame common to all).

        Raises:
            ValueError: `position_ned_m` is not three finite numbers.
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
        """Put one frame on the air at `now_s`. Every receiver except the sender itself may hear it.

        Args:
            now_s: time of sending (s).
            sender: name of the aircraft.
            transport: name from `companion.remote_id.transports`.
            frame: the bytes on the air, which reach the receivers unchanged.
            position_ned_m: position of the sender, as for `place`. None keeps the known position.
            address: radio address of the transmitter. None uses the sender's name.

        Raises:
            ValueError: `now_s` or the position is not finite, the transport is unknown, or the channel let a
                frame arrive before it was sent.
        """
        if not math.isfinite(now_s):
            raise ValueError(f"time of sending is {now_s}; expected a finite number")
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
        # The channel needs the frame even without receivers, because it may collide with other frames.
        self._channel.transmit(Transmission(number, now_s, sender, transport, distance_m), self._rng)
        self._settle(now_s)

    def due(self, now_s: float) -> list[Delivery]:
        """Return the frames that have arrived by `now_s`, in order of arrival.

        Frames that arrive at the same time are in order of sending. A frame about which the channel decides
        late may have arrived before frames that an earlier call returned.
        """
        self._tell_time(now_s)
        self._settle(now_s)
        arrived = []
        while self._queue and self._queue[0][0] <= now_s:
            under_way = heapq.heappop(self._queue)[2]
            delivery = under_way.delivery
            pair = self._pair(delivery.sender, delivery.receiver)
            pair.count_delivery(delivery.transport, now_s - delivery.sent_s)
            # The shared entry of the rest covers many pairs, so it has no common age of information.
            if under_way.brings_position and pair is not self._stats.get(REST):
                pair.refresh(self._now_s, self._now_s - (now_s - delivery.sent_s))
            arrived.append(delivery)
        return arrived

    def next_due_s(self) -> float | None:
        """Next time at which `due` may return a frame; None if nothing is in transit."""
        times = [self._queue[0][0]] if self._queue else []
        decision_s = self._channel.next_s()
        return min(times if decision_s is None else [*times, decision_s], default=None)

    def finish(self, now_s: float) -> None:
        """End the run. The ages of information in `stats` are counted up to `now_s`."""
        self._tell_time(now_s)
        for stats in self._stats.values():
            stats.end(self._now_s)

    def distance_m(self, first: str, second: str) -> float | None:
        """Slant distance of two aircraft (m); None if it is not known."""
        if first in self._told and second in self._told:
            return math.dist(self._told[first], self._told[second])
        if first in self._carried and second in self._carried:
            return _carried_distance_m(self._carried[first], self._carried[second])
        return None

    def information_age_s(self, sender: str, receiver: str) -> float | None:
        """Age of information (s) of `sender` at `receiver`, at the time of the latest call; None before the
        first position."""
        stats = self._stats.get((sender, receiver))
        freshest_s = None if stats is None else stats.freshest_s
        return None if freshest_s is None else self._now_s - freshest_s

    @property
    def receivers(self) -> tuple[str, ...]:
        """Names of the receivers, in order of joining."""
        return tuple(self._receivers)

    @property
    def stats(self) -> dict[tuple[str, str], PairStats]:
        """Statistics by (sender, receiver). A frame counts as delivered when `due` returns it."""
        return self._stats

    def _tell_time(self, now_s: float) -> None:
        if self._begin_s is None:
            self._begin_s = now_s
        self._now_s = now_s - self._begin_s

    def _settle(self, now_s: float) -> None:
        for outcome in self._channel.settle(now_s, self._rng):
            on_air = self._on_air.get(outcome.number)
            # If the receiver has left, `leave` has already counted the frame as lost.
            if on_air is not None and outcome.receiver in on_air.undecided:
                self._take(outcome, on_air)
                self._close(outcome.number, outcome.receiver)

    def _take(self, outcome: Outcome, on_air: _OnAir) -> None:
        """Record the outcome of one frame at one receiver, and queue its delivery."""
        pair = self._pair(on_air.sender, outcome.receiver)
        if outcome.arrival_s is None:
            pair.lost += 1
            return
        if not on_air.sent_s <= outcome.arrival_s < math.inf:
            raise ValueError(
                f"the channel returned arrival at {outcome.arrival_s} s, but sending was at {on_air.sent_s} s"
            )
        if len(self._queue) >= self._max_pending:
            pair.overflowed += 1
            return
        delivery = Delivery(
            outcome.receiver, on_air.sender, on_air.transport, on_air.frame, on_air.sent_s, on_air.address
        )
        # The running number breaks ties, so that deliveries themselves are never compared.
        entry = (outcome.arrival_s, self._number, _UnderWay(delivery, on_air.brings_position))
        heapq.heappush(self._queue, entry)
        self._number += 1

    def _close(self, number: int, receiver: str) -> None:
        """Remove a receiver from the undecided receivers of a frame."""
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
        """Whether a frame contains a position.

        The position is kept if `place` has never set one for the sender.
        """
        heard = self._read(transport, address, frame)
        found = False
        for message in heard.messages if heard is not None else ():
            if isinstance(message, Location) and message.lat_deg is not None and message.lon_deg is not None:
                found = True
                if sender not in self._told and (sender in self._carried or len(self._carried) < MAX_CARRIED):
                    x, y, z = pymap3d.geodetic2ecef(message.lat_deg, message.lon_deg, 0.0)
                    self._carried[sender] = (float(x), float(y), float(z)), message.alt_geodetic_m
        return found


def _carried_distance_m(first: tuple[Vec3, float | None], second: tuple[Vec3, float | None]) -> float:
    """Slant distance (m); horizontal distance if an altitude is missing."""
    level = math.dist(first[0], second[0])
    if first[1] is None or second[1] is None:
        return level
    return math.hypot(level, first[1] - second[1])
