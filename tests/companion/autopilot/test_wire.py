from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20 import development

from companion.autopilot.readers import unpack
from companion.autopilot.wire import (
    CURRENT_MODE,
    MAX_FRAME_BYTES,
    Frame,
    FrameScanner,
    MavlinkReader,
    MavlinkWriter,
    checksum,
    cut,
    flagged,
    is_known,
    is_signed,
    is_whole,
    message_id_of,
    without_signature,
)
from tests.support.place import LAT_E7, LON_E7

UNKNOWN_V2 = bytes([0xFD, 3, 0, 0, 0, 1, 1, 0x39, 0x30, 0, 1, 2, 3, 0xAA, 0xBB])


def frames() -> list[bytes]:
    writer = MavlinkWriter(1, 1)
    messages: list[Any] = [
        mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3),
        mavlink.MAVLink_global_position_int_message(5, LAT_E7, LON_E7, 1, 2, 3, 4, 5, 6),
        mavlink.MAVLink_statustext_message(6, b"PreArm: GPS bad", 0, 0),
        mavlink.MAVLink_system_time_message(0, 0),
    ]
    v1 = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    return [writer.pack(m) for m in messages] + [m.pack(v1, force_mavlink1=True) for m in messages]


def test_every_cut_of_a_stream_gives_the_same_messages() -> None:
    stream = b"noise" + UNKNOWN_V2 + b"".join(frames()) + UNKNOWN_V2 + frames()[0]
    whole = MavlinkReader()
    expected = [m.get_type() for m in whole.feed(stream)]
    assert len(expected) == 9
    for at in range(len(stream)):
        reader = MavlinkReader()
        got = [m.get_type() for part in (stream[:at], stream[at:]) for m in reader.feed(part)]
        assert got == expected
        assert reader.counts == whole.counts


def test_byte_by_byte_gives_the_same_messages() -> None:
    reader = MavlinkReader()
    stream = b"".join(frames())
    assert sum(len(reader.feed(stream[i : i + 1])) for i in range(len(stream))) == 8


def test_flipped_bytes_lose_one_frame_and_no_other() -> None:
    good = frames()
    stream = b"".join(good)
    expected = [m.get_type() for m in MavlinkReader().feed(good[0] + b"".join(good[2:]))]
    first = len(good[0])
    for at in range(first, first + len(good[1])):
        damaged = bytearray(stream)
        damaged[at] ^= 0x55
        # A damaged length may reach over what follows: what comes later makes it known.
        reader = MavlinkReader()
        got = reader.feed(bytes(damaged)) + reader.feed(b"\0" * 2 * MAX_FRAME_BYTES)
        assert [m.get_type() for m in got] == expected, at


def test_unknown_messages_are_counted_and_left_out() -> None:
    reader = MavlinkReader()
    got = reader.feed(UNKNOWN_V2 + frames()[0] + UNKNOWN_V2 + frames()[1])
    assert [m.get_type() for m in got] == ["HEARTBEAT", "GLOBAL_POSITION_INT"]
    assert (reader.counts.unknown, reader.counts.corrupt) == (2, 0)


def test_noise_that_looks_like_an_unknown_frame_swallows_nothing() -> None:
    noise = bytes([0xFD, 40, 0, 0, 0, 1, 1, 0x39, 0x30, 0])
    got = MavlinkReader().feed(noise + b"".join(frames()) * 2)
    assert len(got) == 16


def test_incompatible_flags_are_corrupt() -> None:
    frame = bytearray(frames()[0])
    frame[2] = 0x02
    reader = MavlinkReader()
    assert reader.feed(bytes(frame) + frames()[0])
    assert reader.counts.corrupt == 1


def test_signed_frames_are_read() -> None:
    signer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    signer.signing.secret_key = b"k" * 32
    signer.signing.sign_outgoing = True
    signed = mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3).pack(signer)
    assert [m.get_type() for m in MavlinkReader().feed(signed + frames()[1])] == [
        "HEARTBEAT",
        "GLOBAL_POSITION_INT",
    ]


@given(st.binary(min_size=1, max_size=64), st.sampled_from(sorted(mavlink.mavlink_map)))
def test_checksum_is_pymavlinks(body: bytes, message_id: int) -> None:
    crc = mavlink.x25crc(body)
    crc.accumulate(bytes([mavlink.mavlink_map[message_id].crc_extra]))
    assert checksum(body, message_id) == crc.crc


def test_quick_framing_is_pymavlinks() -> None:
    quick, slow = MavlinkWriter(3, 191), MavlinkWriter(3, 191)
    for message in (
        mavlink.MAVLink_system_time_message(0, 0),
        mavlink.MAVLink_system_time_message(1, 0),
        mavlink.MAVLink_open_drone_id_arm_status_message(0, b""),
    ):
        expected = slow.pack(message)
        unpacker = type(message).unpacker
        payload = bytes(message.get_payload()).ljust(unpacker.size, b"\0")
        assert quick.pack_payload(message.get_msgId(), payload) == expected


def test_sequence_numbers_wrap() -> None:
    writer = MavlinkWriter(1, 1)
    numbers = [writer.pack_payload(0, b"\1" * 9)[4] for _ in range(257)]
    assert numbers == [*range(256), 0]


@settings(max_examples=150, deadline=None)
@given(st.lists(st.binary(max_size=400), max_size=8))
def test_random_bytes_never_raise_and_never_pile_up(pieces: list[bytes]) -> None:
    scanner = FrameScanner()
    for piece in pieces:
        scanner.frames(piece)
        assert scanner.pending_bytes <= MAX_FRAME_BYTES


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_mutated_frames_never_raise_and_good_ones_behind_them_arrive(data: st.DataObject) -> None:
    stream = bytearray(b"".join(frames()))
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(stream) - 1))
        match data.draw(st.sampled_from(["flip", "cut", "insert"])):
            case "flip":
                stream[at] = data.draw(st.integers(0, 255))
            case "cut":
                del stream[at : at + data.draw(st.integers(1, 30))]
                stream += b"\0"
            case _:
                stream[at:at] = data.draw(st.binary(max_size=20))
    reader = MavlinkReader()
    reader.feed(bytes(stream))
    # Whatever a damaged length still waits for is filled up; then the next good frame arrives.
    reader.feed(b"\0" * 2 * MAX_FRAME_BYTES)
    assert [m.get_type() for m in reader.feed(frames()[0])] == ["HEARTBEAT"]


@pytest.mark.parametrize("keep", [False, True])
def test_scanner_keeps_unknown_frames_only_when_asked(keep: bool) -> None:
    found = FrameScanner(keep_unknown=keep).frames(UNKNOWN_V2 + frames()[0])
    assert [f.raw for f in found] == ([UNKNOWN_V2] if keep else []) + [frames()[0]]


def test_current_mode_is_framed_as_the_dialect_that_has_it_frames_it() -> None:
    theirs = development.MAVLink(None, srcSystem=1, srcComponent=1)
    message = development.MAVLink_current_mode_message(0, 0x05040000, 0x00060000)
    frame = message.pack(theirs)
    payload = struct.pack("<IIB", 0x05040000, 0x00060000, 0)
    assert MavlinkWriter(1, 1).pack_payload(CURRENT_MODE, payload) == frame
    (found,) = FrameScanner().frames(frame)
    assert unpack(found.message_id, found.payload) == (0x05040000, 0x00060000, 0)
    reader = MavlinkReader()
    assert reader.feed(frame) == []
    assert (reader.counts.messages, reader.counts.unknown, reader.counts.corrupt) == (0, 1, 0)


def wide_frame(flags: int = 0) -> bytes:
    """An unknown message whose id needs all three bytes; every header field has a number of its own."""
    return bytes([0xFD, 2, flags, 0, 7, 42, 191, 0x56, 0x34, 0x12, 0xAA, 0xBB, 0x01, 0x02])


def test_the_parts_of_a_frame() -> None:
    scanner = FrameScanner(keep_unknown=True)
    (frame,) = scanner.frames(wide_frame())
    assert (frame.message_id, frame.system_id, frame.component_id) == (0x123456, 42, 191)
    assert (frame.payload, frame.raw) == (b"\xaa\xbb", wide_frame())
    assert message_id_of(wide_frame()) == 0x123456
    old = bytes([0xFE, 2, 7, 42, 191, 99, 0xAA, 0xBB, 0x01, 0x02])
    assert cut(old) == Frame(99, 42, 191, b"\xaa\xbb", old)
    assert message_id_of(old) == 99


@pytest.mark.parametrize("message_id", [0, 33, 12_901])
def test_our_frames_carry_the_message_id_in_three_bytes(message_id: int) -> None:
    assert is_known(message_id)
    frame = MavlinkWriter(1, 191).pack_payload(message_id, b"\x01")
    assert frame[7:10] == message_id.to_bytes(3, "little")
    assert is_whole(frame)


def test_a_flag_of_signed_frames_changes_the_checksum_as_if_computed_anew() -> None:
    for frame in frames()[:4]:
        marked = flagged(frame)
        assert marked[2] == frame[2] | 1
        assert marked[:2] + marked[3:-2] == frame[:2] + frame[3:-2]
        assert marked[-2:] == checksum(marked[1:-2], message_id_of(frame)).to_bytes(2, "little")
        assert is_whole(marked)
        signed = marked + bytes(13)
        assert is_signed(signed)
        assert not is_signed(frame)
        assert without_signature(signed) == without_signature(frame) == frame


@pytest.mark.parametrize("at", [2, 4, -1, -2, -3])
def test_every_byte_counts_for_the_checksum(at: int) -> None:
    """Flags, sequence or sender, payload and checksum."""
    for frame in frames():
        damaged = bytearray(frame)
        damaged[at] ^= 0x10
        assert is_whole(frame)
        assert not is_whole(bytes(damaged))


def test_the_sequence_wraps_after_255() -> None:
    writer = MavlinkWriter(1, 191)
    numbers = [writer.pack_payload(0, bytes(9))[4] for _ in range(258)]
    assert numbers == [*range(256), 0, 1]


@pytest.mark.parametrize(
    ("payload", "sent"), [(b"\x01\0\0", b"\x01"), (b"\0\0\0", b"\0"), (b"\0\x02", b"\0\x02")]
)
def test_trailing_zeros_are_left_out_but_for_one_byte(payload: bytes, sent: bytes) -> None:
    frame = MavlinkWriter(1, 191).pack_payload(0, payload)
    assert (frame[1], frame[10:-2]) == (len(sent), sent)
