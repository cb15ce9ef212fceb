"""Wrong answers of the mock vehicle to a companion's mode requests, and several modes within one step."""

from __future__ import annotations

import os

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.readers import unpack
from companion.autopilot.wire import FrameScanner, MavlinkWriter
from companion.errors import ConfigError
from companion.events import Firmware
from sitl_mocks.vehicle.firmware.behaviour import MANNERS, VehicleMode
from sitl_mocks.vehicle.mock_vehicle import MockVehicle, VehicleOptions
from sitl_mocks.vehicle.real_time.trouble_input import TroubleInput

COMPANION, STATION = MavlinkWriter(1, 191), MavlinkWriter(255, 190)
RIGHT = {Firmware.ARDUPILOT: [0], Firmware.PX4: [0, 0]}


@pytest.fixture(params=list(Firmware))
def vehicle(request):
    options = VehicleOptions(firmware=request.param, airborne=True, start_position_ned_m=(0.0, 0.0, -50.0))
    found = MockVehicle(options, np.random.default_rng(1))
    found.advance(1.0)
    found.drain()
    return found


def requests(vehicle, *modes):
    numbers = [MANNERS[vehicle.options.firmware].custom_modes[mode] for mode in modes]
    px4 = vehicle.options.firmware is Firmware.PX4
    params = [(n >> 16 & 0xFF, n >> 24) if px4 else (n, 0) for n in numbers]
    return [
        mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1.0, float(a), float(b), 0, 0, 0, 0)
        for a, b in params
    ]


def answers(vehicle, writer, *modes):
    """Results of mode requests that arrive at once, and the modes that heartbeats then show."""
    vehicle.receive(b"".join(map(writer.pack, requests(vehicle, *modes))), vehicle.now_s)
    frames = FrameScanner().frames(vehicle.drain())
    acks = [unpack(f.message_id, f.payload) for f in frames if f.message_id == 77]
    shown = [int.from_bytes(f.payload[:4], "little") for f in frames if f.message_id == 0]
    return [ack[1] for ack in acks if ack[0] == 176], shown


@pytest.mark.parametrize(
    ("manner", "entered", "results"),
    [("right", True, (0, 0)), ("disobeyed", False, (0,)), ("unanswered", True, ()), ("denied", True, (4, 4))],
)
def test_answers_to_a_companion(vehicle, manner, entered, results):
    vehicle.troubles.set("answers", manner)
    found, _ = answers(vehicle, COMPANION, VehicleMode.LAND)
    assert (vehicle.mode is VehicleMode.LAND) == entered
    assert found == list(results)[: len(RIGHT[vehicle.options.firmware])]


def test_a_ground_station_is_always_answered_right(vehicle):
    vehicle.troubles.set("answers", "disobeyed")
    assert answers(vehicle, STATION, VehicleMode.LAND)[0] == RIGHT[vehicle.options.firmware]
    assert vehicle.mode is VehicleMode.LAND


def test_of_modes_within_one_step_only_the_last_is_shown(vehicle):
    modes = (VehicleMode.LAND, VehicleMode.RTL, VehicleMode.MANUAL)
    results, shown = answers(vehicle, STATION, *modes)
    assert results == 3 * RIGHT[vehicle.options.firmware]
    assert vehicle.mode is VehicleMode.MANUAL
    manners = MANNERS[vehicle.options.firmware]
    assert shown == ([manners.custom_modes[VehicleMode.MANUAL]] if manners.heartbeat_on_mode_change else [])


def test_troubles_come_in_lines(vehicle):
    reads, writes = os.pipe()
    try:
        given = TroubleInput(reads)
        given.read(vehicle.troubles)
        os.write(writes, b'{"answers": "denied"}\n{"gnss_lost": true, "sticks": [0.5, 0, 0, 0]}\n{"battery_')
        given.read(vehicle.troubles)
        troubles = vehicle.troubles
        assert (troubles.answers, troubles.gnss_lost, troubles.sticks) == (
            "denied",
            True,
            (0.5, 0.0, 0.0, 0.0),
        )
        os.write(writes, b'remaining": 0.25}\n')
        given.read(vehicle.troubles)
        assert troubles.battery_remaining == 0.25
    finally:
        os.close(reads)
        os.close(writes)


@pytest.mark.parametrize(
    "line",
    [b"luck\n", b"[1]\n", b'{"luck": 1}\n', b'{"answers": "loudly"}\n', b'{"gnss_lost": 1}\n',
     b'{"sticks": [2, 0, 0, 0]}\n', b'{"battery_remaining": "full"}\n'],
)  # fmt: skip
def test_a_line_that_names_no_trouble_is_refused(vehicle, line):
    reads, writes = os.pipe()
    try:
        os.write(writes, line)
        with pytest.raises(ConfigError, match="trouble"):
            TroubleInput(reads).read(vehicle.troubles)
    finally:
        os.close(reads)
        os.close(writes)
