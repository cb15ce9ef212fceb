"""The send queue: what leaves, in which order, how old it may be, and how much is kept."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.counts import LinkCounts
from companion.autopilot.encoders import command_long, velocity_setpoint
from companion.autopilot.outbox import MAX_QUEUED_BYTES, Outbox
from companion.autopilot.wire import MavlinkReader, WireCounts
from companion.config import VehicleConfig
from companion.events import Severity


class Queue:
    """An outbox and what a receiver makes of it."""

    def __init__(self, **vehicle: object) -> None:
        self.counts = LinkCounts(wire=WireCounts())
        self.outbox = Outbox(VehicleConfig(**vehicle), self.counts, None)  # type: ignore[arg-type]
        self._reader = MavlinkReader()

    def left(self, *, commanding: bool = True) -> list[mavlink.MAVLink_message]:
        return self._reader.feed(self.outbox.drain(commanding=commanding))

    def names(self, *, commanding: bool = True) -> list[str]:
        return [message.get_type() for message in self.left(commanding=commanding)]

    def command(self, now_s: float) -> None:
        self.outbox.command(command_long(176, (1.0,), 1), now_s)

    def setpoint(self, north_mps: float = 1.0) -> None:
        self.outbox.replace_setpoint(velocity_setpoint((north_mps, 0.0, 0.0), None, 0, 1))


SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"


def test_texts_then_commands_then_the_setpoint() -> None:
    queue = Queue()
    queue.setpoint()
    queue.command(10.0)
    queue.outbox.say(Severity.INFO, "first")
    assert queue.outbox.holds
    assert queue.names() == ["STATUSTEXT", "COMMAND_LONG", SETPOINT]
    assert not queue.outbox.holds
    assert queue.names() == []
    assert (queue.counts.setpoints, queue.counts.setpoints_dropped) == (1, 0)


def test_what_commands_the_vehicle_may_be_held_back() -> None:
    queue = Queue()
    queue.setpoint()
    queue.command(10.0)
    queue.outbox.say(Severity.INFO, "said at once")
    assert queue.names(commanding=False) == ["STATUSTEXT"]
    assert queue.outbox.holds
    assert queue.counts.setpoints == 0
    assert queue.names() == ["COMMAND_LONG", SETPOINT]


@pytest.mark.parametrize(("age_s", "left"), [(0.0, 1), (0.24, 1), (0.26, 0), (5.0, 0)])
def test_a_command_leaves_within_a_quarter_of_a_second_or_never(age_s: float, left: int) -> None:
    queue = Queue()
    queue.command(10.0)
    queue.outbox.drop_old(10.0 + age_s)
    assert queue.outbox.holds is bool(left)
    assert queue.names() == ["COMMAND_LONG"] * left


def test_only_the_old_ones_of_several_commands_are_dropped() -> None:
    queue = Queue()
    for now_s in (10.0, 10.2, 10.4):
        queue.command(now_s)
    queue.outbox.drop_old(10.45)
    assert queue.names() == ["COMMAND_LONG"] * 2


def test_a_setpoint_that_has_not_left_by_the_next_step_never_leaves() -> None:
    queue = Queue()
    queue.outbox.drop_old(10.0)
    assert queue.counts.setpoints_dropped == 0
    queue.setpoint()
    queue.outbox.drop_old(10.05)
    assert not queue.outbox.holds
    assert queue.names() == []
    assert (queue.counts.setpoints, queue.counts.setpoints_dropped) == (0, 1)
    queue.outbox.drop_old(10.1)
    assert queue.counts.setpoints_dropped == 1


def test_of_two_setpoints_the_newer_one_leaves() -> None:
    queue = Queue()
    for north_mps in (1.0, 2.0, 3.0):
        queue.setpoint(north_mps)
    (told,) = queue.left()
    assert told.vx == 3.0
    assert (queue.counts.setpoints, queue.counts.setpoints_dropped) == (1, 2)


@pytest.mark.parametrize(("configured", "first"), [(None, 1), (7, 7)])
def test_frames_carry_the_vehicles_system_id_once_it_is_known(configured: int | None, first: int) -> None:
    queue = Queue(system_id=configured)
    queue.outbox.say(Severity.INFO, "before")
    assert [m.get_srcSystem() for m in queue.left()] == [first]
    queue.outbox.speak_as(42)
    queue.outbox.say(Severity.INFO, "after")
    assert [m.get_srcSystem() for m in queue.left()] == [42]


def test_the_queue_is_discarded_only_once_it_is_longer_than_allowed() -> None:
    queue, frame = Queue(), bytes(64)
    for _ in range(MAX_QUEUED_BYTES // len(frame) + 1):
        queue.outbox.queue_frame(frame)
    assert queue.counts.overflows == 0
    queue.outbox.queue_frame(frame)
    assert queue.counts.overflows == 1
    assert queue.outbox.drain() == frame


def test_each_long_text_has_another_id_and_none_has_0() -> None:
    """0 stands for a text of one piece."""
    queue = Queue()
    queue.outbox._text_id = 0xFFFE
    for _ in range(3):
        queue.outbox.say(Severity.INFO, "a" * 60)
    assert [m.id for m in queue.left()] == [0xFFFF, 0xFFFF, 1, 1, 2, 2]
