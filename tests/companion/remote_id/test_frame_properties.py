"""Properties of packs and frames: any valid one comes back as it was."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.errors import PeerDataError
from companion.radio.frames_io import TRANSPORTS, FrameReceiver, FrameSender
from companion.remote_id.codec import decode, decode_pack, decode_payload, encode, encode_pack, read_payload
from companion.remote_id.frames import Frame, parse_frame
from companion.remote_id.transports import BLE4
from tests.companion.remote_id.test_properties import BYTE, CASES, NIBBLE, PACKS, Case, _fits_a_pack

ADDRESS = "c2:01:02:03:04:05"

stable = settings(
    derandomize=True,
    deadline=None,
    max_examples=80,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


# ---------------------------------------------------------------- packs


@given(PACKS, NIBBLE, st.binary(max_size=30))
@stable
def test_a_pack_is_its_messages(cases: list[Case], version: int, padding: bytes) -> None:
    messages = tuple(case.message for case in cases)
    pack = encode_pack(messages)
    assert pack == bytes((0xF2, 25, len(cases))) + b"".join(case.data for case in cases)
    heard = bytes((0xF0 | version,)) + pack[1:] + padding
    assert decode_pack(heard) == decode_payload(heard) == messages
    assert read_payload(heard) == (messages, ())


@given(st.lists(CASES, max_size=12))
@stable
def test_a_pack_that_breaks_the_rules_is_not_built(cases: list[Case]) -> None:
    messages = [case.message for case in cases]
    if 1 <= len(messages) <= 9 and _fits_a_pack(messages):
        assert decode_pack(encode_pack(messages)) == tuple(messages)
    else:
        with pytest.raises(ValueError, match="pack"):
            encode_pack(messages)


@given(PACKS, st.data())
@settings(stable, max_examples=60)
def test_a_damaged_pack_gives_what_is_sound_and_says_what_is_not(
    cases: list[Case], data: st.DataObject
) -> None:
    pack = bytearray(encode_pack([case.message for case in cases]))
    for _ in range(data.draw(st.integers(1, 4))):
        pack[data.draw(st.integers(0, len(pack) - 1))] = data.draw(BYTE)
    heard = bytes(pack[: data.draw(st.integers(0, len(pack)))])
    strict = lenient = None
    with contextlib.suppress(PeerDataError):
        strict = decode_pack(heard)
    with contextlib.suppress(PeerDataError):
        lenient = read_payload(heard)
    if strict is not None:
        assert lenient == (strict, ())
    if lenient is not None and heard and heard[0] >> 4 == 15 and strict is None:
        assert lenient.faults or not lenient.messages
        assert len(lenient.messages) < 9
        for message in lenient.messages:
            assert decode(encode(message)) == message


# ---------------------------------------------------------------- frames


@pytest.mark.parametrize("transport", sorted(TRANSPORTS))
def test_what_a_transport_sends_is_heard(transport: str) -> None:
    @given(PACKS)
    @settings(stable, max_examples=60)
    def check(cases: list[Case]) -> None:
        messages = tuple(case.message for case in cases)
        receiver = FrameReceiver()
        heard = []
        for frame in FrameSender(ADDRESS).frames(transport, messages):
            event = receiver.receive(transport, ADDRESS, frame, -70.0)
            if event is not None:
                assert (event.transport, event.address, event.rssi_dbm) == (transport, ADDRESS, -70.0)
                heard += event.messages
        assert tuple(heard) == messages
        assert receiver.bad == 0

    check()


@pytest.mark.parametrize("transport", sorted(TRANSPORTS))
def test_any_bytes_on_a_transport_are_a_frame_or_refused(transport: str) -> None:
    @given(st.binary(max_size=400))
    @settings(stable, max_examples=60)
    def check(data: bytes) -> None:
        try:
            frame = parse_frame(transport, data)
        except PeerDataError:
            frame = None
        assert frame is None or frame.transport == transport
        receiver = FrameReceiver()
        event = receiver.receive(transport, ADDRESS, data)
        assert (event is not None) == (receiver.heard > 0)

    check()


@pytest.mark.parametrize("transport", sorted(TRANSPORTS))
def test_a_damaged_frame_is_read_or_refused(transport: str) -> None:
    @given(PACKS, st.data())
    @settings(stable, max_examples=60)
    def check(cases: list[Case], data: st.DataObject) -> None:
        whole = FrameSender(ADDRESS).frames(transport, [case.message for case in cases])[-1]
        frame = bytearray(whole)
        for _ in range(data.draw(st.integers(0, 3))):
            frame[data.draw(st.integers(0, len(frame) - 1))] = data.draw(BYTE)
        heard = bytes(frame[: data.draw(st.integers(0, len(frame)))])
        receiver = FrameReceiver()
        event = receiver.receive(transport, ADDRESS, heard)
        if event is not None:
            for message in event.messages:
                assert decode(encode(message)) == message
        with contextlib.suppress(PeerDataError):
            assert isinstance(parse_frame(transport, heard), Frame)

    check()


@given(CASES, BYTE)
@stable
def test_ble4_carries_one_message_and_no_pack(case: Case, counter: int) -> None:
    sender = FrameSender(ADDRESS)
    (frame,) = sender.frames(BLE4, [case.message])
    assert frame == bytes.fromhex("1e16faff0d00") + case.data
    parsed = parse_frame(BLE4, frame[:5] + bytes((counter,)) + frame[6:])
    assert (parsed.counter, parsed.payload) == (counter, case.data)
