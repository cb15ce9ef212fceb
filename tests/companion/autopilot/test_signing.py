"""Signed links: what is believed, what is not and why, and that pymavlink agrees to the bit."""

from __future__ import annotations

import io
import struct
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.link import AutopilotLink
from companion.autopilot.signing import (
    MAX_STREAMS,
    NEW_STREAM_TICKS,
    TICKS_PER_S,
    Refusal,
    Signing,
    timestamp_at,
)
from companion.autopilot.tlog import TlogWriter, read_tlog
from companion.autopilot.wire import Frame, FrameScanner, MavlinkReader, MavlinkWriter, without_signature
from companion.config import VehicleConfig
from companion.events import ArmStatus, GlobalPosition, Heartbeat, RemoteIdModule, VelocitySetpoint
from tests.support.place import LAT_E7, LON_E7

KEY, OTHER_KEY = bytes(range(32)), bytes(32)
START = timestamp_at(1_767_225_600.0)
HEARTBEAT = mavlink.MAVLink_heartbeat_message(2, 3, 81, 4, 4, 3)
POSITION = mavlink.MAVLink_global_position_int_message(1000, LAT_E7, LON_E7, 0, 0, 0, 0, 0, 0)
MESSAGES = (
    HEARTBEAT,
    mavlink.MAVLink_system_time_message(0, 0),
    mavlink.MAVLink_statustext_message(6, b"x" * 50),
    mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1, 4, 0, 0, 0, 0, 0),
)


def signing(key: bytes = KEY, timestamp: int = START) -> Signing:
    return Signing(key, timestamp, 0.0)


def framed(raw: bytes) -> Frame:
    (frame,) = FrameScanner().frames(raw)
    return frame


class Peer:
    """Another device that holds a key."""

    def __init__(self, key: bytes = KEY, system: int = 1, component: int = 1, timestamp: int = START) -> None:
        self.signing = signing(key, timestamp)
        self._writer = MavlinkWriter(system, component)

    def unsigned(self, message: Any = HEARTBEAT) -> bytes:
        return self._writer.pack(message)

    def signed(self, message: Any = HEARTBEAT, link_id: int = 0) -> bytes:
        return self.signing.sign(self.unsigned(message), link_id)


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: m.get_type())
def test_signatures_are_pymavlinks(message: Any) -> None:
    mav = mavlink.MAVLink(None, srcSystem=7, srcComponent=191)
    plain = message.pack(mav)
    mav.signing.secret_key, mav.signing.sign_outgoing = KEY, True
    mav.signing.link_id, mav.signing.timestamp = 9, START + 1
    theirs = message.pack(mav)
    assert signing().sign(plain, 9) == theirs
    assert without_signature(theirs) == plain
    assert signing().refusal(framed(theirs)) is None
    hearer = mavlink.MAVLink(None)
    hearer.signing.secret_key, hearer.signing.timestamp = KEY, START
    assert hearer.decode(bytearray(signing().sign(plain, 9)))._signed


def test_who_has_the_key_is_believed_once() -> None:
    ours, peer = signing(), Peer()
    frame = framed(peer.signed())
    assert ours.refusal(frame) is None
    assert ours.refusal(frame) is Refusal.REPLAYED
    assert ours.refusal(framed(peer.signed())) is None
    assert (ours.counts.valid, ours.counts.replayed) == (2, 1)


def test_the_causes_are_told_apart() -> None:
    ours = signing()
    peer, stranger = Peer(), Peer(OTHER_KEY)
    old = Peer(system=2, timestamp=START - NEW_STREAM_TICKS - 2)
    in_time = Peer(system=3, timestamp=START - NEW_STREAM_TICKS)
    v1 = HEARTBEAT.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1), force_mavlink1=True)
    assert v1[0] == 0xFE
    again = peer.signed()
    judged = [
        ours.refusal(framed(raw))
        for raw in (again, again, peer.unsigned(), v1, stranger.signed(), old.signed(), in_time.signed())
    ]
    assert judged == [
        None,
        Refusal.REPLAYED,
        Refusal.UNSIGNED,
        Refusal.UNSIGNED,
        Refusal.WRONG,
        Refusal.STALE,
        None,
    ]
    counts = ours.counts
    assert (counts.valid, counts.unsigned, counts.wrong, counts.replayed, counts.stale) == (2, 2, 1, 1, 1)
    assert counts.refused() == "frames refused: 2 unsigned, 1 wrongly signed, 1 replayed, 1 too old"


def test_every_bit_of_a_signed_frame_is_signed() -> None:
    raw = Peer().signed()
    for bit in range(8 * len(raw)):
        damaged = bytearray(raw)
        damaged[bit // 8] ^= 1 << bit % 8
        for frame in FrameScanner().frames(bytes(damaged) + bytes(300)):
            assert signing().refusal(frame) is not None, bit


def test_streams_are_told_apart_by_sender_and_link() -> None:
    ours, peer = signing(), Peer()
    first, second = peer.signed(link_id=1), peer.signed(link_id=2)
    assert ours.refusal(framed(second)) is None
    assert ours.refusal(framed(first)) is None


def test_a_forged_timestamp_does_not_lock_the_true_sender_out() -> None:
    ours, peer = signing(), Peer()
    forged = bytearray(Peer(OTHER_KEY, timestamp=START + 10**10).signed())
    assert ours.refusal(framed(bytes(forged))) is Refusal.WRONG
    assert ours.timestamp == START
    assert ours.refusal(framed(peer.signed())) is None


def test_radio_status_needs_no_signature() -> None:
    status = mavlink.MAVLink_radio_status_message(190, 180, 100, 20, 20, 0, 0)
    ours = signing()
    assert ours.refusal(framed(Peer(system=51, component=68).unsigned(status))) is None
    forged = Peer(OTHER_KEY, system=51, component=68).signed(status)
    assert ours.refusal(framed(forged)) is Refusal.WRONG


def test_the_timestamp_goes_with_time_and_never_back() -> None:
    ours = signing()
    stamps = []
    for now_s in (1.0, 2.0, 0.5, 0.0, 2.5):
        ours.advance(now_s)
        stamps += [int.from_bytes(ours.sign(Peer().unsigned())[-12:-6], "little") for _ in range(3)]
    assert stamps == sorted(set(stamps))
    assert stamps[-1] == START + round(2.5 * TICKS_PER_S) + 3


def test_a_computer_without_a_clock_takes_the_peers_time() -> None:
    ours = signing(timestamp=0)
    ours.advance(10.0)
    peer = Peer()
    assert ours.refusal(framed(peer.signed())) is None
    assert ours.timestamp == START + 1
    ours.advance(12.0)
    assert ours.timestamp == START + 1 + 2 * TICKS_PER_S
    # What was recorded long ago is no longer a stream to begin with.
    recorded = Peer(system=9, timestamp=START - 10 * NEW_STREAM_TICKS).signed()
    assert ours.refusal(framed(recorded)) is Refusal.STALE


def test_the_last_timestamp_of_all_ends_nothing() -> None:
    ours = signing(timestamp=(1 << 48) - 1)
    ours.advance(1e6)
    ours.refusal(framed(Peer(timestamp=(1 << 48) - 2).signed()))
    assert len(ours.sign(Peer().unsigned())) == len(Peer().unsigned()) + 13


def test_streams_are_bounded() -> None:
    ours, peer = signing(), Peer()
    judged = [ours.refusal(framed(peer.signed(link_id=number))) for number in range(MAX_STREAMS + 3)]
    assert judged == [None] * MAX_STREAMS + [Refusal.CROWDED] * 3
    assert ours.refusal(framed(peer.signed(link_id=0))) is None


def test_the_key_shows_nowhere() -> None:
    assert KEY.hex() not in repr(signing())
    assert repr(KEY) not in repr(signing())
    with pytest.raises(ValueError, match="32 bytes, not 31"):
        Signing(KEY[:31], 0, 0.0)


# ---------------------------------------------------------------- the link


def link() -> AutopilotLink:
    return AutopilotLink(VehicleConfig(), signing=signing())


def test_the_link_believes_the_key_alone() -> None:
    ours, peer, stranger = link(), Peer(), Peer(OTHER_KEY)
    recorded = peer.signed(HEARTBEAT) + peer.signed(POSITION)
    assert [type(event) for event in ours.receive(recorded, 0.0)] == [Heartbeat, GlobalPosition]
    forged = recorded + stranger.unsigned(HEARTBEAT) + stranger.unsigned(POSITION)
    forged += stranger.signed(HEARTBEAT) + stranger.signed(POSITION)
    assert ours.receive(forged, 0.1) == []
    assert ours.disbelief(0.1) == "frames refused: 2 unsigned, 2 wrongly signed, 2 replayed"


def test_a_forged_heartbeat_makes_no_vehicle() -> None:
    ours = link()
    assert ours.receive(Peer(OTHER_KEY).signed() + Peer().unsigned(), 0.0) == []
    assert ours.vehicle is None


def test_without_a_key_signatures_are_not_looked_at() -> None:
    ours = AutopilotLink(VehicleConfig())
    raw = Peer(OTHER_KEY).signed()
    assert len(ours.receive(raw + raw + Peer().unsigned(), 0.0)) == 3
    assert ours.disbelief(0.0) is None
    ours.advance(0.0)
    assert all(not m.get_header().incompat_flags for m in MavlinkReader().feed(ours.drain()))


def test_all_that_leaves_is_signed_in_order() -> None:
    ours, peer = link(), signing()
    ours.receive(Peer().signed(), 0.0)
    for now_s in (0.1, 0.2, 1.2):
        ours.advance(now_s)
        ours.send(VelocitySetpoint(velocity_ned_mps=(1.0, 0.0, 0.0)), now_s)
        frames = FrameScanner().frames(ours.drain())
        assert frames
        assert [peer.refusal(frame) for frame in frames] == [None] * len(frames)


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (Peer().unsigned(), "unsigned: signing is not set up on the autopilot"),
        (Peer(OTHER_KEY).signed(), "wrongly signed: the autopilot has a different key"),
        (
            Peer(timestamp=0).signed(),
            "more than a minute old: the autopilot does not receive our frames, or it is a replay",
        ),
    ],
    ids=["unsigned", "wrong key", "old"],
)
def test_a_vehicle_that_is_never_believed_is_told_in_words(raw: bytes, words: str) -> None:
    ours = link()
    ours.receive(raw, 0.0)
    assert ours.disbelief(0.0) == f"every frame of the vehicle is {words}"
    # A stranger's frames say nothing of the vehicle, and what was said is not said for ever.
    ours.receive(Peer(system=255, component=190).unsigned(), 10.0)
    assert "every frame" not in (ours.disbelief(10.0) or "")


def test_a_vehicle_that_is_believed_is_not_called_unsigned() -> None:
    ours, peer = link(), Peer()
    ours.receive(peer.signed(), 0.0)
    ours.receive(peer.unsigned(), 2.0)
    assert ours.disbelief(2.0) == "frames refused: 1 unsigned"
    ours.receive(peer.unsigned(), 5.0)
    assert "signing is not set up" in (ours.disbelief(5.0) or "")


def test_setup_signing_is_obeyed_from_nobody() -> None:
    ours, peer = link(), Peer()
    ours.receive(peer.signed(), 0.0)
    setup = mavlink.MAVLink_setup_signing_message(1, 191, list(OTHER_KEY), 0)
    ours.receive(peer.signed(setup), 0.0)
    assert ours.receive(peer.unsigned() + Peer(OTHER_KEY).signed(), 0.1) == []
    assert len(ours.receive(peer.signed(), 0.2)) == 1


def test_our_own_arm_status_is_known_again_by_the_echo_of_a_router() -> None:
    ours = AutopilotLink(VehicleConfig(), signing=signing(), remote_id_component=True)
    ours.receive(Peer().signed(), 0.0)
    ours.send(ArmStatus(ready=True), 0.0)
    ours.advance(0.1)
    echo = ours.drain()
    assert {f.component_id for f in FrameScanner().frames(echo)} == {191, 236}
    assert not [event for event in ours.receive(echo, 0.2) if isinstance(event, RemoteIdModule)]
    another = Peer(component=236, timestamp=START + 10**6)
    transmitter = mavlink.MAVLink_heartbeat_message(34, 8, 0, 0, 4, 3)
    status = mavlink.MAVLink_open_drone_id_arm_status_message(1, b"no fix")
    heard = ours.receive(another.signed(transmitter) + another.signed(status), 0.3)
    assert [type(event) for event in heard] == [RemoteIdModule]


# ---------------------------------------------------------------- the log


def test_a_log_holds_neither_signatures_nor_keys() -> None:
    stream, peer = io.BytesIO(), Peer()
    log = TlogWriter(stream)
    unknown = bytes([0xFD, 2, 0, 0, 0, 1, 1, 0x39, 0x30, 0, 1, 2, 3, 4])
    setup = mavlink.MAVLink_setup_signing_message(1, 191, list(KEY), 0)
    log.received(1e9, peer.signed() + peer.signed(setup) + peer.signing.sign(unknown) + peer.signed(POSITION))
    log.sent(1e9, peer.unsigned(setup) + peer.signed())
    written = stream.getvalue()
    assert KEY not in written
    assert unknown in written
    frames = [raw for _, raw in read_tlog(io.BytesIO(written), "log")]
    assert [raw[2] for raw in frames] == [0] * 4
    names = [m.get_type() for raw in frames for m in MavlinkReader().feed(raw)]
    assert names == ["HEARTBEAT", "GLOBAL_POSITION_INT", "HEARTBEAT"]
    assert struct.pack("<Q", peer.signing.timestamp)[:6] not in written
