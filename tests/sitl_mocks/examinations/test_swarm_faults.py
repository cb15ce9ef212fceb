"""`sitl-mocks swarm --faults` without its processes: the drawn schedules and the judge's input."""

from __future__ import annotations

import contextlib
import json
import socket
import time

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import FrameScanner, MavlinkWriter
from companion.errors import ConfigError
from companion.events import Firmware
from sitl_mocks.examinations.faults import OUTSIDE
from sitl_mocks.examinations.modelled_link import KINDS
from sitl_mocks.examinations.processes import companion_ends, wire
from sitl_mocks.examinations.processes.decisions import Decisions
from sitl_mocks.examinations.processes.wire import GRACE_S, Wire
from sitl_mocks.examinations.rule_judge import Judge
from sitl_mocks.examinations.swarm.schedule import GIVEN_BACK, draw, from_file, link_of, schedule_of, to_file
from sitl_mocks.examinations.swarm.verdict import broken, judged
from sitl_mocks.examinations.world import bounds_of

GUIDED, RTL = 4, 6
COMPANION, VEHICLE = MavlinkWriter(1, 191), MavlinkWriter(1, 1)
ENOUGH_S = GRACE_S + 0.15
"""After this a setpoint against a mode that could be read is a breach."""

# ------------------------------------------------------------ what is drawn


def test_the_same_seed_draws_the_same_schedule():
    assert schedule_of(3, 1, 60.0) == schedule_of(3, 1, 60.0)
    assert schedule_of(3, 1, 60.0)[1:3] == schedule_of(3, 1, 30.0)[1:3]
    assert len({schedule_of(seed, number, 60.0) for seed in range(10) for number in range(3)}) == 30


def test_a_schedule_is_in_order_and_within_the_flight():
    for seed in range(50):
        faults = schedule_of(seed, 0, 60.0)
        times = [fault.at_s for fault in faults]
        assert times == sorted(times)
        assert times[0] >= 0.0
        assert times[-1] < 60.0


def test_three_aircraft_have_three_kinds_of_links():
    for seed in range(10):
        assert {link_of(seed, number) for number in range(3)} == set(KINDS)
    assert len({link_of(seed, 0) for seed in range(20)}) == 3


@pytest.mark.parametrize("link", ["tcp", "pty"])
def test_streams_have_no_doubled_and_no_reordered_datagrams(link):
    kinds = {fault.kind for seed in range(100) for fault in schedule_of(seed, 0, 120.0, link)}
    assert kinds == {*OUTSIDE, GIVEN_BACK} - {"duplicate", "reorder"}


def test_a_schedule_survives_its_file():
    schedule = draw(3, 3, 1, 60.0, None)
    assert schedule.link == link_of(3, 1)
    assert from_file(json.loads(json.dumps(to_file(schedule)))) == schedule


@pytest.mark.parametrize(
    "change",
    [
        {"link": "ipx"},
        {"number": 3},
        {"seed": -1},
        {"until_s": 0.0},
        {"faults": [{"kind": "luck", "at_s": 1.0}]},
    ],
)
def test_a_file_that_is_no_schedule_is_refused(change):
    with pytest.raises(ConfigError, match="schedule"):
        from_file(to_file(draw(3, 3, 1, 60.0, None)) | change)


def test_everything_that_can_be_done_from_outside_is_drawn():
    faults = [fault for seed in range(100) for fault in schedule_of(seed, 0, 120.0)]
    assert {fault.kind for fault in faults} == {*OUTSIDE, GIVEN_BACK}
    stalls = [fault.lasts_s for fault in faults if fault.kind == "stall"]
    assert 0.05 <= min(stalls) < 0.1
    assert 15.0 < max(stalls) <= 20.0
    assert {len(fault.modes) for fault in faults if fault.kind == "mode"} == {1, 2, 3}


def test_many_pilots_choose_while_the_companion_is_stopped():
    inside = 0
    for seed in range(50):
        faults = schedule_of(seed, 0, 60.0)
        stalls = [(f.at_s, f.at_s + f.lasts_s) for f in faults if f.kind == "stall"]
        chosen = [f.at_s for f in faults if f.kind == "mode"]
        inside += any(begins_s < at_s < ends_s for begins_s, ends_s in stalls for at_s in chosen)
    assert inside > 25


# ------------------------------------------------------------ what the judge gets to see


class SkippingClock:
    """The router's clock, which tests advance instead of waiting."""

    time = staticmethod(time.time)

    def __init__(self):
        self.skipped_s = 0.0

    def monotonic(self):
        return time.monotonic() + self.skipped_s


class Ends:
    """A wire with nobody but this test at its two ends, and a judge who knows the vehicle to be in GUIDED."""

    def __init__(self, stack, clock):
        self.clock = clock
        self.vehicle = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        self.vehicle.bind(("127.0.0.1", 0))
        self.judge = Judge(bounds_of(Firmware.ARDUPILOT, "fly"), grace_s=GRACE_S)
        self.wire = Wire(
            "udp", self.vehicle.getsockname()[1], self.judge, rng=np.random.default_rng(1), shown=self.shown
        )
        stack.callback(self.wire.close)
        self.companion = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        self.companion.connect(("127.0.0.1", int(self.wire.name.rsplit(":", 1)[1])))
        self.companion.settimeout(60.0)
        self.vehicle.settimeout(60.0)
        self.clock_ms = 1000
        self.sends_setpoint()
        self.vehicle.connect(self.vehicle.recvfrom(65536)[1])
        self.tells(GUIDED)

    def shown(self, at_s, frame):
        if frame.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            custom_mode = int.from_bytes(frame.payload[:4], "little")
            if custom_mode == RTL:
                self.judge.selects(at_s, custom_mode)
            self.judge.shows(at_s, custom_mode, armed=True)

    def pass_on(self):
        for _ in range(3):
            self.wire.pump(0.02)

    def tells(self, mode):
        self.clock_ms += 50
        heartbeat = mavlink.MAVLink_heartbeat_message(2, 3, 217, mode, 4, 3)
        place = mavlink.MAVLink_global_position_int_message(self.clock_ms, 0, 0, 0, 0, 0, 0, 0, 0)
        for message in (heartbeat, place):
            self.vehicle.send(VEHICLE.pack(message))
        self.pass_on()

    def sends_setpoint(self, clock_ms=None):
        self.companion.send(
            COMPANION.pack(
                mavlink.MAVLink_set_position_target_local_ned_message(
                    self.clock_ms if clock_ms is None else clock_ms,
                    1, 1, 1, 0x9C7, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0, 0,
                )
            )
        )  # fmt: skip
        self.pass_on()

    def asks_guided(self):
        message = mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1.0, float(GUIDED), 0, 0, 0, 0, 0)
        self.companion.send(COMPANION.pack(message))
        self.pass_on()

    @property
    def rules(self):
        return [breach.rule for breach in self.judge.first()]


@pytest.fixture
def ends(monkeypatch):
    clock = SkippingClock()
    for module in (wire, companion_ends):
        monkeypatch.setattr(module, "time", clock)
    with contextlib.ExitStack() as stack:
        found = Ends(stack, clock)
        found.judge.breaches.clear()
        yield found


def test_a_setpoint_against_a_mode_that_was_read_is_a_breach(ends):
    ends.sends_setpoint()
    ends.tells(RTL)
    assert ends.rules == []
    ends.clock.skipped_s += ENOUGH_S
    ends.sends_setpoint()
    assert ends.rules == ["setpoint"]


def test_a_request_against_a_mode_that_was_read_is_a_breach(ends):
    ends.tells(RTL)
    ends.clock.skipped_s += ENOUGH_S
    ends.asks_guided()
    assert ends.rules == ["request"]


def test_a_mode_that_was_lost_on_the_way_condemns_nobody(ends):
    ends.wire.way.weather.down_stands = True
    ends.tells(RTL)
    ends.clock.skipped_s += ENOUGH_S
    ends.sends_setpoint()
    assert ends.rules == []
    assert ends.vehicle.recv(65536)[7] == mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED


def test_what_comes_to_a_companion_that_is_stopped_is_read_when_it_goes_on(ends):
    ends.tells(GUIDED)
    ends.wire.stopped()
    ends.tells(RTL)
    ends.clock.skipped_s += ENOUGH_S
    ends.sends_setpoint()
    assert ends.rules == []
    ends.wire.continues()
    ends.clock.skipped_s += ENOUGH_S  # the router dates a frame too early if it is interrupted while it reads
    ends.asks_guided()
    assert ends.rules == ["request"]


def test_a_mode_that_came_just_before_the_stop_may_not_have_been_read(ends):
    ends.tells(RTL)
    ends.wire.stopped()
    ends.clock.skipped_s += ENOUGH_S
    ends.wire.continues()
    ends.sends_setpoint()
    assert "request" not in ends.rules
    assert "setpoint" not in ends.rules
    ends.asks_guided()
    assert "request" in ends.rules


def test_a_setpoint_that_stayed_in_a_companion_that_was_stopped_is_old(ends):
    ends.sends_setpoint()
    decided_ms = ends.clock_ms
    ends.tells(GUIDED)
    ends.wire.stopped()
    ends.clock.skipped_s += 0.3 + ENOUGH_S
    ends.tells(GUIDED)
    ends.wire.continues()
    ends.sends_setpoint(decided_ms)
    assert ends.rules == ["old"]


def test_clocks_out_of_order_say_nothing_of_decisions():
    def place(clock_ms):
        return VEHICLE.pack(mavlink.MAVLink_global_position_int_message(clock_ms, 0, 0, 0, 0, 0, 0, 0, 0))

    def setpoint(clock_ms):
        message = mavlink.MAVLink_set_position_target_local_ned_message(
            clock_ms, 1, 1, 1, 0x9C7, 0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0, 0
        )
        return FrameScanner().frames(COMPANION.pack(message))

    decisions = Decisions()
    decisions.readable(1.0, [(1.0, place(1000))])
    decisions.readable(2.0, [(2.0, place(2000))])
    assert decisions.decided_s(3.0, setpoint(1500)) == 2.0
    assert decisions.decided_s(3.0, setpoint(2500)) == 3.0
    decisions.readable(3.0, [(0.5, place(500))])
    assert decisions.decided_s(3.0, setpoint(600)) == 3.0


# ------------------------------------------------------------ the verdict

HELD = {"breaches": [], "unknown": None}
SWARM = {"ok": False, "ended_badly": [], "interrupted": False, "min_separation_m": 3.0}


def test_the_verdict_is_that_of_the_rules_and_not_of_the_separation():
    assert judged(SWARM, {"A": HELD})["ok"]
    assert not judged(SWARM, {"A": HELD, "B": HELD | {"breaches": [{"rule": "request"}]}})["ok"]
    assert not judged(SWARM, {"A": HELD | {"unknown": "no pilot chose"}})["ok"]
    assert not judged(SWARM | {"ended_badly": ["DMUCA001 (exit code 1)"]}, {"A": HELD})["ok"]
    assert not broken({"A": HELD})
