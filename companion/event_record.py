"""The event record: input and output of the core, in the order in which they occurred.

The file holds a magic number, then records of [u32 length][u32 CRC-32 of the body][MessagePack body],
little-endian. An incomplete record at the end (a process killed while writing) ends the reading. All records
before it remain readable.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO

import msgspec

from companion.config import Config
from companion.errors import PeerDataError
from companion.events import AnyCommand, AnyEvent

MAGIC = b"DMUCAEV4"
"""Magic number. Its last byte is the format version, which is raised when events, commands or the
configuration change shape."""
_HEAD = struct.Struct("<II")
_MAX_RECORD = 16 * 1024 * 1024
_WRITER = "use the version that wrote it (manifest.json gives its number)"
"""What helps with a record whose format or configuration this version refuses."""


class Header(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """First record of a file: the aircraft, the software and the configuration."""

    aircraft: str
    software: str
    config: Config
    policy: bytes | None = None
    """Whole content of the policy file that chose the transports, so that a run folder is self-contained."""


class Step(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """One step of the core."""

    now_s: float
    events: tuple[AnyEvent, ...]
    commands: tuple[AnyCommand, ...]


Record = Header | Step

_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Record)
_STEP = b"\x84\xa4type\xa4Step"
"""How the body of each step begins: a map of four entries, the first of which is its tag."""


def encode(record: Record) -> bytes:
    """Encode one record with its length and checksum."""
    body = _encoder.encode(record)
    return _HEAD.pack(len(body), zlib.crc32(body)) + body


def read(stream: BinaryIO, name: str) -> Iterator[Record]:
    """Yield the records of a file, ending without an error at an incomplete last record.

    Raises:
        PeerDataError: the file is no event record, or a record inside it is damaged (names the offset).
    """
    return Reader(stream, name).records()


class Reader:
    """Reads the records of a file, and continues where it stopped when the file has grown.

    Args:
        stream: the file at its beginning. Seeking is needed only to read an incomplete record again.
        name: name of the file in errors.
    """

    def __init__(self, stream: BinaryIO, name: str) -> None:
        self._stream = stream
        self._name = name
        self._offset = 0
        self._torn = False

    @property
    def offset(self) -> int:
        """Number of bytes read as whole records, including the magic number."""
        return self._offset

    def records(self) -> Iterator[Record]:
        """Yield the complete records that were not yielded before.

        Raises:
            PeerDataError: the file is no event record, or a record inside it is damaged (names the offset).
        """
        if self._torn:
            self._stream.seek(self._offset)
            self._torn = False
        if self._offset == 0:
            self._magic()
        while (body := self._body()) is not None:
            try:
                entry = _decoder.decode(body)
            except msgspec.DecodeError as error:
                older = self._offset == len(MAGIC)
                raise self._damaged(f"{error}; {_WRITER}" if older else str(error)) from error
            self._offset += _HEAD.size + len(body)
            yield entry

    def _magic(self) -> None:
        magic = self._stream.read(len(MAGIC))
        if magic != MAGIC and magic[:-1] == MAGIC[:-1]:
            raise PeerDataError(
                f"{self._name}: event record of format {magic[-1:]!r}; this version reads {MAGIC[-1:]!r}; "
                f"{_WRITER}"
            )
        if magic != MAGIC:
            raise PeerDataError(f"{self._name}: not an event record (it does not begin with {MAGIC!r})")
        self._offset = len(MAGIC)

    def _body(self) -> bytes | None:
        """Body of the next record; None if it is incomplete."""
        head = self._stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            self._torn = True
            return None
        length, crc = _HEAD.unpack(head)
        if length > _MAX_RECORD:
            raise self._damaged(f"record of {length} bytes; allowed: up to {_MAX_RECORD}")
        body = self._stream.read(length)
        if len(body) < length:
            if self._holds_step(body):
                raise self._damaged(f"a length of {length} bytes reaches over the whole records that follow")
            self._torn = True
            return None
        if zlib.crc32(body) != crc:
            raise self._damaged("checksum differs")
        return body

    @staticmethod
    def _holds_step(tail: bytes) -> bool:
        """Whether a whole step lies in the rest of a file, which then does not end in one torn record."""
        at = -1
        while (at := tail.find(_STEP, at + 1)) >= 0:
            if at >= _HEAD.size:
                length, crc = _HEAD.unpack_from(tail, at - _HEAD.size)
                body = tail[at : at + length]
                if len(body) == length and zlib.crc32(body) == crc:
                    return True
        return False

    def _damaged(self, words: str) -> PeerDataError:
        return PeerDataError(f"{self._name}: byte {self._offset}: {words}")
