"""Checks the codec and the frames against a file of reference vectors (`companion remote-id check`).

The file comes from the public reference implementation (opendroneid-core-c). It is JSON with groups of
vectors. Each vector has an `id`, a `type`, whether the reference accepted it, and the bytes. If `on_grid` is
false, the values of a vector lie between the steps of the wire format. Then the fields that the reference
truncates and we round may differ by one step. Everything else must agree to the bit. Both directions are
checked, and also that the file's bytes agree with its own decoding of them.
"""

from __future__ import annotations

import gzip
import json
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import msgspec

from companion.errors import ConfigError, PeerDataError
from companion.remote_id import frames
from companion.remote_id.codec import (
    MESSAGE_SIZE,
    PACK_HEADER_SIZE,
    PACK_MAX_MESSAGES,
    PACK_TYPE,
    decode,
    decode_pack,
    encode,
    encode_pack,
)
from companion.remote_id.conformance.vector_fields import (
    HIGHEST_CATEGORY,
    TRUNCATED_STEPS,
    Fields,
    as_received,
    bytes_of,
    integer_of,
    message_of,
    stated,
    text_of,
)
from companion.remote_id.messages import Message
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN

_RAW: Final = "raw"
"""Type of a pack's part that is no message of the standard; only its bytes are given."""
_AUTHENTICATION_TYPE: Final = 2
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


@dataclass
class Report:
    """Result of a check."""

    checked: Counter[str] = field(default_factory=Counter)
    """Number of vectors checked, by type."""
    differences: list[str] = field(default_factory=list)
    """One line per difference, naming the vector."""


def check_file(path: Path) -> Report:
    """Check every vector of a file (plain or gzip). Raises ConfigError if it is not a vector file."""
    try:
        data = path.read_bytes()
        content = json.loads(gzip.decompress(data) if path.suffix == ".gz" else data, parse_int=_integer)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from error
    except (ValueError, EOFError, RecursionError, zlib.error) as error:
        raise ConfigError(f"{path}: not JSON: {error}") from error
    try:
        return check_vectors(content)
    except ConfigError as error:
        raise ConfigError(f"{path}: not a vector file: {error}") from error


def _integer(digits: str) -> int | float:
    """Convert a JSON integer; too large ones become float, so that comparisons cannot overflow."""
    return int(digits) if len(digits) < 20 else float(digits)


def check_vectors(content: object) -> Report:
    """Check the parsed content of a vector file. Raises ConfigError if it is none."""
    groups = content.get("vectors") if isinstance(content, dict) else None
    if not isinstance(groups, dict) or not all(isinstance(group, list) for group in groups.values()):
        raise ConfigError("no 'vectors' with lists of vectors in it")
    report = Report()
    for name, group in groups.items():
        for index, vector in enumerate(group):
            try:
                _check_into(report, _fields(vector))
            except ConfigError as error:
                label = vector.get("id") if isinstance(vector, dict) else None
                raise ConfigError(f"vector {label or f'{index} of {name!r}'}: {error}") from error
    if not report.checked:
        raise ConfigError("it holds no vectors")
    return report


def _check_into(report: Report, vector: Fields) -> None:
    name, kind = text_of(vector, "id"), text_of(vector, "type")
    checker = _CHECKERS.get(kind)
    report.checked[kind] += 1
    if checker is None:
        report.differences.append(f"{name}: vector type {kind!r} is not known")
        return
    report.differences.extend(f"{name}: {difference}" for difference in checker(vector))


def _fields(value: object) -> Fields:
    if not isinstance(value, dict):
        raise ConfigError(f"{str(value)[:40]!r} stands where an object was expected")
    return value


def _list(vector: Fields, name: str) -> list[Fields]:
    value = vector.get(name)
    if not isinstance(value, list):
        raise ConfigError(f"field {name!r} is not a list")
    return [_fields(item) for item in value]


def _accepted(vector: Fields) -> bool:
    accepted = vector.get("accepted")
    if not isinstance(accepted, bool):
        raise ConfigError(f"field 'accepted' is {accepted!r}, expected true or false")
    return accepted


def _contradiction(vector: Fields) -> str | None:
    """Describe a vector in which `accepted` and `hex` contradict each other.

    A vector that the reference encoded has bytes; one that it refused has none.
    """
    if "hex" in vector and _accepted(vector) is (vector["hex"] is None):
        return f"'accepted' is {_accepted(vector)}, which 'hex' contradicts: {vector['hex']!r}"
    return None


# ---------------------------------------------------------------- single messages


def _check_message(vector: Fields) -> Iterator[str]:
    """Check the encoding of `input` and the decoding of the reference's bytes."""
    accepted = _accepted(vector)
    if (contradiction := _contradiction(vector)) is not None:
        yield contradiction
        return
    try:
        ours = _encode(vector)
    except ValueError as error:
        if accepted:
            yield f"refused ({error}), the reference encodes it"
        return
    if not accepted:
        yield f"encoded as {ours.hex()}, the reference refuses it"
        return
    theirs = bytes_of(vector, "hex")
    yield from _compare_encoding(vector, ours, theirs)
    yield from _compare_decoding(vector, "type", "decoded", theirs)


def _encode(vector: Fields) -> bytes:
    return encode(message_of(text_of(vector, "type"), _fields(vector.get("input"))))


def _compare_encoding(vector: Fields, ours: bytes, theirs: bytes) -> Iterator[str]:
    """Compare our 25 bytes with the reference's.

    If the vector is on the grid, the bytes must also hold every number of the input exactly.
    """
    exact = vector.get("on_grid", True) is not False
    yield from _compare_bytes(ours, theirs, exact=exact)
    if exact and len(ours) == len(theirs) and ours[0] == theirs[0]:
        _, held = stated(theirs)
        for name, value in as_received(_fields(vector.get("input"))).items():
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


def _compare_decoding(vector: Fields, kind_name: str, decoded_name: str, data: bytes) -> Iterator[str]:
    """Compare our decoding of the reference's 25 bytes, and the fields in them, with the file's decoding."""
    try:
        ours = decode(data)
    except PeerDataError as error:
        yield f"refused to decode ({error}), the reference decodes it"
        return
    kind, decoded = text_of(vector, kind_name), _fields(vector.get(decoded_name))
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


# ---------------------------------------------------------------- packs, and bytes to decode


def _check_pack(vector: Fields) -> Iterator[str]:
    """Check building and reading of a pack. Both must refuse a pack that the reference refused."""
    parts = _list(vector, "messages")
    size = integer_of(vector, "single_message_size") if "single_message_size" in vector else MESSAGE_SIZE
    count = integer_of(vector, "message_count") if "message_count" in vector else len(parts)
    accepted = _accepted(vector)
    if (contradiction := _contradiction(vector)) is not None:
        yield contradiction
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
    try:
        ours = _encode(part)
    except ValueError as error:
        yield f"refused ({error}), the reference encodes it"
        return
    yield from _compare_encoding(part, ours, theirs)


def _check_pack_encoding(vector: Fields, parts: list[Fields], *, accepted: bool) -> Iterator[str]:
    try:
        ours = encode_pack([message_of(text_of(part, "type"), _fields(part.get("input"))) for part in parts])
    except ValueError as error:
        if accepted:
            yield f"refused ({error}), the reference encodes it"
        return
    if not accepted:
        yield f"encoded as {ours.hex()}, the reference refuses it"
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
    expected = _list(vector, "decoded_messages")
    if len(ours) != len(expected):
        yield f"decoded {len(ours)} messages, expected {len(expected)}"
        return
    for index, item in enumerate(expected):
        part = data[PACK_HEADER_SIZE + index * MESSAGE_SIZE :][:MESSAGE_SIZE]
        for difference in _compare_decoding(item, "type", "fields", part):
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


def _check_decode(vector: Fields) -> Iterator[str]:
    """Check a vector that only holds bytes to decode."""
    data = bytes_of(vector, "hex")
    is_pack = bool(data) and data[0] >> 4 == PACK_TYPE
    if not _accepted(vector):
        yield from _check_refusal(data, decode_pack if is_pack else decode)
    elif is_pack:
        yield from _check_pack_decoding(vector, data)
    else:
        yield from _compare_decoding(vector, "message_type", "decoded", data)


# ---------------------------------------------------------------- transport frames


def _check_frame(
    vector: Fields,
    transport: str,
    payload_name: str,
    build: Callable[[bytes, int], bytes],
    address: str | None,
) -> Iterator[str]:
    """Check building and reading of a frame."""
    payload, counter, theirs = (
        bytes_of(vector, payload_name),
        integer_of(vector, "counter"),
        bytes_of(vector, "hex"),
    )
    try:
        ours = build(payload, counter)
    except ValueError as error:
        yield f"refused ({error})"
        return
    if ours != theirs:
        yield f"built {ours.hex()}, expected {theirs.hex()}"
    try:
        frame = frames.parse_frame(transport, theirs)
    except PeerDataError as error:
        yield f"refused to read ({error})"
        return
    expected = frames.Frame(transport=transport, address=address, counter=counter, payload=payload)
    if frame != expected:
        yield f"read {frame}, expected {expected}"


def _check_ble4(vector: Fields) -> Iterator[str]:
    return _check_frame(vector, BLE4, "message_hex", frames.build_ble4, None)


def _check_ble5(vector: Fields) -> Iterator[str]:
    return _check_frame(vector, BLE5, "pack_hex", frames.build_ble5, None)


def _check_beacon(vector: Fields) -> Iterator[str]:
    address, ssid = bytes_of(vector, "mac").hex(":"), text_of(vector, "ssid")
    interval_tu = integer_of(vector, "beacon_interval_tu")

    def build(pack: bytes, counter: int) -> bytes:
        return frames.build_beacon(pack, counter, address, ssid=ssid, interval_tu=interval_tu)

    return _check_frame(vector, WIFI_BEACON, "pack_hex", build, address)


def _check_nan_action(vector: Fields) -> Iterator[str]:
    address = bytes_of(vector, "mac").hex(":")

    def build(pack: bytes, counter: int) -> bytes:
        return frames.build_nan_action(pack, counter, address)

    return _check_frame(vector, WIFI_NAN, "pack_hex", build, address)


def _check_nan_sync_beacon(vector: Fields) -> Iterator[str]:
    """Check building a beacon, and recognising that it holds no Remote ID."""
    address, theirs = bytes_of(vector, "mac").hex(":"), bytes_of(vector, "hex")
    try:
        ours = frames.build_nan_sync_beacon(address)
    except ValueError as error:
        yield f"refused ({error})"
        return
    if ours != theirs:
        yield f"built {ours.hex()}, expected {theirs.hex()}"
    try:
        read: object = frames.parse_wifi(theirs)
    except frames.NanSyncBeaconError as error:
        if error.address != address:
            yield f"read as a synchronisation beacon of {error.address}, expected {address}"
        return
    except PeerDataError as error:
        read = error
    yield f"read as {read}, expected a synchronisation beacon"


_CHECKERS: Final[Mapping[str, Callable[[Fields], Iterator[str]]]] = {
    "basic_id": _check_message,
    "location": _check_message,
    "auth": _check_message,
    "self_id": _check_message,
    "system": _check_message,
    "operator_id": _check_message,
    "message_pack": _check_pack,
    "decode": _check_decode,
    "ble_legacy_adv_data": _check_ble4,
    "ble_extended_adv_data": _check_ble5,
    "wifi_beacon_frame": _check_beacon,
    "wifi_nan_action_frame": _check_nan_action,
    "wifi_nan_sync_beacon_frame": _check_nan_sync_beacon,
}
