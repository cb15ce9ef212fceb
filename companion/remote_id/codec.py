"""Remote ID payloads <-> messages: what the rest of the companion calls.

ASTM F3411-22a section 5.4; `wire_messages` has the 25-byte layouts, `wire_values` the scalings. There are two
kinds of reading:

- `decode` and `decode_pack` are all or nothing, as the public reference decoder (opendroneid-core-c) but for
  one thing: of a pack it leaves out an authentication page that contradicts itself, and takes the rest.
- `read_payload` and `decode_payload` are for a receiver: every message of a pack that can be read is
  returned, so that one reserved type or a torn end does not hide an aircraft's Location. A pack of zero
  messages, which transmitters send before they know anything, is simply empty.

On both: any protocol version is taken (later ones are to stay readable), reserved bits and bytes behind the
payload are ignored, reserved enumeration numbers are kept (`messages.WireCode`), and values that the standard
does not allow are unknown (`wire_values`). Only `PeerDataError` is raised for bad bytes, only ValueError for
a message that cannot be sent.
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
"""Every pack of an aircraft repeats its identities and texts; messages are immutable, so one serves all."""

_PACK_HEAD: Final = PACK_TYPE << 4 | PROTOCOL_VERSION


class Payload(NamedTuple):
    """What a receiver made of one payload."""

    messages: tuple[Message, ...]
    faults: tuple[str, ...]
    """In words: each part that had to be left out, or that breaks the standard."""


def encode_pack(messages: Sequence[Message]) -> bytes:
    """A pack of 1 to 9 messages in the order given. Raises ValueError.

    A pack holds at most two Basic IDs, any number of authentication pages and one of each other message.
    """
    if not 1 <= len(messages) <= PACK_MAX_MESSAGES:
        raise ValueError(f"pack of {len(messages)} messages; allowed: 1 to {PACK_MAX_MESSAGES}")
    counts = Counter(type(message) for message in messages)
    for kind, count in counts.items():
        if count > _most_of(kind):
            raise ValueError(f"pack with {count} {kind.__name__} messages; allowed: {_most_of(kind)}")
    return bytes((_PACK_HEAD, MESSAGE_SIZE, len(messages))) + b"".join(map(encode, messages))


def decode_pack(data: bytes) -> tuple[Message, ...]:
    """All messages of a pack that keeps the standard throughout; bytes behind it are ignored.

    Raises PeerDataError at the first fault, and for a pack without messages.
    """
    messages, faults = _read_pack(data)
    if faults:
        raise PeerDataError(faults[0])
    if not messages:
        raise PeerDataError("pack announces 0 messages at offset 2, expected 1 to 9")
    return messages


def read_payload(data: bytes) -> Payload:
    """One message or a pack, whichever the first byte says, as far as it can be read.

    Bytes behind it (padding) are ignored. Raises PeerDataError where not even the head of a pack, or the one
    message, is sound.
    """
    if not data:
        raise PeerDataError("empty payload")
    if data[0] >> 4 == PACK_TYPE:
        return _read_pack(data)
    return Payload((decode(data[:MESSAGE_SIZE]),), ())


def decode_payload(data: bytes) -> tuple[Message, ...]:
    """The messages of `read_payload`; none for a pack that announces none.

    Raises PeerDataError where no message could be read although some were announced.
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
    """Every sound message of a pack, and what was wrong with the rest."""
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
        faults.append(f"pack announces {announced} messages at offset 2, at most {PACK_MAX_MESSAGES}")
    whole = (len(data) - PACK_HEADER_SIZE) // MESSAGE_SIZE
    if announced > whole:
        faults.append(f"pack of {announced} messages cut short: {len(data)} bytes hold {whole}")
    counts: dict[type[Message], int] = {}
    for index in range(min(announced, whole, PACK_MAX_MESSAGES)):
        offset = PACK_HEADER_SIZE + index * MESSAGE_SIZE
        try:
            raw = bytes(data[offset : offset + MESSAGE_SIZE])
            # A Location is new every time, and would only drive the others out.
            message = decode(raw) if raw[0] >> 4 == _LOCATION else _decode_again(raw)
        except PeerDataError as error:
            faults.append(f"pack message {index + 1} (offset {offset}): {error}")
            continue
        kind = type(message)
        count = counts[kind] = counts.get(kind, 0) + 1
        if count > 1 and count > _most_of(kind):
            # Which of two Locations holds cannot be told: the first stays, as in a receiver that stops there.
            faults.append(f"pack message {index + 1} (offset {offset}) is one {kind.__name__} too many")
            continue
        messages.append(message)
    return Payload(tuple(messages), tuple(faults))
