"""A third party without the key that has recorded a signed link cannot influence the flight."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.signing import Signing, timestamp_at
from companion.autopilot.wire import FrameScanner, MavlinkReader, MavlinkWriter, is_signed
from companion.config import (
    AvoidanceConfig,
    Config,
    FlightConfig,
    IdentityConfig,
    TrajectoryFile,
    VehicleConfig,
    Waypoint,
)
from companion.events import Firmware
from companion.system import CompanionSystem
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from sitl_mocks.vehicle.mock_vehicle import MockVehicle
from sitl_mocks.vehicle.options import VehicleOptions
from tests.support.place import HOME

KEY, OTHER_KEY = b"\x01" * 32, b"\x02" * 32
UTC_S = 1_767_225_600.0
TICK_S = 0.05
LAND = {Firmware.ARDUPILOT: 9, Firmware.PX4: 0x06040000}
SPEED_LIMIT = {Firmware.ARDUPILOT: b"WPNAV_SPEED", Firmware.PX4: b"MPC_XY_VEL_MAX"}


class Signed:
    """Vehicle and companion on a link on which a third party receives and sends."""

    def __init__(
        self,
        firmware: Firmware,
        key: bytes | None = KEY,
        vehicle_key: bytes | None = KEY,
        *,
        airborne: bool = True,
    ) -> None:
        self.vehicle = MockVehicle(
            VehicleOptions(
                firmware=firmware,
                airborne=airborne,
                start_position_ned_m=(0.0, 0.0, -50.0 if airborne else 0.0),
                start_mode=VehicleMode.EXTERNAL if airborne and firmware is Firmware.ARDUPILOT else None,
                utc_at_zero_s=UTC_S,
                signing_key=vehicle_key,
            ),
            np.random.default_rng(1),
        )
        corners = ((0.0, HOME.lat_deg), (200.0, HOME.lat_deg + 0.003))
        config = Config(
            identity=IdentityConfig(uas_id="SIGNED"),
            vehicle=VehicleConfig(system_id=1),
            flight=FlightConfig(use="fly", take_in_flight=True),
            avoidance=AvoidanceConfig(law="none"),
            path=TrajectoryFile(
                altitude="home",
                waypoint=tuple(
                    Waypoint(t_s=t, lat_deg=lat, lon_deg=HOME.lon_deg, alt_m=50.0) for t, lat in corners
                ),
            ),
        )
        signing = None if key is None else Signing(key, timestamp_at(UTC_S), 0.0)
        self.onboard = CompanionSystem(config, signing=signing)
        self.down = self.up = b""
        """All that has passed in either direction."""
        self.inject_down: Callable[[], bytes] = bytes
        self.inject_up: Callable[[], bytes] = bytes
        self.tick = 0

    @property
    def now_s(self) -> float:
        return self.tick * TICK_S

    def run(self, seconds: float) -> list[tuple[float, float, float]]:
        """Let time pass; the true positions."""
        track = []
        for _ in range(round(seconds / TICK_S)):
            self.vehicle.advance(self.now_s)
            down = self.vehicle.drain()
            self.down += down
            self.onboard.receive(self.inject_down() + down, self.now_s)
            self.onboard.tick(self.now_s)
            up = self.onboard.drain(self.now_s)
            self.up += up
            self.vehicle.receive(up + self.inject_up(), self.now_s)
            track.append(self.vehicle.position_ned_m)
            self.tick += 1
        return track


def set_mode(firmware: Firmware) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_set_mode_message(1, 1, LAND[firmware])


def do_set_mode(firmware: Firmware) -> mavlink.MAVLink_message:
    number = LAND[firmware]
    params = (1, number) if firmware is Firmware.ARDUPILOT else (1, number >> 16 & 0xFF, number >> 24)
    return mavlink.MAVLink_command_long_message(1, 1, 176, 0, *params, *([0] * (7 - len(params))))


def param_set(firmware: Firmware) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_param_set_message(1, 1, SPEED_LIMIT[firmware], 100.0, 9)


def setpoint(_firmware: Firmware) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 0xDC7, 0, 0, 0, 0.0, -8.0, 3.0, 0, 0, 0, 0, 0
    )


MESSAGES = (set_mode, do_set_mode, param_set, setpoint)


def read_limit(vehicle: MockVehicle) -> object:
    return vehicle._params.get(SPEED_LIMIT[vehicle.options.firmware].decode())


class ThirdParty:
    """Sends one message repeatedly, as the companion or as a ground station."""

    def __init__(self, way: str, message: mavlink.MAVLink_message, firmware: Firmware) -> None:
        self._writers = [MavlinkWriter(1, 191), MavlinkWriter(255, 190)]
        self._message = message
        # The forger knows the time and gives its frames the latest timestamps.
        self._signing = Signing(OTHER_KEY, timestamp_at(UTC_S + 30.0), 0.0)
        self._way = way

    def __call__(self) -> bytes:
        frames = [writer.pack(self._message) for writer in self._writers]
        if self._way == "wrong key":
            frames = [self._signing.sign(frame) for frame in frames]
        return b"".join(frames)


@pytest.mark.parametrize("way", ["unsigned", "wrong key"])
@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: m.__name__)
@pytest.mark.parametrize("firmware", Firmware)
def test_a_third_party_changes_nothing_on_the_vehicle(firmware, message, way):
    alone, attacked = Signed(firmware), Signed(firmware)
    limit = read_limit(attacked.vehicle)
    alone.run(4.0)
    attacked.run(4.0)
    assert attacked.vehicle.mode is VehicleMode.EXTERNAL
    attacked.inject_up = ThirdParty(way, message(firmware), firmware)
    assert attacked.run(2.0) == alone.run(2.0)
    assert attacked.vehicle.mode is VehicleMode.EXTERNAL
    assert read_limit(attacked.vehicle) == limit
    counts = attacked.vehicle.signing.counts
    assert (counts.unsigned if way == "unsigned" else counts.wrong) == 2 * 40


@pytest.mark.parametrize("message", MESSAGES, ids=lambda m: m.__name__)
@pytest.mark.parametrize("firmware", Firmware)
def test_the_attack_works_where_nothing_is_signed(firmware, message):
    """Without this, the test above could not fail."""
    alone, attacked = Signed(firmware, None, None), Signed(firmware, None, None)
    limit = read_limit(attacked.vehicle)
    alone.run(4.0)
    attacked.run(4.0)
    attacked.inject_up = ThirdParty("unsigned", message(firmware), firmware)
    flown = attacked.run(2.0)
    assert flown != alone.run(2.0) or read_limit(attacked.vehicle) != limit


@pytest.mark.parametrize("firmware", Firmware)
def test_what_the_companion_said_once_is_not_obeyed_again(firmware):
    """All recorded bytes, with SET_MODE and setpoints, are replayed on the same link and on another one."""
    pair = Signed(firmware)
    pair.run(4.0)
    recorded = pair.up
    assert {"COMMAND_LONG", "SET_POSITION_TARGET_LOCAL_NED"} <= {
        m.get_type() for m in MavlinkReader().feed(recorded)
    }
    pair.vehicle.pilot_selects(VehicleMode.HOLD)
    pair.run(3.0)
    assert pair.vehicle.mode is VehicleMode.HOLD
    replayed, setpoints = pair.vehicle.signing.counts.replayed, pair.vehicle.setpoints_received
    pair.inject_up = lambda: recorded
    pair.vehicle.receive(recorded, pair.now_s, link=1)
    pair.run(1.0)
    assert pair.vehicle.mode is VehicleMode.HOLD
    assert pair.vehicle.setpoints_received == setpoints
    frames = len(FrameScanner().frames(recorded))
    assert pair.vehicle.signing.counts.replayed - replayed == 21 * frames


def forged(way: str, signed: Signed) -> Callable[[], bytes]:
    """Forged telemetry from the third party: a vehicle elsewhere, disarmed and in another mode."""
    writer, signing = MavlinkWriter(1, 1), Signing(OTHER_KEY, timestamp_at(UTC_S + 30.0), 0.0)

    def frames() -> bytes:
        boot_ms = round((signed.now_s + 120.0) * 1e3)
        told = [
            mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 4, 3),
            mavlink.MAVLink_global_position_int_message(boot_ms, 100, 100, 0, 0, 500, 500, 500, 0),
            mavlink.MAVLink_local_position_ned_message(boot_ms, 0, 0, 0, 9, 9, 9),
            mavlink.MAVLink_system_time_message(1, boot_ms - 100_000),
            mavlink.MAVLink_extended_sys_state_message(0, 1),
            mavlink.MAVLink_gps_raw_int_message(0, 1, 100, 100, 0, 0, 0, 0, 0, 0),
        ]
        packed = [writer.pack(message) for message in told]
        return b"".join(packed if way == "unsigned" else [signing.sign(frame) for frame in packed])

    return frames


@pytest.mark.parametrize("way", ["unsigned", "wrong key", "replayed"])
@pytest.mark.parametrize("firmware", Firmware)
def test_a_third_party_changes_nothing_aboard(firmware, way):
    alone, attacked = Signed(firmware), Signed(firmware)
    alone.run(4.0)
    attacked.run(4.0)
    recorded = attacked.down
    attacked.inject_down = forged(way, attacked) if way != "replayed" else lambda: recorded
    assert attacked.run(3.0) == alone.run(3.0)
    assert attacked.onboard.core.state is alone.onboard.core.state
    assert attacked.onboard.core.in_control
    assert attacked.onboard.core.own == alone.onboard.core.own
    cause = {"unsigned": "unsigned", "wrong key": "wrongly signed", "replayed": "replayed"}[way]
    assert cause in attacked.onboard.link.disbelief(attacked.now_s)


def test_a_vehicle_without_the_key_is_told_and_not_flown():
    pair = Signed(Firmware.ARDUPILOT, KEY, None)
    pair.run(3.0)
    assert pair.onboard.link.vehicle is None
    assert "signing is not set up on the autopilot" in pair.onboard.link.disbelief(pair.now_s)


@pytest.mark.parametrize("firmware", Firmware)
def test_a_vehicle_that_restarts_is_believed_again(firmware):
    pair = Signed(firmware, airborne=False)
    pair.run(4.0)
    reboot = MavlinkWriter(255, 190).pack(
        mavlink.MAVLink_command_long_message(1, 1, 246, 0, 1, 0, 0, 0, 0, 0, 0)
    )
    pair.vehicle.receive(Signing(KEY, timestamp_at(UTC_S), 0.0).sign(reboot), pair.now_s)
    pair.run(6.0)
    assert pair.vehicle.reboots == 1
    assert pair.onboard.link.counts.reboots == 1
    assert pair.onboard.core.own.age_s(pair.now_s) < 0.2


def test_everything_on_a_signed_link_is_signed():
    pair = Signed(Firmware.PX4)
    pair.run(2.0)
    assert all(is_signed(f.raw) for data in (pair.up, pair.down) for f in FrameScanner().frames(data))
    assert math.isfinite(pair.onboard.core.own.age_s(pair.now_s))
