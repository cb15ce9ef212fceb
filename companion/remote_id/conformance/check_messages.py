"""Checks single messages against their reference vectors: our encoding and our decoding."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from typing import Final

import msgspec

from companion.errors import PeerDataError
from companion.remote_id.codec import decode, encode
from companion.remote_id.conformance.vector_fields import (
    HIGHEST_CATEGORY,
    TRUNCATED_STEPS,
    Fields,
    accepted_of,
    as_received,
    bytes_of,
    contradiction,
    fields_of,
    message_of,
    stated,
    text_of,
)
from companion.remote_id.messages import Message

_NEAR: Final = 1e-8
"""Tolerance for decimal rounding in the file, far below every wire step."""

_RESERVED_BITS: Final[Mapping[int, bytes]] = {
    0: bytes(22) + b"\xff\xff\xff",
    1: b"\0\x08" + bytes(21) + b"\xf0\xff",
    2: bytes(25),
    3: bytes(25),
    4: b"\0\xe0" + bytes(22) + b"\xff",
    5: bytes(22) + b"\xff\xff\xff",
}
"""Bits of each message type that belong to no field."""


def check_message(vector: Fields) -> Iterator[str]:
    """Check the encoding of `input` and the decoding of the reference's bytes."""
    accepted = accepted_of(vector)
    if (wrong := contradiction(vector)) is not None:
        yield wrong
        return
    ours = yield from encoding_of(lambda: encode_input(vector), accepted=accepted)
    if ours is None:
        return
    theirs = bytes_of(vector, "hex")
    yield from compare_encoding(vector, ours, theirs)
    yield from compare_decoding(vector, "type", "decoded", theirs)


def encoding_of(encode_it: Callable[[], bytes], *, accepted: bool) -> Generator[str, None, bytes | None]:
    """Encode. Return the bytes if both we and the reference accept the input, otherwise None.

    Args:
        accepted: whether the reference accepted it; the difference is yielded if we did otherwise.
    """
    try:
        ours = encode_it()
    except ValueError as error:
        if accepted:
            yield f"refused ({error}), the reference encodes it"
        return None
    if not accepted:
        yield f"encoded as {ours.hex()}, the reference refuses it"
        return None
    return ours


def encode_input(vector: Fields) -> bytes:
    """Encode the vector's `input`. Raises ValueError if it cannot go on the air."""
    return encode(message_of(text_of(vector, "type"), fields_of(vector.get("input"))))


def compare_encoding(vector: Fields, ours: bytes, theirs: bytes) -> Iterator[str]:
    """Compare our 25 bytes with the reference's.

    If the vector is on the grid, the bytes must also hold every number of the input exactly.
    """
    exact = vector.get("on_grid", True) is not False
    yield from _compare_bytes(ours, theirs, exact=exact)
    if exact and len(ours) == len(theirs) and ours[0] == theirs[0]:
        _, held = stated(theirs)
        for name, value in as_received(fields_of(vector.get("input"))).items():
            if isinstance(value, int | float) and name in held and not _same(held[name], value):
                yield f"bytes hold {name} {held[name]!r}, the input on the grid is {value!r}"


def _compare_bytes(ours: bytes, theirs: bytes, *, exact: bool) -> Iterator[str]:
    """Compare our 25 bytes with the reference's, field by field where they may differ."""
    if ours == theirs:
        return
    if len(ours) != len(theirs) or ours[0] != theirs[0]:
        yield f"encoded as {ours.hex()}, expected {theirs.hex()}"
        return
    (_, our_fields), (_, their_fields) = stated(ours), stated(theirs)
    explained = False
    for name, expected in their_fields.items():
        value = our_fields.get(name)
        if value == expected:
            continue
        explained = True
        unknown_for_reserved = value == 0 and _reserved(name, expected)
        if not unknown_for_reserved and (exact or not _within_step(name, value, expected)):
            yield f"encoded {name} as {value!r}, expected {expected!r}"
    mask = _RESERVED_BITS[theirs[0] >> 4]
    if not explained or any((a ^ b) & bits for a, b, bits in zip(ours, theirs, mask, strict=True)):
        yield f"encoded as {ours.hex()}, expected {theirs.hex()}: bits outside the fields differ"


def _reserved(name: str, value: object) -> bool:
    return name in HIGHEST_CATEGORY and isinstance(value, int) and value > HIGHEST_CATEGORY[name]


def _within_step(name: str, ours: object, theirs: object) -> bool:
    if not isinstance(ours, int | float) or not isinstance(theirs, int | float):
        return False
    return abs(ours - theirs) <= TRUNCATED_STEPS.get(name, 0.0)


def compare_decoding(vector: Fields, kind_name: str, decoded_name: str, data: bytes) -> Iterator[str]:
    """Compare our decoding of the reference's 25 bytes, and the fields in them, with the file's decoding."""
    try:
        ours = decode(data)
    except PeerDataError as error:
        yield f"refused to decode ({error}), the reference decodes it"
        return
    kind, decoded = text_of(vector, kind_name), fields_of(vector.get(decoded_name))
    their_kind, fields = stated(data)
    if their_kind != kind:
        yield f"decoded as {their_kind}, expected {kind}"
        return
    agree = True
    for name, value in decoded.items():
        if name.endswith("_hex"):
            value = bytes_of(decoded, name).hex()
        if not _same(fields.get(name), value):
            agree = False
            yield f"bytes hold {name} {fields.get(name)!r}, expected {value!r}"
    if not agree:
        return
    try:
        yield from _compare_messages(ours, message_of(kind, as_received(decoded)))
    except ValueError as error:
        yield f"states a decoding that no message can hold ({error})"


def _same(value: object, expected: object) -> bool:
    if isinstance(value, int | float) and isinstance(expected, int | float):
        return abs(value - expected) <= _NEAR
    return value == expected


def _compare_messages(ours: Message, expected: Message) -> Iterator[str]:
    if type(ours) is not type(expected):
        yield f"decoded as {type(ours).__name__}, expected {type(expected).__name__}"
        return
    for info in msgspec.structs.fields(ours):
        value, wanted = getattr(ours, info.name), getattr(expected, info.name)
        if not _same(value, wanted):
            yield f"decoded {info.name} {value!r}, expected {wanted!r}"
