"""Rules 1 to 3 and 7 to 10: kinds of frames, target, modes, age, form and speed."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.signing import Signing
from companion.autopilot.wire import MavlinkReader, MavlinkWriter, message_id_of
from companion.events import Firmware, Parameter, TwoAutopilots, VehicleParameters
from tests.companion.gate.flying import (
    ARDUPILOT,
    EXTERNAL,
    HOLD,
    MISSION,
    OTHER,
    PX4,
    RTL,
    STICKS,
    Flying,
    config,
    flown_at,
)

BOTH = pytest.mark.parametrize("firmware", Firmware)


# ---------------------------------------------------------------- 1: whole frames


def test_what_is_no_whole_frame_does_not_leave(taken):
    frame = taken.packed(taken.setpoint(1.0))
    text = taken.packed(mavlink.MAVLink_statustext_message(6, b"x", 0, 0))
    for damaged in (b"\0", b"garbage", frame[:-1], frame[:2], b"\xfd", frame[:1] + b"\xff" + frame[2:]):
        taken.run(5.1)
        assert taken.gate.release(text + damaged, taken.now_s) == text
        assert taken.refused() == [1]
    assert taken.gate.counts == {"whole": 6}
    assert taken.gate.release(b"", taken.now_s) == b""


def test_mavlink_1_and_unknown_flags_do_not_leave(taken):
    old = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    beat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    assert not taken.leaves(bytes(beat.pack(old, force_mavlink1=True)))
    frame = bytearray(taken.packed(beat))
    frame[2] = 0x02
    assert not taken.leaves(bytes(frame))
    assert taken.gate.counts == {"whole": 2}


@pytest.mark.parametrize("command", [False, True])
def test_a_payload_longer_than_its_message_does_not_leave(taken, command):
    """Receivers cut off fields that they do not know, so the part that they would act on is the front."""
    message = (
        mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1, 17, 0, 0, 0, 0, 0)
        if command
        else taken.setpoint(1.0)
    )
    frame = taken.packed(message)
    payload = frame[10:-2].ljust(33 if command else 53, b"\0")
    longer = MavlinkWriter(1, 191).pack_payload(message_id_of(frame), payload + b"\1")
    assert not taken.leaves(longer)
    assert taken.refused() == [1]


def test_signed_frames_are_judged_as_unsigned_ones_are(taken):
    signing = Signing(bytes(range(32)), 1, taken.now_s)
    frame = signing.sign(taken.packed(taken.setpoint(1.0)))
    assert taken.leaves(frame)
    assert taken.leaves(signing.sign(taken.packed(mavlink.MAVLink_statustext_message(6, b"x", 0, 0))))
    assert not taken.leaves(frame[:-1])
    assert not taken.leaves(signing.sign(taken.packed(taken.setpoint(99.0))))
    assert taken.refused() == [1, 10]


def test_what_leaves_keeps_its_order_and_its_bytes(taken):
    text = taken.packed(mavlink.MAVLink_statustext_message(6, b"x", 0, 0))
    arms = taken.packed(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0))
    fly = taken.packed(taken.setpoint(1.0))
    assert taken.gate.release(fly + arms + text, taken.now_s) == fly + text


# ---------------------------------------------------------------- 2: kinds

NEEDED = [
    mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3),
    mavlink.MAVLink_statustext_message(6, b"text", 0, 0),
    mavlink.MAVLink_timesync_message(0, 5),
    mavlink.MAVLink_collision_message(0, 1, 1, 1, 1.0, 1.0, 1.0),
    mavlink.MAVLink_command_ack_message(512, 0),
    mavlink.MAVLink_param_request_read_message(1, 1, b"WP_SPD", -1),
    mavlink.MAVLink_param_value_message(b"DMUCA_ENABLE", 1.0, 9, 4, 0),
    mavlink.MAVLink_mission_request_list_message(1, 1),
    mavlink.MAVLink_mission_request_message(1, 1, 0),
    mavlink.MAVLink_mission_request_int_message(1, 1, 0),
    mavlink.MAVLink_mission_ack_message(1, 1, 0),
    mavlink.MAVLink_autopilot_version_message(0, 1, 0, 0, 0, bytes(8), bytes(8), bytes(8), 0, 0, 0),
    mavlink.MAVLink_open_drone_id_basic_id_message(0, 0, bytes(20), 1, 2, bytes(20)),
    mavlink.MAVLink_open_drone_id_arm_status_message(0, b""),
]
FORBIDDEN = [
    mavlink.MAVLink_param_set_message(1, 1, b"FENCE_ENABLE", 0.0, 9),
    mavlink.MAVLink_set_mode_message(1, 1, 4),
    mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0, [1, 0, 0, 0], 0, 0, 0, 0.5),
    mavlink.MAVLink_set_position_target_global_int_message(0, 1, 1, 6, 0x9C7, 0, 0, 0, *(0.0,) * 8),
    mavlink.MAVLink_rc_channels_override_message(1, 1, *(1500,) * 8),
    mavlink.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0),
    mavlink.MAVLink_command_int_message(1, 1, 0, 176, 0, 0, 1, 4, 0, 0, 0, 0, 0),
    mavlink.MAVLink_mission_count_message(1, 1, 3),
    mavlink.MAVLink_mission_clear_all_message(1, 1),
    mavlink.MAVLink_mission_set_current_message(1, 1, 0),
    mavlink.MAVLink_setup_signing_message(1, 1, bytes(32), 0),
    mavlink.MAVLink_gps_inject_data_message(1, 1, 0, bytes(110)),
]


@pytest.mark.parametrize("message", NEEDED, ids=lambda m: m.get_type())
def test_what_commands_nothing_leaves_at_any_time(message):
    one = Flying(config("watch"))
    assert one.out(message)
    assert not one.gate.counts


@pytest.mark.parametrize("message", FORBIDDEN, ids=lambda m: m.get_type())
def test_other_messages_never_leave(taken, message):
    assert not taken.out(message)
    assert taken.refused() == [2]


@pytest.mark.parametrize("number", [20, 21, 22, 92, 185, 192, 209, 246, 252, 300, 400, 420, 43003])
def test_other_commands_never_leave(taken, number):
    assert not taken.command(number, 1.0)
    assert taken.refused() == [2]


@pytest.mark.parametrize("number", [511, 512])
def test_messages_may_be_asked_for_at_any_time(number):
    one = Flying(config("watch"))
    assert one.command(number, 33.0, 50_000.0)
    assert not one.gate.counts


@pytest.mark.parametrize(
    ("opcode", "leaves"), [(128, True), (129, True), (7, False), (6, False), (15, False)]
)
def test_files_are_told_of_and_never_written(taken, opcode, leaves):
    """ArduPilot keeps parameters in files, so writing a file can set parameters."""
    payload = bytes((0, 0, 0, opcode)).ljust(251, b"\1")
    assert taken.out(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, payload)) is leaves
    assert taken.refused() == ([] if leaves else [2])


# ---------------------------------------------------------------- 3: the target


@BOTH
def test_only_the_autopilot_that_is_heard_is_commanded(firmware):
    one = Flying(firmware=firmware).taken()
    for target in ((2, 1), (1, 0), (0, 0), (0, 1), (1, 191)):
        assert not one.flies(target=target)
        assert not one.asks(HOLD, target=target)
        assert not one.command(178, 1.0, 3.0, -1.0, target=target)
    assert one.gate.counts == {"target": 15}
    assert one.refused() == [3]


def test_nobody_is_commanded_before_a_vehicle_is_heard():
    one = Flying()
    one.gate.emptied(one.now_s)
    one.gate.decided(one.now_s)
    assert not one.flies()
    assert one.refused() == [3]


@pytest.mark.parametrize(("system_id", "takes"), [(0, False), (1, True)])
def test_of_two_autopilots_none_is_taken_unless_one_was_configured(system_id, takes):
    one = Flying(config(system_id=system_id)).airborne(MISSION)
    one.gate.hear(TwoAutopilots(reason="two"), one.now_s)
    assert one.asks(EXTERNAL) is takes
    assert one.refused() == ([] if takes else [3])


def test_of_two_autopilots_the_one_that_is_held_is_kept_and_not_taken_again():
    one = Flying(config("guard", system_id=0)).taken()
    one.gate.hear(TwoAutopilots(reason="two"), one.now_s)
    assert one.flies()
    assert one.asks(MISSION)
    one.mode = MISSION
    one.run()
    assert not one.asks(EXTERNAL)
    assert one.refused() == [3]


# ---------------------------------------------------------------- 7: modes


@BOTH
@pytest.mark.parametrize(("use", "mission"), [("guard", True), ("fly", False)])
def test_only_four_modes_are_asked_for(firmware, use, mission):
    for mode in (EXTERNAL, MISSION, HOLD, STICKS, RTL):
        one = Flying(config(use), firmware).taken()
        leaves = mode is not RTL and (mission or mode is not MISSION)
        assert one.asks(mode) is leaves, mode
        assert one.refused() == ([] if leaves else [7])


@BOTH
@pytest.mark.parametrize("use", ["guard", "fly"])
@pytest.mark.parametrize("mode", [EXTERNAL, MISSION, HOLD, STICKS, RTL])
def test_from_which_modes_the_vehicle_is_taken(firmware, use, mode):
    one = Flying(config(use), firmware).airborne(mode)
    chosen = use == "fly" and mode is EXTERNAL
    taken = mode is MISSION or chosen or (use == "fly" and mode is HOLD and firmware is PX4)
    assert one.asks(EXTERNAL) is taken
    assert one.refused() == ([] if taken else [7])
    one = Flying(config(use), firmware).airborne(mode)
    assert one.flies() is taken
    assert one.refused() == ([] if taken else [6])
    for other in (HOLD, STICKS):
        one = Flying(config(use), firmware).airborne(mode)
        assert one.asks(other) is chosen


@pytest.mark.parametrize("params", [(0, 17, 0), (1, 17, 1), (1, math.nan, 0), (math.nan, 17, 0), (1, 4, 4)])
def test_a_mode_is_asked_for_in_its_own_words(taken, params):
    assert not taken.command(176, *map(float, params))
    assert taken.refused() == [7]


def test_requests_do_not_come_in_storms(taken):
    taken.run(3.0)
    assert [taken.asks(HOLD) for _ in range(6)] == [True] * 5 + [False]
    assert taken.refused() == [7]
    taken.run(1.9)
    assert not taken.asks(HOLD)
    taken.run(0.15)
    assert taken.asks(HOLD)


def test_a_missions_speed_goes_with_the_mission_alone():
    one = Flying(config("guard")).taken()
    assert not one.command(178, 1.0, 3.0, -1.0)
    assert one.refused() == [7]
    one = Flying(config("guard")).taken()
    assert one.asks(MISSION)
    assert one.command(178, 1.0, 3.0, -1.0)
    one.mode = MISSION
    one.run()
    assert one.command(178, 1.0, 3.0, -1.0)
    assert not one.gate.counts


@pytest.mark.parametrize("speed_mps", [0.0, -1.0, math.nan, math.inf, 101.0])
def test_a_missions_speed_is_one(speed_mps):
    one = Flying(config("guard")).airborne(MISSION)
    assert not one.command(178, 1.0, speed_mps, -1.0)
    assert one.refused() == [10]


@pytest.mark.parametrize(
    ("kind", "throttle"), [(0.0, -1.0), (2.0, -1.0), (3.0, -1.0), (1.0, 50.0), (1.0, 0.0)]
)
def test_a_missions_speed_is_a_ground_speed_and_no_throttle(kind, throttle):
    one = Flying(config("guard")).airborne(MISSION)
    assert not one.command(178, kind, 3.0, throttle)
    assert one.refused() == [10]


def test_a_mission_that_is_flown_has_its_own_speed():
    one = Flying(config("fly")).airborne(MISSION)
    assert not one.command(178, 1.0, 3.0, -1.0)
    assert one.refused() == [7]


# ---------------------------------------------------------------- after a fault


def test_after_a_fault_nothing_but_a_request_to_hold_leaves_for_three_seconds():
    one = Flying(config("guard")).taken()
    assert not one.command(400, 1.0)
    (told,) = one.broken()
    assert told.ends == "fault"
    assert "gate rule 2 (kind): command 400" in told.text
    for _ in range(58):
        one.run()
        assert not one.flies()
    assert not one.asks(EXTERNAL)
    assert not one.asks(MISSION)
    assert one.asks(HOLD)
    one.run(0.2)
    assert one.flies()
    assert one.asks(MISSION)


def test_no_missions_speed_leaves_after_a_fault():
    one = Flying(config("guard")).airborne(MISSION)
    assert not one.command(400, 1.0)
    one.run(2.9)
    assert not one.command(178, 1.0, 3.0, -1.0)
    one.run(0.15)
    assert one.command(178, 1.0, 3.0, -1.0)
    assert one.gate.counts == {"kind": 1, "age": 1}


def test_what_comes_too_late_is_no_fault(taken):
    taken.now_s += 0.3
    assert not taken.flies()
    (told,) = taken.broken()
    assert told.ends == "nothing"
    taken.run(0.1)
    assert taken.flies()


def test_the_same_rule_is_told_of_once_in_five_seconds(taken):
    told = 0
    for _ in range(240):
        taken.run()
        taken.out(FORBIDDEN[0])
        told += len(taken.broken())
    assert told == 3
    assert taken.gate.counts == {"kind": 240}


def test_what_has_left_can_be_read_by_anybody(taken):
    frames = taken.packed(taken.setpoint(1.0)) + taken.packed(NEEDED[1])
    read = MavlinkReader().feed(taken.gate.release(frames, taken.now_s))
    assert [m.get_type() for m in read] == ["SET_POSITION_TARGET_LOCAL_NED", "STATUSTEXT"]


assert OTHER is RTL


def test_every_fault_is_told_to_the_program_above():
    """Each of these shuts the gate. A program that was not told would go on as if its commands had left."""
    one = Flying().taken()
    for _ in range(3):
        assert not one.flies(30.0)
        assert one.refused() == [10]
        one.run(3.2)
        assert one.flies()


def test_what_was_decided_before_a_limit_was_told_does_not_leave_and_is_no_fault():
    """A setpoint waits for an answer, and a new limit of the vehicle arrives before it."""
    one = flown_at(Flying().taken(), 4.0, 0.0, 0.0)
    one.now_s += 0.01
    lower = Parameter(name="P", value=3.0)
    one.gate.hear(VehicleParameters(firmware=ARDUPILOT, speed_mps=lower), one.now_s)
    assert not one.flies(4.0)
    assert one.refused() == [8]
    one.run()
    assert one.flies(3.0)
    assert not one.flies(4.0)
    assert one.refused() == [10]
