"""The event record: what entered and left the heart, in the order it happened.

File: magic, then records of [u32 length][u32 CRC-32 of the body][MessagePack body], little-endian. A torn
tail (a process killed while writing) ends the reading without losing what stands before it.
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
"""Ends in the version of the format: raised when events, commands or the configuration change shape."""
_HEAD = struct.Struct("<II")
_MAX_RECORD = 16 * 1024 * 1024


class Header(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """First record: whose heart this is and what it was configured with."""

    aircraft: str
    software: str
    config: Config
    policy: bytes | None = None
    """The file of the policy that chose the transports, whole: a run folder stands alone."""


class Step(msgspec.Struct, frozen=True, tag=True, kw_only=True):
    """One call of the heart."""

    now_s: float
    events: tuple[AnyEvent, ...]
    commands: tuple[AnyCommand, ...]


Record = Header | Step

_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Record)


def encode(record: Record) -> bytes:
    """One framed record."""
    body = _encoder.encode(record)
    return _HEAD.pack(len(body), zlib.crc32(body)) + body


def read(stream: BinaryIO, name: str) -> Iterator[Record]:
    """Yield the records of a file, ending quietly at a torn tail.

    Raises:
        PeerDataError: this is no event record, or a record inside the file is damaged (names the offset).
    """
    magic = stream.read(len(MAGIC))
    if magic != MAGIC and magic[:-1] == MAGIC[:-1]:
        raise PeerDataError(
            f"{name}: event record of format {magic[-1:]!r}; this version reads {MAGIC[-1:]!r}: "
            "use the version that wrote it (its number stands in manifest.json)"
        )
    if magic != MAGIC:
        raise PeerDataError(f"{name}: not an event record (it does not begin with {MAGIC!r})")
    offset = len(MAGIC)
    while len(head := stream.read(_HEAD.size)) == _HEAD.size:
        length, crc = _HEAD.unpack(head)
        if length > _MAX_RECORD:
            raise PeerDataError(f"{name}: byte {offset}: record of {length} bytes, at most {_MAX_RECORD}")
        body = stream.read(length)
        if len(body) < length:
            return
        if zlib.crc32(body) != crc:
            raise PeerDataError(f"{name}: byte {offset}: checksum differs")
        try:
            yield _decoder.decode(body)
        except msgspec.DecodeError as error:
            raise PeerDataError(f"{name}: byte {offset}: {error}") from error
        offset += _HEAD.size + length
