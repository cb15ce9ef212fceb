"""The flight of an encounter: the same commands as in the campaign, and the behaviour of the law."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from companion.avoidance import kernels as k
from companion.avoidance.law import settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from ground_tools.campaign import flight as campaign_flight
from ground_tools.campaign import outcome, vehicles
from ground_tools.campaign.encounters import cells, flight

END_S = 240.0
EXACT = msgspec.structs.replace(
    cells.WORLD, end_s=END_S, delay_s=(0.5, 0.5), sigma_m=0.0, sigma_mps=0.0, quantised=False
)
"""A world without random errors."""
OWN = Trajectory([-60.0, END_S + 60.0], [(-2400.0, 0.0, -80.0), (1200.0, 0.0, -80.0)])


def crossing(aside_m, climb_mps):
    """A straight track at 45 m/s that passes ours at 180 s."""
    other = Trajectory(
        [-60.0, END_S + 60.0],
        [
            (aside_m, -240.0 * 45.0, -70.0 + 240.0 * climb_mps),
            (aside_m, 120.0 * 45.0, -70.0 - 120.0 * climb_mps),
        ],
    )
    steps = round(END_S / EXACT.step_s)
    position = np.array([other.position(i * EXACT.step_s) for i in range(steps + 1)])
    return other, position, np.tile([0.0, 45.0, -climb_mps], (steps + 1, 1))


@pytest.mark.parametrize("kind", ["geometric", "barometric"])
@pytest.mark.parametrize(("aside_m", "climb_mps"), [(20.0, 0.0), (-90.0, 0.1), (300.0, -0.05)])
@pytest.mark.parametrize("horizontal_m", [150.0, 610.0])
def test_the_campaign_flies_the_same(kind, aside_m, climb_mps, horizontal_m):
    """Compares step by step without randomness; the campaign's crewed aircraft flies straight."""
    other, position, velocity = crossing(aside_m, climb_mps)
    avoidance = AvoidanceConfig(crewed_horizontal_m=horizontal_m)
    conditions = EXACT.conditions(avoidance.period_s)
    settings = settings_of(avoidance, LimitsConfig(max_speed_mps=15.0), OWN)
    crewed = settings_of(AvoidanceConfig(law="none"), LimitsConfig(max_speed_mps=50.0), other)
    steps = len(position) - 1
    wanted, result = np.zeros((steps, 2, 3)), np.zeros(outcome.FLIGHT_ENTRIES)
    kinds = np.array(
        [vehicles.AVOIDS, vehicles.CREWED if kind == "geometric" else vehicles.BAROMETRIC], float
    )
    campaign_flight.fly(
        np.random.default_rng(3), conditions, np.stack([OWN.arrays[0], other.arrays[0]]),
        np.stack([OWN.arrays[1], other.arrays[1]]), k.NO_WALLS, np.array([settings, crewed]), kinds, wanted,
        outcome.new_log(2), np.zeros((2, 2, outcome.PAIR_ENTRIES)), result,
    )  # fmt: skip
    received = flight.Received(flight.GEOMETRIC if kind == "geometric" else flight.BAROMETRIC, 1e6, 0.0)
    found, numbers = flight.fly(
        np.random.default_rng(3), conditions, OWN.arrays, (position, velocity), settings, received
    )
    np.testing.assert_allclose(wanted[:, 1], position[1:], atol=1e-6)
    np.testing.assert_allclose(found[1:], wanted[:, 0], atol=1e-6)
    assert numbers[flight.F_DEVIATION] == pytest.approx(result[outcome.F_DEVIATION], abs=1e-6)
    assert numbers[flight.F_BACK] == pytest.approx(result[outcome.F_BACK], abs=1e-6)
    assert result[outcome.F_DEVIATION] > 20.0 or aside_m == 300.0  # the aircraft has to avoid


def test_it_goes_below_crewed_traffic_first_and_returns():
    """The crewed aircraft passes 40 m above. Our aircraft descends, hardly deviates to the side, and returns
    to its path."""
    _, position, velocity = crossing(0.0, 0.0)
    position[:, 2] = -120.0
    settings = settings_of(AvoidanceConfig(), LimitsConfig(max_speed_mps=15.0), OWN)
    world = msgspec.structs.replace(EXACT, floor_m=20.0, ceiling_m=150.0)
    trace, result = flight.fly(
        np.random.default_rng(3), world.conditions(AvoidanceConfig().period_s), OWN.arrays,
        (position, velocity), settings, flight.Received(flight.GEOMETRIC, 1e6, 0.0),
    )  # fmt: skip
    assert trace[:, 2].max() > -45.0
    assert trace[:, 2].min() > -81.0
    away = np.hypot(*(position - trace)[:, :2].T)
    assert (np.abs((position - trace)[:, 2]) / 76.2)[away < 609.6].min() > 1.0
    assert result[flight.F_BACK] < 5.0


def test_a_pressure_altitude_beside_ours_counts_with_its_error():
    """A crewed aircraft that seems 100 m higher than it is is not avoided to the side; without the error it
    is."""
    _, position, velocity = crossing(10.0, 0.0)
    position[:, 2] = -100.0
    settings = settings_of(AvoidanceConfig(), LimitsConfig(max_speed_mps=15.0), OWN)
    deviations = []
    for error_m in (0.0, 300.0):
        _, result = flight.fly(
            np.random.default_rng(3), EXACT.conditions(AvoidanceConfig().period_s), OWN.arrays,
            (position, velocity), settings, flight.Received(flight.PRESSURE, 1e6, error_m),
        )  # fmt: skip
        deviations.append(result[flight.F_DEVIATION])
    assert deviations[0] > 30.0
    assert deviations[1] < 1.0


def test_a_pressure_altitude_counts_only_where_it_is_far_from_ours():
    """A crewed aircraft 200 m above is avoided to the side if its altitude is barometric, and not if it is
    geometric. One 400 m above is not avoided in either case."""
    for above_m, avoids in ((200.0, True), (400.0, False)):
        _, position, velocity = crossing(10.0, 0.0)
        position[:, 2] = -80.0 - above_m
        settings = settings_of(AvoidanceConfig(), LimitsConfig(max_speed_mps=15.0), OWN)
        deviations = []
        for received in (flight.GEOMETRIC, flight.BAROMETRIC):
            _, result = flight.fly(
                np.random.default_rng(3), EXACT.conditions(AvoidanceConfig().period_s), OWN.arrays,
                (position, velocity), settings, flight.Received(received, 1e6, 0.0),
            )  # fmt: skip
            deviations.append(result[flight.F_DEVIATION])
        assert deviations[0] < 1.0
        assert (deviations[1] > 50.0) == avoids
