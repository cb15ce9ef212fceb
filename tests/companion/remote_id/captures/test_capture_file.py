"""Capture files: written by another library, in both byte orders, damaged at every byte."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable

import dpkt
import pytest
from dpkt.pcapng import (
    PCAPNG_OPT_IF_TSOFFSET,
    PCAPNG_OPT_IF_TSRESOL,
    EnhancedPacketBlock,
    EnhancedPacketBlockLE,
    InterfaceDescriptionBlock,
    InterfaceDescriptionBlockLE,
    PcapngOption,
    PcapngOptionLE,
    SectionHeaderBlock,
    SectionHeaderBlockLE,
)
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import ConfigError, PeerDataError
from companion.remote_id.captures.capture_file import Packet, read_packets

START_S = 1_700_000_000
PACKETS = [b"first", b"", b"the third one"]


def read(data: bytes) -> list[Packet]:
    return list(read_packets(io.BytesIO(data), "made"))


def read_until_damaged(data: bytes) -> tuple[list[Packet], str | None]:
    packets: list[Packet] = []
    try:
        packets.extend(read_packets(io.BytesIO(data), "made"))
    except PeerDataError as error:
        return packets, str(error)
    return packets, None


def pcap(*, nano: bool = False) -> bytes:
    stream = io.BytesIO()
    writer = dpkt.pcap.Writer(stream, linktype=127, nano=nano)
    for number, packet in enumerate(PACKETS):
        writer.writepkt(packet, ts=START_S + number + 0.25)
    return stream.getvalue()


def pcapng() -> bytes:
    stream = io.BytesIO()
    writer = dpkt.pcapng.Writer(stream, linktype=127)
    for number, packet in enumerate(PACKETS):
        writer.writepkt(packet, ts=START_S + number + 0.25)
    return stream.getvalue()


def big_endian_pcap() -> bytes:
    head = dpkt.pcap.FileHdr(linktype=127)
    records = [
        bytes(dpkt.pcap.PktHdr(tv_sec=START_S + number, tv_usec=250_000, caplen=len(data), len=len(data)))
        + data
        for number, data in enumerate(PACKETS)
    ]
    return bytes(head) + b"".join(records)


def big_endian_pcapng() -> bytes:
    blocks = [bytes(SectionHeaderBlock()), bytes(InterfaceDescriptionBlock(linktype=127))]
    for number, data in enumerate(PACKETS):
        ticks = (START_S + number) * 1_000_000 + 250_000
        blocks.append(
            bytes(EnhancedPacketBlock(ts_high=ticks >> 32, ts_low=ticks & 0xFFFFFFFF, pkt_data=data, opts=[]))
        )
    return b"".join(blocks)


FORMATS: list[Callable[[], bytes]] = [
    pcap,
    lambda: pcap(nano=True),
    pcapng,
    big_endian_pcap,
    big_endian_pcapng,
]


@pytest.mark.parametrize("make", FORMATS)
def test_what_another_library_writes_is_read(make: Callable[[], bytes]) -> None:
    assert read(make()) == [
        Packet(number=n + 1, time_ns=(START_S + n) * 10**9 + 250_000_000, link_type=127, data=data)
        for n, data in enumerate(PACKETS)
    ]


@pytest.mark.parametrize("make", FORMATS)
def test_a_file_cut_anywhere_gives_its_whole_packets_and_says_where_it_ends(
    make: Callable[[], bytes],
) -> None:
    whole = make()
    packets = read(whole)
    seen = set()
    for end in range(4, len(whole)):
        got, error = read_until_damaged(whole[:end])
        assert got == packets[: len(got)]
        assert error is None or f"made: packet {len(got) + 1}, at byte" in error
        seen.add(len(got))
    assert seen == set(range(len(packets)))  # the last is whole only with the last byte


def test_interfaces_keep_their_link_type_and_their_clock() -> None:
    def interface(link_type: int, *options: tuple[int, bytes]) -> bytes:
        opts = [PcapngOptionLE(code=code, data=value) for code, value in options]
        return bytes(InterfaceDescriptionBlockLE(linktype=link_type, opts=[*opts, PcapngOptionLE()]))

    def packet(index: int, ticks: int) -> bytes:
        return bytes(
            EnhancedPacketBlockLE(
                iface_id=index, ts_high=ticks >> 32, ts_low=ticks & 0xFFFFFFFF, pkt_data=b"x", opts=[]
            )
        )

    section = (
        bytes(SectionHeaderBlockLE())
        + interface(272, (2, b"nRF"), (PCAPNG_OPT_IF_TSRESOL, b"\x09"))
        + interface(127, (PCAPNG_OPT_IF_TSRESOL, b"\x8a"), (PCAPNG_OPT_IF_TSOFFSET, struct.pack("<q", 100)))
        + struct.pack("<III", 0xBAD, 12, 12)  # a block of a kind that is not known
        + packet(1, 1024 + 512)
        + packet(0, START_S * 10**9 + 1)
    )
    second_section = (
        bytes(SectionHeaderBlock())
        + bytes(InterfaceDescriptionBlock(linktype=105))
        + bytes(
            EnhancedPacketBlock(
                ts_low=1, pkt_data=b"y", opts=[PcapngOption(code=1, data=b"\xff\xfe"), PcapngOption()]
            )
        )
    )
    assert read(section + second_section) == [
        Packet(1, 101_500_000_000, 127, b"x"),
        Packet(2, START_S * 10**9 + 1, 272, b"x"),
        Packet(3, 1000, 105, b"y"),
    ]


def test_simple_packets_have_no_time() -> None:
    head = bytes(SectionHeaderBlockLE()) + bytes(InterfaceDescriptionBlockLE(linktype=105, snaplen=6))
    simple = struct.pack("<IIIQI", 3, 24, 9, 0x1122334455667788, 24)
    assert read(head + simple) == [Packet(1, None, 105, b"\x88\x77\x66\x55\x44\x33")]


SECTION = bytes(SectionHeaderBlockLE())
INTERFACE = bytes(InterfaceDescriptionBlockLE(linktype=127))


def test_a_block_full_of_options_is_read_in_one_pass() -> None:
    """A copy of the rest for each option would be 4 TB here: the test would not end."""
    options = struct.pack("<HH", 2, 0) * 1_000_000
    size = 20 + len(options)
    interface = struct.pack("<IIHHI", 1, size, 127, 0, 0) + options + struct.pack("<I", size)
    assert read(SECTION + interface + bytes(EnhancedPacketBlockLE(pkt_data=b"x", opts=[])))[0].data == b"x"


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "made: is empty"),
        (b"\x0a", "made: starts with 0a"),
        (b"PK\x03\x04 and so on", "made: starts with 504b0304; expected a capture"),
    ],
)
def test_what_is_no_capture_is_named(data: bytes, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        read(data)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (
            pcap()[:24] + struct.pack("<IIII", 0, 0, 1 << 30, 0),
            "at byte 40, has a length of 1073741824 bytes",
        ),
        (SECTION[:8] + b"\1\2\3\4" + SECTION[12:], "byte order 01020304"),
        (SECTION + struct.pack("<II", 6, 0), "block of 0 bytes"),
        (SECTION + struct.pack("<II", 6, 33), "block of 33 bytes"),
        (SECTION + struct.pack("<III", 6, 12, 16), "a length that differs"),
        (SECTION + struct.pack("<III", 1, 12, 12), "has 0 bytes where its head should be"),
        (SECTION + bytes(EnhancedPacketBlockLE(pkt_data=b"x", opts=[])), "interface 0 of 0"),
        (SECTION + INTERFACE + struct.pack("<IIIIIIII", 6, 32, 0, 0, 0, 9, 9, 32), "announces 9 bytes"),
    ],
)
def test_damage_is_named_with_its_place(data: bytes, words: str) -> None:
    with pytest.raises(PeerDataError, match=words):
        read(data)


@given(st.sampled_from(FORMATS), st.lists(st.tuples(st.integers(4, 300), st.integers(0, 255)), max_size=4))
def test_damage_raises_nothing_else(make: Callable[[], bytes], changes: list[tuple[int, int]]) -> None:
    data = bytearray(make())
    for at, value in changes:
        data[at % len(data)] = value
    if data[:4] == make()[:4]:
        _, error = read_until_damaged(bytes(data))
        assert error is None or error.startswith("made: packet ")
    else:
        with pytest.raises(ConfigError, match="made: starts with"):
            read(bytes(data))
