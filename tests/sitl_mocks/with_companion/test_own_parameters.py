"""A ground station behind the autopilot reads and sets the companion's parameters by pymavlink's client."""

from __future__ import annotations

import msgspec
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.mavparm import MAVParmDict

from companion.adjustable_parameters import NAMES
from companion.authority.table import State
from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from companion.events import Firmware, Settings, VelocitySetpoint
from companion.radio.ether.section import EtherRadio
from companion.system import CompanionSystem
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from tests.sitl_mocks.with_companion.pair import TICK_S
from tests.sitl_mocks.with_companion.test_with_vehicle import MissionPair


class Station:
    """What `MAVParmDict` needs of a connection, on a link of its own to the autopilot."""

    def __init__(self, settings=None, firmware=Firmware.ARDUPILOT):
        self.pair = MissionPair(firmware)
        radio = (EtherRadio(address="127.0.0.1:1"),)
        config = msgspec.structs.replace(self.pair.onboard.core.config, radio=radio)
        self.pair.onboard = CompanionSystem(config, self.pair.steps.append, settings=settings)
        self._writer, self._reader = MavlinkWriter(255, 190), MavlinkReader()
        self._heard = []
        # The autopilot learns from received frames which system is on which link.
        self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))

    def send(self, message):
        self.pair.vehicle.receive(self._writer.pack(message), self.pair.tick * TICK_S, 1)

    def run(self, seconds):
        """Let time pass; returns the received messages about the companion's parameters."""
        self.pair.run(seconds)
        messages = self._reader.feed(self.pair.vehicle.drain(1))
        ours = [m for m in messages if m.get_type() == "PARAM_VALUE" and m.get_srcComponent() == 191]
        self._heard += ours
        return {m.param_id: m.param_value for m in ours}

    def param_set_send(self, name, value, parm_type=None):
        kind = mavlink.MAV_PARAM_TYPE_REAL32 if parm_type is None else parm_type
        self.send(mavlink.MAVLink_param_set_message(1, 191, name.encode(), value, kind))

    def recv_match(self, type, blocking):
        self.run(0.1)
        return self._heard.pop(0) if self._heard else None


def test_a_list_asked_of_everybody_brings_ours_as_well():
    station = Station()
    station.run(12.0)
    station.send(mavlink.MAVLink_param_request_list_message(1, 0))
    assert station.run(3.0) == dict(zip(NAMES, (1.0, 5.0, 20.0, 5.0), strict=True))


def test_a_station_switches_off_and_on_and_sets_a_speed_for_the_next_path():
    station, client = Station(), MAVParmDict()
    pair = station.pair
    station.run(12.0)
    assert pair.vehicle.mode is VehicleMode.EXTERNAL
    assert client.mavset(station, "DMUCA_ENABLE", 0)
    station.run(3.0)
    assert pair.state is State.FAULT
    assert pair.vehicle.mode is VehicleMode.BRAKE
    assert client.mavset(station, "DMUCA_SPD_MAX", 4)
    assert pair.onboard.settings == Settings(enable=False, max_speed_mps=4.0)
    assert client.mavset(station, "DMUCA_ENABLE", 1)
    station.run(8.0)
    assert pair.vehicle.mode is VehicleMode.EXTERNAL
    assert pair.onboard.core.in_control
    assert [e for s in pair.steps for e in s.events if isinstance(e, Settings)] == [
        Settings(enable=False),
        Settings(enable=False, max_speed_mps=4.0),
        Settings(max_speed_mps=4.0),
    ]


@pytest.mark.parametrize("firmware", Firmware)
def test_a_station_beside_the_companion_does_the_same_on_both_firmwares(firmware):
    """PX4 does not forward here; a router or the companion's own link does."""
    station = Station(firmware=firmware)
    pair = station.pair
    station.run(12.0)
    stopped = VehicleMode.BRAKE if firmware is Firmware.ARDUPILOT else VehicleMode.HOLD
    for value, mode in ((0.0, stopped), (1.0, VehicleMode.EXTERNAL)):
        assert pair.vehicle.mode is not mode
        message = mavlink.MAVLink_param_set_message(1, 191, b"DMUCA_ENABLE", value, 9)
        pair.onboard.receive(MavlinkWriter(255, 190).pack(message), pair.tick * TICK_S)
        station.run(10.0)
        assert pair.vehicle.mode is mode
        since = len(pair.steps)
        station.run(1.0)
        assert bool(pair.commands(VelocitySetpoint, since)) is (value == 1.0)


def test_stored_settings_are_the_first_event_and_are_told():
    station = Station(Settings(enable=False, horizon_s=30.0))
    station.run(12.0)
    assert station.pair.state is State.STANDBY
    assert station.pair.steps[0].events[0] == Settings(enable=False, horizon_s=30.0)
    assert station.pair.onboard.core.config.avoidance.horizon_s == 30.0
    station.send(mavlink.MAVLink_param_request_list_message(1, 191))
    assert station.run(3.0)["DMUCA_HORIZON"] == 30.0
