"""What sensors of obstacles say on the link: every field is checked, and floods are bounded."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot import sensors
from companion.autopilot.link import AutopilotLink
from companion.autopilot.readers import unpack
from companion.autopilot.sensors import SENSOR_READERS, attitude
from companion.config import SensedConfig, VehicleConfig
from companion.errors import PeerDataError
from companion.events import Attitude, ObstaclePoint, ObstacleScan, SensedAircraft
from companion.events.sensed import NOTHING, UNKNOWN
from tests.companion.autopilot.conftest import PX4, Scripted
from tests.support.place import LAT_E7, LON_E7

SENSOR = 196
FRD = mavlink.MAV_FRAME_BODY_FRD
NAN, INF = math.nan, math.inf


def read(message):
    encoder = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    message.pack(encoder)
    fields = unpack(message.get_msgId(), bytes(message.get_payload()))
    return SENSOR_READERS[message.get_msgId()](SENSOR, fields)


def scan(distances, **over):
    values = {
        "increment": 5, "min_distance": 20, "max_distance": 4000, "increment_f": 0.0, "angle_offset": 0.0,
        "frame": FRD
    } | over  # fmt: skip
    filled = [*distances, *[0xFFFF] * (72 - len(distances))]
    return mavlink.MAVLink_obstacle_distance_message(
        0, 0, filled, values["increment"], values["min_distance"], values["max_distance"],
        increment_f=values["increment_f"], angle_offset=values["angle_offset"], frame=values["frame"],
    )  # fmt: skip


def point(x, y, z, **over):
    values = {"frame": FRD, "obstacle_id": 0xFFFF, "min_distance": 0.2, "max_distance": 60.0} | over
    return mavlink.MAVLink_obstacle_distance_3d_message(
        0, 0, values["frame"], values["obstacle_id"], x, y, z, values["min_distance"], values["max_distance"]
    )


def turned(roll=0.0, pitch=0.0, yaw=0.0):
    return mavlink.MAVLink_attitude_message(1000, roll, pitch, yaw, 0.0, 0.0, 0.0)


def aircraft(**over):
    values = {"flags": 0x3F, "altitude_type": 0, "tslc": 0} | over
    return mavlink.MAVLink_adsb_vehicle_message(
        77, LAT_E7, LON_E7, values["altitude_type"], 450000, 9000, 1000, 0, b"", 14, values["tslc"],
        values["flags"], 0,
    )  # fmt: skip


@pytest.mark.parametrize(
    "message_id", [mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE, mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE_3D,
    mavlink.MAVLINK_MSG_ID_ATTITUDE],
)  # fmt: skip
def test_fields_are_in_the_order_that_is_read(message_id):
    order = {
        mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE: "time_usec distances min_distance max_distance sensor_type "
        "increment increment_f angle_offset frame",
        mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE_3D: "time_boot_ms x y z min_distance max_distance "
        "obstacle_id sensor_type frame",
        mavlink.MAVLINK_MSG_ID_ATTITUDE: "time_boot_ms roll pitch yaw rollspeed pitchspeed yawspeed",
    }
    assert mavlink.mavlink_map[message_id].ordered_fieldnames == order[message_id].split()


def test_distances_of_a_scan():
    # Beyond the range and at its end nothing is there; below the least distance and UINT16_MAX are unknown.
    event = read(scan([500, 4000, 4001, 0xFFFF, 19, 0, 3999]))
    assert event == ObstacleScan(
        component=SENSOR, axes="body", first_deg=0.0, step_deg=5.0, max_cm=4000,
        distances_cm=(500, NOTHING, NOTHING, UNKNOWN, UNKNOWN, UNKNOWN, 3999),
    )  # fmt: skip


def test_a_scan_of_nothing_known_is_none():
    assert read(scan([])) is None


def test_the_finer_increment_counts_and_sectors_beyond_a_circle_do_not():
    event = read(scan([700] * 72, increment=0, increment_f=7.5))
    assert event.step_deg == 7.5
    assert len(event.distances_cm) == 48
    assert read(scan([700] * 72, increment=0, increment_f=-10.0)).step_deg == -10.0


@pytest.mark.parametrize(
    ("frame", "axes"), [(0, "north"), (1, "north"), (7, "north"), (8, "body"), (12, "body"), (20, "nose")]
)
def test_frames_of_a_scan(frame, axes):
    assert read(scan([500], frame=frame)).axes == axes


@pytest.mark.parametrize(
    "over",
    [
        {"increment": 0},
        {"increment": 0, "increment_f": NAN},
        {"increment": 0, "increment_f": INF},
        {"increment": 0, "increment_f": 0.01},
        {"increment": 0, "increment_f": 400.0},
        {"angle_offset": NAN},
        {"angle_offset": -INF},
        {"angle_offset": 1e9},
        {"frame": 2},
        {"frame": 255},
        {"min_distance": 4000},
        {"max_distance": 0, "min_distance": 0},
    ],
)
def test_impossible_scans_are_refused(over):
    with pytest.raises(PeerDataError, match="OBSTACLE_DISTANCE"):
        read(scan([500], **over))


def test_a_point():
    assert read(point(3.0, -4.0, 1.0, obstacle_id=9)) == ObstaclePoint(
        component=SENSOR, axes="body", position_m=(3.0, -4.0, 1.0), number=9
    )
    assert read(point(3.0, -4.0, 1.0)).number is None
    assert read(point(3.0, -4.0, 1.0, frame=7)).axes == "offset"
    assert read(point(300.0, -4.0, 1.0, frame=1)).axes == "local", "it may be far from the origin"


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (60.0, 0.0, 0.0), (100.0, 0.0, 0.0)])
def test_points_out_of_the_sensors_range_are_none(place):
    assert read(point(*place)) is None


@pytest.mark.parametrize(
    "message",
    [point(NAN, 0.0, 1.0), point(INF, 0.0, 1.0), point(1e9, 0.0, 0.0), point(1.0, 1.0, 1.0, frame=0),
     point(1.0, 1.0, 1.0, frame=20), point(1e9, 0.0, 0.0, frame=1), point(NAN, 0.0, 0.0, frame=1)],
)  # fmt: skip
def test_impossible_points_are_refused(message):
    with pytest.raises(PeerDataError, match="OBSTACLE_DISTANCE_3D"):
        read(message)


@pytest.mark.parametrize("angles", [{"roll": NAN}, {"pitch": 2.0}, {"yaw": INF}, {"roll": 4.0}, {"yaw": 7.0}])
def test_impossible_attitudes_are_refused(angles):
    message = turned(**angles)
    message.pack(mavlink.MAVLink(None))
    with pytest.raises(PeerDataError, match="attitude"):
        attitude(unpack(message.get_msgId(), bytes(message.get_payload())))


# ------------------------------------------------------------ on the link


def scripted(*, use=True, autopilot=3, components=(SENSOR,)):
    found = Scripted(autopilot=autopilot)
    found.link = AutopilotLink(VehicleConfig(), sensed=SensedConfig(use=use, components=components))
    found.heartbeat()
    found.after(0.0)
    return found


def test_sensors_of_our_system_are_read():
    link = scripted()
    assert isinstance(link.says(scan([500]), component=SENSOR)[0], ObstacleScan)
    assert isinstance(link.says(point(5.0, 0.0, 0.0), component=SENSOR)[0], ObstaclePoint)
    assert isinstance(link.says(aircraft(), component=SENSOR)[0], SensedAircraft)
    assert isinstance(link.says(turned())[0], Attitude)
    assert isinstance(link.says(scan([500]))[0], ObstacleScan), "PX4 sends on what it fuses"


def test_nobody_else_is_a_sensor():
    link = scripted()
    assert link.says(scan([500]), system=2, component=SENSOR) == []
    assert link.says(scan([500]), component=197) == []
    assert link.says(turned(), component=SENSOR) == [], "the attitude is the autopilot's"
    assert not isinstance(link.says(aircraft())[0], SensedAircraft), "from the autopilot it is ADS-B"


def test_without_the_section_nothing_is_read_or_asked_for():
    link = scripted(use=False)
    for component in (1, SENSOR):
        assert link.says(scan([500]), point(5.0, 0.0, 0.0), turned(), component=component) == []
    assert link.says(aircraft(), component=SENSOR) == []
    asked = {int(m.param1) for m in link.told("COMMAND_LONG")}
    assert mavlink.MAVLINK_MSG_ID_ATTITUDE not in asked


@pytest.mark.parametrize(("autopilot", "fused"), [(3, False), (PX4, True)])
def test_the_attitude_is_asked_for_and_px4s_fused_distances(autopilot, fused):
    link = scripted(autopilot=autopilot)
    asked = {int(m.param1) for m in link.told("COMMAND_LONG")}
    assert mavlink.MAVLINK_MSG_ID_ATTITUDE in asked
    assert (mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE in asked) == fused


def test_a_flood_is_bounded():
    link = scripted()
    read_in_all = 0
    for _ in range(1000):  # a thousand a second
        link.now_s += 0.001
        read_in_all += len(link.says(scan([500]), component=SENSOR))
    rate, burst = sensors.RATES[mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE]
    assert rate * 0.9 <= read_in_all <= rate + burst
    assert link.link.counts.sensed_dropped == 1000 - read_in_all
    assert len(link.says(turned())) == 1, "a flood of one message leaves the others"


def test_a_clock_that_jumps_back_admits_no_more():
    link = scripted()
    for _ in range(50):
        link.says(scan([500]), component=SENSOR)
    link.now_s -= 1000.0
    assert link.says(scan([500]), component=SENSOR) == []
    link.now_s += 1001.0
    assert len(link.says(scan([500]), component=SENSOR)) == 1


def test_bad_values_are_counted_and_named():
    link = scripted()
    assert link.says(scan([500], increment=0), component=SENSOR) == []
    assert link.link.counts.bad_values == 1
    assert "increment" in link.link.last_bad
