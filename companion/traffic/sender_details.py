"""What senders tell beside their position, held for each radio address until a track can take it.

On BLE 4 every message is a frame of its own: Basic ID, System and the others come before and between the
Locations. One of each message is held, for a bounded number of addresses.
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
    """The last of each message of a sender, and how it was last heard."""

    transport: str
    address: str
    rssi_dbm: float | None = None
    basic_id: BasicId | None = None
    """The identity that the track goes by."""
    other_id: BasicId | None = None
    """Another identity of the same address, such as a registration beside the serial number."""
    system: System | None = None
    operator_id: OperatorId | None = None
    self_id: SelfId | None = None
    authentication: AuthenticationData | None = None

    def keep(self, message: Message) -> None:
        """Hold the last System, Operator ID and Self ID; others are no news here."""
        if type(message) is System:
            self.system = message
        elif type(message) is OperatorId:
            self.operator_id = message
        elif type(message) is SelfId:
            self.self_id = message

    def keep_id(self, message: BasicId, identity: str | None) -> None:
        """Hold a Basic ID as the one that names the sender, or as its other one."""
        if message.uas_id == identity:
            self.basic_id = message
        else:
            self.other_id = message

    def update(self, other: About) -> None:
        """Take over whatever `other` knows; it is the newer."""
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
    """From its first Basic ID: a second one must not rename its track back and forth."""
    vouched_s: float = -math.inf
    """When a UAS ID signature from here last held (our monotonic time)."""
    signed_utc_s: float = -math.inf
    """Timestamp of the last signature from here that held."""
    reception: Reception = field(default_factory=Reception)


@dataclass(slots=True)
class Sources:
    """Addresses heard, at most `most`; the longest silent is forgotten first."""

    most: int
    _held: OrderedDict[str, Source] = field(default_factory=OrderedDict)
    """Ordered: a plain dict's first entry is slow to find after many deletions before it."""

    def __len__(self) -> int:
        """Addresses held."""
        return len(self._held)

    def at(self, transport: str, address: str) -> Source:
        """The source of a frame, remembered from now on."""
        key = f"{transport}/{address}"
        source = self._held.get(key)
        if source is not None:
            self._held.move_to_end(key)
            return source
        if len(self._held) >= self.most:
            self._held.popitem(last=False)
        source = self._held[key] = Source(key, About(transport, address))
        return source

    def held(self, key: str) -> Source | None:
        """The source of a key, if it is remembered."""
        return self._held.get(key)
