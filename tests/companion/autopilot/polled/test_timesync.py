"""TIMESYNC on the link: asking, believing only the echo, answering."""

from __future__ import annotations

import struct
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.link import AutopilotLink
from companion.autopilot.polled.timesync import LONGEST_ROUND_TRIP_S, read_timesync, timesync
from companion.autopilot.wire import FrameScanner, MavlinkWriter
from companion.events import ClockRead, Event
from tests.companion.autopilot.conftest import Scripted

TIMESYNC = mavlink.MAVLINK_MSG_ID_TIMESYNC
BOOT_NS = 5_000_000_000


def sent(link: AutopilotLink) -> list[tuple[int, int, int, int]]:
    """The TIMESYNC of ours: tc1, ts1, targets."""
    frames = FrameScanner().frames(link.drain())
    return [read_timesync(frame.payload) for frame in frames if frame.message_id == TIMESYNC]


def answer(tc1: int, ts1: int, targets: tuple[int, int] = (0, 0), component: int = 1) -> bytes:
    writer = MavlinkWriter(1, component)
    return writer.pack_payload(*timesync(tc1, ts1, *targets))


def asked(scripted: Scripted) -> int:
    """Let the next question leave."""
    scripted.heartbeat()
    scripted.after(1.0)
    ((tc1, ts1, *targets),) = sent(scripted.link)
    assert (tc1, targets) == (0, [1, 1])
    return ts1


def test_the_layout_is_the_dialects_with_targets(ardupilot: Scripted) -> None:
    _, payload = timesync(1, -2, 3, 4)
    assert payload == struct.pack("<qqBB", 1, -2, 3, 4)
    message = ardupilot.bytes(mavlink.MAVLink_timesync_message(7, 9))
    (frame,) = FrameScanner().frames(message)
    assert read_timesync(frame.payload) == (7, 9, 0, 0)


def test_asks_once_a_second(ardupilot: Scripted) -> None:
    sent(ardupilot.link)
    found = []
    for _ in range(100):
        ardupilot.heartbeat()
        ardupilot.after(0.05)
        found += sent(ardupilot.link)
    assert len(found) == 5
    assert found[-1][1] == round(ardupilot.now_s * 1e9)


def test_the_answer_is_between_two_moments_of_ours(ardupilot: Scripted) -> None:
    ts1 = asked(ardupilot)
    asked_s = ardupilot.now_s
    ardupilot.now_s += 0.02
    (event,) = ardupilot.link.receive(answer(BOOT_NS, ts1), ardupilot.now_s)
    assert event == ClockRead(time_boot_s=5.0, asked_s=asked_s, heard_s=ardupilot.now_s)


def test_only_the_echo_of_the_last_question_counts_once(ardupilot: Scripted) -> None:
    old = asked(ardupilot)
    new = asked(ardupilot)
    assert ardupilot.link.receive(answer(BOOT_NS, old) + answer(BOOT_NS, new + 1), ardupilot.now_s) == []
    both = ardupilot.link.receive(answer(BOOT_NS, new) + answer(BOOT_NS + 1, new), ardupilot.now_s)
    assert len(both) == 1


def test_others_answers_do_not_count(ardupilot: Scripted) -> None:
    ts1 = asked(ardupilot)
    for forged in (answer(BOOT_NS, ts1, component=190), answer(-BOOT_NS, ts1)):
        assert ardupilot.link.receive(forged, ardupilot.now_s) == []


def test_px4_answers_with_targets_that_it_never_set(px4: Scripted) -> None:
    ts1 = asked(px4)
    assert len(px4.link.receive(answer(BOOT_NS, ts1, (201, 77)), px4.now_s)) == 1


def test_a_late_answer_tells_nothing(ardupilot: Scripted) -> None:
    ts1 = asked(ardupilot)
    late = ardupilot.now_s + LONGEST_ROUND_TRIP_S + 0.01
    assert ardupilot.link.receive(answer(BOOT_NS, ts1), late) == []


def test_what_was_asked_before_a_restart_is_void(ardupilot: Scripted) -> None:
    ardupilot.says(ardupilot.position(900_000))
    ts1 = asked(ardupilot)
    ardupilot.says(ardupilot.position(1_000))
    assert ardupilot.link.counts.reboots == 1
    assert not clock_reads(ardupilot.link.receive(answer(BOOT_NS, ts1), ardupilot.now_s))
    ardupilot.after(0.05)
    assert len(sent(ardupilot.link)) == 1


def clock_reads(events: list[Event]) -> list[Any]:
    return [event for event in events if isinstance(event, ClockRead)]


def test_the_vehicles_question_is_answered_at_once(px4: Scripted) -> None:
    px4.now_s = 123.25
    assert px4.link.receive(answer(0, 77), px4.now_s) == []
    assert sent(px4.link) == [(123_250_000_000, 77, 1, 1)]
    # Meant for another, or asked by another.
    px4.link.receive(answer(0, 78, (1, 190)) + answer(0, 79, component=190), px4.now_s)
    assert sent(px4.link) == []
