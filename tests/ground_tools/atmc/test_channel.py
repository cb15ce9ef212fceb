"""Compares the PyTorch equations with the NumPy ones, and difference costs with costs after real changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from companion.atmc.actions import PAPER_ACTIONS, SET_ACTIONS
from ground_tools.atmc.env.channel import TorchChannel
from ground_tools.atmc.env.environment import Env, EnvSettings, path_loss_db
from ground_tools.atmc.env.objective import (
    AwarenessObjective,
    PaperObjective,
    age_s,
    costs,
    difference_costs,
)
from ground_tools.atmc.env.tasks import AWARENESS_CHANNEL
from ground_tools.atmc.env.world import WorldSettings
from sitl_mocks.channel.equations.analytic import Analytic, Fleet
from sitl_mocks.channel.link_budget import Links
from sitl_mocks.channel.parameters import ChannelParameters, load

CONFIG = Path(__file__).parents[3] / "config"
WORLD = WorldSettings(sides="any", shadowing_sigma_db=(0.0, 2.5), wifi_channels="either", load=(0.0, 0.8))


def env_of(objective, aircraft, fleets=6, seed=1, world=WORLD):
    generator = torch.Generator().manual_seed(seed)
    return Env(EnvSettings(world=world, lossy=True), objective, fleets, aircraft, generator)


def links_of(env):
    """The same fleets as one set of links, in the form that the NumPy model takes."""
    fleets, aircraft = env.action.shape
    sender, receiver = np.nonzero(~np.eye(aircraft, dtype=bool))
    loss = path_loss_db(env.world.distance_m(), env.channel) + env.world.shadowing_db
    base = np.arange(fleets)[:, None] * aircraft
    return Links(
        fleets * aircraft,
        (base + sender).ravel(),
        (base + receiver).ravel(),
        loss.double().numpy()[:, receiver, sender].ravel(),
    )


def in_numpy(env):
    fleet = Fleet(
        env.channel.rates[env.action].long().numpy().reshape(-1, 3),
        env.world.wifi_channel.numpy().ravel(),
    )
    busy = env.world.busy.double().numpy().reshape(-1, 3)
    return Analytic(env.channel.parameters).evaluate(links_of(env), fleet, busy=busy)


@pytest.fixture(scope="module")
def paper():
    return PaperObjective(TorchChannel(ChannelParameters(), PAPER_ACTIONS))


@pytest.fixture(scope="module")
def awareness():
    return AwarenessObjective(TorchChannel(AWARENESS_CHANNEL, SET_ACTIONS))


def test_awareness_uses_the_channel_of_the_standard_file():
    assert load(CONFIG / "channel/standard.toml") == AWARENESS_CHANNEL


@pytest.mark.parametrize("aircraft", [2, 10, 40])
def test_delays_equal_those_of_the_numpy_model(paper, aircraft):
    env = env_of(paper, aircraft)
    ours = costs(paper, env.air, env.action).double().numpy()
    theirs = in_numpy(env).uav_delay_s().reshape(ours.shape)
    assert ours == pytest.approx(theirs, rel=2e-3)


@pytest.mark.parametrize("aircraft", [2, 10, 40])
def test_ages_follow_from_the_delays_of_the_numpy_model(awareness, aircraft):
    env = env_of(awareness, aircraft)
    found = in_numpy(env)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.where(found.carried, 1.0 / found.delay_s, 0.0).sum(1)
        age = np.where(rate > 1e-4, -np.expm1(-3.0 * rate) / rate, 3.0)
    links = found.links
    weight = env.air.weight.double().numpy()
    fleet, sender = np.divmod(links.transmitter, aircraft)
    receiver = links.receiver % aircraft
    cost = np.bincount(links.transmitter, age * weight[fleet, receiver, sender], links.nodes)
    ours = costs(awareness, env.air, env.action).double().numpy()
    assert ours == pytest.approx(cost.reshape(ours.shape), rel=2e-3, abs=1e-6)


def test_an_age_is_that_of_a_poisson_stream_cut_at_three_seconds():
    rates = torch.tensor([0.0, 0.1, 1.0, 10.0])
    times = torch.linspace(0.0, 3.0, 300_001, dtype=torch.float64)
    expected = [float(torch.trapezoid(torch.exp(-rate * times), times)) for rate in rates]
    assert age_s(rates).tolist() == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("name", ["paper", "awareness"])
@pytest.mark.parametrize("aircraft", [3, 12])
def test_difference_costs_equal_the_cost_of_a_real_change(name, aircraft, request):
    objective = request.getfixturevalue(name)
    env = env_of(objective, aircraft, fleets=1, seed=4)
    _, difference = difference_costs(objective, env.air, env.action)
    actions = len(objective.channel.actions)
    for changed in range(3):
        trials = env.action.repeat(actions, 1)
        trials[:, changed] = torch.arange(actions)
        real = torch.stack([costs(objective, env.air, trial[None]).sum() for trial in trials])
        told = difference[0, changed]
        # The difference cost is first order in the change for the others, so its best choice may cost
        # slightly more. With three aircraft the own radio's deafness is a large part, which is no small step.
        assert float(real[told.argmin()] - real.min()) <= 0.002 * float(real.min())
        assert (told - told.min()).numpy() == pytest.approx(
            (real - real.min()).numpy(), rel=0.1, abs=0.012 * float(real.min())
        )


@pytest.mark.parametrize("name", ["paper", "awareness"])
@pytest.mark.parametrize("side", [300.0, 3000.0])
def test_difference_costs_include_the_effect_on_other_aircraft(name, side, request):
    objective = request.getfixturevalue(name)
    env = env_of(objective, 12, fleets=1, seed=6, world=WorldSettings(sides=side, wifi_channels="random"))
    _, difference = difference_costs(objective, env.air, env.action)
    actions = len(objective.channel.actions)
    for changed in range(4):
        trials = env.action.repeat(actions, 1)
        trials[:, changed] = torch.arange(actions)
        each = torch.cat([costs(objective, env.air, trial[None]) for trial in trials])
        others = each.sum(1) - each[:, changed]
        told = difference[0, changed] - each[:, changed]
        now = env.action[0, changed]
        real, told = others - others[now], told - told[now]
        assert told.numpy() == pytest.approx(real.numpy(), abs=0.1 * float(real.abs().max()) + 1e-5)


@pytest.mark.parametrize("name", ["paper", "awareness"])
def test_an_aircrafts_own_action_adds_no_load_to_its_own_links(name, request):
    objective = request.getfixturevalue(name)
    env = env_of(objective, 2, seed=9)
    loads = objective.channel.loads(env.air.reach, env.action)
    other = env.action.clone()
    other[:, 0] = (other[:, 0] + 7) % len(objective.channel.actions)
    changed = objective.channel.loads(env.air.reach, other)
    for key, load_ in loads.items():
        if load_.shape[1] == 2:  # by link: what reaches receiver 1 from sender 0
            assert torch.equal(load_[:, 1, 0], changed[key][:, 1, 0])


@pytest.mark.parametrize("name", ["paper", "awareness"])
def test_an_undisturbed_delay_is_that_of_two_aircraft_of_which_one_sends(name, request):
    channel = request.getfixturevalue(name).channel
    fleet_of, told = np.array([0, 1]), channel.undisturbed_s()
    links = Links(2, fleet_of, fleet_of[::-1].copy(), np.full(2, 60.0))
    for action in range(0, len(channel.actions), 7):
        rates = np.stack([channel.rates[action].long().numpy(), np.zeros(3, int)])
        found = Analytic(channel.parameters).evaluate(links, Fleet(rates, np.zeros(2, int)))
        assert float(told[action]) == pytest.approx(np.nanmin(found.delay_s[0]), rel=2e-3)


def test_relabelling_aircraft_relabels_costs(awareness):
    env = env_of(awareness, 8, seed=2)
    before = costs(awareness, env.air, env.action)
    order = torch.randperm(8, generator=torch.Generator().manual_seed(1))
    w = env.world
    moved = type(w)(
        w.position_m[:, order],
        w.velocity_mps[:, order],
        w.side_m,
        w.shadowing_db[:, order][:, :, order],
        w.wifi_channel[:, order],
        w.busy[:, order],
    )
    env.place(moved)
    after = costs(awareness, env.air, env.action[:, order])
    assert after.numpy() == pytest.approx(before[:, order].numpy(), rel=1e-4)
