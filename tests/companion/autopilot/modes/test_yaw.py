"""Where the nose points: the words of `flight.yaw` as fields of the setpoint."""

from __future__ import annotations

import itertools
import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.dialect import VELOCITY_YAW_MASK, VELOCITY_YAW_RATE_MASK
from companion.autopilot.link import AutopilotLink
from companion.autopilot.modes.yaw import LEAST_MPS, PAUSE_S, RATE_RADPS, Nose
from companion.config import VehicleConfig
from companion.events import VelocitySetpoint
from tests.companion.autopilot.conftest import Scripted

EAST = (0.0, 3.0, 0.0)
STILL = (0.0, 0.0, -1.0)


def facing(heading_deg: float | None = 0.0) -> Nose:
    nose = Nose("face")
    nose.heard(65535 if heading_deg is None else round(heading_deg * 100))
    return nose


def turned(nose: Nose, velocity: tuple[float, float, float], seconds: float, start_s: float = 0.0) -> float:
    """The yaw after a stream of setpoints at 20 Hz."""
    yaw = None
    for step in range(round(seconds * 20) + 1):
        yaw = nose.yaw_rad(velocity, start_s + step / 20)
    assert yaw is not None
    return yaw


def test_masks_say_what_mavlink_means_by_them() -> None:
    names = ("X", "Y", "Z", "AX", "AY", "AZ")
    ignored = sum(getattr(mavlink, f"POSITION_TARGET_TYPEMASK_{n}_IGNORE") for n in names)
    assert ignored + mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE == VELOCITY_YAW_MASK
    assert ignored + mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE == VELOCITY_YAW_RATE_MASK


def test_hold_never_says_an_angle() -> None:
    nose = Nose("hold")
    nose.heard(9000)
    assert [nose.yaw_rad(EAST, t / 20) for t in range(40)] == [None] * 40


def test_the_nose_turns_slowly_to_where_the_aircraft_flies() -> None:
    nose = facing(0.0)
    yaws = [nose.yaw_rad(EAST, t / 20) for t in range(60)]
    assert yaws[0] == pytest.approx(0.0)
    assert yaws[20] == pytest.approx(RATE_RADPS)
    steps = [b - a for a, b in itertools.pairwise(yaws)]  # type: ignore[operator]
    assert max(steps) <= RATE_RADPS / 20 + 1e-9
    assert yaws[-1] == pytest.approx(math.pi / 2)


@pytest.mark.parametrize(
    ("heading_deg", "velocity", "sign"),
    [(350, (3, 0.5, 0), 1), (10, (3, -1, 0), -1), (170, (-3, -1, 0), 1), (190, (-3, 1, 0), -1)],
)
def test_it_turns_the_short_way(heading_deg: float, velocity, sign: int) -> None:
    nose = facing(heading_deg)
    first = nose.yaw_rad(velocity, 0.0)
    second = nose.yaw_rad(velocity, 0.05)
    assert first is not None
    assert second is not None
    assert math.copysign(1, math.remainder(second - first, math.tau)) == sign
    assert turned(nose, velocity, 3.0, 0.1) == pytest.approx(math.atan2(velocity[1], velocity[0]))


def test_in_hover_the_nose_stays() -> None:
    nose = facing(30.0)
    assert nose.yaw_rad(STILL, 0.0) is None
    slow = LEAST_MPS - 0.01
    assert nose.yaw_rad((slow, 0.0, 0.0), 0.05) is None
    yaw = turned(nose, EAST, 3.0, 0.1)
    # Slow again, and blown about: still east.
    for step, angle in enumerate((0.3, 2.0, 4.0, 5.5)):
        drift = (slow * math.cos(angle), slow * math.sin(angle), 0.0)
        assert nose.yaw_rad(drift, 3.2 + step / 20) == pytest.approx(yaw)


def test_without_a_heading_it_stays_until_there_is_one() -> None:
    nose = facing(None)
    assert nose.yaw_rad(EAST, 0.0) is None
    nose.heard(8000)
    assert nose.yaw_rad(EAST, 0.05) == pytest.approx(math.radians(80.0) + RATE_RADPS / 20)


def test_after_a_pause_it_begins_where_the_vehicle_points() -> None:
    nose = facing(0.0)
    turned(nose, EAST, 3.0)
    nose.heard(20_000)
    assert nose.yaw_rad(STILL, 3.05 + PAUSE_S) is None
    assert nose.yaw_rad(EAST, 3.1 + PAUSE_S) == pytest.approx(math.radians(-160.0) - RATE_RADPS / 20)


@pytest.mark.parametrize("word", ["face", "hold"])
@pytest.mark.parametrize("autopilot", [3, 12])
def test_both_firmwares_are_told_the_same(autopilot: int, word) -> None:
    scripted = Scripted(autopilot=autopilot)
    scripted.link = AutopilotLink(VehicleConfig(), yaw=word)
    scripted.heartbeat()
    scripted.says(scripted.position(1000, hdg=9000))
    scripted.told()
    scripted.link.send(VelocitySetpoint(velocity_ned_mps=EAST), scripted.now_s)
    (setpoint,) = scripted.told("SET_POSITION_TARGET_LOCAL_NED")
    assert (setpoint.vx, setpoint.vy, setpoint.vz) == EAST
    assert setpoint.type_mask == (0x9C7 if word == "face" else 0x5C7)
    assert setpoint.yaw == pytest.approx(math.pi / 2 if word == "face" else 0.0)
    assert setpoint.yaw_rate == 0.0
