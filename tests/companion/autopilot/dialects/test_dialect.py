from __future__ import annotations

import pytest
from pymavlink import mavutil

from companion.autopilot.dialect import DIALECTS, FIRMWARES, refusal
from companion.autopilot.dialects.ardupilot import DIALECT as ARDUPILOT
from companion.autopilot.dialects.definition import Dialect
from companion.autopilot.dialects.px4 import DIALECT as PX4
from companion.events import Firmware, FlightMode

MODES = [FlightMode.EXTERNAL, FlightMode.MISSION, FlightMode.HOLD]


@pytest.mark.parametrize("dialect", [ARDUPILOT, PX4], ids=lambda d: d.firmware.value)
@pytest.mark.parametrize("mode", MODES)
def test_a_commanded_mode_is_read_back_as_itself(dialect: Dialect, mode: FlightMode) -> None:
    assert dialect.mode(1, dialect.command(mode).custom_mode) is mode


@pytest.mark.parametrize("dialect", [ARDUPILOT, PX4], ids=lambda d: d.firmware.value)
def test_other_cannot_be_commanded(dialect: Dialect) -> None:
    with pytest.raises(ValueError, match="cannot be commanded"):
        dialect.command(FlightMode.OTHER)


def test_ardupilot_numbers_are_those_of_copter() -> None:
    number = {v: k for k, v in mavutil.mode_mapping_acm.items()}
    assert ARDUPILOT.command(FlightMode.EXTERNAL).custom_mode == number["GUIDED"]
    assert ARDUPILOT.command(FlightMode.MISSION).custom_mode == number["AUTO"]
    assert ARDUPILOT.command(FlightMode.HOLD).custom_mode == number["BRAKE"]
    assert ARDUPILOT.mode(1, number["LOITER"]) is FlightMode.STICKS
    assert ARDUPILOT.mode(1, number["RTL"]) is FlightMode.OTHER
    assert ARDUPILOT.name(6) == "RTL"


def test_px4_numbers_are_main_and_sub() -> None:
    assert PX4.command(FlightMode.EXTERNAL).custom_mode == 0x00060000
    assert PX4.command(FlightMode.HOLD).custom_mode == 0x03040000
    mission = PX4.command(FlightMode.MISSION)
    assert (mission.custom_mode, mission.param2, mission.param3) == (0x04040000, 4.0, 4.0)
    assert PX4.mode(1, 0x05040000) is FlightMode.OTHER
    for main in (1, 2, 3, 5, 6, 7):
        assert PX4.name(main << 16) == mavutil.interpret_px4_mode(1, main << 16)
    assert PX4.name(0x05040000) == "AUTO.RTL"
    assert PX4.name(0x63000000) == f"mode {0x63000000}"


def test_without_the_custom_mode_flag_the_number_means_nothing() -> None:
    assert ARDUPILOT.mode(0, 4) is FlightMode.OTHER


@pytest.mark.parametrize("vehicle_type", [2, 3, 13, 14, 15, 29, 35])
@pytest.mark.parametrize("firmware", list(Firmware))
def test_multirotors_are_supported(firmware: Firmware, vehicle_type: int) -> None:
    assert refusal(firmware, vehicle_type) is None


@pytest.mark.parametrize(
    ("vehicle_type", "word"),
    [
        (1, "fixed-wing"),
        (10, "rover"),
        (11, "boat"),
        (12, "submarine"),
        (20, "VTOL"),
        (22, "VTOL"),
        (0, "vehicle"),
    ],
)
@pytest.mark.parametrize("firmware", list(Firmware))
def test_other_vehicles_are_named_and_refused(firmware: Firmware, vehicle_type: int, word: str) -> None:
    reason = refusal(firmware, vehicle_type)
    assert reason is not None
    assert word in reason
    assert "supported are" in reason


def test_helicopters_fly_on_ardupilot_only() -> None:
    assert refusal(Firmware.ARDUPILOT, 4) is None
    assert "helicopter" in str(refusal(Firmware.PX4, 4))


def test_each_firmware_has_its_dialect():
    assert [dialect.firmware for dialect in DIALECTS.values()] == list(Firmware)
    assert len(FIRMWARES) == len(DIALECTS), "no two report the same MAV_AUTOPILOT"
