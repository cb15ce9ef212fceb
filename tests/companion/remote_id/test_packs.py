"""Message packs: order, limits, damaged and torn packs."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import PeerDataError
from companion.remote_id.codec import (
    decode_pack,
    decode_payload,
    encode,
    encode_pack,
    read_payload,
)
from companion.remote_id.messages import (
    Authentication,
    BasicId,
    IdType,
    Location,
    Message,
    SelfId,
    System,
    UaType,
)

BASIC = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.GLIDER, uas_id="1581F6N8A23B2ML3Y3KR")
TEXT = SelfId(description_type=0, text="survey")
PAGES = tuple(Authentication(auth_type=1, page=page, data=bytes(23)) for page in range(1, 8))


@given(st.permutations([BASIC, BASIC, Location(), TEXT, System(), *PAGES[:4]]), st.integers(1, 9))
def test_a_pack_comes_back_in_its_order(messages: list[Message], count: int) -> None:
    pack = encode_pack(messages[:count])
    assert len(pack) == 3 + 25 * count
    assert pack[:3] == bytes((0xF2, 25, count))
    assert decode_pack(pack) == tuple(messages[:count])
    assert decode_pack(pack + b"padding") == tuple(messages[:count])
    assert decode_payload(pack) == tuple(messages[:count])


@pytest.mark.parametrize(
    "messages",
    [(), (TEXT, TEXT), (Location(), Location()), (BASIC,) * 3, (*PAGES, BASIC, TEXT, Location())],
)
def test_a_pack_beyond_the_standard_is_refused(messages: tuple[Message, ...]) -> None:
    with pytest.raises(ValueError, match="pack"):
        encode_pack(messages)


def test_a_bad_message_does_not_hide_the_others() -> None:
    pack = bytearray(encode_pack((BASIC, TEXT, Location(alt_geodetic_m=1.0))))
    pack[3 + 25] = 0x62
    with pytest.raises(PeerDataError, match="type 6"):
        decode_pack(bytes(pack))
    messages, faults = read_payload(bytes(pack))
    assert messages == (BASIC, Location(alt_geodetic_m=1.0))
    assert len(faults) == 1
    assert "message 2" in faults[0]


def test_a_torn_pack_gives_its_whole_messages() -> None:
    pack = encode_pack((BASIC, Location(alt_geodetic_m=1.0)))
    messages, faults = read_payload(pack[:-1])
    assert messages == (BASIC,)
    assert "cut short" in faults[0]
    with pytest.raises(PeerDataError, match="cut short"):
        decode_pack(pack[:-1])
    with pytest.raises(PeerDataError, match="cut short"):
        decode_payload(pack[:20])


def test_a_second_location_in_a_pack_is_left_out() -> None:
    pack = encode_pack((Location(alt_geodetic_m=1.0), TEXT))
    doubled = pack[:2] + b"\x03" + pack[3:] + encode(Location(alt_geodetic_m=2.0))
    messages, faults = read_payload(doubled)
    assert messages == (Location(alt_geodetic_m=1.0), TEXT)
    assert "too many" in faults[0]


def test_a_pack_that_announces_none_is_empty_to_a_receiver() -> None:
    padded = bytes((0xF0, 25, 0)) + bytes(225)
    assert decode_payload(padded) == ()
    assert read_payload(padded).faults == ()
    with pytest.raises(PeerDataError, match="0 messages"):
        decode_pack(padded)


def test_one_message_with_padding_is_a_payload() -> None:
    assert decode_payload(encode(TEXT) + bytes(5)) == (TEXT,)
