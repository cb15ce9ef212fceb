"""Converts between Remote ID payloads and messages. The rest of the companion calls this module.

The format is that of ASTM F3411-22a section 5.4. `wire_messages` holds the 25-byte layouts, `wire_values` the
scalings. There are two ways to read a payload:

- `decode` and `decode_pack` are all or nothing, like the public reference decoder (opendroneid-core-c). There
  is one difference: if an authentication page in a pack contradicts itself, the reference leaves out that
  page and takes the rest, while `decode_pack` refuses the pack.
- `read_payload` and `decode_payload` are for a receiver. They return every readable message of a pack, so
  that one reserved type or a truncated end does not hide an aircraft's Location. A pack of zero messages is
  simply empty. Transmitters send such packs before they have any data.

Both ways accept any protocol version, so that later versions stay readable. They ignore reserved bits and
bytes after the payload, and keep reserved enumeration numbers (`messages.WireCode`). Values that the standard
does not allow become unknown (`wire_values`). Bad bytes raise only `PeerDataError`; a message that cannot be
sent raises only ValueError.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from typing import Final, NamedTuple

from companion.errors import PeerDataError
from companion.remote_id.messages import Authentication, BasicId, Message
from companion.remote_id.wire_messages import (
    MESSAGE_SIZE,
    PACK_TYPE,
    PROTOCOL_VERSION,
    decode,
    encode,
    message_type,
)

__all__ = [
    "MESSAGE_SIZE",
    "PACK_HEADER_SIZE",
    "PACK_MAX_MESSAGES",
    "PACK_TYPE",
    "Payload",
    "decode",
    "decode_pack",
    "decode_payload",
    "encode",
    "encode_pack",
    "message_type",
    "read_payload",
]

PACK_HEADER_SIZE: Final = 3
PACK_MAX_MESSAGES: Final = 9

_LOCATION: Final = 1
_decode_again = lru_cache(maxsize=1024)(decode)
"""Cached `decode`. An aircraft repeats its identities and texts in every pack, and messages are immutable."""

_PACK_HEAD: Final = PACK_TYPE << 4 | PROTOCOL_VERSION


class Payload(NamedTuple):
    """Messages that a receiver could read from one payload, and the faults it found."""

    messages: tuple[Message, ...]
    faults: tuple[str, ...]
    """Descriptions of the parts that had to be left out or that violate the standard."""


def encode_pack(messages: Sequence[Message]) -> bytes:
    """Encode 1 to 9 messages as a pack, in the order given. Raises ValueError.

    A pack holds at most two Basic IDs, any number of authentication pages, and one of each other message.
    """
    if not 1 <= len(messages) <= PACK_MAX_MESSAGES:
        raise ValueError(f"pack of {len(messages)} messages; allowed: 1 to {PACK_MAX_MESSAGES}")
    counts = Counter(type(message) for message in messages)
    for kind, count in counts.items():
        if count > _most_of(kind):
            raise ValueError(f"pack with {count} {kind.__name__} messages; allowed: {_most_of(kind)}")
    return bytes((_PACK_HEAD, MESSAGE_SIZE, len(messages))) + b"".join(map(encode, messages))


def decode_pack(data: bytes) -> tuple[Message, ...]:
    """Decode all messages of a pack that is free of faults. Bytes after the pack are ignored.

    Raises PeerDataError at the first fault, and for a pack without messages.
    """
    messages, faults = _read_pack(data)
    if faults:
        raise PeerDataError(faults[0])
    if not messages:
        raise PeerDataError("pack announces 0 messages at offset 2, expected 1 to 9")
    return messages


def read_payload(data: bytes) -> Payload:
    """Read one message or a pack, as the first byte indicates, as far as it is readable.

    Bytes after it (padding) are ignored. Raises PeerDataError if the pack header or the single message is
    invalid.
    """
    if not data:
        raise PeerDataError("empty payload")
    if data[0] >> 4 == PACK_TYPE:
        return _read_pack(data)
    return Payload((decode(data[:MESSAGE_SIZE]),), ())


def decode_payload(data: bytes) -> tuple[Message, ...]:
    """Return the messages of `read_payload`. A pack that announces no messages yields none.

    Raises PeerDataError if messages were announced but none could be read.
    """
    messages, faults = read_payload(data)
    if faults and not messages:
        raise PeerDataError(faults[0])
    return messages


def _most_of(kind: type[Message]) -> int:
    if kind is Authentication:
        return PACK_MAX_MESSAGES
    return 2 if kind is BasicId else 1


def _read_pack(data: bytes) -> Payload:
    """Return every valid message of a pack, and the faults of the rest."""
    if len(data) < PACK_HEADER_SIZE:
        raise PeerDataError(f"pack of {len(data)} bytes, shorter than its head of {PACK_HEADER_SIZE}")
    if data[0] >> 4 != PACK_TYPE:
        raise PeerDataError(f"message type {data[0] >> 4} at offset 0 is not a pack")
    if data[1] != MESSAGE_SIZE:
        raise PeerDataError(f"pack message size {data[1]} at offset 1, expected {MESSAGE_SIZE}")
    messages: list[Message] = []
    faults: list[str] = []
    announced = data[2]
    if announced > PACK_MAX_MESSAGES:
        faults.append(f"pack announces {announced} messages at offset 2, allowed: up to {PACK_MAX_MESSAGES}")
    whole = (len(data) - PACK_HEADER_SIZE) // MESSAGE_SIZE
    if announced > whole:
        faults.append(f"pack of {announced} messages cut short: {len(data)} bytes hold {whole}")
    counts: dict[type[Message], int] = {}
    for index in range(min(announced, whole, PACK_MAX_MESSAGES)):
        offset = PACK_HEADER_SIZE + index * MESSAGE_SIZE
        try:
            raw = bytes(data[offset : offset + MESSAGE_SIZE])
            # A Location is new every time. In the cache it would only displace the other messages.
            message = decode(raw) if raw[0] >> 4 == _LOCATION else _decode_again(raw)
        except PeerDataError as error:
            faults.append(f"pack message {index + 1} (offset {offset}): {error}")
            continue
        kind = type(message)
        count = counts[kind] = counts.get(kind, 0) + 1
        if count > 1 and count > _most_of(kind):
            # We cannot tell which of two Locations is right. The first one is kept, as in a receiver that
            # stops reading there.
            faults.append(f"pack message {index + 1} (offset {offset}) is one {kind.__name__} too many")
            continue
        messages.append(message)
    return Payload(tuple(messages), tuple(faults))
