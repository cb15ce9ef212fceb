"""HCI layouts byte by byte, written out by hand from the standard."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import PeerDataError
from companion.radio.hci import packets
from companion.radio.hci.controller_events import (
    CommandResult,
    DataStatus,
    H4Reader,
    HardwareError,
    Report,
    Reports,
    SetTerminated,
    parse_event,
)
from companion.radio.hci.packets import HciCommand, Opcode, Phy, status_words

ADDRESS = "c2:01:02:03:04:05"

COMMANDS = {
    "reset": (HciCommand(Opcode.RESET), "01 030c 00"),
    "event mask": (packets.event_mask(), "01 010c 08 0080000000000020"),
    "LE event mask": (packets.le_event_mask(), "01 0120 08 0210020000000000"),
    "random address": (packets.random_address(ADDRESS), "01 0520 06 0504030201c2"),
    "parameters of BLE 4": (
        packets.set_parameters(0, legacy=True, phy=Phy.LE_1M),
        "01 3620 19 00 1000 a00000 a00000 07 01 00 000000000000 00 7f 01 00 01 00 00",
    ),
    "parameters of BLE 5": (
        packets.set_parameters(1, legacy=False, phy=Phy.CODED),
        "01 3620 19 01 0000 a00000 a00000 07 01 00 000000000000 00 7f 03 00 03 01 00",
    ),
    "address of a set": (packets.set_random_address(1, ADDRESS), "01 3520 07 01 0504030201c2"),
    "one event": (packets.set_enable(1, 1), "01 3920 06 01 01 01 0000 01"),
    "set off": (packets.set_disable(1), "01 3920 06 00 01 01 0000 00"),
    "scan on two PHYs": (
        packets.scan_parameters((Phy.LE_1M, Phy.CODED), 172, 86),
        "01 4120 0d 01 00 05 00 ac00 5600 00 ac00 5600",
    ),
    "scan on 1M": (packets.scan_parameters((Phy.LE_1M,), 172, 172), "01 4120 08 01 00 01 00 ac00 ac00"),
    "scan": (packets.scan_enable(), "01 4220 06 01 00 0000 0000"),
    "legacy parameters": (
        packets.legacy_parameters(),
        "01 0620 0f a000 a000 03 01 00 000000000000 07 00",
    ),
    "legacy data": (packets.legacy_data(b"\x02\x01\x06"), "01 0820 20 03 020106" + "00" * 28),
    "legacy on": (packets.legacy_enable(True), "01 0a20 01 01"),
    "legacy off": (packets.legacy_enable(False), "01 0a20 01 00"),
    "legacy scan": (packets.legacy_scan_parameters(172, 172), "01 0b20 07 00 ac00 ac00 01 00"),
    "legacy scan on": (packets.legacy_scan_enable(), "01 0c20 02 01 00"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_byte_by_byte(name: str) -> None:
    command, expected = COMMANDS[name]
    assert command.packet().hex() == bytes.fromhex(expected).hex()


def test_advertising_data_in_one_command() -> None:
    (command,) = packets.set_data(1, b"\xaa" * 234)
    assert command.packet() == bytes.fromhex("01 3720 ee 01 03 01 ea") + b"\xaa" * 234


@pytest.mark.parametrize(
    ("size", "pieces"),
    [(0, [(3, 0)]), (251, [(3, 251)]), (252, [(1, 251), (2, 1)]), (700, [(1, 251), (0, 251), (2, 198)])],
)
def test_long_advertising_data_in_fragments(size: int, pieces: list[tuple[int, int]]) -> None:
    data = bytes(i & 0xFF for i in range(size))
    commands = packets.set_data(7, data)
    assert [(c.parameters[1], c.parameters[3]) for c in commands] == pieces
    assert all(c.parameters[0] == 7 and len(c.packet()) <= 4 + 255 for c in commands)
    assert b"".join(c.parameters[4:] for c in commands) == data


def test_addresses_are_turned_round() -> None:
    assert packets.address_text(packets.address_bytes(ADDRESS)) == ADDRESS
    with pytest.raises(ValueError, match="six octets"):
        packets.address_bytes("c2:01")


def test_words() -> None:
    assert Opcode.LE_SET_EXTENDED_ADVERTISING_DATA.words == "LE Set Extended Advertising Data"
    assert Opcode.LE_READ_NUMBER_OF_SUPPORTED_ADVERTISING_SETS.words.startswith("LE Read Number of Supported")
    assert "legacy and extended commands were mixed" in status_words(0x0C)
    assert status_words(0x99) == "error code 0x99"


EXTENDED_REPORT = "0000 01 0605040302c1 03 03 01 7f c4 0000 00 000000000000 03 aabbcc"
EVENTS = {
    "command complete": ("0e 05 02 030c 00 77", CommandResult(0x0C03, 2, 0, b"\x77")),
    "leave to go on": ("0e 03 05 0000", CommandResult(0, 5, 0)),
    "command status": ("0f 04 0c 01 3920", CommandResult(0x2039, 1, 0x0C)),
    "hardware error": ("10 01 42", HardwareError(0x42)),
    "set terminated": ("3e 06 12 43 01 0000 01", SetTerminated(0x43, 1, 1)),
    "extended report": (
        "3e 1d 0d 01" + EXTENDED_REPORT,
        Reports(
            (Report(False, bytes.fromhex("0605040302c1"), 1, -60.0, DataStatus.COMPLETE, b"\xaa\xbb\xcc"),)
        ),
    ),
    "two reports": (
        "3e 34 0d 02 1000 01 0605040302c1 01 00 ff 7f 7f 0000 00 000000000000 01 11"
        "2000 01 0605040302c1 03 03 02 7f 80 0000 00 000000000000 01 22",
        Reports(
            (
                Report(True, bytes.fromhex("0605040302c1"), 0xFF, None, DataStatus.COMPLETE, b"\x11"),
                Report(False, bytes.fromhex("0605040302c1"), 2, -128.0, DataStatus.MORE_TO_COME, b"\x22"),
            )
        ),
    ),
    "legacy reports": (
        "3e 17 02 02 03 01 0605040302c1 01 11 c4 03 01 0605040302c1 00 7f",
        Reports(
            (
                Report(True, bytes.fromhex("0605040302c1"), 0, -60.0, DataStatus.COMPLETE, b"\x11"),
                Report(True, bytes.fromhex("0605040302c1"), 0, None, DataStatus.COMPLETE, b""),
            )
        ),
    ),
    "another LE event": ("3e 02 01 00", None),
    "another event": ("05 04 00 0100 13", None),
}


@pytest.mark.parametrize("name", EVENTS)
def test_events_byte_by_byte(name: str) -> None:
    text, expected = EVENTS[name]
    assert parse_event(bytes.fromhex(text)) == expected


@pytest.mark.parametrize("name", [n for n, (_, event) in EVENTS.items() if event is not None])
def test_events_cut_short_or_too_long_are_refused(name: str) -> None:
    packet = bytes.fromhex(EVENTS[name][0])
    for size in range(len(packet)):
        with pytest.raises(PeerDataError):
            parse_event(packet[:size])
    if name in ("command complete", "leave to go on", "hardware error"):
        return  # may grow in later versions
    longer = packet + b"\0"
    with pytest.raises(PeerDataError):
        parse_event(bytes((longer[0], len(longer) - 2)) + longer[2:])


@pytest.mark.parametrize(
    "text",
    ["0e 00", "0e 02 01 03", "0e 03 01 030c", "0f 03 00 01 39", "10 00", "3e 00", "3e 01 0d", "3e 02 0d 01",
     "3e 05 12 43 01 00 00", "3e 1c 0d 01" + EXTENDED_REPORT[:-2], "3e 02 02 09"],
)  # fmt: skip
def test_events_with_wrong_lengths_are_refused(text: str) -> None:
    with pytest.raises(PeerDataError):
        parse_event(bytes.fromhex(text))


@given(st.binary(max_size=300))
def test_any_bytes_are_an_event_or_refused(data: bytes) -> None:
    with contextlib.suppress(PeerDataError):
        parse_event(data)
    with contextlib.suppress(PeerDataError):
        parse_event(b"\x3e" + bytes((len(data[:255]),)) + data[:255])


# ---------------------------------------------------------------- the stream

COMPLETE = bytes.fromhex("04 0e 04 01 030c 00")
REPORT = bytes.fromhex("04 3e 1d 0d 01" + EXTENDED_REPORT)


@given(st.lists(st.sampled_from([COMPLETE, REPORT]), max_size=8), st.integers(1, 40))
def test_events_come_whole_from_any_pieces(packets: list[bytes], size: int) -> None:
    reader = H4Reader()
    stream = b"".join(packets)
    events = [e for start in range(0, len(stream), size) for e in reader.feed(stream[start : start + size])]
    assert events == [packet[1:] for packet in packets]
    assert reader.dropped == 0


def test_garbage_before_and_between_events_is_dropped_and_counted() -> None:
    reader = H4Reader()
    assert reader.feed(b"\xff\x00\x01junk" + COMPLETE) == [COMPLETE[1:]]
    assert reader.dropped == 7
    assert reader.dropped_in_row == 0
    assert reader.feed(b"AT\r\n" + REPORT + COMPLETE) == [REPORT[1:], COMPLETE[1:]]
    assert reader.dropped == 11


def test_a_torn_event_costs_itself_and_its_neighbours_only() -> None:
    reader = H4Reader()
    events = reader.feed(REPORT[:10] + REPORT * 4 + COMPLETE)  # ten bytes, then the line lost the rest
    assert events[-2:] == [REPORT[1:], COMPLETE[1:]]
    assert reader.dropped > 0


@given(st.lists(st.binary(max_size=400), max_size=10))
def test_any_stream_is_cut_without_growth(chunks: list[bytes]) -> None:
    reader = H4Reader()
    total = 0
    for chunk in chunks:
        events = reader.feed(chunk)
        total += sum(len(event) + 1 for event in events)
        assert all(len(event) == 2 + event[1] for event in events)
    fed = sum(len(chunk) for chunk in chunks)
    assert 0 <= fed - total - reader.dropped < 258
