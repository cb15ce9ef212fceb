"""The configured limits beside the vehicle's own: the law, the path, and what the operator is told."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest

from companion.authority.table import HOLDING, State
from companion.autopilot.advice import after_silence, remarks, too_fast
from companion.avoidance.limits import effective
from companion.avoidance.trajectory import Trajectory, check_speeds
from companion.config import AvoidanceConfig, LimitsConfig
from companion.errors import ConfigError
from companion.events import Firmware, MissionItem, Parameter, Say, Severity, VehicleParameters

LIMITS = LimitsConfig()


def told(firmware: Firmware = Firmware.ARDUPILOT, **values: tuple[str, float]) -> VehicleParameters:
    fields = {key: Parameter(name=name, value=number) for key, (name, number) in values.items()}
    return VehicleParameters(firmware=firmware, **fields)


def adsb(radius_m: float, receiver: float = 1) -> VehicleParameters:
    return told(adsb_type=("ADSB_TYPE", receiver), adsb_radius_m=("ADSB_LIST_RADIUS", radius_m))


SLOW = told(speed_mps=("WPNAV_SPEED", 2.0))


def mission(*speeds_mps: float) -> list[MissionItem]:
    """A change of speed (0: none) before each waypoint; item 1 is the first of them."""
    items = [
        (
            MissionItem(seq=2 * n + 1, command=178, frame=2, params=(1.0, speed_mps, -1.0, 0.0)),
            MissionItem(seq=2 * n + 2, command=16, frame=6, lat_deg=47.0, lon_deg=8.0, alt_m=30.0),
        )
        for n, speed_mps in enumerate(speeds_mps)
    ]
    return [item for pair in items for item in pair if item.command != 178 or item.params[1]]


PX4 = told(Firmware.PX4, speed_mps=("MPC_XY_VEL_MAX", 12.0), cruise_mps=("MPC_XY_CRUISE", 7.0))
COPTER = told(speed_mps=("WP_SPD", 10.0))


@pytest.mark.parametrize(
    ("vehicle", "items", "limit_mps", "words"),
    [
        (COPTER, mission(0.0), 10.0, None),
        (COPTER, mission(0.0), 5.0, "WP_SPD 10 is above limits.max_speed_mps 5"),
        (COPTER, [], 5.0, "WP_SPD 10 is above limits.max_speed_mps 5"),
        (COPTER, mission(5.0), 5.0, None),
        (COPTER, mission(5.0, 9.6), 5.0, "mission item 3: 9.6 m/s is above limits.max_speed_mps 5"),
        (COPTER, mission(0.0, 5.0), 5.0, "WP_SPD 10 is above limits.max_speed_mps 5"),
        # ArduPilot flies above its own speed where a mission asks for it; the companion does not.
        (COPTER, mission(12.0), 15.0, "mission item 1: 12 m/s is above WP_SPD 10"),
        (told(), mission(0.0), 5.0, None),
        (told(), mission(6.0), 5.0, "mission item 1: 6 m/s is above limits.max_speed_mps 5"),
        (PX4, mission(0.0), 7.0, None),
        (PX4, mission(0.0), 5.0, "MPC_XY_CRUISE 7 is above limits.max_speed_mps 5"),
        (PX4, mission(15.0), 8.0, "mission item 1: 15 m/s is above limits.max_speed_mps 8"),
        # In single precision, as both are told.
        (told(cruise_mps=("MPC_XY_CRUISE", 5.300000190734863)), mission(0.0), 5.3, None),
        (told(), mission(5.300000190734863), 5.3, None),
        (told(), mission(5.31), 5.3, "mission item 1: 5.31 m/s is above limits.max_speed_mps 5.3"),
        # PX4 never flies above it.
        (PX4, mission(15.0), 20.0, None),
    ],
)
def test_a_mission_that_is_faster_than_the_limit(
    vehicle: VehicleParameters, items: list[MissionItem], limit_mps: float, words: str | None
) -> None:
    text = too_fast(LimitsConfig(max_speed_mps=limit_mps), vehicle, items)
    slows = ": when taken in a conflict, the vehicle slows down to that at once"
    assert text == (None if words is None else words + slows)


def test_the_lower_of_each_counts() -> None:
    vehicle = told(
        speed_mps=("WPNAV_SPEED", 3.0),
        climb_mps=("WPNAV_SPEED_UP", 2.5),
        descent_mps=("WPNAV_SPEED_DN", 1.5),
        acceleration_mps2=("WPNAV_ACCEL", 0.5),
    )
    assert effective(LIMITS, vehicle) == LimitsConfig(
        max_speed_mps=3.0, max_climb_mps=2.0, max_descent_mps=1.5, max_acceleration_mps2=0.5
    )
    assert effective(LIMITS, told()) == effective(LIMITS, None) == LIMITS
    kept = LimitsConfig(floor_height_m=20.0, ceiling_height_m=90.0, fence="vehicle")
    changed = effective(kept, vehicle)
    assert (changed.floor_height_m, changed.ceiling_height_m, changed.fence) == (20.0, 90.0, "vehicle")


@pytest.mark.parametrize(
    ("vehicle", "step", "words"),
    [
        (told(speed_mps=("WP_SPD", 3.0)), (4.0, 0.0, 0.0), "4.000 m/s is above the vehicle's WP_SPD 3"),
        (
            told(climb_mps=("MPC_Z_VEL_MAX_UP", 1.0)),
            (0, 0, -1.5),
            "climb 1.500 m/s is above the vehicle's MPC_",
        ),
        (told(descent_mps=("WPNAV_SPEED_DN", 1.5)), (0, 0, 1.8), "above the vehicle's WPNAV_SPEED_DN 1.5"),
        (told(speed_mps=("WP_SPD", 30.0)), (6.0, 0.0, 0.0), "is above limits.max_speed_mps 5"),
        (None, (6.0, 0.0, 0.0), "is above limits.max_speed_mps 5"),
    ],
)
def test_a_path_faster_than_the_vehicle_names_its_parameter(
    vehicle: VehicleParameters | None, step: tuple[float, float, float], words: str
) -> None:
    path = Trajectory([0.0, 10.0], [(0.0, 0.0, -50.0), (step[0] * 10, step[1] * 10, -50.0 + step[2] * 10)])
    with pytest.raises(ConfigError) as error:
        check_speeds(path, LIMITS, vehicle=vehicle)
    assert words in str(error.value)
    check_speeds(path, LimitsConfig(max_speed_mps=6, max_climb_mps=3, max_descent_mps=3))


def texts(bench) -> list[str]:
    return [c.text for _, c in bench.log if isinstance(c, Say)]


def test_a_path_that_the_vehicle_cannot_fly_is_refused_in_flight(make_bench) -> None:
    bench = make_bench()
    bench.extra.append(SLOW)
    bench.step(100)
    assert bench.core.state is State.STANDBY
    assert not bench.setpoints([c for _, c in bench.log])
    (refused,) = (text for text in texts(bench) if "path refused" in text)
    assert "horizontal speed 3.0" in refused
    assert "above the vehicle's WPNAV_SPEED 2" in refused


def test_what_is_commanded_stays_below_the_vehicles_own_limit(make_bench) -> None:
    """Behind its point of the path the law hurries: with 3.2 m/s of its own, no more than that."""
    fastest = {}
    for limit in (None, 3.2):
        bench = make_bench()
        if limit is not None:
            bench.extra.append(told(speed_mps=("WP_SPD", limit)))
        bench.until(lambda bench=bench: bench.core.in_control)
        bench.step(200)
        speeds = [math.hypot(*c.velocity_ned_mps) for c in bench.setpoints([c for _, c in bench.log])]
        fastest[limit] = max(speeds)
    assert fastest[None] > 4.0
    assert 3.0 < fastest[3.2] <= 3.2 + 1e-6


def test_it_is_said_once_and_again_only_when_it_changes(make_bench) -> None:
    bench = make_bench()
    bound = told(speed_mps=("WP_SPD", 4.0))
    for event in (bound, bound, told(speed_mps=("WP_SPD", 3.5)), bound):
        bench.extra.append(event)
        bench.step(20)
    said = [text for text in texts(bench) if "WP_SPD" in text]
    assert said == [
        f"DMUCA: WP_SPD {number} is below limits.max_speed_mps 5: the vehicle's limit applies"
        for number in ("4", "3.5")
    ]
    severities = {c.severity for _, c in bench.log if isinstance(c, Say) and "WP_SPD" in c.text}
    assert severities == {Severity.WARNING}
    assert bench.core.state in HOLDING


# ---------------------------------------------------------------- remarks


@pytest.mark.parametrize(
    ("vehicle", "over", "words"),
    [
        (
            told(setpoint_timeout_s=("GUID_TIMEOUT", 0.4)),
            {},
            "GUID_TIMEOUT 0.4 s is too short for 20 setpoints",
        ),
        (told(setpoint_timeout_s=("GUID_TIMEOUT", 0.5)), {}, None),
        (
            told(Firmware.PX4, setpoint_timeout_s=("COM_OF_LOSS_T", 0.9)),
            {"setpoint_rate_hz": 5.0},
            "for 5 setpoints a second: set 1 or more",
        ),
        (told(Firmware.PX4, setpoint_timeout_s=("COM_OF_LOSS_T", 1.0)), {"setpoint_rate_hz": 5.0}, None),
        (
            told(Firmware.PX4, loss_action=("COM_OBL_RC_ACT", 6)),
            {},
            "COM_OBL_RC_ACT 6: without setpoints the vehicle",
        ),
        (told(Firmware.PX4, loss_action=("COM_OBL_RC_ACT", 7)), {}, "without setpoints the vehicle disarms"),
        (told(Firmware.PX4, loss_action=("COM_OBL_RC_ACT", 3)), {}, None),
        (told(fence_action=("FENCE_ENABLE", 0)), {"fence": "vehicle"}, "FENCE_ENABLE 0: the vehicle itself"),
        (told(fence_action=("FENCE_ENABLE", 0)), {}, None),
        (told(fence_action=("FENCE_ENABLE", 1)), {"fence": "vehicle"}, None),
        (told(Firmware.PX4, fence_action=("GF_ACTION", 1)), {"fence": "vehicle"}, "GF_ACTION 1: the vehicle"),
        (told(Firmware.PX4, fence_action=("GF_ACTION", 3)), {"fence": "vehicle"}, None),
        (told(setpoint_timeout_s=("GUID_TIMEOUT", 0.1)), {"use": "watch"}, None),
        (told(mission_restart=("MIS_RESTART", 1)), {"use": "guard"}, "MIS_RESTART 1: after a handback"),
        (told(mission_restart=("MIS_RESTART", 0)), {"use": "guard"}, None),
        (told(mission_restart=("MIS_RESTART", 1)), {}, None),
        (told(), {}, None),
        (
            adsb(2000),
            {},
            "ADSB_LIST_RADIUS 2000: the autopilot reports no aircraft beyond 2000 m; at 80 m/s that is 25 s",
        ),
        (adsb(2000), {}, "but the look-ahead is 90 s: set 7200 m or more"),
        (adsb(2000), {"use": "watch"}, "ADSB_LIST_RADIUS 2000"),
        (adsb(7199), {}, "ADSB_LIST_RADIUS 7199"),
        (adsb(7200), {}, None),
        (adsb(0), {}, None),
        (adsb(2000, receiver=0), {}, None),
        (told(adsb_radius_m=("ADSB_LIST_RADIUS", 2000)), {}, None),
        (told(adsb_type=("ADSB_TYPE", 1)), {}, None),
    ],
)
def test_remarks(make_config, vehicle: VehicleParameters, over: dict[str, Any], words: str | None) -> None:
    config = make_config(**{key: value for key, value in over.items() if key != "fence"})
    config = msgspec.structs.replace(config, limits=LimitsConfig(fence=over.get("fence")))
    found = remarks(config, vehicle)
    assert len(found) == (words is not None)
    assert words is None or words in found[0]


def test_a_longer_look_ahead_asks_for_a_wider_radius(make_config) -> None:
    config = msgspec.structs.replace(make_config(), avoidance=AvoidanceConfig(horizon_s=100.0))
    (text,) = remarks(config, adsb(7200))
    assert text.endswith("the look-ahead is 100 s: set 8000 m or more")


def test_what_follows_silence() -> None:
    assert after_silence(told(setpoint_timeout_s=("GUID_TIMEOUT", 3.0))) == (
        "without setpoints for 3 s (GUID_TIMEOUT) it brakes and stays in GUIDED"
    )
    px4 = told(Firmware.PX4, setpoint_timeout_s=("COM_OF_LOSS_T", 1.0), loss_action=("COM_OBL_RC_ACT", 5.0))
    assert after_silence(px4) == "without setpoints for 1 s (COM_OF_LOSS_T) it holds (COM_OBL_RC_ACT 5)"
    assert after_silence(told(Firmware.PX4)) == "without setpoints it follows COM_OBL_RC_ACT"
