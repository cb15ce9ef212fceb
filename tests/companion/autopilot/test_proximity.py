"""DISTANCE_SENSOR of ArduPilot's proximity sensors: eight messages of one burst become one scan."""

from __future__ import annotations

import random

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.link import AutopilotLink
from companion.autopilot.readers import unpack
from companion.autopilot.sensors import FINER_S, RATES, SETTLED_S, Sector, proximity_sector
from companion.config import SensedConfig, VehicleConfig
from companion.errors import PeerDataError
from companion.events import ObstacleScan
from companion.events.sensed import NOTHING, UNKNOWN
from tests.companion.autopilot.conftest import ARDUPILOT, PX4, Scripted
from tests.companion.autopilot.test_sensors import SENSOR, scan, turned

DISTANCE = mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR
ALL_GOOD = 0xFFFF_FFFF


def sector(number, cm=1500, **over):
    values = {"min_distance": 20, "max_distance": 4000, "id": 10 + number, "orientation": number} | over
    return mavlink.MAVLink_distance_sensor_message(
        1000, values["min_distance"], values["max_distance"], cm, 0, values["id"], values["orientation"], 0
    )


def fields(message):
    message.pack(mavlink.MAVLink(None))
    return unpack(DISTANCE, bytes(message.get_payload()))


def status(present=ALL_GOOD, enabled=ALL_GOOD, health=ALL_GOOD):
    return mavlink.MAVLink_sys_status_message(present, enabled, health, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)


def scripted(*, use=True, autopilot=ARDUPILOT):
    found = Scripted(autopilot=autopilot)
    found.link = AutopilotLink(VehicleConfig(), sensed=SensedConfig(use=use))
    found.heartbeat()
    found.after(0.0)
    return found


def test_fields_are_in_the_order_that_is_read():
    names = "time_boot_ms min_distance max_distance current_distance type id orientation"
    assert mavlink.mavlink_map[DISTANCE].ordered_fieldnames[:7] == names.split()
    bits = "onboard_control_sensors_present onboard_control_sensors_enabled onboard_control_sensors_health"
    found = mavlink.mavlink_map[mavlink.MAVLINK_MSG_ID_SYS_STATUS].ordered_fieldnames[:3]
    assert found == bits.split()


@pytest.mark.parametrize(
    ("cm", "read"),
    [(1500, 1500), (3999, 3999), (4000, NOTHING), (0xFFFF, NOTHING), (19, UNKNOWN), (0, UNKNOWN)],
)
def test_a_sector(cm, read):
    """ArduPilot writes the greatest distance where it measures nothing."""
    assert proximity_sector(fields(sector(3, cm))) == Sector(3, read, 4000)


def test_a_sensor_without_a_least_distance_never_measures_zero():
    """The simulator's has none."""
    assert proximity_sector(fields(sector(0, 0, min_distance=0))).cm == UNKNOWN


@pytest.mark.parametrize(
    ("id_", "orientation"),
    [(0, 25), (0, 0), (9, 0), (18, 0), (19, mavlink.MAV_SENSOR_ROTATION_PITCH_90), (255, 3)],
)
def test_other_sensors_are_no_sectors(id_, orientation):
    """Single rangefinders, whichever way they look, and the distance upwards."""
    assert proximity_sector(fields(sector(0, id=id_, orientation=orientation))) is None


@pytest.mark.parametrize(
    ("over", "named"),
    [
        ({"orientation": 3}, "orientation 3 with id 12; allowed: 2"),
        ({"orientation": mavlink.MAV_SENSOR_ROTATION_PITCH_270}, "orientation 25"),
        ({"min_distance": 4000}, "min_distance 4000 cm is not below max_distance 4000 cm"),
        ({"min_distance": 5000}, "min_distance 5000 cm"),
        ({"min_distance": 0, "max_distance": 0}, "max_distance 0 cm"),
    ],
)
def test_impossible_sectors_are_refused(over, named):
    with pytest.raises(PeerDataError, match=named):
        proximity_sector(fields(sector(2, **over)))


def test_any_payload_is_a_sector_or_refused():
    rng = random.Random(1)
    kept = 0
    for _ in range(3000):
        data = bytearray(rng.randbytes(rng.randint(0, 40)))
        if len(data) > 12:
            data[11] = rng.choice((10, 13, 17, data[11]))
            data[12] = rng.choice((0, 3, 7, data[12]))
        try:
            found = proximity_sector(unpack(DISTANCE, bytes(data)))
        except PeerDataError:
            continue
        if found is not None:
            kept += 1
            assert 0 <= found.number < 8
            assert UNKNOWN <= found.cm < found.max_cm
    assert kept > 50


# ------------------------------------------------------------ on the link


def test_a_burst_is_one_scan():
    link = scripted()
    assert link.says(*(sector(i, 1000 + i) for i in range(7))) == []
    (event,) = link.says(sector(7, 4000))
    assert event == ObstacleScan(
        component=1, axes="body", first_deg=0.0, step_deg=45.0, max_cm=4000,
        distances_cm=(1000, 1001, 1002, 1003, 1004, 1005, 1006, NOTHING),
    )  # fmt: skip


def test_what_was_never_measured_is_not_sent_and_unknown():
    """The burst ends when nothing more of it comes."""
    link = scripted()
    assert link.says(sector(0, 900), sector(2, 800)) == []
    assert link.after(0.5 * SETTLED_S) == [], "more may come"
    (event,) = link.after(SETTLED_S)
    assert event.distances_cm == (900, UNKNOWN, 800, *(UNKNOWN,) * 5)
    assert link.after(1.0) == [], "it is told once"


def test_a_burst_that_was_cut_ends_with_the_next_one():
    link = scripted()
    assert link.says(sector(0, 900), sector(1, 800)) == []
    (event,) = link.says(sector(0, 700))
    assert event.distances_cm[:2] == (900, 800)
    (event,) = link.says(*(sector(i, 600) for i in range(1, 8)))
    assert event.distances_cm == (700, *(600,) * 7)


def test_sectors_that_come_in_another_order_are_one_scan():
    link = scripted()
    (event,) = link.says(*(sector(i, 500 + i) for i in (3, 1, 0, 2, 6, 5, 4, 7)))
    assert event.distances_cm == tuple(range(500, 508))


def test_the_range_is_that_of_the_sector_that_sees_least_far():
    link = scripted()
    (event,) = link.says(sector(0, 3000, max_distance=2000), sector(7, 3000))
    assert (event.max_cm, event.distances_cm[0], event.distances_cm[7]) == (2000, NOTHING, 3000)


def test_a_burst_in_which_nothing_is_known_is_no_scan():
    link = scripted()
    assert link.says(*(sector(i, 5) for i in range(8))) == []


def test_rangefinders_do_not_disturb():
    link = scripted()
    down = sector(0, 300, id=0, orientation=25)
    (event,) = link.says(down, *(sector(i) for i in range(8)), sector(0, id=19, orientation=24))
    assert event.distances_cm == (1500,) * 8
    assert link.link.counts.bad_values == 0
    assert link.link.counts.sensed == 8


def test_a_bad_sector_is_named_and_the_others_count():
    link = scripted()
    (event,) = link.says(sector(0), sector(1, orientation=9), *(sector(i) for i in range(2, 8)))
    assert event.distances_cm == (1500, UNKNOWN, *(1500,) * 6)
    assert link.link.counts.bad_values == 1
    assert "orientation 9" in link.link.last_bad


def test_only_an_ardupilots_own_are_read():
    burst = [sector(i) for i in range(8)]
    assert scripted(autopilot=PX4).says(*burst) == [], "PX4 sends OBSTACLE_DISTANCE"
    link = scripted()
    assert link.says(*burst, component=SENSOR) == []
    assert link.says(*burst, system=2) == []
    assert link.after(1.0) == []


@pytest.mark.parametrize(
    ("autopilot", "use", "asked"), [(ARDUPILOT, True, True), (PX4, True, False), (ARDUPILOT, False, False)]
)
def test_they_are_asked_for_ten_times_a_second(autopilot, use, asked):
    link = scripted(autopilot=autopilot, use=use)
    wanted = {int(m.param1): m.param2 for m in link.told("COMMAND_LONG")}
    assert wanted.get(DISTANCE) == (1e5 if asked else None)
    assert (mavlink.MAVLINK_MSG_ID_SYS_STATUS in wanted) == asked
    if not use:
        assert link.says(*(sector(i) for i in range(8)), status()) == []


def test_requests_end_when_they_come():
    link = scripted()
    link.told()
    for _ in range(40):
        link.says(sector(0), turned())
        link.after(1.0)
    asked = [int(m.param1) for m in link.told("COMMAND_LONG")]
    assert DISTANCE not in asked


def test_a_finer_sensor_of_which_they_are_a_copy_replaces_them():
    link = scripted()
    assert len(link.says(scan([500]), component=SENSOR)) == 1
    burst = [sector(i) for i in range(8)]
    assert link.says(*burst) == []
    link.now_s += FINER_S - 0.1
    assert link.says(*burst) == []
    link.now_s += 0.2
    assert len(link.says(*burst)) == 1


def test_a_flood_is_bounded():
    link = scripted()
    found = 0
    for _ in range(1000):
        link.now_s += 0.001
        found += len(link.says(sector(7)))
    rate, burst = RATES[DISTANCE]
    assert rate * 0.9 <= found <= rate + burst
    assert link.link.counts.sensed_dropped == 1000 - found


# ------------------------------------------------------------ silence


def test_a_healthy_sensor_that_sees_nothing_is_an_empty_scan():
    """ArduPilot sends nothing then, which is what it sends of a sensor that failed, too."""
    (event,) = scripted().says(status())
    assert event.distances_cm == (UNKNOWN,) * 8


@pytest.mark.parametrize("bits", ["present", "enabled", "health"])
def test_one_that_is_not_there_or_has_failed_is_silent(bits):
    lost = ALL_GOOD & ~mavlink.MAV_SYS_STATUS_SENSOR_PROXIMITY
    assert scripted().says(status(**{bits: lost})) == []


def test_while_it_sees_something_its_health_is_no_news():
    link = scripted()
    assert len(link.says(*(sector(i) for i in range(8)))) == 1
    assert link.says(status()) == []
    link.now_s += 0.6
    assert len(link.says(status())) == 1
