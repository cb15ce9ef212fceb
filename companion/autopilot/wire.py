"""MAVLink frames: cut a byte stream into frames, decode them, encode ours.

pymavlink is the codec (message layouts, checksums); the framing is ours because a stream that never blocks
and counts what it drops is ours to answer for. No socket and no clock in here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

MavlinkMessage = Any
"""A decoded pymavlink message: the library has no types of its own."""

_MAGIC_V1 = 0xFE
_MAGIC_V2 = 0xFD
_SIGNATURE_BYTES = 13
_SIGNED = 0x01


@dataclass(slots=True)
class WireCounts:
    """What a reader has met so far."""

    messages: int = 0
    """Frames decoded to a known message."""
    unknown: int = 0
    """Well-formed frames of a message id outside the dialect."""
    corrupt: int = 0
    """Frames with a wrong checksum, length or incompatible flags."""
    skipped_bytes: int = 0
    """Bytes outside any frame."""


class MavlinkReader:
    """Bytes to messages. Feed it pieces of any size; it keeps an unfinished frame for the next piece."""

    def __init__(self) -> None:
        self.counts = WireCounts()
        self._buffer = bytearray()
        self._decoder = mavlink.MAVLink(None)

    def feed(self, data: bytes) -> list[MavlinkMessage]:
        """Return the messages completed by `data`; corrupt and unknown ones are counted and left out."""
        self._buffer += data
        buffer = self._buffer
        messages: list[MavlinkMessage] = []
        at = 0
        end = len(buffer)
        while at < end:
            magic = buffer[at]
            if magic not in (_MAGIC_V1, _MAGIC_V2):
                at += 1
                self.counts.skipped_bytes += 1
                continue
            if end - at < 3:
                break
            length = buffer[at + 1] + 8
            if magic == _MAGIC_V2:
                length += 4 + (_SIGNATURE_BYTES if buffer[at + 2] & _SIGNED else 0)
            if end - at < length:
                break
            message = self._decode(buffer[at : at + length])
            if message is None:
                # The magic byte may have been payload: look for the next one behind it.
                at += 1
                self.counts.skipped_bytes += 1
                continue
            at += length
            if message.get_msgId() < 0 or message.get_type().startswith("UNKNOWN"):
                self.counts.unknown += 1
                continue
            self.counts.messages += 1
            messages.append(message)
        del buffer[:at]
        return messages

    def _decode(self, frame: bytearray) -> MavlinkMessage | None:
        if frame[0] == _MAGIC_V2 and frame[2] & ~_SIGNED:
            self.counts.corrupt += 1
            return None
        try:
            return self._decoder.decode(frame)
        except (mavlink.MAVError, ValueError):
            # ValueError: text fields that are not ASCII in a frame whose checksum is right by accident.
            self.counts.corrupt += 1
            return None


class MavlinkWriter:
    """Messages to MAVLink 2 bytes, numbered as one component."""

    def __init__(self, system_id: int, component_id: int) -> None:
        self.encoder = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)

    def pack(self, message: MavlinkMessage) -> bytes:
        """Encode one message with the next sequence number."""
        packed: bytes = message.pack(self.encoder)
        self.encoder.seq = (self.encoder.seq + 1) % 256
        return packed
