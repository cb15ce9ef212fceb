"""Checks message packs, and bytes that are only to be decoded, against their reference vectors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from companion.errors import PeerDataError
from companion.remote_id.codec import (
    MESSAGE_SIZE,
    PACK_HEADER_SIZE,
    PACK_MAX_MESSAGES,
    PACK_TYPE,
    decode,
    decode_pack,
    encode_pack,
)
from companion.remote_id.conformance.check_messages import (
    compare_decoding,
    compare_encoding,
    encode_input,
    encoding_of,
)
from companion.remote_id.conformance.vector_fields import (
    Fields,
    accepted_of,
    bytes_of,
    contradiction,
    fields_of,
    integer_of,
    list_of,
    message_of,
    text_of,
)

_RAW: Final = "raw"
"""Type of a pack's part that is no message of the standard; only its bytes are given."""
_AUTHENTICATION_TYPE: Final = 2


def check_pack(vector: Fields) -> Iterator[str]:
    """Check building and reading of a pack. Both must refuse a pack that the reference refused."""
    parts = list_of(vector, "messages")
    size = integer_of(vector, "single_message_size") if "single_message_size" in vector else MESSAGE_SIZE
    count = integer_of(vector, "message_count") if "message_count" in vector else len(parts)
    accepted = accepted_of(vector)
    if (wrong := contradiction(vector)) is not None:
        yield wrong
        return
    for index, part in enumerate(parts):
        for difference in _check_part(part):
            yield f"message {index + 1}: {difference}"
    raw = any(text_of(part, "type") == _RAW for part in parts)
    if size == MESSAGE_SIZE and count == len(parts) and not raw:
        yield from _check_pack_encoding(vector, parts, accepted=accepted)
    if accepted:
        yield from _check_pack_decoding(vector, bytes_of(vector, "hex"))
    elif 0 <= size <= 0xFF and 0 <= count <= 0xFF:
        # Our encoder cannot be asked for a wrong size or count, so the decoder is tested with them.
        pack = bytes((0xF2, size, count)) + b"".join(bytes_of(part, "hex") for part in parts)
        yield from _check_refusal(pack, decode_pack)


def _check_part(part: Fields) -> Iterator[str]:
    """Check one message of a pack by itself, even if the pack is refused. A raw part is only bytes."""
    theirs = bytes_of(part, "hex")
    if text_of(part, "type") == _RAW:
        return
    ours = yield from encoding_of(lambda: encode_input(part), accepted=True)
    if ours is not None:
        yield from compare_encoding(part, ours, theirs)


def _check_pack_encoding(vector: Fields, parts: list[Fields], *, accepted: bool) -> Iterator[str]:
    ours = yield from encoding_of(
        lambda: encode_pack(
            [message_of(text_of(part, "type"), fields_of(part.get("input"))) for part in parts]
        ),
        accepted=accepted,
    )
    if ours is None:
        return
    theirs = bytes_of(vector, "hex")
    if len(ours) != len(theirs) or ours[:PACK_HEADER_SIZE] != theirs[:PACK_HEADER_SIZE]:
        yield f"encoded as {ours.hex()}, expected {theirs.hex()}"
        return
    for index, part in enumerate(parts):
        at = slice(PACK_HEADER_SIZE + index * MESSAGE_SIZE, PACK_HEADER_SIZE + (index + 1) * MESSAGE_SIZE)
        if theirs[at] != bytes_of(part, "hex"):
            yield f"message {index + 1}: the pack holds {theirs[at].hex()}, expected {part['hex']}"


def _check_pack_decoding(vector: Fields, data: bytes) -> Iterator[str]:
    whole, data = data, _without_unsound_pages(data)
    try:
        ours = decode_pack(data) if data == whole or data[2] else ()
    except PeerDataError as error:
        yield f"refused to decode ({error}), the reference decodes it"
        return
    expected = list_of(vector, "decoded_messages")
    if len(ours) != len(expected):
        yield f"decoded {len(ours)} messages, expected {len(expected)}"
        return
    for index, item in enumerate(expected):
        part = data[PACK_HEADER_SIZE + index * MESSAGE_SIZE :][:MESSAGE_SIZE]
        for difference in compare_decoding(item, "type", "fields", part):
            yield f"message {index + 1}: {difference}"
        if ours[index] != decode(part):
            yield f"message {index + 1}: read differently inside the pack"


def _without_unsound_pages(pack: bytes) -> bytes:
    """Return the pack without authentication pages that contradict themselves.

    The reference leaves those out, while `decode_pack` refuses the whole pack. A pack that is itself invalid
    is returned unchanged.
    """
    end = PACK_HEADER_SIZE + pack[2] * MESSAGE_SIZE if len(pack) >= PACK_HEADER_SIZE else 0
    if not PACK_HEADER_SIZE < end <= len(pack) or pack[2] > PACK_MAX_MESSAGES:
        return pack
    parts = [pack[at : at + MESSAGE_SIZE] for at in range(PACK_HEADER_SIZE, end, MESSAGE_SIZE)]
    kept = [part for part in parts if part[0] >> 4 != _AUTHENTICATION_TYPE or _readable(part)]
    if len(kept) == len(parts):
        return pack
    return pack[:2] + bytes((len(kept),)) + b"".join(kept)


def _readable(message: bytes) -> bool:
    try:
        decode(message)
    except PeerDataError:
        return False
    return True


def _check_refusal(data: bytes, reader: Callable[[bytes], object]) -> Iterator[str]:
    try:
        reader(data)
    except PeerDataError:
        return
    yield f"decoded {data.hex()}, the reference refuses it"


def check_decode(vector: Fields) -> Iterator[str]:
    """Check a vector that only holds bytes to decode."""
    data = bytes_of(vector, "hex")
    is_pack = bool(data) and data[0] >> 4 == PACK_TYPE
    if not accepted_of(vector):
        yield from _check_refusal(data, decode_pack if is_pack else decode)
    elif is_pack:
        yield from _check_pack_decoding(vector, data)
    else:
        yield from compare_decoding(vector, "message_type", "decoded", data)
