"""Mode messages that newer messages have overtaken are marked."""

from __future__ import annotations

import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.message_order import MessageOrder
from companion.autopilot.wire import CURRENT_MODE, FrameScanner, MavlinkWriter
from companion.events import CurrentMode, Heartbeat
from tests.companion.autopilot.conftest import PX4, Scripted


@pytest.mark.parametrize(
    ("sequence", "overtaken"), [(10, False), (11, False), (137, False), (138, True), (9, True)]
)
def test_the_half_of_the_numbers_before_the_newest_message_is_older(sequence, overtaken):
    order = MessageOrder()
    assert not order.is_overtaken(sequence)
    order.stamped(10, 5.0)
    order.stamped(8, 4.9)  # This message is older itself.
    assert order.is_overtaken(sequence) is overtaken


def test_the_numbers_of_a_vehicle_that_has_restarted_begin_anew():
    order = MessageOrder()
    order.stamped(200, 500.0)
    order.stamped(3, 1.0)
    assert not order.is_overtaken(4)
    assert order.is_overtaken(2)


def frames():
    """A heartbeat, a mode and a position, in the order in which the vehicle has sent them."""
    writer = MavlinkWriter(1, 1)
    writer.encoder.seq = 255
    return (
        writer.pack(mavlink.MAVLink_heartbeat_message(2, 12, 1, 4 << 16, 4, 3)),
        writer.pack_payload(CURRENT_MODE, struct.pack("<IIB", 4 << 16, 4 << 16, 0)),
        writer.pack(mavlink.MAVLink_system_time_message(0, 60_000)),
    )


def marks(link, *data):
    return [
        event.overtaken
        for frame in data
        for event in link.receive(frame, 100.0)
        if isinstance(event, Heartbeat | CurrentMode)
    ]


def test_the_link_marks_what_arrives_after_a_message_that_was_sent_later():
    scripted = Scripted(autopilot=PX4)
    scripted.heartbeat()
    heartbeat, mode, time = frames()
    assert marks(scripted.link, heartbeat, mode, time) == [False, False]
    assert marks(scripted.link, heartbeat, mode) == [True, True]


def test_the_sequence_number_is_read_from_both_versions_of_mavlink():
    for version, at in ((1, 2), (2, 4)):
        message = mavlink.MAVLink_heartbeat_message(2, 12, 1, 0, 4, 3)
        encoder = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        encoder.seq = 77
        raw = message.pack(encoder, force_mavlink1=version == 1)
        assert raw[at] == 77
        (frame,) = FrameScanner().frames(raw)
        assert frame.sequence == 77
