"""Details of Algorithm 1, and properties of every algorithm."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
from msgspec.structs import replace
from torch import nn

from companion.atmc import policy
from companion.atmc.observation import NEIGHBOUR_COLUMNS, OWN_COLUMNS
from ground_tools.atmc.env.environment import Env, EnvSettings
from ground_tools.atmc.env.flat_observation import (
    FLAT_NEIGHBOUR_COLUMNS,
    FLAT_OWN_COLUMNS,
    flat,
    whole_rows,
)
from ground_tools.atmc.env.paper_task import PaperTask, TaskSettings, measure
from ground_tools.atmc.learners.algorithms import ALGORITHMS
from ground_tools.atmc.learners.iac import discounted
from ground_tools.atmc.learners.madqn import Madqn, MadqnSettings, exploration_rate, td_target
from ground_tools.atmc.learners.replay_buffer import Replay
from ground_tools.atmc.learners.stack import Stack, clipped, frozen, soft_update, thawed

CPU = torch.device("cpu")
TASK = TaskSettings(uavs=4, steps=10, validation_environments=2, validation_steps=2)
TINY = {"task": TASK, "hidden": (16, 8)}
REPLAY = {"batch": 16, "buffer_steps": 15}
CHANGES = {
    "madqn": {**TINY, **REPLAY},
    "madqn-shared": {**TINY, **REPLAY},
    "maddpg": {**TINY, **REPLAY, "learn_every": 2},
    "iac": TINY,
}


def tiny(algorithm: str, seed: int = 1, episodes: int = 4):
    parts = ALGORITHMS[algorithm].parts()
    settings = replace(parts.settings, episodes=episodes, **CHANGES[algorithm])
    return parts.make(settings, seed, CPU)


def same(a: object, b: object) -> bool:
    if isinstance(a, torch.Tensor):
        return torch.equal(a, b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return a == b or (a != a and b != b)


# ------------------------------------------------------------ Algorithm 1


def test_defaults_are_those_of_the_paper_s_table():
    s = MadqnSettings()
    assert (s.batch, s.buffer_steps, s.discount, s.learning_rate) == (256, 25_000, 0.95, 1e-4)
    assert (s.soft_update, s.first_exploration, s.last_exploration) == (0.999, 1.0, 0.1)
    assert (s.exploration_episodes, s.episodes, s.task.steps, s.hidden) == (500, 1000, 100, (256, 128))
    assert (s.task.local_weight, s.task.global_weight, s.task.uavs) == (1.0, 1.0, 10)


@pytest.mark.parametrize(
    ("episode", "rate"), [(1, 0.9982), (250, 0.55), (499, 0.1018), (500, 0.1), (1000, 0.1)]
)
def test_exploration_falls_along_a_line(episode, rate):
    assert exploration_rate(MadqnSettings(), episode) == pytest.approx(rate)


def test_target_looks_one_step_ahead():
    values = torch.tensor([[-3.0, -2.0], [-1.0, -4.0]])
    assert td_target(torch.tensor([-0.5, 0.25]), values, 0.95).tolist() == pytest.approx([-2.4, -0.7])


def test_an_update_moves_to_the_target_worked_out_by_hand():
    """One network without hidden layers and one experience: a step of plain gradient descent, computed by
    hand."""
    learner = tiny("madqn-shared")
    learner.network = Stack(1, (learner._task.inputs, 30), learner._generator)
    learner.target = copy.deepcopy(learner.network)
    learner._adam = torch.optim.SGD(learner.network.parameters(), lr=0.1)
    x, y = torch.zeros(4, learner._task.inputs), torch.zeros(4, learner._task.inputs)
    x[:, 2], y[:, 5] = 1.0, 1.0
    for _ in range(15):
        learner.replay.add(x, torch.full((4,), 7), torch.full((4,), -0.5), y)
    weight = learner.network.weights[0].detach().clone()[0]
    learner._learn()
    error = -0.5 + 0.95 * weight[5].max() - weight[2, 7]
    found = float(learner.network.weights[0].detach()[0, 2, 7])
    assert found == pytest.approx(float(weight[2, 7] + 0.2 * error), abs=1e-6)
    assert float(learner.network.biases[0].detach()[0, 0, 7]) == pytest.approx(float(0.2 * error), abs=1e-6)


def test_soft_update_is_the_paper_s():
    g = torch.Generator().manual_seed(1)
    network, target = Stack(2, (3, 4), g), Stack(2, (3, 4), g)
    wanted = 0.999 * network.weights[0] + 0.001 * target.weights[0]
    soft_update(target, network, 0.999)
    torch.testing.assert_close(target.weights[0], wanted)


def test_nothing_is_learned_before_the_buffer_is_full():
    learner = tiny("madqn")
    before = copy.deepcopy(learner.network.state_dict())
    assert np.isnan(learner.train()["loss"])
    assert same(before, learner.network.state_dict())
    assert not learner.replay.full
    assert learner.train()["loss"] > 0.0
    assert not same(before, learner.network.state_dict())
    assert learner.replay.full


def test_a_stacked_update_is_that_of_ten_networks():
    """The reference is ten PyTorch modules with ten Adam optimisers, the same batches and three updates in a
    row."""
    g = torch.Generator().manual_seed(1)
    stack = Stack(10, (7, 6, 5), g)
    alone = [nn.Sequential(nn.Linear(7, 6), nn.ReLU(), nn.Linear(6, 5)) for _ in range(10)]
    with torch.no_grad():
        for n, net in enumerate(alone):
            for layer, index in ((net[0], 0), (net[2], 1)):
                layer.weight.copy_(stack.weights[index][n].T)
                layer.bias.copy_(stack.biases[index][n, 0])
    adam = torch.optim.Adam(stack.parameters(), lr=1e-2, fused=True)
    adams = [torch.optim.Adam(net.parameters(), lr=1e-2) for net in alone]
    for _ in range(3):
        x, y = torch.randn(10, 32, 7, generator=g), torch.randn(10, 32, 5, generator=g)
        adam.zero_grad()
        (stack(x) - y).square().mean((1, 2)).sum().backward()
        adam.step()
        for n, net in enumerate(alone):
            adams[n].zero_grad()
            (net(x[n]) - y[n]).square().mean().backward()
            adams[n].step()
    for n, net in enumerate(alone):
        torch.testing.assert_close(stack.weights[0][n], net[0].weight.T, atol=1e-5, rtol=1e-4)
        torch.testing.assert_close(stack.biases[1][n, 0], net[2].bias, atol=1e-5, rtol=1e-4)


# ------------------------------------------------------------ parts


def test_buffer_gives_each_network_its_own_aircraft_and_drops_the_oldest():
    replay = Replay(3, 2, 1, CPU)
    for step in range(5):
        seen = torch.tensor([[float(step)], [step + 100.0]])
        replay.add(seen, torch.tensor([step, step]), seen[:, 0], seen + 1.0)
    g = torch.Generator().manual_seed(1)
    batch = replay.sample(200, 2, g)
    assert set(batch.reward[0].tolist()) == {2.0, 3.0, 4.0}
    assert set(batch.reward[1].tolist()) == {102.0, 103.0, 104.0}
    torch.testing.assert_close(batch.then, batch.seen + 1.0)
    assert set(replay.sample(200, 1, g).reward[0].tolist()) == {2.0, 3.0, 4.0, 102.0, 103.0, 104.0}
    steps = replay.sample_steps(50, g)
    torch.testing.assert_close(steps.reward[1], steps.reward[0] + 100.0)


def test_gradients_are_clipped_for_each_network():
    gradients = [torch.ones(2, 3, 4), torch.ones(2, 1, 4)]
    gradients[0][1] *= 0.01
    gradients[1][1] *= 0.01
    found = clipped(gradients, 0.5)
    norms = [sum(float(g[n].square().sum()) for g in found) ** 0.5 for n in range(2)]
    assert norms == pytest.approx([0.5, 0.04])


def test_returns_look_beyond_the_last_step():
    found = discounted(torch.tensor([[1.0, 2.0]]), torch.tensor([10.0]), 0.5)
    assert found.tolist() == [[4.5, 7.0]]


def test_flat_rows_stand_nearest_first():
    task = PaperTask(TASK, torch.Generator().manual_seed(1))
    env = Env(EnvSettings(), task.objective, 50, 6, torch.Generator().manual_seed(2))
    seen = env.observe()
    table = flat(seen)[..., 6:].reshape(50, 6, 5, 8)
    assert torch.equal(table[..., -1].sum(-1), seen.heard.sum(-1))
    there = table[..., -1] > 0
    distance = torch.where(there, table[..., 0], torch.inf)
    assert (distance[..., 1:] >= distance[..., :-1]).all()
    assert (table[~there] == 0).all()
    assert 0 < there.sum() < there.numel()


def test_a_flat_row_becomes_the_observation_of_those_that_are_heard():
    task = PaperTask(TASK, torch.Generator().manual_seed(1))
    seen = Env(EnvSettings(), task.objective, 20, 6, torch.Generator().manual_seed(2)).observe()
    assert 0 < seen.heard.sum() < seen.heard.numel() - 120
    for e, n in np.ndindex(20, 6):
        own, rows = whole_rows(flat(seen)[e, n].numpy())
        heard = seen.rows[e, n][seen.heard[e, n] > 0]
        heard = heard[heard[:, 0].argsort()].numpy()
        columns = [NEIGHBOUR_COLUMNS.index(name) for name in FLAT_NEIGHBOUR_COLUMNS]
        np.testing.assert_array_equal(rows[:, columns], heard[:, columns])
        columns = [OWN_COLUMNS.index(name) for name in FLAT_OWN_COLUMNS]
        np.testing.assert_array_equal(own[columns], seen.own[e, n].numpy()[columns])


def test_a_frozen_policy_chooses_as_the_network_does():
    """The NumPy code aboard, with whole observations, is compared with PyTorch on flat ones."""
    task = PaperTask(TASK, torch.Generator().manual_seed(1))
    env = Env(EnvSettings(), task.objective, 20, 4, torch.Generator().manual_seed(2))
    stack = Stack(4, (task.inputs, 16, 30), torch.Generator().manual_seed(3))
    data = frozen(stack, task.actions, "x", {}, task.examples())
    file = policy.load(data, "x")
    assert same(dict(thawed(data, "x").state_dict()), dict(stack.state_dict()))
    seen = env.observe()
    wanted = stack.of_all(flat(seen)).detach().numpy()
    for e in range(20):
        for n in range(4):
            rows = seen.rows[e, n][seen.heard[e, n] > 0].numpy()
            found = file.values(seen.own[e, n].numpy(), rows, agent=n)
            np.testing.assert_allclose(found, wanted[e, n], atol=1e-5)


def test_fixed_modes_are_measured_as_published():
    """Wi-Fi at 10 messages has 1,871 ms within 1 %, and the published mean at high density."""
    task = PaperTask(TaskSettings(), torch.Generator().manual_seed(1))
    measured = measure(lambda seen: torch.full(seen.shape[:-1], 29), task.objective, 10, 30, 3, 5)
    found = measured.delays_ms
    assert found["high_ms"] == pytest.approx(1900.0, rel=0.01)
    assert found["delay_ms"] == pytest.approx((found["high_ms"] + found["low_ms"]) / 2.0)
    assert sum(measured.uav_ms) == pytest.approx(found["delay_ms"], rel=1e-4)


# ------------------------------------------------------------ every algorithm


@pytest.mark.parametrize("algorithm", CHANGES)
def test_a_resumed_run_is_the_uninterrupted_one(algorithm, tmp_path):
    whole, first, second = tiny(algorithm), tiny(algorithm), tiny(algorithm, seed=99)
    rows = [whole.train() for _ in range(4)]
    for _ in range(2):
        first.train()
        first.validate()
    torch.save(first.state(), tmp_path / "state")
    second.load(torch.load(tmp_path / "state", weights_only=True))
    assert same([second.train() for _ in range(2)], rows[2:])
    assert same(second.state(), whole.state())
    assert second.validate() == whole.validate()


@pytest.mark.parametrize("algorithm", CHANGES)
def test_results_depend_on_the_seed_only(algorithm):
    one, again, other = tiny(algorithm), tiny(algorithm), tiny(algorithm, seed=2)
    assert same([one.train() for _ in range(3)], [again.train() for _ in range(3)])
    other.train()
    assert not same(one.state(), other.state())


@pytest.mark.parametrize("algorithm", CHANGES)
def test_every_algorithm_writes_a_policy_file(algorithm):
    learner = tiny(algorithm)
    data = learner.frozen("name", {"delay_ms": 1.0})
    found = policy.load(data, "name")
    assert found.metadata.agents == (1 if algorithm == "madqn-shared" else 4)
    assert found.metadata.results == {"delay_ms": 1.0}


def test_every_listed_algorithm_is_tested_here():
    trained = {"madqn", "madqn-shared", "maddpg", "iac"}
    assert trained == set(CHANGES) <= set(ALGORITHMS)
    assert isinstance(tiny("madqn"), Madqn)
