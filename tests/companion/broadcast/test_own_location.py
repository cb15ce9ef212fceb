"""What our Location tells of the own position: where we are as it is received, and how well that is known."""

from __future__ import annotations

import math

import msgspec
import pytest

from companion.broadcast.own_messages import location_of
from companion.events import EstimatorState, GlobalPosition, GnssFix, Landed, LandedState, VehicleTime
from companion.ownship import Ownship

NORTH_MPS = 25.0
METRES_PER_DEG = math.radians(1.0) * 6_378_137.0


@pytest.fixture
def own() -> Ownship:
    """An own state whose position was measured and received at 0 s, while it flew north and climbed."""
    own = Ownship()
    own.observe(
        GlobalPosition(
            time_boot_s=100.0,
            lat_deg=47.0,
            lon_deg=8.0,
            alt_msl_m=450.0,
            height_above_home_m=50.0,
            velocity_ned_mps=(NORTH_MPS, 0.0, -4.0),
        ),
        0.0,
    )
    return own


@pytest.mark.parametrize("age_s", [0.0, 0.25, 0.97])
@pytest.mark.parametrize("knows_utc", [True, False])
def test_the_position_is_that_of_the_time_by_which_it_is_dated(
    own: Ownship, age_s: float, knows_utc: bool
) -> None:
    """By its timestamp; by its reception if it has none."""
    utc_s = 1_767_225_600.0
    if knows_utc:
        own.observe(VehicleTime(time_boot_s=100.0, utc_s=utc_s), 0.0)
    location = location_of(own, age_s, 1.0)
    assert (location.timestamp_s is not None) is knows_utc
    dated_s = age_s if location.timestamp_s is None else location.timestamp_s - utc_s % 3600.0
    assert location.lat_deg is not None
    assert (location.lat_deg - 47.0) * METRES_PER_DEG == pytest.approx(NORTH_MPS * dated_s, abs=0.01)
    assert location.height_m == pytest.approx(50.0 + 4.0 * dated_s)


@pytest.mark.parametrize(("home_m", "height_m"), [(400.0, 50.0), (408.0, 42.0), (412.0, 50.0), (450.0, 50.0)])
def test_the_height_is_above_the_take_off_if_home_is_set_in_flight(
    own: Ownship, home_m: float, height_m: float
) -> None:
    """PX4 also moves home, by some metres, when the GNSS altitude has drifted since the take-off. Then the
    height above home is right, and the altitude has drifted."""
    flying = own.position
    assert flying is not None
    ground = msgspec.structs.replace(flying, alt_msl_m=400.0, height_above_home_m=0.0)
    own = Ownship()
    own.observe(LandedState(landed=Landed.ON_GROUND), 0.0)
    own.observe(ground, 0.0)
    own.observe(LandedState(landed=Landed.IN_AIR), 0.1)
    above_home_m = flying.alt_msl_m - home_m
    own.observe(msgspec.structs.replace(flying, time_boot_s=110.0, height_above_home_m=above_home_m), 10.0)
    assert location_of(own, 10.0, 1.0).height_m == pytest.approx(height_m)


def test_the_accuracies_of_the_receiver_are_not_told_of_an_estimator_that_lost_it(own: Ownship) -> None:
    """The autopilot goes on reporting a position, which may stand still or drift away."""
    own.observe(
        GnssFix(
            fix_type=3,
            lat_deg=47.0,
            lon_deg=8.0,
            alt_msl_m=450.0,
            horizontal_accuracy_m=1.0,
            vertical_accuracy_m=3.0,
            speed_accuracy_mps=0.3,
        ),
        0.1,
    )

    def accuracies() -> set[float | None]:
        told = location_of(own, 0.5, 1.0)
        assert told.lat_deg is not None
        return {told.horizontal_accuracy_m, told.vertical_accuracy_m, told.speed_accuracy_mps}

    assert accuracies() == {1.0, 3.0, 0.3}
    own.observe(EstimatorState(usable=False), 0.2)
    assert accuracies() == {None}
    own.observe(EstimatorState(usable=True), 0.3)
    assert accuracies() == {1.0, 3.0, 0.3}
