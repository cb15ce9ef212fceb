"""Intervals and the tail of a policy, computed from given costs."""

from __future__ import annotations

import numpy as np
import pytest

from ground_tools.atmc.commands.evaluate_command import _tail
from ground_tools.atmc.commands.places import Places, Square
from ground_tools.atmc.env.world import SIDES_M

ACTIONS = ((10, 0, 10), (0, 0, 2))
ALLOWED = np.array([True, True])


def places(policy=1.0, count=100, spread=0.0, weight=None):
    """Six squares in which the first action costs 0.2 s everywhere and the policy `policy` times as much."""
    rng = np.random.default_rng(3)
    made = Places()
    for _ in SIDES_M:
        fixed = 0.2 * (1.0 + spread * rng.uniform(-1.0, 1.0, count))
        ratio = np.broadcast_to(policy, count) * (1.0 + spread * rng.uniform(-1.0, 1.0, count))
        cost = {"policy": fixed * ratio, "rule": fixed, "search": 0.9 * fixed}
        made.squares.append(
            Square(cost, np.stack([fixed, 5.0 * fixed]), np.ones(count) if weight is None else weight)
        )
    return made


def report(made):
    return made.report(ALLOWED, ACTIONS)


def test_a_policy_that_is_better_everywhere_has_no_tail():
    found = report(places(0.97, spread=0.01))
    assert found["best_fixed"] == "10+0+10"
    assert found["vs_best_fixed_low_pct"] < found["vs_best_fixed_pct"] < found["vs_best_fixed_high_pct"] < 0.0
    assert found["vs_best_fixed_pct"] == pytest.approx(-3.0, abs=0.3)
    assert (found["places"], found["places_worse"]) == (600, 0)
    assert found["places_worse_high_pct"] < 1.0
    assert found["ratio_max"] < 1.0


def test_bad_places_are_counted_although_the_mean_is_good():
    made = places(0.97)
    made.squares[5].cost["policy"][:3] = 0.8
    made.squares[1].cost["policy"] *= 1.04
    found = report(made)
    assert found["vs_best_fixed_pct"] < 0.0  # on average the policy is still better
    assert (found["places_worse"], found["worse_side_10000"], found["worse_side_5000"]) == (3, 3, 0)
    assert found["places_worse_pct"] == 0.5
    assert found["places_worse_low_pct"] < 0.5 < found["places_worse_high_pct"]
    assert found["ratio_max"] == pytest.approx(4.0)
    words = _tail(found)
    assert "In 3 of 600 places the policy is more than 5 % worse" in words
    assert ": 3 of 100 at 10,000 m." in words
    assert "4.00 at most" in words
    assert "In the square where it does worst (10,000 m): +6.1 %" in words
    assert found["vs_side_500_pct"] == pytest.approx(0.88)


def test_the_interval_is_wide_where_few_places_decide():
    """One place in a hundred has all the weight of the square."""
    weight = np.full(100, 1e-6)
    weight[::25] = 1.0

    def width(made):
        found = report(made)
        return found["vs_best_fixed_high_pct"] - found["vs_best_fixed_low_pct"]

    policy = np.where(np.arange(100) % 2, 0.6, 1.4)
    assert width(places(policy, weight=weight)) > width(places(policy, weight=np.ones(100))) > 0.0


def test_places_without_weight_do_not_count_as_worse():
    found = report(places(2.0, weight=np.full(100, 1e-4)))
    assert (found["places"], found["places_worse"], found["ratio_max"]) == (0, 0, 1.0)
    assert "none is compared by itself" in _tail(found)


def test_an_action_that_is_not_allowed_is_not_the_best_fixed_one():
    assert places().report(np.array([False, True]), ACTIONS)["best_fixed"] == "0+0+2"


def test_few_places_have_no_interval():
    """The bootstrap of a few skewed values is too narrow."""
    ends = {"vs_best_fixed_low_pct", "vs_best_fixed_high_pct"}
    assert ends <= report(places(0.97, count=30, spread=0.01)).keys()
    found = report(places(0.97, count=29, spread=0.01))
    assert not ends & found.keys()
    assert "Against the best fixed mode: -3.0 % (too few places for an interval)." in _tail(found)
