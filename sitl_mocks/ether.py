"""The air between simulated aircraft: real frames in, the same frames out later, or never, as a channel says.

Pure: no clock and no socket; time and the random generator are passed in, and one generator with one order of
calls gives one air. It carries (address, transport, frame), which is what a radio reports about a reception.
Distances come from the positions a simulator tells (`place`); for a pair of which nobody told both, from the
Location messages that the two last put on the air.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np
import pymap3d

from companion.events import Vec3
from companion.radio.frames_io import FrameReceiver
from companion.remote_id.messages import Location
from sitl_mocks.channel.simple import Channel

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
class PairStats:
    """What became of the frames of one sender on their way to one receiver."""

    sent: int = 0
    delivered: int = 0
    lost: int = 0
    """By the channel, or because the receiver left while they were under way."""
    overflowed: int = 0
    """Dropped because too many messages were under way."""
    unknown_distance: int = 0
    """Sent while the distance was not known."""
    age_sum_s: float = 0.0
    age_min_s: float = math.inf
    age_max_s: float = 0.0

    @property
    def age_mean_s(self) -> float | None:
        """Mean age at delivery (s); None before the first."""
        return self.age_sum_s / self.delivered if self.delivered else None

    def _count_delivery(self, age_s: float) -> None:
        self.delivered += 1
        self.age_sum_s += age_s
        self.age_min_s = min(self.age_min_s, age_s)
        self.age_max_s = max(self.age_max_s, age_s)

    def to_dict(self) -> dict[str, int | float | None]:
        """For a JSON line; ages are None before the first delivery."""
        heard = self.delivered > 0
        return {
            "sent": self.sent,
            "delivered": self.delivered,
            "lost": self.lost,
            "overflowed": self.overflowed,
            "unknown_distance": self.unknown_distance,
            "age_min_s": self.age_min_s if heard else None,
            "age_mean_s": self.age_mean_s,
            "age_max_s": self.age_max_s if heard else None,
        }


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
        self._queue: list[tuple[float, int, Delivery]] = []
        self._number = 0
        self._told: dict[str, Vec3] = {}
        # On the ellipsoid and Earth-centred, so that two positions need no common origin; and the altitude.
        self._carried: dict[str, tuple[Vec3, float | None]] = {}
        self._stats: dict[tuple[str, str], PairStats] = {}
        self._reader = FrameReceiver()

    def join(self, receiver: str) -> None:
        """From now on `receiver` hears what others send. Joining twice changes nothing."""
        self._receivers.setdefault(receiver)

    def leave(self, receiver: str) -> None:
        """`receiver` hears nothing more; what is under way to it is lost and its positions are forgotten."""
        self._receivers.pop(receiver, None)
        self._told.pop(receiver, None)
        self._carried.pop(receiver, None)
        kept = []
        for entry in self._queue:
            if entry[2].receiver == receiver:
                self._pair(entry[2].sender, receiver).lost += 1
            else:
                kept.append(entry)
        heapq.heapify(kept)
        self._queue = kept

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
            transport: `companion.radio.transport` name.
            frame: the bytes on the air, unchanged to the receivers.
            position_ned_m: where the sender is, like `place`; None leaves what is known.
            address: the transmitter's radio address; the sender's name where there is none.

        Raises:
            ValueError: `now_s` or the position is not finite, or the channel gave a delay that is none.
        """
        if not math.isfinite(now_s):
            raise ValueError(f"time of sending: {now_s}")
        if position_ned_m is not None:
            self.place(sender, position_ned_m)
        address = sender if address is None else address
        if sender not in self._told:
            self._note_carried(sender, transport, address, frame)
        for receiver in self._receivers:
            if receiver != sender:
                self._send(now_s, Delivery(receiver, sender, transport, frame, now_s, address))

    def due(self, now_s: float) -> list[Delivery]:
        """What has arrived by `now_s`, in order of arrival; what arrives together, in order of sending."""
        arrived = []
        while self._queue and self._queue[0][0] <= now_s:
            delivery = heapq.heappop(self._queue)[2]
            self._pair(delivery.sender, delivery.receiver)._count_delivery(now_s - delivery.sent_s)
            arrived.append(delivery)
        return arrived

    def next_due_s(self) -> float | None:
        """When the next message arrives; None when nothing is under way."""
        return self._queue[0][0] if self._queue else None

    def distance_m(self, first: str, second: str) -> float | None:
        """Slant distance of two aircraft (m); None when not known."""
        if first in self._told and second in self._told:
            return math.dist(self._told[first], self._told[second])
        if first in self._carried and second in self._carried:
            return _carried_distance_m(self._carried[first], self._carried[second])
        return None

    @property
    def receivers(self) -> tuple[str, ...]:
        """Who listens, in order of joining."""
        return tuple(self._receivers)

    @property
    def stats(self) -> dict[tuple[str, str], PairStats]:
        """Statistics by (sender, receiver). Ages are those at the moment `due` handed the frame over."""
        return self._stats

    def _send(self, now_s: float, delivery: Delivery) -> None:
        pair = self._pair(delivery.sender, delivery.receiver)
        pair.sent += 1
        distance = self.distance_m(delivery.sender, delivery.receiver)
        if distance is None:
            pair.unknown_distance += 1
        delay = self._channel.deliver(
            delivery.sender, delivery.receiver, delivery.transport, distance, self._rng
        )
        if delay is None:
            pair.lost += 1
            return
        if not 0.0 <= delay < math.inf:
            raise ValueError(f"the channel gave a delay of {delay} s")
        if len(self._queue) >= self._max_pending:
            pair.overflowed += 1
            return
        # The running number settles ties, so that deliveries themselves are never compared.
        heapq.heappush(self._queue, (now_s + delay, self._number, delivery))
        self._number += 1

    def _pair(self, sender: str, receiver: str) -> PairStats:
        key = (sender, receiver)
        if key not in self._stats and len(self._stats) >= MAX_PAIRS:
            key = REST
        return self._stats.setdefault(key, PairStats())

    def _note_carried(self, sender: str, transport: str, address: str, frame: bytes) -> None:
        if sender not in self._carried and len(self._carried) >= MAX_CARRIED:
            return
        heard = self._reader.receive(transport, address, frame)
        for message in heard.messages if heard is not None else ():
            if isinstance(message, Location) and message.lat_deg is not None and message.lon_deg is not None:
                x, y, z = pymap3d.geodetic2ecef(message.lat_deg, message.lon_deg, 0.0)
                self._carried[sender] = (float(x), float(y), float(z)), message.alt_geodetic_m


def _carried_distance_m(first: tuple[Vec3, float | None], second: tuple[Vec3, float | None]) -> float:
    """Slant distance (m); horizontal only where an altitude is missing."""
    level = math.dist(first[0], second[0])
    if first[1] is None or second[1] is None:
        return level
    return math.hypot(level, first[1] - second[1])
