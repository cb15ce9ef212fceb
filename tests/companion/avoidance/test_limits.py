"""The configured limits beside the vehicle's own, for the law and for paths."""

from __future__ import annotations

import math

import pytest

from companion.authority.table import HOLDING, State
from companion.avoidance.limits import effective
from companion.avoidance.trajectory import Trajectory, check_speeds
from companion.config import LimitsConfig
from companion.errors import ConfigError
from companion.events import Firmware, Parameter, Say, Severity, VehicleParameters

LIMITS = LimitsConfig()


def told(firmware: Firmware = Firmware.ARDUPILOT, **values: tuple[str, float]) -> VehicleParameters:
    fields = {key: Parameter(name=name, value=number) for key, (name, number) in values.items()}
    return VehicleParameters(firmware=firmware, **fields)


SLOW = told(speed_mps=("WPNAV_SPEED", 2.0))


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
