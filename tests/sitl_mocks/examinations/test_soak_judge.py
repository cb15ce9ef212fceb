"""The judge with hand-made input: it reports each broken rule, and accepts what is allowed."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkWriter
from companion.events import Firmware
from sitl_mocks.examinations.rule_judge import Judge
from sitl_mocks.examinations.world import bounds_of

GUIDED, RTL, AUTO, BRAKE, LOITER = 4, 6, 3, 17, 5
COMPANION, VEHICLE = MavlinkWriter(1, 191), MavlinkWriter(1, 1)


def setpoint(north=1.0, down=0.0, *, mask=0x9C7, frame=1):
    return COMPANION.pack(
        mavlink.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, frame, mask, 0, 0, 0, north, 0, down, 0, 0, 0, 0, 0
        )
    )


def asks(mode):
    return COMPANION.pack(mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1.0, float(mode), 0, 0, 0, 0, 0))


def heartbeat(mode):
    return VEHICLE.pack(mavlink.MAVLink_heartbeat_message(2, 3, 217, mode, 4, 3))


def position():
    return VEHICLE.pack(mavlink.MAVLink_global_position_int_message(1, 0, 0, 0, 0, 0, 0, 0, 0))


class Table:
    """A vehicle that entered GUIDED at 0.1 s, at the companion's request."""

    def __init__(self, use="guard"):
        self.judge = Judge(bounds_of(Firmware.ARDUPILOT, use))
        self.judge.shows(0.0, AUTO, armed=True)
        self.read(0.0, position(), heartbeat(AUTO))
        self.send(0.1, asks(GUIDED))
        self.judge.shows(0.1, GUIDED, armed=True)

    def read(self, now_s, *frames, sent_s=None):
        self.judge.reads(now_s, [(now_s if sent_s is None else sent_s, frame) for frame in frames])

    def keep_reading(self, from_s, to_s):
        for tick in range(round((to_s - from_s) / 0.05) + 1):
            self.read(from_s + 0.05 * tick, position())

    def send(self, now_s, data, *, after_s=0.0):
        self.judge.leaves(now_s, data)
        self.judge.reaches(now_s + after_s, data, now_s)

    def pilot(self, now_s, mode):
        self.judge.selects(now_s, mode)
        self.judge.shows(now_s, mode, armed=True)
        self.judge.accepted(now_s)

    @property
    def rules(self):
        return [breach.rule for breach in self.judge.first()]


def test_another_vehicle_tells_nothing_about_this_one():
    """Its positions make no setpoint fresh, and its mode is not read as the pilot's."""
    other = MavlinkWriter(77, 1)
    place = other.pack(mavlink.MAVLink_global_position_int_message(1, 0, 0, 0, 0, 0, 0, 0, 0))
    mode = other.pack(mavlink.MAVLink_heartbeat_message(2, 3, 217, RTL, 4, 3))
    for system_id, rules in ((1, ["stale"]), (None, ["request"])):
        table = Table()
        table.judge = Judge(bounds_of(Firmware.ARDUPILOT, "guard"), system_id=system_id)
        table.judge.shows(0.0, AUTO, armed=True)
        table.read(0.0, position())
        table.send(0.1, asks(GUIDED))
        table.judge.shows(0.1, GUIDED, armed=True)
        table.read(1.9, place)
        table.send(2.0, setpoint())
        table.pilot(2.1, RTL)
        table.read(2.2, mode)
        table.send(2.25, asks(BRAKE))
        assert table.rules == rules


def test_a_companion_that_yields_breaks_nothing():
    table = Table()
    table.send(1.0, setpoint())
    table.pilot(1.02, RTL)
    table.send(1.05, setpoint())  # under way
    table.read(1.1, heartbeat(RTL))
    table.read(20.0, position(), heartbeat(RTL))
    assert table.rules == []
    assert table.judge.setpoints == 2


def test_a_mode_may_not_be_asked_for_once_the_pilots_can_be_read():
    table = Table()
    table.pilot(5.0, RTL)
    table.read(9.0, heartbeat(RTL), sent_s=5.0)
    table.send(9.0, asks(BRAKE))
    table.judge.shows(9.0, BRAKE, armed=True)
    assert table.rules == ["request", "left"]
    assert "the pilot's mode 6 was left after 4.000 s for mode 17" in table.judge.breaches[1].words


def test_a_pilots_mode_that_was_lost_is_not_left_after_a_standstill():
    table = Table()
    table.keep_reading(0.1, 1.0)
    table.pilot(2.0, RTL)
    table.read(2.3, position())
    table.send(2.3, asks(BRAKE))
    table.judge.shows(2.3, BRAKE, armed=True)
    assert table.rules == ["unread"]


@pytest.mark.parametrize(("asked_s", "rules", "crossed"), [(1.95, [], 1), (2.3, [], 1), (2.9, ["unread"], 0)])
def test_a_request_may_cross_the_pilots_choice_of_a_moment_ago(asked_s, rules, crossed):
    table = Table()
    table.keep_reading(0.1, asked_s)
    table.judge.leaves(asked_s, asks(BRAKE))
    table.pilot(2.0, RTL)
    table.judge.reaches(max(2.1, asked_s), asks(BRAKE), max(2.1, asked_s))
    table.judge.shows(max(2.1, asked_s), BRAKE, armed=True)
    assert (table.rules, table.judge.crossed) == (rules, crossed)


def test_no_setpoint_a_tenth_of_a_second_after_the_pilots_mode_whatever_comes_then():
    table = Table()
    table.pilot(1.0, RTL)
    table.read(1.05, position(), heartbeat(RTL))
    table.judge.shows(1.06, GUIDED, armed=True)
    table.read(1.1, heartbeat(GUIDED))
    table.send(1.15, setpoint())
    assert table.rules == []
    table.send(1.2, setpoint())
    assert table.rules == ["setpoint"]


def test_only_the_disarming_gives_back_what_was_taken_from_our_hands():
    table = Table()
    table.pilot(1.0, RTL)
    table.read(1.05, position(), heartbeat(RTL))
    table.pilot(2.0, AUTO)
    table.read(2.05, position(), heartbeat(AUTO))
    table.send(2.1, asks(GUIDED))
    assert table.rules == ["request"]
    other = Table()
    other.pilot(1.0, RTL)
    other.read(1.05, heartbeat(RTL))
    other.judge.shows(2.0, AUTO, armed=False)
    other.judge.shows(3.0, AUTO, armed=True)
    other.read(3.1, position(), heartbeat(AUTO))
    other.send(3.2, asks(GUIDED))
    assert other.rules == []


def test_a_mission_that_was_only_watched_is_watched_again_when_it_is_selected_again():
    table = Table()
    table.send(20.0, asks(AUTO))
    table.judge.shows(20.0, AUTO, armed=True)
    table.pilot(40.0, LOITER)
    table.read(40.0, position(), heartbeat(LOITER))
    table.pilot(50.0, AUTO)
    table.read(50.0, position(), heartbeat(AUTO))
    table.send(50.1, asks(GUIDED))
    assert table.rules == []
    table.pilot(60.0, LOITER)
    table.judge.shows(70.0, LOITER, armed=True)
    table.read(70.0, position(), heartbeat(LOITER))
    table.send(70.1, asks(BRAKE))
    assert table.rules == ["request"]


def test_what_a_failsafe_chose_is_not_ours_to_end():
    table = Table()
    table.judge.shows(3.0, RTL, armed=True)
    table.read(3.0, position(), heartbeat(RTL))
    table.send(3.1, asks(BRAKE))
    assert table.rules == ["request"]


def test_a_mode_that_we_asked_for_ourselves_is_no_sign_of_the_pilot():
    table = Table()
    table.send(20.0, asks(AUTO))
    table.pilot(20.05, AUTO)
    table.read(20.1, position(), heartbeat(AUTO))
    table.send(20.2, setpoint())
    table.send(20.2, asks(GUIDED))
    assert table.rules == []


def test_a_mode_that_was_accepted_must_be_entered():
    table = Table()
    table.judge.selects(1.0, RTL)
    table.judge.accepted(1.0)
    assert table.rules == ["refused"]


@pytest.mark.parametrize(
    ("data", "rules"),
    [
        (setpoint(6.0), []),
        (setpoint(6.1), ["bounds"]),
        (setpoint(float("nan")), ["bounds"]),
        (setpoint(0.0, -3.1), ["bounds"]),
        (setpoint(0.0, 3.1), ["bounds"]),
        (setpoint(mask=0xDC7), ["form"]),
        (setpoint(frame=8), ["form"]),
    ],
)
def test_what_a_setpoint_may_be(data, rules):
    table = Table()
    table.send(0.5, data)
    assert table.rules == rules


def test_setpoints_are_of_a_fresh_position_and_arrive_fresh():
    table = Table()
    table.send(1.4, setpoint(), after_s=0.25)
    assert table.rules == []
    table.send(1.6, setpoint(), after_s=0.3)
    assert table.rules == ["stale", "old"]


def test_what_a_companion_may_not_have_read_before_it_stopped_it_reads_when_it_goes_on():
    table = Table()
    judge = table.judge = Judge(bounds_of(Firmware.ARDUPILOT, "guard"), grace_s=0.15)
    judge.shows(0.0, AUTO, armed=True)
    table.read(0.0, position(), heartbeat(AUTO))
    table.send(0.1, asks(GUIDED))
    judge.shows(0.1, GUIDED, armed=True)
    table.keep_reading(0.15, 1.0)
    table.pilot(1.02, RTL)
    table.read(1.05, position(), heartbeat(RTL))
    judge.stops(1.1)
    table.read(4.0, position(), heartbeat(RTL), sent_s=1.05)
    table.read(4.0, position())
    table.send(4.05, setpoint())
    assert judge.breaches == []
    table.send(4.2, setpoint())
    assert [breach.rule for breach in judge.breaches] == ["setpoint"]


def test_a_mode_that_was_read_before_the_stop_stays_read():
    table = Table()
    table.keep_reading(0.15, 1.0)
    table.pilot(1.02, RTL)
    table.read(1.05, position(), heartbeat(RTL))
    table.judge.stops(1.5)
    table.send(1.6, asks(GUIDED))
    assert [breach.rule for breach in table.judge.breaches] == ["request"]
