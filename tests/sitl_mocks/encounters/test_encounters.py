"""Short encounters have real conflicts and are reproducible, alone and side by side."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from companion.atmc.observation import conflict_weight
from sitl_mocks.air.air_settings import AirSettings
from sitl_mocks.encounters import draw, lockstep
from sitl_mocks.encounters.awareness import AgeLog, awareness_of, weights_of
from sitl_mocks.encounters.draw import APART_M, CELL_M, END_S, LAYER_M, converging, side_by_side
from sitl_mocks.encounters.lockstep import Flown, Run
from sitl_mocks.encounters.scenario_file import PathSettings, Scenario


def at(rows, times):
    return np.column_stack([np.interp(times, rows[:, 0], rows[:, k]) for k in (1, 2, 3)])


def test_every_pair_meets_and_nobody_begins_or_ends_near_another():
    times = np.arange(0.0, END_S, 0.02)
    counts = set()
    for seed in range(60):
        paths = converging(seed)
        counts.add(len(paths))
        for first, second in combinations(paths, 2):
            away = np.linalg.norm(at(first, times) - at(second, times), axis=1)
            assert away.min() < 6.0
            assert min(away[0], away[-1]) > APART_M - 0.5
        for rows in paths:
            legs = np.diff(rows, axis=0)
            speeds = np.linalg.norm(legs[:, 1:3], axis=1) / legs[:, 0]
            np.testing.assert_allclose(speeds, speeds[0])
            assert 3.0 <= speeds[0] <= 7.0
    assert counts == {2, 3, 4}


def test_the_first_legs_show_no_conflict():
    """Straight on from the beginning few pairs would meet: the turn makes the conflict."""
    would = []
    for seed in range(60):
        ends = [rows[0, 1:] + (rows[1, 1:] - rows[0, 1:]) / rows[1, 0] * 15.0 for rows in converging(seed)]
        would += [np.linalg.norm(a - b) < 10.0 for a, b in combinations(ends, 2)]
    assert np.mean(would) < 0.2


def test_the_same_seed_is_the_same_encounter_alone_and_in_a_crowd():
    seeds = (7, 8, 9, 10, 11, 12)
    crowd = side_by_side(seeds)
    for number, (seed, paths) in enumerate(zip(seeds, crowd, strict=True)):
        shift = (CELL_M * (number % 4 // 2), CELL_M * (number % 2), -LAYER_M * (number // 4))
        for alone, beside in zip(converging(seed), paths, strict=True):
            np.testing.assert_allclose(beside - alone, np.broadcast_to((0.0, *shift), alone.shape), atol=1e-9)
    starts = [rows[0, 1:] for paths in crowd for rows in paths]
    assert min(np.linalg.norm(a - b) for a, b in combinations(starts, 2)) > APART_M - 0.1


@pytest.mark.parametrize("count", [0, draw.MAX_SIDE_BY_SIDE + 1])
def test_nobody_and_too_many(count):
    with pytest.raises(ValueError, match="side by side"):
        side_by_side(tuple(range(count)))


def test_one_of_a_crowd_is_heard_and_hears():
    """Aircraft of different encounters share the air: frames cross in both directions."""
    groups = side_by_side((1, 2))
    paths = tuple(PathSettings(points=tuple(map(tuple, rows.tolist()))) for e in groups for rows in e)
    air = AirSettings(model="packets", rate=10)
    run = lockstep.fly(Scenario(path=paths, air=air, duration_s=4.0), 1)
    names = [aircraft.name for aircraft in run.aircraft]
    here, there = names[: len(groups[0])], names[len(groups[0]) :]
    for a in here:
        for b in there:
            assert run.air[a, b].delivered > 0
            assert run.air[b, a].delivered > 0


# ---------------------------------------------------------------- ages


def test_weighted_ages_by_hand():
    age = np.array([[1.0, 2.0], [3.0, 10.0]])
    found = awareness_of(age, np.array([[1.0, 1.0], [0.5, 0.0]]))
    assert found.mean_s == pytest.approx((1.0 + 2.0 + 1.5) / 2.5)
    assert found.p95_s == 3.0
    assert found.largest_s == 3.0
    assert awareness_of(age, np.array([[1.0, 0.1], [0.01, 0.01]])).p95_s == 2.0
    assert awareness_of(age, np.array([[0.4, 0.1], [0.01, 0.01]])).largest_s == 0.0


class Air:
    """Ages in the form in which an air reports them."""

    def __init__(self):
        self.ages = {}

    def information_age_s(self, sender, receiver):
        return self.ages.get((sender, receiver))


def test_what_was_never_heard_is_as_old_as_the_run():
    air, log = Air(), AgeLog([("a", "b"), ("b", "a")])
    log(air)
    log(air)
    air.ages["a", "b"] = 0.2
    log(air)
    np.testing.assert_allclose(log.ages_s(), [[0.0, 0.0], [0.05, 0.05], [0.2, 0.1]])
    assert log.unheard() == 1


def test_weights_begin_with_the_paths_and_fall_with_the_distance():
    time_s = np.array([-0.05, 0.0, 0.05])
    near, far = np.zeros((3, 3)), np.array([[60.0, 0.0, 0.0]] * 3)
    farther = far * 5.0
    run = Run([Flown("a", near), Flown("b", far), Flown("c", farther)], {}, time_s, {})
    weight = weights_of(run, [("a", "b"), ("a", "c")])
    assert weight.shape == (3, 2)
    assert (weight[0] == 0.0).all()
    wanted = conflict_weight(np, np.array([60.0, 300.0]), np.zeros(2))
    np.testing.assert_allclose(weight[1:], [wanted] * 2)
    assert wanted[0] > 0.5 > wanted[1]
