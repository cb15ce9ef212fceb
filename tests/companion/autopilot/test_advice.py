"""What the operator is told of the vehicle's own parameters."""

from __future__ import annotations

import json
from typing import Any

import msgspec
import pytest

from companion.autopilot.advice import after_silence, no_receiver, remarks, restarting, too_fast
from companion.config import AvoidanceConfig, LimitsConfig
from companion.events import Firmware, MissionItem, Parameter, VehicleParameters
from companion.shipped import shipped


def told(firmware: Firmware = Firmware.ARDUPILOT, **values: tuple[str, float]) -> VehicleParameters:
    fields = {key: Parameter(name=name, value=number) for key, (name, number) in values.items()}
    return VehicleParameters(firmware=firmware, **fields)


def adsb(radius_m: float, receiver: float = 1) -> VehicleParameters:
    return told(adsb_type=("ADSB_TYPE", receiver), adsb_radius_m=("ADSB_LIST_RADIUS", radius_m))


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
OLD_COPTER = told(speed_mps=("WPNAV_SPEED", 10.0))


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
        # Before 4.7 in centimetres: who reads 10 m/s must not set 5 where 500 is meant.
        (OLD_COPTER, [], 5.0, "WPNAV_SPEED 10 (set in centimetres: 1000) is above limits.max_speed_mps 5"),
        (
            OLD_COPTER,
            mission(12.0),
            15.0,
            "mission item 1: 12 m/s is above WPNAV_SPEED 10 (set in centimetres: 1000)",
        ),
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
    slows = ": in a conflict, the companion slows the vehicle down to that at once"
    assert text == (None if words is None else words + slows)


# ---------------------------------------------------------------- remarks


@pytest.mark.parametrize(
    ("vehicle", "over", "words"),
    [
        (told(setpoint_timeout_s=("GUID_TIMEOUT", 0.4)), {}, "GUID_TIMEOUT 0.4 s is too short for 20"),
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
            "ADSB_LIST_RADIUS 2000: the autopilot reports no aircraft beyond 2000 m, too late to keep well "
            "clear of many. In simulations 2000 m left up to 35 % of the losses of well clear, 3000 m up to "
            "23 %: set 3000 m or more (alerts look 90 s ahead, at 80 m/s 7200 m)",
        ),
        (adsb(2999), {}, "beyond 2999 m, too late"),
        (
            adsb(3000),
            {},
            "ADSB_LIST_RADIUS 3000: the autopilot reports no aircraft beyond 3000 m. In simulations more "
            "than 3000 m hardly kept well clear more often, but alerts look 90 s ahead, at 80 m/s 7200 m: "
            "set 7200 m or more for all of them",
        ),
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
    assert text.endswith("alerts look 100 s ahead, at 80 m/s 8000 m: set 8000 m or more for all of them")


def test_the_cost_of_a_smaller_radius_is_the_measured_one(make_config) -> None:
    """The largest ratio of losses of well clear of powered aircraft, of which the text has whole percent."""
    worst: dict[float, float] = {}
    for name in ("encounters", "encounters-range"):
        for line in json.loads(shipped(f"results/campaign/{name}.json").read_bytes())["lines"]:
            if line["cell"]["model"].startswith("uncor"):
                range_m = line["cell"]["range_m"]
                worst[range_m] = max(worst.get(range_m, 0.0), line["found"]["lowc_ratio"])
    (text,) = remarks(make_config(), adsb(2000))
    assert f"2000 m left up to {worst[2000.0]:.0%} of".replace("%", " %") in text
    assert f"3000 m up to {worst[3000.0]:.0%}:".replace("%", " %") in text
    assert worst[3000.0] - worst[5000.0] < 0.02


def test_what_follows_silence() -> None:
    assert after_silence(told(setpoint_timeout_s=("GUID_TIMEOUT", 3.0))) == (
        "without setpoints for 3 s (GUID_TIMEOUT) it brakes and stays in GUIDED"
    )
    px4 = told(Firmware.PX4, setpoint_timeout_s=("COM_OF_LOSS_T", 1.0), loss_action=("COM_OBL_RC_ACT", 5.0))
    assert after_silence(px4) == "without setpoints for 1 s (COM_OF_LOSS_T) it holds (COM_OBL_RC_ACT 5)"
    assert after_silence(told(Firmware.PX4)) == "without setpoints it follows COM_OBL_RC_ACT"


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, None),
        (0.0, None),
        (1.0, "MIS_RESTART 1: after a handback the mission would restart from its beginning"),
    ],
)
def test_a_mission_that_would_begin_anew(value: float | None, words: str | None) -> None:
    text = restarting(told() if value is None else told(mission_restart=("MIS_RESTART", value)))
    assert (text is None) == (words is None)
    assert words is None or text == f"{words}; set 0 to guard it"


def test_a_vehicle_without_a_receiver_hears_no_crewed_traffic() -> None:
    assert no_receiver(adsb(2000, receiver=0)) == (
        "ADSB_TYPE 0: no ADS-B receiver, so crewed traffic is not received"
    )
    assert no_receiver(adsb(2000, receiver=1)) is None
    assert no_receiver(told()) is None


@pytest.mark.parametrize("action", range(8))
def test_each_action_after_silence_is_named(action: int) -> None:
    """With the parameter that sets it, also if that is 0."""
    said = after_silence(told(Firmware.PX4, loss_action=("COM_OBL_RC_ACT", float(action))))
    words = {3: "returns", 4: "lands", 5: "holds", 6: "terminates the flight", 7: "disarms"}
    modes = {0: "Position", 1: "Altitude", 2: "Stabilized"}
    assert said.endswith(f" (COM_OBL_RC_ACT {action})")
    assert words.get(action, f"switches to {modes.get(action)} mode") in said


def test_nothing_said_of_parameters_that_are_as_they_should_be(make_config) -> None:
    config = msgspec.structs.replace(make_config(use="guard"), limits=LimitsConfig(fence="vehicle"))
    sound = told(
        speed_mps=("WP_SPD", 20.0),
        setpoint_timeout_s=("GUID_TIMEOUT", 3.0),
        fence_action=("FENCE_ENABLE", 1.0),
        mission_restart=("MIS_RESTART", 0.0),
        adsb_type=("ADSB_TYPE", 1.0),
        adsb_radius_m=("ADSB_LIST_RADIUS", 10_000.0),
    )
    assert remarks(config, sound) == []


def test_every_remark_is_said(make_config) -> None:
    config = msgspec.structs.replace(make_config(use="guard"), limits=LimitsConfig(fence="vehicle"))
    parameters = {
        "adsb_type": ("ADSB_TYPE", 1.0),
        "adsb_radius_m": ("ADSB_LIST_RADIUS", 2000.0),
        "speed_mps": ("MPC_XY_VEL_MAX", 3.0),
        "setpoint_timeout_s": ("COM_OF_LOSS_T", 0.1),
        "loss_action": ("COM_OBL_RC_ACT", 7.0),
        "mission_restart": ("MIS_RESTART", 1.0),
        "fence_action": ("GF_ACTION", 0.0),
    }
    names = [name for key, (name, _) in parameters.items() if key != "adsb_type"]
    assert [text.split()[0] for text in remarks(config, told(Firmware.PX4, **parameters))] == names
