"""Details that senders report in addition to positions, held by radio address until a track can take them.

On BLE 4 every message is a separate frame: Basic ID, System and the others arrive before and between the
Locations. The last message of each type is held, for a bounded number of addresses.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field

from companion.remote_id.authentication import AuthenticationData
from companion.remote_id.messages import BasicId, Message, OperatorId, SelfId, System
from companion.traffic.reception import Reception


@dataclass(slots=True)
class About:
    """The last message of each type from a sender, and how the sender was last received."""

    transport: str
    address: str
    rssi_dbm: float | None = None
    basic_id: BasicId | None = None
    """Basic ID with the identity that the track uses."""
    other_id: BasicId | None = None
    """Another Basic ID from the same address, such as a registration in addition to the serial number."""
    system: System | None = None
    operator_id: OperatorId | None = None
    self_id: SelfId | None = None
    authentication: AuthenticationData | None = None

    def keep(self, message: Message) -> None:
        """Hold the message if it is a System, Operator ID or Self ID; other messages are ignored."""
        if type(message) is System:
            self.system = message
        elif type(message) is OperatorId:
            self.operator_id = message
        elif type(message) is SelfId:
            self.self_id = message

    def keep_id(self, message: BasicId, identity: str | None) -> None:
        """Hold a Basic ID as `basic_id` if it carries the sender's `identity`, else as `other_id`."""
        if message.uas_id == identity:
            self.basic_id = message
        else:
            self.other_id = message

    def update(self, other: About) -> None:
        """Take over everything that is set in `other`, which is newer."""
        self.transport, self.address, self.rssi_dbm = other.transport, other.address, other.rssi_dbm
        if other.basic_id is not None:
            self.basic_id = other.basic_id
        if other.other_id is not None:
            self.other_id = other.other_id
        if other.system is not None:
            self.system = other.system
        if other.operator_id is not None:
            self.operator_id = other.operator_id
        if other.self_id is not None:
            self.self_id = other.self_id
        if other.authentication is not None:
            self.authentication = other.authentication


@dataclass(slots=True)
class Source:
    """One radio address on one transport."""

    key: str
    about: About
    identity: str | None = None
    """Identity from the first Basic ID. Later ones do not change it, so that a sender of two identities does
    not rename its track back and forth."""
    vouched_s: float = -math.inf
    """When a UAS ID signature from this address was last valid (our monotonic time)."""
    signed_utc_s: float = -math.inf
    """Timestamp (UTC) of the last valid signature from this address."""
    reception: Reception = field(default_factory=Reception)
    tracks: int = 0
    """Number of tracks that it feeds."""


@dataclass(slots=True)
class Sources:
    """Radio addresses that were heard, at most `most`. The one that has been silent longest is removed
    first, and those that feed a track last: whoever churns through addresses makes nobody forget theirs."""

    most: int
    _idle: OrderedDict[str, Source] = field(default_factory=OrderedDict)
    """OrderedDict, because finding the first entry of a plain dict is slow after many deletions before it."""
    _feeding: OrderedDict[str, Source] = field(default_factory=OrderedDict)

    def __len__(self) -> int:
        """Number of addresses held."""
        return len(self._idle) + len(self._feeding)

    def at(self, transport: str, address: str) -> Source:
        """The source of a frame. A new one is added."""
        key = f"{transport}/{address}"
        for part in (self._feeding, self._idle):
            source = part.get(key)
            if source is not None:
                part.move_to_end(key)
                return source
        if len(self) >= self.most:
            (self._idle or self._feeding).popitem(last=False)
        source = self._idle[key] = Source(key, About(transport, address))
        return source

    def held(self, key: str) -> Source | None:
        """The source of a key; None if it is not held."""
        return self._feeding.get(key) or self._idle.get(key)

    def feed(self, key: str) -> None:
        """Note that an address feeds one more track."""
        source = self.held(key)
        if source is not None:
            source.tracks += 1
            if source.tracks == 1:
                self._feeding[key] = self._idle.pop(key)

    def release(self, key: str) -> None:
        """Note that an address feeds one track less."""
        source = self.held(key)
        if source is not None and source.tracks:
            source.tracks -= 1
            if not source.tracks:
                self._idle[key] = self._feeding.pop(key)
