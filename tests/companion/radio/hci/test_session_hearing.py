"""A session hears: reports, parts of them, hostile bytes."""

from __future__ import annotations

import random

from hypothesis import given, settings
from hypothesis import strategies as st

from companion.radio.frames_io import FrameReceiver, FrameSender
from companion.radio.hci.advertising import HciCounts
from companion.radio.hci.reports import HeardFrame
from companion.radio.hci.session import HciSession
from companion.remote_id.transports import BLE4, BLE5
from tests.companion.radio.hci.controller import (
    Controller,
    extended_report,
)
from tests.companion.radio.hci.host import ADDRESS, LOCATION, SELF_ID, SERIAL, Host

# ---------------------------------------------------------------- hearing


def test_reports_become_frames_with_transport_address_and_strength() -> None:
    host = Host(Controller())
    ble4 = host.sender.frames(BLE4, [LOCATION])[0]
    ble5 = host.sender.frames(BLE5, [LOCATION, SERIAL])[0]
    heard = host.hear(extended_report(ble4, event_type=0x10, rssi=127), extended_report(ble5, rssi=-91))
    assert heard == [
        HeardFrame(BLE4, "c1:02:03:04:05:06", ble4, None),
        HeardFrame(BLE5, "c1:02:03:04:05:06", ble5, -91.0),
    ]


def test_what_is_not_remote_id_is_left_out() -> None:
    host = Host(Controller())
    assert host.hear(extended_report(b"\x02\x01\x06", event_type=0x10), extended_report(b"")) == []


def test_parts_are_put_together_by_address_and_sid() -> None:
    host = Host(Controller())
    one, two = (host.sender.frames(BLE5, [LOCATION, message])[0] for message in (SERIAL, SELF_ID))
    more = 0x20
    heard = host.hear(
        extended_report(one[:20], event_type=more, sid=1),
        extended_report(two[:30], event_type=more, sid=2),
        extended_report(one[20:40], event_type=more, sid=1),
        extended_report(two[30:], sid=2),
        extended_report(one[40:], sid=1),
    )
    assert [frame.data for frame in heard] == [two, one]


def test_parts_that_are_late_or_endless_are_dropped() -> None:
    host = Host(Controller())
    (frame,) = host.sender.frames(BLE5, [LOCATION, SERIAL])
    more = 0x20
    host.hear(extended_report(frame[:20], event_type=more))
    host.now_s += 2.0
    assert host.hear(extended_report(frame[20:])) == []
    host.hear(extended_report(frame, event_type=more))
    for _ in range(100):
        assert host.hear(extended_report(bytes(100), event_type=more)) == []
    assert all(len(part.data) <= 1650 for part in host.session._reassembler._partial.values())
    assert host.hear(extended_report(frame, sid=3)) != []


def test_an_advertisement_that_is_cut_short_is_used_as_far_as_it_goes() -> None:
    """The link may lose the end of a long one; the Location is at the beginning."""
    host = Host(Controller())
    (frame,) = host.sender.frames(BLE5, [LOCATION, SERIAL])
    more, cut = 0x20, 0x40
    heard = host.hear(
        extended_report(frame[:20], event_type=more), extended_report(frame[20:40], event_type=cut)
    )
    assert [part.data for part in heard] == [frame[:40]]
    event = FrameReceiver().receive(BLE5, ADDRESS, heard[0].data)
    assert event is not None
    assert event.messages == (LOCATION,)
    assert host.hear(extended_report(frame)) != []


def test_an_advertisement_whose_end_is_lost_is_not_mixed_with_the_next_one() -> None:
    host = Host(Controller())
    (frame,) = host.sender.frames(BLE5, [SERIAL, LOCATION])
    for size in range(5, len(frame)):
        first = extended_report(frame[:size], event_type=0x20)
        assert [part.data for part in host.hear(first, first, extended_report(frame[size:]))] == [frame]


def test_many_unfinished_advertisements_do_not_grow_memory() -> None:
    host = Host(Controller())
    for number in range(1000):
        host.hear(extended_report(b"x", event_type=0x20, address=number.to_bytes(6, "big")))
    assert len(host.session._reassembler._partial) <= 64


def test_frames_that_nobody_takes_are_bounded() -> None:
    host = Host(Controller())
    (frame,) = host.sender.frames(BLE5, [LOCATION])
    for _ in range(1500):
        host.session.receive(extended_report(frame), host.now_s)
    assert len(host.session.heard) == 1024
    assert host.counts.overrun == 1500 - 1024


# ---------------------------------------------------------------- hostile bytes


def test_a_flood_of_garbage_ends_the_session_in_words() -> None:
    host = Host(Controller())
    host.session.receive(b"\xaa" * 5000, host.now_s)
    assert "no HCI events (H4)" in str(host.session.failure)
    assert host.counts.garbage > 4000


def test_a_little_garbage_is_survived() -> None:
    host = Host(Controller())
    (frame,) = host.sender.frames(BLE5, [LOCATION])
    host.session.receive(b"\xaa" * 50 + bytes.fromhex("043e030d0900") + b"\x55", host.now_s)
    assert len(host.hear(extended_report(frame))) == 1
    assert host.counts.garbage == 51
    assert host.counts.malformed == 1
    assert host.session.failure is None


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32))
def test_damaged_conversations_only_fail_in_words(seed: int) -> None:
    generator = random.Random(seed)
    controller = Controller()
    session = HciSession(ADDRESS, send=True, listen=True, counts=HciCounts(), now_s=0.0)
    sender = FrameSender(ADDRESS)
    (frame,) = sender.frames(BLE5, [LOCATION, SERIAL])
    now_s = 0.0
    for _ in range(200):
        now_s += generator.choice((0.0, 0.01, 0.1))
        answer = bytearray(controller.feed(b"".join(session.packets())))
        if generator.random() < 0.3:
            answer += extended_report(frame, event_type=generator.choice((0, 0x10, 0x20, 0x40)))
        if answer and generator.random() < 0.2:
            position = generator.randrange(len(answer))
            match generator.randrange(3):
                case 0:
                    answer[position] = generator.randrange(256)
                case 1:
                    del answer[position:]
                case _:
                    answer[position:position] = generator.randbytes(generator.randrange(1, 40))
        session.receive(bytes(answer), now_s)
        session.offer(generator.choice((BLE4, BLE5)), sender.frames(BLE4, [LOCATION, SELF_ID]), now_s)
        session.tick(now_s)
        assert session.next_s >= 0.0
        assert isinstance(session.failure, str | None)
        if session.failure is not None:
            assert session.can_send == set()
            return


@given(st.binary(max_size=600))
def test_any_bytes_leave_the_session_standing(data: bytes) -> None:
    host = Host(Controller())
    host.session.receive(data, host.now_s)
    host.session.tick(host.now_s)
    assert len(host.session.heard) <= 1024
