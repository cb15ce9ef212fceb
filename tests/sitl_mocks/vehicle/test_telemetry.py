"""Telemetry, message rates per link, parameters, time, forwarding, reboot."""

from __future__ import annotations

import math
import struct
import sys
from collections import Counter
from pathlib import Path

import numpy
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.readers import unpack
from companion.autopilot.wire import CURRENT_MODE, FrameScanner, MavlinkReader, MavlinkWriter
from companion.events import Firmware
from companion.geometry import LocalFrame
from companion.ownship import pressure_altitude_m
from sitl_mocks.vehicle.firmware.behaviour import PX4 as PX4_MANNERS
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from sitl_mocks.vehicle.firmware.param_tables import INT32
from sitl_mocks.vehicle.links import packed
from sitl_mocks.vehicle.motion.navigation import Globe
from tests.support.place import HOME

AP, PX4 = Firmware.ARDUPILOT, Firmware.PX4
BOTH = pytest.mark.parametrize("firmware", [AP, PX4])
RECORDINGS = Path(__file__).resolve().parents[4] / "shared" / "data" / "mavlink"


def count(messages):
    return Counter(m.get_type() for m in messages)


def test_ardupilot_fresh_link_carries_only_heartbeat_and_timesync(bench):
    assert count(bench(AP).run(30.01)) == {"HEARTBEAT": 31, "TIMESYNC": 4}


def test_px4_streams_unasked(bench):
    seen = count(bench(PX4).run(10.0))
    for name, hertz in (("HEARTBEAT", 1), ("GLOBAL_POSITION_INT", 50), ("LOCAL_POSITION_NED", 30),
                        ("TIMESYNC", 10), ("GPS_RAW_INT", 8), ("ATTITUDE", 50)):  # fmt: skip
        assert seen[name] == pytest.approx(10 * hertz, abs=0.05 * 10 * hertz + 1), name


@BOTH
def test_intervals_are_per_link(bench, firmware):
    b = bench(firmware)
    assert b.interval(30, 5.0, link=1) == [0]
    before = count(b.run(2.0))["ATTITUDE"]
    other = count(b.collect(1))["ATTITUDE"]
    assert other == pytest.approx(10, abs=1)
    assert before == (0 if firmware is AP else pytest.approx(100, abs=2))


@BOTH
def test_interval_off_and_default(bench, firmware):
    b = bench(firmware)
    b.interval(32, 10.0)
    assert count(b.run(1.0))["LOCAL_POSITION_NED"] == pytest.approx(10, abs=1)
    b.command(511, 32.0, -1.0)
    assert count(b.run(1.0))["LOCAL_POSITION_NED"] == 0
    b.command(511, 32.0, 0.0)
    assert count(b.run(1.0))["LOCAL_POSITION_NED"] == (0 if firmware is AP else pytest.approx(30, abs=1))


def test_ardupilot_refuses_interval_param3(bench):
    assert bench(AP).command(511, 33.0, 1e5, 1.0) == [2]


@pytest.mark.parametrize(("firmware", "number", "result"), [(AP, 230, 2), (AP, 247, 2), (PX4, 193, 4)])
def test_unsupported_message_interval(bench, firmware, number, result):
    b = bench(firmware)
    assert b.interval(number, 1.0) == [result]
    assert (f"No ap_message for mavlink id ({number})" in b.texts()) is (firmware is AP)


@BOTH
def test_get_interval_and_request_message(bench, firmware):
    b = bench(firmware)
    b.interval(33, 4.0)
    b.command(510, 33.0)
    assert [(m.message_id, m.interval_us) for _, m in b.seen if m.get_type() == "MESSAGE_INTERVAL"] == [
        (33, 250000)
    ]
    assert b.command(512, 242.0) == [0]
    assert b.command(512, 148.0) == [0]
    assert b.command(512, 247.0) != [0]
    names = count(m for _, m in b.seen)
    assert names["HOME_POSITION"] == 1
    assert names["AUTOPILOT_VERSION"] == 1
    version = next(m for _, m in b.seen if m.get_type() == "AUTOPILOT_VERSION")
    assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT


@pytest.mark.parametrize(("firmware", "hertz"), [(AP, 4), (PX4, 50)])
def test_request_data_stream(bench, firmware, hertz):
    b = bench(firmware)
    b.send(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_POSITION, 4, 1))
    assert count(b.run(2.0))["GLOBAL_POSITION_INT"] == pytest.approx(2 * hertz, abs=1)


@BOTH
def test_command_int_is_acknowledged_too(airborne, firmware):
    b = airborne(firmware)
    answers = b.send(mavlink.MAVLink_command_int_message(1, 1, 0, 511, 0, 0, 33.0, 1e5, 0, 0, 0, 0, 0))
    assert [(m.command, m.result, m.target_component) for m in answers] == [(511, 0, 191)]


def test_globe_agrees_with_the_exact_conversion():
    rng = numpy.random.default_rng(3)
    for lat, lon, alt in (
        (HOME.lat_deg, HOME.lon_deg, HOME.alt_m),
        (-33.9, 151.2, 0.0),
        (0.0, 179.9999, 20.0),
        (89.0, -60.0, 5.0),
    ):
        for ned in rng.uniform(-5000.0, 5000.0, (50, 3)).tolist():
            got, exact = Globe(lat, lon, alt).to_geodetic(*ned), LocalFrame(lat, lon, alt).to_geodetic(*ned)
            assert got == pytest.approx(exact, abs=1e-9, rel=0) or (
                abs(got[0] - exact[0]) < 1e-10
                and abs(got[1] - exact[1]) < 1e-10
                and abs(got[2] - exact[2]) < 1e-5
            )


@BOTH
def test_position_messages_agree_with_truth_without_noise(airborne, firmware):
    b = airborne(firmware, start_position_ned_m=(300.0, -200.0, -60.0)).in_external()
    for message_id in (24, 29, 32, 33):
        b.interval(message_id, 10.0)
    found = {m.get_type(): m for m in b.run(4.0, 3.0, 2.0, -1.0)}
    truth, velocity = b.vehicle.position_ned_m, b.vehicle.velocity_ned_mps
    for name in ("GLOBAL_POSITION_INT", "GPS_RAW_INT"):
        m = found[name]
        assert HOME.to_ned(m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3) == pytest.approx(truth, abs=0.5)
    local, place, gps = (found[n] for n in ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "GPS_RAW_INT"))
    assert (local.x, local.y, local.z) == pytest.approx(truth, abs=0.5)
    assert (place.vx, place.vy, place.vz) == pytest.approx([100 * v for v in velocity], abs=30)
    assert pressure_altitude_m(found["SCALED_PRESSURE"].press_abs) == pytest.approx(gps.alt * 1e-3, abs=0.5)
    assert gps.alt_ellipsoid - gps.alt == 47000
    assert gps.fix_type >= 3
    assert (gps.h_acc, gps.v_acc, gps.vel_acc) == (300, 300, 100)


def test_noise_is_correlated_consistent_and_of_the_stated_size(airborne):
    sigmas = {"gnss_horizontal_sigma_m": 2.0, "gnss_vertical_sigma_m": 3.0, "gnss_velocity_sigma_mps": 0.4}
    errors = []
    for seed in range(300):
        b = airborne(AP)
        b = type(b)(
            type(b.vehicle.options)(airborne=True, start_position_ned_m=(0, 0, -50.0), **sigmas), seed
        )
        local = b.vehicle._telemetry
        errors.append((*local.position_ned_m(), *local.velocity_ned_mps()))
        assert b.vehicle.position_ned_m == (0, 0, -50.0)
    spread = numpy.std(errors, axis=0)
    assert spread == pytest.approx([2.0, 2.0, 3.0, 0.4, 0.4, 0.4], rel=0.15)
    for message_id in (24, 32, 33):
        b.interval(message_id, 10.0)
    found = b.run(120.0)
    north = numpy.array([m.x for m in found if m.get_type() == "LOCAL_POSITION_NED"])
    assert numpy.abs(numpy.diff(north)).max() < 1.0
    assert north.std() > 0.2
    last = {m.get_type(): m for m in found}
    for name in ("GLOBAL_POSITION_INT", "GPS_RAW_INT"):
        m = last[name]
        assert HOME.to_ned(m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3)[0] == pytest.approx(north[-1], abs=0.05)
    assert (m.h_acc, m.v_acc, m.vel_acc) == (2000, 3000, 400)
    assert b.vehicle.position_ned_m == (0, 0, -50.0)


@BOTH
def test_time(bench, firmware):
    b = bench(firmware, utc_at_zero_s=1.7e9, boot_time_offset_s=50.0)
    b.run(2.0)
    (shown,) = (m for m in [*b.send(mavlink.MAVLink_command_long_message(1, 1, 512, 0, 2, 0, 0, 0, 0, 0, 0))]
                if m.get_type() == "SYSTEM_TIME")  # fmt: skip
    assert shown.time_unix_usec == round((1.7e9 + 2.0) * 1e6)
    assert shown.time_boot_ms == 52000
    (answer,) = b.send(mavlink.MAVLink_timesync_message(0, 123456789))
    assert (answer.tc1, answer.ts1) == (52_000_000_000, 123456789)
    assert b.send(mavlink.MAVLink_timesync_message(5, 6)) == []


def read(b, name, index=-1):
    return b.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), index))


@BOTH
def test_param_list(bench, firmware):
    b = bench(firmware)
    b.send(mavlink.MAVLink_param_request_list_message(1, 1))
    values = [m for m in b.run(2.0) if m.get_type() == "PARAM_VALUE"]
    assert [m.param_index for m in values] == list(range(values[0].param_count))
    (by_index,) = read(b, "", 3)
    assert by_index.param_id == values[3].param_id


def test_ardupilot_casts_integers(bench):
    b = bench(AP)
    (value,) = read(b, "RTL_ALT")
    assert (value.param_value, value.param_type) == (1500.0, INT32)
    (echo,) = b.send(mavlink.MAVLink_param_set_message(1, 1, b"RTL_ALT", 2000.0, INT32))
    assert (echo.param_value, echo.param_index) == (2000.0, 65535)


def test_px4_lays_integers_into_the_float(bench):
    b = bench(PX4)
    (value,) = read(b, "SYS_AUTOSTART")
    assert struct.unpack("<i", struct.pack("<f", value.param_value))[0] == 10040
    wanted = struct.unpack("<f", struct.pack("<i", 3))[0]
    (echo,) = b.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_RC_IN_MODE", wanted, INT32))
    assert struct.unpack("<i", struct.pack("<f", echo.param_value))[0] == 3
    (real,) = read(b, "COM_OF_LOSS_T")
    assert real.param_value == 1.0


@BOTH
def test_unknown_parameter_gets_silence(bench, firmware):
    b = bench(firmware)
    assert read(b, "NO_SUCH_NAME") == []
    assert read(b, "", 9999) == []
    assert b.send(mavlink.MAVLink_param_set_message(1, 1, b"NO_SUCH_NAME", 1.0, 9)) == []


def test_ardupilot_names_before_and_after_the_renaming(bench):
    assert read(bench(AP, system_id=1), "MAV_SYSID")[0].param_value == 1.0
    assert read(bench(AP), "SYSID_THISMAV") == []
    old = bench(AP, legacy_parameter_names=True)
    assert read(old, "SYSID_THISMAV")[0].param_value == 1.0
    assert read(old, "MAV_SYSID") == []


def test_the_timeout_parameter_is_obeyed(airborne):
    b = airborne(AP)
    b.send(mavlink.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", 1.0, 9))
    b.in_external()
    b.run(4.0, 5.0, 0.0, 0.0)
    b.run(4.0)
    assert b.speed < 0.3


def test_ardupilot_forwards_between_links_and_px4_does_not(bench):
    for firmware in (AP, PX4):
        b = bench(firmware)
        b.vehicle.open_link(1)
        gcs = MavlinkWriter(255, 190)
        beat = gcs.pack(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        text = gcs.pack(mavlink.MAVLink_statustext_message(6, b"hello"))
        b.vehicle.receive(beat + text, 0.0, 1)
        sources = [(m.get_srcSystem(), m.get_type()) for m in b.collect(0)]
        assert sources == ([(255, "HEARTBEAT"), (255, "STATUSTEXT")] if firmware is AP else [])
        # To the ground station only where it was heard; to the autopilot not at all.
        b.send(mavlink.MAVLink_param_request_read_message(255, 190, b"X", -1))
        b.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NONE", -1))
        passed = [m for m in b.collect(1) if m.get_srcComponent() == 191]
        assert [m.target_system for m in passed] == ([255] if firmware is AP else [])


@BOTH
def test_reboot_is_silent_for_2_4_s_and_forgets_rates(bench, firmware):
    b = bench(firmware)
    b.interval(30, 20.0)
    b.run(1.0)
    b.send(mavlink.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", 2.0, 9))
    assert b.command(246, 1.0) == [0]
    assert b.vehicle.reboots == 1
    assert b.run(2.38) == []
    back = b.run(2.0)
    assert "HEARTBEAT" in count(back)
    assert count(back)["ATTITUDE"] == (0 if firmware is AP else pytest.approx(99, abs=6))
    timesync = next(m for m in back if m.get_type() == "TIMESYNC")
    assert timesync.ts1 < 1e9


@BOTH
def test_reboot_while_armed_is_refused(airborne, firmware):
    b = airborne(firmware)
    assert b.command(246, 1.0) not in ([0], [])
    assert b.vehicle.reboots == 0


@BOTH
def test_garbage_between_frames_does_no_harm(bench, firmware):
    b = bench(firmware)
    rng = numpy.random.default_rng(5)
    for _ in range(50):
        b.vehicle.receive(rng.bytes(200), b.now_s)
        b.run(0.02)
    b.run(0.1)
    b.vehicle.receive(b"\0" * 300, b.now_s)
    assert b.interval(30, 5.0) == [0]


def test_undrained_link_is_bounded(bench):
    b = bench(PX4)
    b.vehicle.open_link(1)
    b.run(120.0)
    assert len(b.vehicle.drain(1)) <= 1 << 18


def recorded(name):
    path = RECORDINGS / name
    if not path.exists():
        pytest.skip(f"recording {path} is not on this machine")
    data, at, reader = path.read_bytes(), 0, MavlinkReader()
    while at + 8 < len(data):
        size = data[at + 9] + 12
        yield from reader.feed(data[at + 8 : at + 8 + size])
        at += 8 + size


@pytest.mark.skipif(sys.byteorder != "little", reason="recordings are read on little-endian machines")
@pytest.mark.parametrize(
    ("firmware", "name"), [(AP, "ardupilot_sitl_guided.tlog"), (PX4, "px4_sih_offboard.tlog")]
)
def test_heartbeats_are_those_of_the_recorded_vehicle(bench, firmware, name):
    real = {
        (m.custom_mode, m.base_mode, m.type, m.autopilot)
        for m in recorded(name)
        if m.get_type() == "HEARTBEAT" and m.get_srcComponent() == 1
    }
    manners = bench(firmware).vehicle._manners
    numbers = {manners.mode_of(custom): custom for custom, *_ in real}
    assert None not in numbers, "the recorded vehicle flew a mode that the mock lacks"
    for custom, base, kind, autopilot in real:
        mode = manners.mode_of(custom)
        assert (kind, autopilot) == (mavlink.MAV_TYPE_QUADROTOR, manners.autopilot_id)
        if firmware is AP or base & 128:
            expected = manners.base_modes[mode] | 128
            assert base | 128 == expected, mode
    assert VehicleMode.EXTERNAL in numbers


@pytest.mark.parametrize(
    ("firmware", "name"), [(AP, "ardupilot_sitl_guided.tlog"), (PX4, "px4_sih_offboard.tlog")]
)
def test_mission_exchange_is_that_of_the_recorded_vehicle(bench, firmware, name):
    """Replay the recorded companion's mission frames: the mock asks and answers as the real one did."""
    kept = [
        m for m in recorded(name) if m.get_type().startswith("MISSION_") and m.get_type() != "MISSION_CURRENT"
        and m.get_type() != "MISSION_ITEM_REACHED"
    ]  # fmt: skip
    b = bench(firmware)
    if firmware is AP:
        home = next(m for m in kept if m.get_srcComponent() == 1 and m.get_type() == "MISSION_ITEM_INT")
        b = bench(firmware, home_lat_deg=home.x * 1e-7, home_lon_deg=home.y * 1e-7, home_alt_msl_m=home.z)
    answers = []
    for m in kept:
        if m.get_srcComponent() == 191:
            answers += [a.to_dict() for a in b.send(m) if a.get_type().startswith("MISSION_")]
    real = [m.to_dict() for m in kept if m.get_srcComponent() == 1]
    for message in (*answers, *real):
        message.pop("current", None)
        for key, value in message.items():
            if isinstance(value, float) and math.isnan(value):
                message[key] = None
    assert answers == real


def modes_told(bench, seconds):
    """(time, custom mode, intended, standard) of each CURRENT_MODE."""
    scanner, found = FrameScanner(), []
    for _ in range(round(seconds / 0.02)):
        frames = [f for f in scanner.frames(bench.vehicle.drain()) if f.message_id == CURRENT_MODE]
        found += [(bench.now_s, *unpack(CURRENT_MODE, frame.payload)) for frame in frames]
        bench.now_s = round(bench.now_s + 0.02, 6)
        bench.vehicle.advance(bench.now_s)
    return found


def test_px4_tells_its_mode_twice_a_second_at_most(bench):
    b = bench(PX4)
    assert len(modes_told(b, 10.0)) in (5, 6)
    for hertz, rate in ((1.0, 1), (4.0, 2), (10.0, 2), (50.0, 2)):
        b.interval(CURRENT_MODE, hertz)
        assert len(modes_told(b, 10.0)) == pytest.approx(10 * rate, abs=1)


def test_px4_tells_the_mode_that_it_leaves_and_the_new_one_an_interval_later(bench):
    b = bench(PX4)
    b.interval(CURRENT_MODE, 20.0)
    modes_told(b, 2.2)
    began = b.now_s
    b.vehicle.receive(set_mode_bytes(VehicleMode.LAND), began)
    (first, *left), (then, *entered) = modes_told(b, 0.2)
    assert (first, left) == (began, [0x3040000, 0x3040000, 0])
    assert (then - began, entered) == (pytest.approx(0.06, abs=0.03), [0x6040000, 0x6040000, 7])


def test_px4_tells_which_mode_a_failsafe_left(bench):
    b = bench(PX4, airborne=True, start_position_ned_m=(0.0, 0.0, -30.0)).in_external()
    b.interval(CURRENT_MODE, 20.0)
    told = modes_told(b, 3.0)
    assert told[-1][1:] == (0x5040000, 0x60000, 5)


@pytest.mark.parametrize(
    ("firmware", "quirks", "result"), [(AP, {}, 2), (PX4, {"tells_current_mode": False}, 4)]
)
def test_current_mode_where_it_is_not_known(bench, firmware, quirks, result):
    b = bench(firmware, quirks=quirks)
    assert b.interval(CURRENT_MODE, 20.0) == [result]
    b.set_mode(VehicleMode.LAND)
    assert modes_told(b, 5.0) == []


def set_mode_bytes(mode):
    number = PX4_MANNERS.custom_modes[mode]
    params = (1.0, float(number >> 16 & 0xFF), float(number >> 24), 0, 0, 0, 0)
    return MavlinkWriter(1, 191).pack(mavlink.MAVLink_command_long_message(1, 1, 176, 0, *params))


def test_a_packed_message_is_that_of_pymavlink_and_may_lack_extensions():
    """Other versions of pymavlink may know more extensions of a message."""
    kind = mavlink.MAVLink_scaled_pressure_message
    mav = mavlink.MAVLink(None)
    sent = kind(7, 1013.25, -1.5, 1500).pack(mav)
    body = packed(kind, 7, 1013.25, -1.5, 1500).body
    assert sent[10 : 10 + sent[1]] == body.rstrip(b"\0")
