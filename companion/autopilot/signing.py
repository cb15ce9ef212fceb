"""MAVLink 2 message signing: frames signed with the key are accepted, each once; all other frames are
rejected.

The module follows the MAVLink guide, "Message Signing". A signature is the first 48 bits of SHA-256 over the
key and the frame with its link id and timestamp. Timestamps count 10 microseconds since 2015 and only rise:
sent ones by at least one a frame, received ones within each stream of (system, component, link id). Only a
correct signature changes the stored timestamps, or a forged timestamp would lock the true sender out.
(pymavlink's check stores the timestamp before it has checked the signature, so it is not used.)

This module reads no clock. The timestamp starts at the value that the caller gives and advances with `now_s`.
"""

from __future__ import annotations

import enum
import hmac
from dataclasses import dataclass
from hashlib import sha256

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import SIGNATURE_BYTES, Frame, flagged, is_signed

KEY_BYTES = 32
EPOCH_S = 1_420_070_400.0
"""Unix time of timestamp 0: 2015-01-01."""
TICKS_PER_S = 100_000
NEW_STREAM_TICKS = 60 * TICKS_PER_S
"""How far behind our own timestamp the first frame of a new stream may be."""
MAX_STREAMS = 64
"""Number of streams remembered. Only a holder of the key can create one."""
UNSIGNED = frozenset({mavlink.MAVLINK_MSG_ID_RADIO_STATUS})
"""Messages accepted without a signature. Telemetry radios cannot sign their own status."""
LATEST = (1 << 48) - 1
"""Greatest timestamp: that of the year 2104."""
_HASH_BYTES = 6


class Refusal(enum.Enum):
    """Why a frame is rejected. The value describes such frames in reports."""

    UNSIGNED = "unsigned"
    WRONG = "wrongly signed"
    REPLAYED = "replayed"
    STALE = "too old"
    CROWDED = "from too many senders"


@dataclass(slots=True)
class SigningCounts:
    """Counters of the frames checked so far."""

    valid: int = 0
    unsigned: int = 0
    wrong: int = 0
    """Frames whose signature was made with another key, or with none."""
    replayed: int = 0
    """Correctly signed frames with a timestamp not newer than the last one of their stream."""
    stale: int = 0
    """Correctly signed frames, first of their stream, and dated more than a minute before our own time."""
    crowded: int = 0
    """Correctly signed frames, first of a stream beyond `MAX_STREAMS`."""

    def refused(self) -> str | None:
        """How many frames were rejected and why, in words; None when none were."""
        counted = (
            (self.unsigned, Refusal.UNSIGNED),
            (self.wrong, Refusal.WRONG),
            (self.replayed, Refusal.REPLAYED),
            (self.stale, Refusal.STALE),
            (self.crowded, Refusal.CROWDED),
        )
        words = ", ".join(f"{count} {refusal.value}" for count, refusal in counted if count)
        return f"frames refused: {words}" if words else None


def timestamp_at(utc_s: float) -> int:
    """Signing timestamp of a Unix time; 0 before 2015."""
    return min(max(int((utc_s - EPOCH_S) * TICKS_PER_S), 0), LATEST)


class Signing:
    """Signing state for one key at one end of a link, or of several links that share it."""

    def __init__(self, key: bytes, timestamp: int, now_s: float) -> None:
        """Create a state in which no frame has been received yet.

        Args:
            key: 32 bytes.
            timestamp: the last timestamp that may have been used before.
            now_s: the caller's clock now.
        """
        if len(key) != KEY_BYTES:
            raise ValueError(f"a signing key has {KEY_BYTES} bytes, not {len(key)}")
        self.counts = SigningCounts()
        self.timestamp = min(timestamp, LATEST)
        """The last timestamp used; it never falls."""
        self._key = key
        self._ticks = int(now_s * TICKS_PER_S)
        self._ahead = self.timestamp - self._ticks
        """Timestamp minus the caller's clock."""
        self._streams: dict[tuple[int, int, int], int] = {}

    def advance(self, now_s: float) -> None:
        """Advance the timestamp with time. A clock that steps back only stops it."""
        self._ticks = int(now_s * TICKS_PER_S)
        self.timestamp = min(max(self.timestamp, self._ticks + self._ahead), LATEST)

    def sign(self, frame: bytes, link_id: int = 0) -> bytes:
        """Add the next timestamp and the signature to a whole MAVLink 2 frame that is not signed yet."""
        self.timestamp = min(self.timestamp + 1, LATEST)
        body = flagged(frame) + bytes((link_id,)) + self.timestamp.to_bytes(6, "little")
        return body + self._hash(body)

    def refusal(self, frame: Frame) -> Refusal | None:
        """Why a checked frame is rejected; None if it is accepted. The frame is counted in either case."""
        refused = self._judge(frame)
        counts = self.counts
        match refused:
            case None:
                counts.valid += 1
            case Refusal.UNSIGNED:
                counts.unsigned += 1
            case Refusal.WRONG:
                counts.wrong += 1
            case Refusal.REPLAYED:
                counts.replayed += 1
            case Refusal.STALE:
                counts.stale += 1
            case Refusal.CROWDED:
                counts.crowded += 1
        return refused

    def _judge(self, frame: Frame) -> Refusal | None:
        raw = frame.raw
        if not is_signed(raw):
            return None if frame.message_id in UNSIGNED else Refusal.UNSIGNED
        if not hmac.compare_digest(self._hash(raw[:-_HASH_BYTES]), raw[-_HASH_BYTES:]):
            return Refusal.WRONG
        stream = (frame.system_id, frame.component_id, raw[-SIGNATURE_BYTES])
        timestamp = int.from_bytes(raw[-SIGNATURE_BYTES + 1 : -_HASH_BYTES], "little")
        last = self._streams.get(stream)
        if last is not None:
            if timestamp <= last:
                return Refusal.REPLAYED
        elif timestamp + NEW_STREAM_TICKS < self.timestamp:
            return Refusal.STALE
        elif len(self._streams) >= MAX_STREAMS:
            return Refusal.CROWDED
        self._streams[stream] = timestamp
        if timestamp > self.timestamp:
            # Our computer may have no clock to start from (no battery), so the peer's newer timestamp is
            # adopted.
            self.timestamp = timestamp
            self._ahead = timestamp - self._ticks
        return None

    def _hash(self, body: bytes) -> bytes:
        return sha256(self._key + body).digest()[:_HASH_BYTES]

    def __repr__(self) -> str:
        """Representation without the key."""
        return f"Signing(timestamp={self.timestamp})"
