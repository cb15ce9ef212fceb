"""What is held of each radio address: what its sender reports, and which of its frames a signature may cover.

On BLE 4 every message is a separate frame: Basic ID, System and the others arrive before and between the
Locations. The last message of each type is held until a track can take it, for a bounded number of addresses.
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from dataclasses import dataclass, field

from companion.remote_id.messages import Location, Message
from companion.traffic.fix import Fix
from companion.traffic.latest_messages import LatestMessages
from companion.traffic.senders.reception import Reception
from companion.traffic.track import Track, same

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
    placed: Location | None = None
    """Its last Location with a position."""
    last: Fix | None = None
    """Its last Location with a timestamp, as redated."""
    last_s: float = -math.inf
    """When that was received (our monotonic time)."""
    slow_s: float = 0.0
    """How far its clock has stepped back while it was heard; 0 once it is right again."""

    def redate(self, fix: Fix, now_s: float) -> None:
        """Correct the time of a Location if its sender's clock has stepped back.

        A message that is dated back may also have been delayed, but then its position is that of its
        timestamp. After a step the aircraft is where it is expected from the time of reception. A message
        that fits its own timestamp ends the correction, so that a forged one does nothing to those that
        follow.
        """
        last, passed_s, stamp_s = self.last, now_s - self.last_s, fix.stamp_s
        if stamp_s is None:
            return
        if stamp_s + self.slow_s > now_s + _AHEAD_S:
            self.slow_s = 0.0  # the clock was set right while the aircraft hovered, or was not heard
        if last is not None and last.stamp_s is not None and passed_s <= _STEP_WITHIN_S:
            stepped_s = last.stamp_s + passed_s - stamp_s
            if self.slow_s or stepped_s >= _STEP_S:
                self.slow_s = self._slow_s(last, fix, passed_s, stepped_s)
        fix.stamp_s = stamp_s + self.slow_s
        ahead = fix.stamp_s > now_s + _AHEAD_S
        if not ahead and (last is None or not same(last.content, fix.content)):
            self.last, self.last_s = fix, now_s

    def _slow_s(self, last: Fix, fix: Fix, passed_s: float, stepped_s: float) -> float:
        """How far the clock has stepped back, after another Location.

        Args:
            passed_s: time between the receptions of both.
            stepped_s: how much less time passed by the timestamp.
        """
        own_s, noise_m = passed_s - stepped_s, 2.0 + 2.0 * math.hypot(last.sigma_m, fix.sigma_m)
        as_sent_m, redated_m = _off_m(last, fix, own_s), _off_m(last, fix, own_s + self.slow_s)
        least_m = min(as_sent_m, redated_m)
        if least_m <= noise_m + 0.5 * _TURNS_MPS2 * min(abs(own_s), passed_s) ** 2:
            return 0.0 if redated_m > as_sent_m + noise_m else self.slow_s
        bent_m = 0.5 * _GENTLE_MPS2 * passed_s * passed_s
        goes_on = _off_m(last, fix, passed_s) <= min(noise_m + bent_m, 0.5 * least_m)
        return stepped_s if goes_on and stepped_s >= _STEP_S else self.slow_s


_STEP_S, _STEP_WITHIN_S = 1.0, 5.0
"""Least step back of a clock, and longest time between two messages that show it."""
_AHEAD_S = 0.5
"""A message that is dated ahead by more than this may be forged, and shows no step of the true ones."""
_TURNS_MPS2, _GENTLE_MPS2 = 12.0, 5.0
"""Accelerations that may explain a place: freely where a message fits its timestamp, little where it does
not."""


def _off_m(last: Fix, fix: Fix, passed_s: float) -> float:
    """Distance of a Location from where the one before leads to in a time; 0 if no velocity is known."""
    a, b = last.velocity, fix.velocity
    if a is None or b is None:
        return 0.0
    north = fix.position[0] - last.position[0] - 0.5 * passed_s * (a[0] + b[0])
    east = fix.position[1] - last.position[1] - 0.5 * passed_s * (a[1] + b[1])
    return math.hypot(north, east)


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
