"""Training for a city: the cost of information, the fleets, and those who do not adapt."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
import torch

from companion.atmc.policy import load
from companion.avoidance.kernels.neighbours import KEPT_S
from ground_tools.atmc.env.objective import costs
from ground_tools.atmc.learners import city_policy
from ground_tools.atmc.learners.city_policy import UNHEARD_S, CityLearner, city_objective, price_s


def _learner(seed: int = 1) -> CityLearner:
    small = msgspec.structs.replace(
        city_policy.city_settings(), fleets=((6, 5), (9, 4)), episodes=2, updates=4
    )
    return CityLearner(small, seed)


@pytest.mark.parametrize(("rate", "weight"), [(0.05, 0.3), (0.4, 1.0), (3.0, 0.7)])
def test_the_cost_is_the_age_of_a_track_and_then_the_price_of_an_unknown_aircraft(rate, weight):
    ages = (np.arange(200_000) + 0.5) * (KEPT_S / 200_000)
    known = float((ages * rate * np.exp(-rate * ages)).mean() * KEPT_S)
    lost = math.exp(-rate * KEPT_S)
    found = float(price_s(torch.tensor(rate), torch.tensor(weight)))
    assert found == pytest.approx(weight * known + weight**4 * UNHEARD_S * lost, rel=1e-4)


def test_silence_is_dear_before_a_conflict_and_cheap_far_from_one():
    silent, seldom, often = torch.tensor([0.0, 0.1, 5.0])
    soon, late = torch.tensor(0.9), torch.tensor(0.2)
    assert price_s(silent, soon) > price_s(seldom, soon) > price_s(often, soon)
    assert price_s(seldom, late) > price_s(silent, late)


def test_the_cost_of_an_action_is_the_cost_after_taking_it():
    learner = _learner()
    objective, env = learner._objective, learner._groups[0].env
    channel = objective.channel
    packets = channel.packets(env.air.reach, channel.loads(env.air.reach, env.action))
    own = objective.own(env.air, packets, torch.tensor([2]))[:, 0]
    for action in (0, 11, 30, len(channel.actions) - 1):
        taken = env.action.clone()
        taken[:, 2] = action
        after = costs(city_objective(), env.air, taken)[:, 2]
        # What the others hear of the sender depends on its own transmissions only through half duplex, which
        # acts on what it receives.
        assert own[:, action].numpy() == pytest.approx(after.numpy(), rel=1e-4)


def test_fleets_have_a_citys_density_and_those_who_do_not_adapt_keep_their_action():
    learner = _learner()
    for _ in range(3):
        learner.train()
        for group in learner._groups:
            env = group.env
            per_km2 = env.aircraft / (env.world.side_m / 1000.0) ** 2
            assert ((per_km2 > 2.99) & (per_km2 < 100.1)).all()
            theirs = env._theirs.expand_as(env.action)
            assert (env.action[env.stubborn] == theirs[env.stubborn]).all()
    assert any(bool(group.env.stubborn.any()) for group in learner._groups)


@pytest.fixture
def few_cases(monkeypatch):
    """Validate with two small fleets instead of ten of up to 200 aircraft."""
    monkeypatch.setattr(city_policy, "_CASES", ((12, 30.0, 0.6), (9, 10.0, 0.0)))


@pytest.mark.usefixtures("few_cases")
def test_a_resumed_run_is_the_uninterrupted_one_and_its_policy_can_be_read():
    whole, first, second = _learner(), _learner(), _learner(2)
    whole.train()
    first.train()
    second.load(first.state())
    assert whole.train() == second.train()
    data = second.frozen("city", second.validate())
    assert data == whole.frozen("city", whole.validate())
    assert load(data, "city").metadata.neighbours == 8


@pytest.mark.usefixtures("few_cases")
def test_the_same_policy_has_the_same_validation_every_time():
    learner = _learner()
    assert learner.validate() == learner.validate()
