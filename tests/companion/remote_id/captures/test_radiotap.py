"""Radiotap: fields by alignment, chained presence words, namespaces, torn headers."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import PeerDataError
from companion.remote_id.captures.radiotap import Radiotap, build_radiotap, parse_radiotap

FRAME = b"\x80\x00 the frame, of thirty-two bytes."
FCS = b"\xde\xad\xbe\xef"


def header(present: list[int], fields: bytes) -> bytes:
    words = struct.pack(f"<{len(present)}I", *present)
    return struct.pack("<BBH", 0, 0, 4 + len(words) + len(fields)) + words + fields


def bits(*numbers: int) -> int:
    return sum(1 << n for n in numbers)


def test_the_header_for_injection_byte_by_byte() -> None:
    # rate 1 Mb/s at 8, a byte of padding, TX flags "no acknowledgement" at 10
    assert build_radiotap() == bytes.fromhex("00 00 0c00 04800000 02 00 0800")
    assert build_radiotap(12, no_ack=False) == bytes.fromhex("00 00 0c00 04800000 0c 00 0000")


@pytest.mark.parametrize("rate", [0, -1, 256])
def test_a_rate_that_does_not_fit_is_refused(rate: int) -> None:
    with pytest.raises(ValueError, match="rate_500kbps"):
        build_radiotap(rate)


def test_what_is_injected_is_known_as_sent() -> None:
    assert parse_radiotap(build_radiotap() + FRAME) == Radiotap(FRAME, None, None, False, True)


def test_an_empty_header_says_nothing() -> None:
    assert parse_radiotap(header([0], b"") + FRAME) == Radiotap(FRAME, None, None, False, False)


def test_fields_are_aligned_and_the_fcs_comes_off() -> None:
    # flags, rate, channel (2-aligned), signal, antenna, RX flags (2-aligned): what most drivers give
    fields = struct.pack("<BBHHbBH", 0x10, 2, 2437, 0xA0, -61, 1, 0)
    got = parse_radiotap(header([bits(1, 2, 3, 5, 11, 14)], fields) + FRAME + FCS)
    assert got == Radiotap(FRAME, -61.0, 2437, False, False)


def test_padding_before_aligned_fields() -> None:
    # TSFT is 8-aligned from the start: with two presence words the fields begin at 12, so it stands at 16;
    # flags at 24, channel at 26 after a byte of padding, signal at 30.
    fields = b"\xaa" * 4 + struct.pack("<QBxHHb", 1234, 0, 5745, 0x140, -40)
    got = parse_radiotap(header([bits(0, 1, 3, 5, 29, 31), 0], fields) + FRAME)
    assert got == Radiotap(FRAME, -40.0, 5745, False, False)


def test_every_field_of_the_namespace() -> None:
    sizes = [(8, 8), (1, 1), (1, 1), (2, 4), (2, 2), (1, 1), (1, 1), (2, 2), (2, 2), (2, 2), (1, 1), (1, 1)]
    sizes += [(1, 1), (1, 1), (2, 2), (2, 2), (1, 1), (1, 1), (4, 8), (1, 3), (4, 8), (2, 12), (8, 12)]
    sizes += [(2, 12), (2, 12), (2, 6), (1, 1), (2, 4)]
    fields = b""
    starts = []
    for alignment, size in sizes:
        fields += b"\x00" * (-(8 + len(fields)) % alignment)
        starts.append(len(fields))
        fields += b"\x00" * size
    # A second namespace word after all of them finds its signal only if every size before it was right.
    data = bytearray(header([(1 << 28) - 1 | bits(29, 31), bits(5)], b"\x00" * 4 + fields + b"\xc4"))
    got = parse_radiotap(bytes(data) + FRAME)
    assert got.rssi_dbm == 0.0  # the first signal counts
    assert got.frame == FRAME
    with pytest.raises(PeerDataError, match="field 5 of 1 bytes"):
        parse_radiotap(header([(1 << 28) - 1 | bits(29, 31), bits(5)], b"\x00" * 4 + fields) + FRAME)
    assert starts[27] + 4 == len(fields)


def test_signals_per_antenna_do_not_hide_the_first() -> None:
    fields = struct.pack("<bbBbB", -50, -52, 0, -70, 1)
    words = [bits(5, 29, 31), bits(5, 11, 29, 31), bits(5, 11)]
    assert parse_radiotap(header(words, fields) + FRAME).rssi_dbm == -50.0


def test_vendor_fields_are_skipped_by_their_length() -> None:
    vendor = b"\x00\x11\x22\x01" + struct.pack("<H", 5) + b"\xff" * 5
    words = [bits(1, 30, 31), 0x1FFFFFFF | bits(29, 31), bits(1, 5)]
    fields = struct.pack("<Bx", 0x10) + vendor + struct.pack("<Bb", 0, -33)
    got = parse_radiotap(header(words, fields) + FRAME + FCS)
    assert got == Radiotap(FRAME, -33.0, None, False, False)


def test_a_vendor_word_may_be_followed_by_more_of_the_same_vendor() -> None:
    vendor = b"\x00\x11\x22\x01" + struct.pack("<H", 2) + b"\xff" * 2
    words = [bits(30, 31), 0x0FFFFFFF | bits(31), 0x0FFFFFFF | bits(29, 31), bits(5)]
    assert parse_radiotap(header(words, vendor + b"\xce") + FRAME).rssi_dbm == -50.0


def test_bits_beyond_the_standard_end_the_reading_not_the_frame() -> None:
    got = parse_radiotap(header([bits(5, 31), bits(3)], b"\xce" + b"?" * 9) + FRAME)
    assert got == Radiotap(FRAME, -50.0, None, False, False)


def test_a_list_of_typed_fields_ends_the_reading() -> None:
    got = parse_radiotap(header([bits(5, 28, 31), bits(3)], b"\xce" + b"?" * 15) + FRAME)
    assert got == Radiotap(FRAME, -50.0, None, False, False)


@pytest.mark.parametrize(
    ("present", "fields"), [(bits(1), b"\x40"), (bits(1), b"\x50"), (bits(14), b"\x02\x00")]
)
def test_a_frame_that_failed_its_check_is_marked(present: int, fields: bytes) -> None:
    assert parse_radiotap(header([present], fields) + FRAME).bad_fcs


def test_a_frame_of_no_length_that_the_card_announces() -> None:
    assert parse_radiotap(header([bits(26)], b"\x00")).frame == b""


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "shorter"),
        (b"\x00\x00\x08\x00\x00\x00\x00", "shorter"),
        (b"\x01" + header([0], b"")[1:] + FRAME, "version is 1"),
        (struct.pack("<BBHI", 0, 0, 7, 0) + FRAME, "length is 7"),
        (struct.pack("<BBHI", 0, 0, 200, 0) + FRAME, "length is 200"),
        (header([bits(31)], b"") + FRAME, "presence words"),
        (header([bits(29, 31)] * 20, b"")[:40] + FRAME, "length is 84"),
        (header([bits(3)], b"\x01\x02\x03") + FRAME, "field 3"),
        (header([bits(30)], b"\x00" * 5) + FRAME, "vendor namespace"),
        (header([bits(30)], b"\x00\x00\x00\x00\x03\x00??") + FRAME, "vendor data"),
        (header([bits(29, 30)], b"\x00" * 6) + FRAME, "two namespaces"),
        (header([0], b""), "no frame"),
        (header([bits(1)], b"\x10") + FCS, "no frame"),
        (header([bits(1)], b"\x10") + b"\x80", "no frame"),
    ],
)
def test_torn_headers_say_where(data: bytes, words: str) -> None:
    with pytest.raises(PeerDataError, match=words):
        parse_radiotap(data)


@given(st.binary(max_size=80), st.integers(0, 0xFFFF), st.binary(max_size=8))
def test_any_bytes_are_read_or_refused(body: bytes, length: int, prefix: bytes) -> None:
    for data in (body, prefix + body, struct.pack("<BBH", 0, 0, length % (len(body) + 5)) + body):
        try:
            got = parse_radiotap(data)
        except PeerDataError:
            continue
        assert data.count(got.frame) >= 1
