"""The mock's Remote ID as seen on the real firmwares, and our link beside a ground station on it."""

from __future__ import annotations

from collections import Counter

import numpy
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.link import AutopilotLink
from companion.autopilot.wire import FrameScanner, MavlinkReader, MavlinkWriter
from companion.config import Config, IdentityConfig, RemoteIdConfig, VehicleConfig
from companion.errors import ConfigError
from companion.events import ArmStatus, Firmware, OperatorData, RemoteIdHeard, RemoteIdModule
from companion.remote_id.mavlink import READABLE, decode_odid
from companion.remote_id.messages import Location, System
from companion.system import CompanionSystem
from sitl_mocks.vehicle.mock_vehicle import MockVehicle, VehicleOptions
from tests.support.place import HOME, LAT_E7, LON_E7

AP, PX4 = Firmware.ARDUPILOT, Firmware.PX4
EPOCH = 1546300800
UTC_S = 1_767_225_600.0
NO_ID = bytes(20)
ARM = 400


def odid(messages):
    return [m for m in messages if m.get_type().startswith("OPEN_DRONE_ID_")]


def count(messages):
    return Counter(m.get_type().removeprefix("OPEN_DRONE_ID_") for m in odid(messages))


def basic_id():
    return mavlink.MAVLink_open_drone_id_basic_id_message(0, 0, NO_ID, 1, 2, b"MOCK1".ljust(20, b"\0"))


def system(timestamp, kind=1, lat=473969000, lon=85449000):
    return mavlink.MAVLink_open_drone_id_system_message(
        0, 0, NO_ID, kind, 0, lat, lon, 1, 0, -1000.0, -1000.0, 0, 0, 390.0, timestamp
    )


def update(timestamp):
    return mavlink.MAVLink_open_drone_id_system_update_message(0, 0, LAT_E7, LON_E7, 391.0, timestamp)


def arm_status(status=0, text=b""):
    return mavlink.MAVLink_open_drone_id_arm_status_message(status, text)


def test_px4_streams_location_and_system_unasked_and_ardupilot_nothing(bench):
    assert count(bench(PX4).run(10.0)) == {"LOCATION": 11, "SYSTEM": 11}
    assert count(bench(AP).run(10.0)) == {}


@pytest.mark.parametrize(("utc_s", "time_s", "stamp"), [(None, 65535.0, 2748666496), (UTC_S, 2.0, 220924802)])
def test_px4s_clock_with_and_without_gnss_time(airborne, utc_s, time_s, stamp):
    messages = odid(airborne(PX4, utc_at_zero_s=utc_s, gnss_horizontal_sigma_m=2.0).run(2.01))
    place, home = messages[-2:]
    assert place.timestamp == pytest.approx(time_s)
    assert (place.status, place.height, place.horizontal_accuracy) == (2, pytest.approx(50.0), 11)
    assert home.timestamp == stamp
    assert (home.operator_location_type, home.operator_latitude) == (0, LAT_E7)


def test_an_enabled_ardupilot_sends_its_own_and_what_it_was_told_in_turn(bench):
    seen = count(bench(did_enable=True).run(32.0))
    assert seen["LOCATION"] == seen["SYSTEM_UPDATE"] == 33
    for name in ("BASIC_ID", "SYSTEM", "SELF_ID", "OPERATOR_ID"):
        assert seen[name] == pytest.approx(10, abs=1)


def test_what_it_is_told_is_relayed_as_received(bench):
    b = bench(did_enable=True)
    told = {
        12900: basic_id(),
        12903: mavlink.MAVLink_open_drone_id_self_id_message(0, 0, NO_ID, 1, b"survey"),
        12904: system(0),
        12905: mavlink.MAVLink_open_drone_id_operator_id_message(0, 0, NO_ID, 0, b"FIN87astrdge12k8"),
    }
    gcs = MavlinkWriter(255, 190)
    frames = b"".join(gcs.pack(m) for m in told.values())
    b.vehicle.receive(frames, 0.0)
    payloads = {f.message_id: f.payload for f in FrameScanner().frames(frames)}
    b.vehicle.advance(4.0)
    relayed = {f.message_id: f.payload for f in FrameScanner().frames(b.vehicle.drain())}
    assert {number: relayed[number] for number in told} == payloads
    # An update changes the position in the stored System and nothing else.
    b.now_s = 4.0
    b.send(update(77))
    moved = [m for m in b.run(4.0) if m.get_type() == "OPEN_DRONE_ID_SYSTEM"][-1]
    assert (moved.operator_latitude, moved.operator_altitude_geo, moved.timestamp) == (LAT_E7, 391.0, 77)
    assert (moved.area_ceiling, moved.area_count, moved.operator_location_type) == (-1000.0, 1, 1)


def test_what_a_receiver_heard_of_another_aircraft_is_taken_for_its_own(bench):
    """The firmware ignores addresses, so its SYSTEM_UPDATE then carries the other aircraft's operator."""
    b = bench(did_enable=True)
    other = mavlink.MAVLink_open_drone_id_system_message(
        0, 0, b"\x01" * 20, 1, 0, 475000000, 86000000, 1, 0, -1000.0, -1000.0, 0, 0, 390.0, 7
    )
    b.send(mavlink.MAVLink_open_drone_id_basic_id_message(0, 0, b"\x01" * 20, 1, 2, b"X" * 20))
    b.send(other)
    relayed = {m.get_type(): m for m in b.run(4.0)}
    assert bytes(relayed["OPEN_DRONE_ID_BASIC_ID"].id_or_mac) == b"\x01" * 20
    assert bytes(relayed["OPEN_DRONE_ID_SYSTEM"].id_or_mac) == b"\x01" * 20
    assert relayed["OPEN_DRONE_ID_SYSTEM_UPDATE"].operator_latitude == 475000000


def test_arming_waits_for_transmitter_identity_and_operator(bench):
    b = bench(did_enable=True, did_require=True)
    steps = [
        (basic_id(), "UA_TYPE required in BasicID"),
        (system(5), "operator location must be set"),
        (arm_status(1, b"missing location message"), "ARM_STATUS not available"),
        (arm_status(), "missing location message"),
    ]
    for message, reason in steps:
        assert b.command(ARM, 1.0) == [4]
        assert b.command(ARM, 1.0, 21196.0) == [4]  # not by force either
        assert b.texts()[-1] == f"Arm: OpenDroneID: {reason}"
        b.send(message)
    b.run(3.1)
    b.send(arm_status())
    assert b.command(ARM, 1.0) == [4]
    assert b.texts()[-1] == "Arm: OpenDroneID: SYSTEM not available"
    b.send(update(8))
    assert b.command(ARM, 1.0) == [0]
    assert b.vehicle.armed


def test_what_is_not_required_does_not_stop_it(bench):
    assert bench(did_enable=True).command(ARM, 1.0) == [0]


def test_options_that_do_not_go_together_are_refused():
    with pytest.raises(ConfigError, match="did_enable"):
        VehicleOptions(firmware=PX4, did_enable=True)
    with pytest.raises(ConfigError, match="did_require is allowed only"):
        VehicleOptions(did_require=True)


class Trio:
    """A vehicle with our link on its link 0 and a ground station, or another component, on link 1."""

    def __init__(self, firmware=AP, *, component=False, **options):
        self.vehicle = MockVehicle(
            VehicleOptions(firmware=firmware, utc_at_zero_s=UTC_S, **options), numpy.random.default_rng(1)
        )
        self.link = AutopilotLink(VehicleConfig(), remote_id_component=component)
        self.events = []
        self.ground = []
        self.now_s = 0.0
        self._reader = MavlinkReader()
        self.vehicle.open_link(1)

    def run(self, seconds, every_second=lambda second: b""):
        for tick in range(round(seconds / 0.05)):
            if tick % 20 == 0:
                self.vehicle.receive(every_second(tick // 20), self.now_s, 1)
            self.now_s = round(self.now_s + 0.05, 6)
            self.vehicle.advance(self.now_s)
            self.events += self.link.receive(self.vehicle.drain(0), self.now_s)
            self.events += self.link.advance(self.now_s)
            self.vehicle.receive(self.link.drain(), self.now_s, 0)
            self.ground += self._reader.feed(self.vehicle.drain(1))

    def of(self, kind):
        return [e for e in self.events if isinstance(e, kind)]


def now_2019(second):
    return int(UTC_S) - EPOCH + second


def test_a_module_and_a_receiver_behind_ardupilot_are_heard():
    trio = Trio()
    module, receiver = MavlinkWriter(1, 236), MavlinkWriter(1, 237)
    mac = bytes.fromhex("c0ffee123456").ljust(20, b"\0")
    beat = mavlink.MAVLink_heartbeat_message(34, 8, 0, 0, 4, 3)
    heard = mavlink.MAVLink_open_drone_id_operator_id_message(0, 0, mac, 0, b"X")
    messages = (beat, arm_status(1, b"no fix"))
    trio.run(5.0, lambda _: b"".join(map(module.pack, messages)) + receiver.pack(heard))
    assert set(trio.of(RemoteIdModule)) == {RemoteIdModule(component_id=236, ready=False, text="no fix")}
    assert {e.address for e in trio.of(RemoteIdHeard)} == {"c0:ff:ee:12:34:56"}
    assert len(trio.of(RemoteIdHeard)) >= 4


def test_a_companion_that_is_the_component_lets_ardupilot_arm_and_hears_the_operator():
    trio = Trio(component=True, did_enable=True, did_require=True)
    gcs = MavlinkWriter(255, 190)
    beat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    arm = mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0)
    trio.run(2.0)
    trio.link.send(ArmStatus(ready=True), trio.now_s)

    def speak(second):
        return b"".join(gcs.pack(m) for m in (beat, basic_id(), system(now_2019(second))))

    trio.run(6.0, speak)
    trio.vehicle.receive(gcs.pack(arm), trio.now_s, 1)
    assert trio.vehicle.armed
    stamps = [m.timestamp_utc_s for e in trio.of(OperatorData) for m in e.messages if isinstance(m, System)]
    assert len(stamps) == 6
    assert stamps == sorted(set(stamps))
    # The ground station sees the component, and it never takes itself for a module.
    beats = [m for m in trio.ground if m.get_type() == "HEARTBEAT" and m.get_srcComponent() == 236]
    statuses = [m for m in trio.ground if m.get_type() == "OPEN_DRONE_ID_ARM_STATUS"]
    assert {m.type for m in beats} == {34}
    assert len(beats) == pytest.approx(6, abs=1)
    assert len(statuses) == pytest.approx(6.0 / 0.7, abs=1)
    assert trio.of(RemoteIdModule) == []


def test_the_operator_told_to_the_autopilot_alone_is_relayed_until_the_station_falls_silent():
    trio = Trio(did_enable=True)
    gcs = MavlinkWriter(255, 190)

    def speak(second):
        message = system(now_2019(second))
        message.target_system, message.target_component = 1, 1  # not forwarded
        return gcs.pack(message)

    trio.run(12.0, speak)
    fresh = trio.of(OperatorData)
    located = [e for e in fresh if isinstance(e.messages[0], System)]
    assert len(located) == 3  # one SYSTEM every 3.2 s, and the first only sets the mark
    trio.events.clear()
    trio.run(60.0)
    late = [e for e in trio.of(OperatorData) if isinstance(e.messages[0], System)]
    assert len(late) <= 1


@pytest.mark.parametrize("firmware", [AP, PX4])
def test_what_the_autopilot_says_of_itself_is_no_operator(firmware):
    trio = Trio(firmware, **({"did_enable": True} if firmware is AP else {}))
    trio.run(10.0)
    assert [m for e in trio.of(OperatorData) for m in e.messages if isinstance(m, System)] == []
    assert trio.link.counts.bad_values == 0
    assert trio.link.counts.unneeded > 10


def test_the_mocks_own_location_is_what_it_flies():
    vehicle = MockVehicle(
        VehicleOptions(
            firmware=PX4,
            airborne=True,
            start_position_ned_m=(30.0, 40.0, -50.0),
            utc_at_zero_s=UTC_S,
        ),
        numpy.random.default_rng(1),
    )
    vehicle.advance(0.02)
    frames = [f for f in FrameScanner().frames(vehicle.drain()) if f.message_id in READABLE]
    (place,) = [
        m for f in frames for m in decode_odid(f.message_id, f.payload).messages if isinstance(m, Location)
    ]
    assert place.lat_deg == pytest.approx(HOME.lat_deg + 0.00027, abs=1e-5)
    assert place.lon_deg == pytest.approx(8.54553, abs=1e-5)
    assert place.alt_geodetic_m == pytest.approx(497.0, abs=0.01)
    assert place.height_m == pytest.approx(50.0, abs=0.01)


@pytest.mark.parametrize("commanding", [True, False])
def test_aboard_the_status_reaches_the_vehicle_unless_nothing_is_broadcast(commanding):
    vehicle = MockVehicle(VehicleOptions(utc_at_zero_s=UTC_S), numpy.random.default_rng(1))
    config = Config(identity=IdentityConfig(uas_id="ABOARD"), remote_id=RemoteIdConfig(component=True))
    onboard = CompanionSystem(config, commanding=commanding)
    reader = MavlinkReader()

    def said(now_s):
        data = onboard.drain(now_s)
        vehicle.receive(data, now_s)
        return [m for m in reader.feed(data) if m.get_srcComponent() == 236]

    messages = []
    for tick in range(1, 101):
        now_s = round(tick * 0.05, 6)
        vehicle.advance(now_s)
        onboard.receive(vehicle.drain(), now_s)
        onboard.tick(now_s)
        messages += said(now_s)
    statuses = [m for m in messages if m.get_type() == "OPEN_DRONE_ID_ARM_STATUS"]
    assert bool(statuses) is commanding
    assert bool(messages) is commanding
    if commanding:
        onboard.let_go(5.0)
        onboard.idle(5.05)
        status = next(m for m in said(5.05) if m.get_type() == "OPEN_DRONE_ID_ARM_STATUS")
        assert (status.status, status.error) == (1, "companion is stopping")
