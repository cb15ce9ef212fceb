"""Telemetry logs as ground stations write them.

A log repeats [8-byte big-endian Unix microseconds][one MAVLink frame]. Logs of real flights are damaged:
there is radio noise between frames, or a power cut has torn off the end. The reader resynchronises on the
next good frame and counts the bytes that it skipped. Only a file that is no log at all is an error.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import (
    MAGIC_V1,
    MAGIC_V2,
    MAX_FRAME_BYTES,
    FrameScanner,
    frame_length,
    is_known,
    is_whole,
    message_id_of,
    without_signature,
)
from companion.errors import PeerDataError

_STAMP = struct.Struct(">Q")
_MAGIC = re.compile(rb"[\xfd\xfe]")
_LATEST_US = 4_102_444_800_000_000
"""The year 2100. A larger number is not a time stamp."""
_DAY_US = 86_400_000_000
_LOOKAHEAD = 2 * (_STAMP.size + MAX_FRAME_BYTES)
"""Number of bytes needed to judge a record: the record itself, and the head of the next."""
_CHUNK = 65536
_SEARCH_LIMIT = 65536
"""The first record of a log appears within this many bytes."""


@dataclass(slots=True)
class TlogCounts:
    """What a reader has found so far."""

    records: int = 0
    corrupt_spans: int = 0
    """Places where bytes had to be skipped to find the next record."""
    corrupt_bytes: int = 0
    torn_bytes: int = 0
    """Bytes after the last record that belong to no record."""


class ByteSink(Protocol):
    """Destination of bytes: a file, or a queue in front of one."""

    def write(self, data: bytes, /) -> object:
        """Write bytes."""
        ...


class TlogWriter:
    """Writes the log of one link. Received bytes may be cut anywhere; each frame becomes one record.

    As the MAVLink guide asks of logs, signatures are removed, and SETUP_SIGNING, which contains a key, is
    left out.
    """

    def __init__(self, stream: ByteSink) -> None:
        self._stream = stream
        self._received = FrameScanner(keep_unknown=True)
        self._sent = FrameScanner(keep_unknown=True)

    def received(self, utc_s: float, data: bytes) -> None:
        """Record bytes received from the vehicle. Damaged ones are left out."""
        self._write(self._received, utc_s, data)

    def sent(self, utc_s: float, data: bytes) -> None:
        """Record bytes that we sent."""
        self._write(self._sent, utc_s, data)

    def _write(self, scanner: FrameScanner, utc_s: float, data: bytes) -> None:
        stamp = _STAMP.pack(round(utc_s * 1e6))
        for frame in scanner.frames(data):
            if frame.message_id != mavlink.MAVLINK_MSG_ID_SETUP_SIGNING:
                self._stream.write(stamp + without_signature(frame.raw))


def read_tlog(stream: BinaryIO, name: str, counts: TlogCounts | None = None) -> Iterator[tuple[float, bytes]]:
    """Yield (utc_s, frame) for every whole record. Frames of known messages have a correct checksum.

    Args:
        stream: The file; it is read as needed.
        name: What to call it in errors.
        counts: Filled in while reading.

    Raises:
        PeerDataError: this is no telemetry log.
    """
    reader = _Reader(stream, name, counts if counts is not None else TlogCounts())
    while True:
        yield from reader.plain()
        record = reader.next()
        if record is None:
            return
        yield record


class _Reader:
    def __init__(self, stream: BinaryIO, name: str, counts: TlogCounts) -> None:
        self._stream = stream
        self._name = name
        self._counts = counts
        self._buffer = b""
        self._head = b""
        self._at = 0
        self._ended = False
        self._stamp_us: int | None = None
        """Time of the previous record."""

    def plain(self) -> Iterator[tuple[float, bytes]]:
        """Yield the records in the buffer up to the first that needs a closer look. This is the fast path of
        `next`."""
        self._fill()
        buffer = self._buffer
        at, safe = self._at, len(buffer) - _LOOKAHEAD
        while at <= safe:
            (stamp_us,) = _STAMP.unpack_from(buffer, at)
            at += _STAMP.size
            length = frame_length(buffer, at)
            raw = buffer[at : at + length]
            if stamp_us > _LATEST_US or length <= 0 or not is_whole(raw):
                return
            at += length
            self._at, self._stamp_us = at, stamp_us
            self._counts.records += 1
            yield stamp_us / 1e6, raw

    def next(self) -> tuple[float, bytes] | None:
        """The next record; None at the end."""
        self._fill()
        at = self._at
        length = self._record(at)
        if length:
            return self._emit(at + _STAMP.size, length, self._stamp(at))
        return self._resync()

    def _fill(self) -> None:
        if self._ended or len(self._buffer) - self._at >= _LOOKAHEAD:
            return
        rest = self._buffer[self._at :]
        while len(rest) < _LOOKAHEAD and not self._ended:
            chunk = self._stream.read(_CHUNK)
            self._ended = not chunk
            rest += chunk
        self._buffer, self._at = rest, 0
        self._head = self._head or rest[:8]

    def _emit(self, frame_at: int, length: int, stamp_us: int) -> tuple[float, bytes]:
        self._at = frame_at + length
        self._stamp_us = stamp_us
        self._counts.records += 1
        return stamp_us / 1e6, self._buffer[frame_at : self._at]

    def _stamp(self, at: int) -> int:
        stamp_us: int = _STAMP.unpack_from(self._buffer, at)[0]
        return stamp_us

    def _record(self, at: int) -> int:
        """Length of the frame of the record at `at`; 0 if there is no record."""
        if at + _STAMP.size >= len(self._buffer) or self._stamp(at) > _LATEST_US:
            return 0
        frame_at = at + _STAMP.size
        length = self._frame(frame_at)
        if length or self._buffer[frame_at] not in (MAGIC_V1, MAGIC_V2):
            return length
        # A message that the dialect does not know is accepted if another record, or the end, follows it.
        length = frame_length(self._buffer, frame_at)
        end = frame_at + length
        if length < 10 or end > len(self._buffer) or is_known(message_id_of(self._buffer[frame_at:end])):
            return 0
        if end == len(self._buffer):
            return length
        magic_at = end + _STAMP.size
        follows = magic_at < len(self._buffer) and self._buffer[magic_at] in (MAGIC_V1, MAGIC_V2)
        return length if follows and self._stamp(end) <= _LATEST_US else 0

    def _frame(self, at: int) -> int:
        """Length of the frame of a known message at `at` with a correct checksum; 0 if there is none."""
        length = frame_length(self._buffer, at)
        if length <= 0 or at + length > len(self._buffer):
            return 0
        raw = self._buffer[at : at + length]
        return length if is_whole(raw) else 0

    def _resync(self) -> tuple[float, bytes] | None:
        """Skip damaged bytes up to the next frame with a correct checksum."""
        stepped = 0
        stamp_us = self._stamp_us
        if len(self._buffer) - self._at >= _STAMP.size and self._believable(self._stamp(self._at)):
            # Use the damaged record's own time, because noise often lies between a record's time and its
            # frame.
            stamp_us = self._stamp(self._at)
        while True:
            # Near the end of the buffer a frame may be cut off. It can be judged only when more bytes have
            # been read.
            safe = len(self._buffer) - (0 if self._ended else _LOOKAHEAD)
            found = self._find_frame(safe)
            if found is not None:
                frame_at, length, own_us = found
                stepped += frame_at - self._at - (0 if own_us is None else _STAMP.size)
                self._counts.corrupt_spans += 1
                self._counts.corrupt_bytes += stepped
                return self._emit(frame_at, length, (stamp_us or 0) if own_us is None else own_us)
            if self._ended:
                self._finish(stepped)
                return None
            # Keep the bytes that may be the time stamp of a frame in the next chunk.
            keep = max(self._at, safe - _STAMP.size)
            stepped += keep - self._at
            self._at = keep
            if self._stamp_us is None and stepped > _SEARCH_LIMIT:
                raise self._no_log()
            self._fill_more()

    def _find_frame(self, stop: int) -> tuple[int, int, int | None] | None:
        """First good frame that begins before `stop`: its position, its length, and its time if it has one.

        The first record after a damaged beginning needs a time and another record after it. Files of other
        kinds contain frames by chance, and a raw stream of frames has no times; neither may pass for a log.
        """
        for match in _MAGIC.finditer(self._buffer, self._at, max(stop, self._at)):
            frame_at = match.start()
            length = self._frame(frame_at)
            if not length:
                continue
            if frame_at - self._at >= _STAMP.size:
                own_us = self._stamp(frame_at - _STAMP.size)
                first = self._stamp_us is None
                if self._believable(own_us) and not (first and self._record(frame_at + length) == 0):
                    return frame_at, length, own_us
            if self._stamp_us is not None:
                return frame_at, length, None
        return None

    def _fill_more(self) -> None:
        chunk = self._stream.read(_CHUNK)
        self._ended = not chunk
        self._buffer, self._at = self._buffer[self._at :] + chunk, 0

    def _believable(self, stamp_us: int) -> bool:
        if self._stamp_us is None:
            return stamp_us <= _LATEST_US
        return abs(stamp_us - self._stamp_us) < _DAY_US

    def _finish(self, stepped: int) -> None:
        if self._stamp_us is None:
            raise self._no_log()
        self._counts.torn_bytes += stepped + len(self._buffer) - self._at
        self._at = len(self._buffer)

    def _no_log(self) -> PeerDataError:
        found = f"begins with {self._head.hex(' ')}" if self._head else "is empty"
        return PeerDataError(
            f"{self._name}: not a telemetry log: it {found}; "
            "expected records of an 8-byte time and a MAVLink frame"
        )
