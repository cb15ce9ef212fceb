"""What is held of each radio address: what its sender reports, and which of its frames a signature may cover.

On BLE 4 every message is a separate frame: Basic ID, System and the others arrive before and between the
Locations. The last message of each type is held until a track can take it, for a bounded number of addresses.
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from dataclasses import dataclass, field

from companion.remote_id.messages import Message
from companion.traffic.latest_messages import LatestMessages
from companion.traffic.senders.reception import Reception
from companion.traffic.track import Track

_REPORTED = 40
"""Frames with Locations that are remembered of an address: three seconds at 10 a second, and some more."""


@dataclass(slots=True)
class Reported:
    """A frame with Locations that a signature may cover later."""

    transport: str
    messages: tuple[Message, ...]
    tracks: tuple[Track, ...]
    """Tracks that its Locations fed."""
    hash: bytes | None = None
    """Hash by which a Manifest names it; computed when it is first needed."""


@dataclass(slots=True)
class Source:
    """One radio address on one transport."""

    key: str
    latest: LatestMessages
    identity: str | None = None
    """Identity from the first Basic ID. Later ones do not change it, so that a sender of two identities does
    not rename its track back and forth."""
    ours: bool = False
    """Whether one of its Basic IDs is ours. The first may be our registration, or one that our module has."""
    fed: list[Track] = field(default_factory=list)
    """The track to which its last Location belongs, if any."""
    reported: deque[Reported] = field(default_factory=lambda: deque(maxlen=_REPORTED))
    """Its last frames with Locations, if signatures are verified."""
    vouched_s: float = -math.inf
    """When a signature from this address was last valid (our monotonic time)."""
    signed_utc_s: float = -math.inf
    """Begin of the window (UTC) of the last valid signature from this address."""
    last_signed: bytes = b""
    """The last valid evidence, which needs no second check when it is repeated."""
    checks: float = 0.0
    checks_s: float = -math.inf
    """Signature checks that are left to this address, and when that was computed."""
    reception: Reception = field(default_factory=Reception)
    tracks: int = 0
    """Number of tracks that it feeds."""


@dataclass(slots=True)
class Sources:
    """Radio addresses that were heard, at most `most`. The one that has been silent longest is removed first,
    and those that feed a track last, so that a sender that keeps changing its address does not displace
    others."""

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
        source = self._idle[key] = Source(key, LatestMessages(transport, address))
        return source

    def of(self, transport: str, address: str) -> Source | None:
        """The source of frames; None if it is not held."""
        return self.held(f"{transport}/{address}")

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
