"""MAVLink frames: cuts a byte stream into checked frames, decodes them, and encodes our own.

pymavlink provides the message layouts. The framing is our own, because it must never block, must count what
it drops, and must cost only microseconds. This module uses no socket and no clock.

Frame layouts and the checksum (CRC-16/MCRF4XX over everything after the magic byte, then one byte that stands
for the layout) are those of the MAVLink 1 and 2 serialisation guide. Signatures are skipped here; `signing`
makes and checks them.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Any

import msgspec
from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import ardupilotmega as mavlink

MavlinkMessage = Any
"""A decoded pymavlink message. The library has no types of its own."""

MAGIC_V1 = 0xFE
MAGIC_V2 = 0xFD
MAX_FRAME_BYTES = 10 + 255 + 2 + 13
"""Longest frame: MAVLink 2 header, payload, checksum, signature."""

_MAGIC = re.compile(rb"[\xfd\xfe]")
SIGNATURE_BYTES = 13
"""Length of the link id, timestamp and signature at the end of a signed frame."""
_SIGNED = 0x01
_FLAG_BYTE = bytes((_SIGNED,))
_HEAD_V2 = struct.Struct("<BBBBBBBHB")

CURRENT_MODE = 436
"""Message of standard.xml, missing in pymavlink's ardupilotmega dialect."""
_CRC_EXTRA = {
    **{i: bytes([m.crc_extra]) for i, m in mavlink.mavlink_map.items()},
    CURRENT_MODE: bytes([193]),
}
COMPONENT_INFORMATION_BASIC, COMPONENT_METADATA = 396, 397
# Messages of common.xml that neither pymavlink's dialects nor ArduPilot's contain. We send them; received
# ones count as unknown.
_SENT_EXTRA = {
    COMPONENT_INFORMATION_BASIC: bytes([50]),
    COMPONENT_METADATA: bytes([182]),
    **_CRC_EXTRA,
}


def names_of(enum: str, prefix: str) -> dict[int, str]:
    """Names of the entries of a MAVLink enum, without their prefix, by number."""
    return {number: entry.name.removeprefix(prefix) for number, entry in mavlink.enums[enum].items()}


@dataclass(slots=True)
class WireCounts:
    """What a reader has received so far."""

    messages: int = 0
    """Frames of a known message with a correct checksum."""
    unknown: int = 0
    """Well-formed frames of a message id outside the dialect."""
    corrupt: int = 0
    """Frames with a wrong checksum, length or incompatible flags."""
    skipped_bytes: int = 0
    """Bytes outside any frame."""


class Frame(msgspec.Struct, frozen=True, gc=False):
    """One frame, cut into its parts."""

    message_id: int
    system_id: int
    component_id: int
    payload: bytes
    """Payload as sent: MAVLink 2 cuts trailing zeros."""
    raw: bytes

    @property
    def sequence(self) -> int:
        """Sequence number that the sender gave to the frame, 0 to 255."""
        return self.raw[4] if self.raw[0] == MAGIC_V2 else self.raw[2]


def checksum(body: bytes, message_id: int) -> int:
    """Checksum of a frame's bytes between the magic byte and the checksum. The message must be known, or be
    one that we only send."""
    return mcrf4xx(_SENT_EXTRA[message_id], mcrf4xx(body))


def frame_length(buffer: bytes, at: int) -> int:
    """Frame length that the header at `at` announces; 0 while too little of the header is there, -1 if it is
    none."""
    magic = buffer[at]
    if len(buffer) - at < 3:
        return 0
    if magic == MAGIC_V1:
        return buffer[at + 1] + 8
    flags = buffer[at + 2]
    if magic != MAGIC_V2 or flags > _SIGNED:
        return -1
    return buffer[at + 1] + 12 + flags * SIGNATURE_BYTES


def is_signed(raw: bytes) -> bool:
    """Whether a whole frame ends in a signature."""
    return raw[0] == MAGIC_V2 and bool(raw[2] & _SIGNED)


def flagged(frame: bytes) -> bytes:
    """An unsigned MAVLink 2 frame with the flag that announces a signature, and its checksum updated."""
    return _toggled(frame)


def without_signature(raw: bytes) -> bytes:
    """The frame as if it had not been signed."""
    return _toggled(raw[:-SIGNATURE_BYTES]) if is_signed(raw) else raw


def _toggled(frame: bytes) -> bytes:
    """A MAVLink 2 frame, up to its checksum, with the flag of signed frames inverted.

    The checksum is linear: it changes by the checksum of the changed bits alone, so no message layout is
    needed.
    """
    change = mcrf4xx(_FLAG_BYTE + bytes(len(frame) - 4), 0)
    toggled = bytearray(frame)
    toggled[2] ^= _SIGNED
    toggled[-2] ^= change & 0xFF
    toggled[-1] ^= change >> 8
    return bytes(toggled)


def message_id_of(raw: bytes) -> int:
    """Message id from a frame's header."""
    if raw[0] == MAGIC_V1:
        return raw[5]
    return raw[7] | raw[8] << 8 | raw[9] << 16


def is_known(message_id: int) -> bool:
    """Whether the dialect contains this message, so that its checksum can be verified."""
    return message_id in _CRC_EXTRA


def is_whole(raw: bytes) -> bool:
    """Whether a frame of the length that its header announces is of a known message and has a correct
    checksum."""
    # A log has tens of millions of frames, so function calls are avoided here.
    if raw[0] == MAGIC_V1:
        stop, message_id = raw[1] + 6, raw[5]
    else:
        stop, message_id = raw[1] + 10, raw[7] | raw[8] << 8 | raw[9] << 16
    extra = _CRC_EXTRA.get(message_id)
    if extra is None:
        return False
    crc = mcrf4xx(extra, mcrf4xx(raw[1:stop]))
    return raw[stop] == crc & 0xFF and raw[stop + 1] == crc >> 8


def cut(raw: bytes) -> Frame:
    """Cut one whole frame into its parts; its checksum is not verified."""
    if raw[0] == MAGIC_V1:
        _, size, _, system, component, message_id = raw[:6]
        return Frame(message_id, system, component, raw[6 : 6 + size], raw)
    _, size, _, _, _, system, component, low, high = _HEAD_V2.unpack_from(raw)
    return Frame(low | high << 16, system, component, raw[10 : 10 + size], raw)


def _checked(raw: bytes) -> Frame | None:
    """The parts of a frame of the length that its header announces; None if `is_whole` is false."""
    if raw[0] == MAGIC_V1:
        return cut(raw) if is_whole(raw) else None
    # This repeats `is_whole` and `cut`, because most frames take this path and calls would cost time.
    _, size, _, _, _, system, component, low, high = _HEAD_V2.unpack_from(raw)
    message_id, stop = low | high << 16, size + 10
    extra = _CRC_EXTRA.get(message_id)
    if extra is None or raw[stop] | raw[stop + 1] << 8 != mcrf4xx(extra, mcrf4xx(raw[1:stop])):
        return None
    return Frame(message_id, system, component, raw[10:stop], raw)


class FrameScanner:
    """Cuts bytes into checked frames. The frames are the same however the input is divided into pieces."""

    def __init__(self, *, keep_unknown: bool = False) -> None:
        self.counts = WireCounts()
        self._keep_unknown = keep_unknown
        self._rest = b""

    @property
    def pending_bytes(self) -> int:
        """Number of bytes of an unfinished frame kept for the next piece; never more than
        `MAX_FRAME_BYTES`."""
        return len(self._rest)

    def frames(self, data: bytes) -> list[Frame]:
        """Return the frames completed by `data`. Damaged frames are counted and left out.

        Frames of unknown messages are counted. They are left out unless the scanner was created to keep them,
        because a record of a link must not lose what a newer dialect can read.
        """
        buffer = self._rest + data
        counts = self.counts
        found: list[Frame] = []
        at, end = 0, len(buffer)
        while at < end:
            if buffer[at] != MAGIC_V2 and buffer[at] != MAGIC_V1:
                match = _MAGIC.search(buffer, at)
                start = match.start() if match else end
                counts.skipped_bytes += start - at
                at = start
                continue
            length = frame_length(buffer, at)
            if length == 0 or at + length > end:
                break
            frame = _checked(buffer[at : at + length]) if length > 0 else None
            if frame is not None:
                counts.messages += 1
                found.append(frame)
                at += length
                continue
            taken = self._take(buffer, at, length, found)
            if taken == 0:
                break
            if taken < 0:
                # The magic byte may have been payload, so the search goes on behind it.
                counts.corrupt += 1
                counts.skipped_bytes += 1
                taken = 1
            at += taken
        self._rest = buffer[at:]
        return found

    def _take(self, buffer: bytes, at: int, length: int, found: list[Frame]) -> int:
        """Number of bytes used by what is no whole frame of a known message; 0: more bytes are needed to
        decide; -1: it is not a frame."""
        if length < 0:
            return -1
        raw = buffer[at : at + length]
        if is_known(message_id_of(raw)):
            return -1
        # Its checksum cannot be verified, so it must at least end where another frame begins. Otherwise
        # damaged bytes that only look like a frame would swallow a good one.
        if at + length == len(buffer):
            if not self._keep_unknown:
                return 0
            # A record needs the time of arrival, so the frame is not held back until the next one.
        elif buffer[at + length] != MAGIC_V2 and buffer[at + length] != MAGIC_V1:
            return -1
        self.counts.unknown += 1
        if self._keep_unknown:
            found.append(cut(raw))
        return length


class MavlinkReader:
    """Decodes bytes to pymavlink messages. The pieces may be of any size."""

    def __init__(self) -> None:
        self._scanner = FrameScanner()
        self._decoder = mavlink.MAVLink(None)

    @property
    def counts(self) -> WireCounts:
        """What has been read and dropped so far."""
        return self._scanner.counts

    def feed(self, data: bytes) -> list[MavlinkMessage]:
        """Return the messages completed by `data`. Corrupt and unknown ones are counted and left out."""
        messages: list[MavlinkMessage] = []
        for frame in self._scanner.frames(data):
            if frame.message_id not in mavlink.mavlink_map:
                self.counts.messages -= 1
                self.counts.unknown += 1
                continue
            try:
                messages.append(self._decoder.decode(bytearray(frame.raw)))
            except (mavlink.MAVError, ValueError):
                # ValueError is raised by text fields that are not ASCII.
                self.counts.messages -= 1
                self.counts.corrupt += 1
        return messages


class MavlinkWriter:
    """Encodes messages as MAVLink 2 bytes, with the sequence numbers of one component."""

    def __init__(self, system_id: int, component_id: int) -> None:
        self.encoder = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)

    def pack(self, message: MavlinkMessage) -> bytes:
        """Encode one message with the next sequence number."""
        packed: bytes = message.pack(self.encoder)
        self.encoder.seq = (self.encoder.seq + 1) % 256
        return packed

    def pack_payload(self, message_id: int, payload: bytes) -> bytes:
        """Frame a payload that is already laid out, with the next sequence number. This is the fast path."""
        encoder = self.encoder
        body = payload.rstrip(b"\0") or payload[:1]
        head = _HEAD_V2.pack(
            MAGIC_V2,
            len(body),
            0,
            0,
            encoder.seq,
            encoder.srcSystem,
            encoder.srcComponent,
            message_id & 0xFFFF,
            message_id >> 16,
        )
        encoder.seq = (encoder.seq + 1) % 256
        frame = head + body
        return frame + checksum(frame[1:], message_id).to_bytes(2, "little")
