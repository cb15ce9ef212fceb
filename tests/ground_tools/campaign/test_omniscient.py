"""The law that knows everybody's future: its plans keep separation within the limits, and aircraft fly
them."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from companion.config import LimitsConfig
from companion.errors import ConfigError
from ground_tools import cli
from ground_tools.campaign import cells as campaign
from ground_tools.campaign.cells import Cell
from ground_tools.campaign.peers import omniscient
from ground_tools.campaign.peers.omniscient import APART_M, STEP_S, Limits

STEPS = 121
NOBODY = np.zeros((0, STEPS, 3))


def limits(number, speed=5.0):
    return Limits(*(np.full(number, value) for value in (speed, 2.0, 2.0, 1.0)))


def straight(place, velocity):
    """Straight paths that pass a place at the middle of the time."""
    times = (np.arange(STEPS) - STEPS // 2) * STEP_S
    return np.array(place, float) + times[:, None] * np.array(velocity, float)


def planned(wanted, others=NOBODY, seed=1):
    wanted = np.array(wanted)
    return omniscient.plan(np.random.default_rng(seed), wanted, others, limits(len(wanted)))


def dense_distance(a, b):
    share = np.linspace(0.0, 1.0, 20)[:, None, None]
    away = a - b
    return np.linalg.norm(away[:-1] + share * np.diff(away, axis=0), axis=-1).min()


def test_an_aircraft_that_meets_nobody_keeps_its_path():
    wanted = [straight((0, 0, 0), (3, 0, 0)), straight((0, 11.5, 0), (-3, 0, 0))]
    np.testing.assert_array_equal(planned(wanted), wanted)


@pytest.mark.parametrize(
    "other",
    [
        straight((0, 1, 0), (-3, 0, 0)),
        straight((0, 0, 0), (-3, 0, 0)),
        straight((1, 0, 1), (0, 3, 0)),
        straight((0, 0, 0.5), (1.5, 0, 0)),
    ],
    ids=["head-on", "exactly head-on", "crossing", "overtaking"],
)
def test_two_aircraft_share_the_least_way_round(other):
    wanted = np.array([straight((0, 0, 0), (3, 0, 0)), other])
    found = planned(wanted)
    assert dense_distance(*found) > 10.3
    gaps = np.linalg.norm(found - wanted, axis=2).max(axis=1)
    assert gaps == pytest.approx(gaps[::-1], abs=1.0)  # equal parts
    assert 4.0 < gaps.max() < APART_M
    velocity = np.diff(found, axis=1) / STEP_S
    acceleration = np.diff(velocity, axis=1) / STEP_S
    assert np.linalg.norm(velocity, axis=2).max() < 5.0
    assert np.linalg.norm(acceleration, axis=2).max() < 1.0
    assert np.abs(velocity[:, :, 2]).max() < 2.0
    np.testing.assert_allclose(found[:, :2], wanted[:, :2])  # the aircraft begins on its path


def test_fast_aircraft_do_not_pass_between_two_steps():
    """At 32 m/s relative speed, 16 m from step to step."""
    wanted = np.array([straight((0, 0, 0), (16, 0, 0)), straight((8, 1, 0), (-16, 0, 0))])
    found = omniscient.plan(np.random.default_rng(1), wanted, NOBODY, limits(2, speed=20.0))
    assert dense_distance(*found) > 10.3


def test_the_plan_yields_fully_to_aircraft_that_do_not_avoid():
    other = straight((0, 1, 0), (-3, 0, 0))
    wanted = np.array([straight((0, 0, 0), (3, 0, 0))])
    found = planned(wanted, other[None])
    assert dense_distance(found[0], other) > 10.3
    assert np.linalg.norm(found - wanted, axis=2).max() == pytest.approx(APART_M - 1.0, abs=1.0)


def test_least_distances_are_those_between_the_steps():
    paths = np.array([straight((0, 0, 0), (4, 0, 0)), straight((1, 0, 3), (-4, 0, 0))])
    assert omniscient._least_distance(paths, NOBODY) == pytest.approx(3.0)
    assert omniscient._least_distance(paths[:1], paths[1:]) == pytest.approx(3.0)
    assert np.linalg.norm(paths[0] - paths[1], axis=1).min() > 3.1


def test_the_transpose_of_the_differences():
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(2, 9, 3)), rng.normal(size=(2, 8, 3))
    assert (omniscient._rate(x) * y).sum() == pytest.approx((x * omniscient._back(y)).sum())


def test_the_plan_is_flown_and_the_intruder_is_the_same_as_for_other_laws():
    cell = Cell(
        generator="cruise",
        aircraft=2,
        intruders=0.5,
        intruder="shuttle",
        delay_s=(1.0, 2.0),
        law="omniscient",
    )
    look = campaign.look(cell, 90001)
    ours = campaign.look(replace(cell, law="dmuca"), 90001)
    free = campaign.look(replace(cell, law="none"), 90001)
    np.testing.assert_array_equal(look.trace[:, 0], ours.trace[:, 0])
    assert free.row.separation_m < 10.0 <= look.row.separation_m
    assert look.row.deviation_m < ours.row.deviation_m
    assert campaign.fly(cell, [90001]) == [look.row]
    velocity = np.diff(look.trace[:, 1], axis=0) / look.world.step_s
    assert np.linalg.norm(velocity, axis=1).max() < 5.05
    change = np.diff(look.log.flown[1:, 1], axis=0)
    assert np.linalg.norm(change, axis=1).max() <= LimitsConfig().max_acceleration_mps2 * 0.2 + 1e-9
    assert campaign.software_of([cell]) == campaign.software(planned=True, scenarios=True)


def test_five_aircraft_in_one_place():
    cell = Cell(generator="circle", aircraft=5, delay_s=(2.0, 3.0), law="omniscient")
    (row,) = campaign.fly(cell, [90001])
    assert row.separation_m >= 10.0
    assert row.deviation_m < 15.0


def test_a_flown_plan_keeps_apart_where_many_meet_on_their_way_to_pads():
    """Vehicles follow a plan of 1.7 m/s2 with so much error that this flight came to 9.97 m."""
    cell = Cell(generator="landing-row", aircraft=5, delay_s=(1.0, 2.0), law="omniscient")
    (row,) = campaign.fly(cell, [90002])
    assert row.separation_m >= 10.2


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"world": "wind"}, "--law omniscient cannot be combined with --world wind"),
        ({"intruder": "crewed", "intruders": 0.5}, "cannot be combined with --intruder crewed"),
        ({"intruder": "twin", "intruders": 0.5}, "cannot be combined with --intruder twin"),
    ],
)
def test_omniscient_refuses_unsupported_cells(options, said):
    with pytest.raises(ConfigError, match=said):
        campaign.flown_by(Cell(generator="circle", aircraft=4, law="omniscient", **options))


def test_omniscient_is_listed_among_the_laws(capsys):
    assert cli.main(["campaign", "run", "--generator", "S2", "--law", "nonsense"]) == 2
    assert "daidalus, omniscient" in capsys.readouterr().err
