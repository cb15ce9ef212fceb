"""Learning of each algorithm: on a task whose best choices are known, and against updates that are computed
by hand for one network at a time."""

from __future__ import annotations

import copy
import math

import pytest
import torch
from torch.nn import functional

from companion.atmc.actions import PAPER_ACTIONS
from ground_tools.atmc.env.objective import costs
from ground_tools.atmc.env.paper_task import PaperTask, TaskSettings
from ground_tools.atmc.env.world import World
from ground_tools.atmc.learners import iac, maddpg, madqn

CPU = torch.device("cpu")
ACTIONS = 5
ARMS = torch.tensor([1, 3, 0])
UNCLIPPED = 1e9
FILLED_BY_ONE = {"buffer_steps": 30, "learn_every": 31}
"""One episode of 30 steps fills the buffer, and nothing is learned."""


class Bandit:
    """Replacement of the task: the reward is 0 for each aircraft's own arm and less for all others,
    independent of the observation."""

    def __init__(self, settings, generator):
        self._generator = generator
        self.device, self.inputs, self.actions = generator.device, 3, PAPER_ACTIONS[:ACTIONS]
        self.uavs = settings.uavs
        self.arms = ARMS.repeat(self.uavs)[: self.uavs]
        self.worth = 1.0
        self.taken = []

    def reset(self):
        return torch.rand(self.uavs, self.inputs, generator=self._generator)

    def step(self, action):
        self.taken.append(action)
        lost = self.worth * (action != self.arms)
        return self.reset(), -lost, lost

    def counts(self):
        """Share of each action in all actions taken."""
        return torch.bincount(torch.cat(self.taken), minlength=ACTIONS) / sum(map(len, self.taken))


@pytest.fixture(autouse=True)
def _bandit(monkeypatch):
    for module in (iac, maddpg, madqn):
        monkeypatch.setattr(module, "PaperTask", Bandit)


def of(module, uavs=3, steps=20, **changes):
    make, settings = {
        madqn: (madqn.Madqn, madqn.MadqnSettings),
        iac: (iac.Iac, iac.IacSettings),
        maddpg: (maddpg.Maddpg, maddpg.MaddpgSettings),
    }[module]
    task = TaskSettings(uavs=uavs, steps=steps)
    return make(settings(**{"task": task, "hidden": (8,), "discount": 0.5} | changes), 1, CPU)


def redrawn(stack, seed):
    """Replace weights and biases by random ones, in place."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in stack.parameters():
            parameter.copy_(torch.rand(parameter.shape, generator=generator) - 0.5)


def biased(stack, logits):
    """Make the outputs independent of the input."""
    with torch.no_grad():
        for parameter in stack.parameters():
            parameter.zero_()
        stack.biases[-1] += torch.tensor(logits)


def alone(stack, n, x):
    """Outputs of network n, (batch, outputs)."""
    for index, (weight, bias) in enumerate(zip(stack.weights, stack.biases, strict=True)):
        x = (x.relu() if index else x) @ weight[n] + bias[n]
    return x


def stepped(stack, loss, rate):
    """Parameters of a stack after a step of plain gradient descent."""
    parameters = list(stack.parameters())
    gradients = torch.autograd.grad(loss, parameters)
    return [p.detach() - rate * g for p, g in zip(parameters, gradients, strict=True)]


def assert_is(stack, parameters):
    for found, wanted in zip(stack.parameters(), parameters, strict=True):
        torch.testing.assert_close(found.detach(), wanted, atol=1e-5, rtol=1e-4)


def between(target, network, share):
    return [
        share * b.detach() + (1.0 - share) * a.detach()
        for a, b in zip(target.parameters(), network.parameters(), strict=True)
    ]


def twin(generator):
    return torch.Generator().set_state(generator.get_state())


# ------------------------------------------------------------ every algorithm


@pytest.mark.parametrize(
    ("module", "episodes", "changes"),
    [
        (madqn, 8, {"buffer_steps": 40, "batch": 32, "learning_rate": 2e-2}),
        (iac, 20, {"learn_every": 10, "learning_rate": 5e-2}),
        (
            maddpg,
            12,
            {"buffer_steps": 40, "batch": 32, "learn_every": 1, "actor_rate": 2e-2, "critic_rate": 2e-2},
        ),
    ],
    ids=["madqn", "iac", "maddpg"],
)
def test_each_aircraft_finds_its_own_best_choice(module, episodes, changes):
    learner = of(module, **changes)
    for _ in range(episodes):
        learner.train()
    seen = torch.rand(20, 3, 3, generator=torch.Generator().manual_seed(2))
    assert learner._best(seen).tolist() == [ARMS.tolist()] * 20


@pytest.mark.parametrize("module", [iac, maddpg], ids=["iac", "maddpg"])
def test_actions_are_drawn_with_the_actors_probabilities(module):
    """The shares of the actions are the probabilities of the softmax."""
    changes = {"learning_rate": 1e-9} if module is iac else {"exploration": 0.0, **FILLED_BY_ONE}
    learner = of(module, uavs=100, steps=30, **changes)
    logits = [2.0, 1.0, 0.0, 1.0, -1.0]
    biased(learner.actor, logits)
    learner.train()
    learner._task.taken.clear()  # MADDPG fills its buffer with random choices
    learner.train()
    wanted = torch.softmax(torch.tensor(logits), 0)
    torch.testing.assert_close(learner._task.counts(), wanted, atol=0.04, rtol=0.0)


# ------------------------------------------------------------ MADQN


@pytest.mark.parametrize("rate", [0.0, 0.25, 1.0])
def test_exploration_is_the_share_of_random_choices(rate):
    learner = of(madqn, uavs=100, steps=30, first_exploration=rate, last_exploration=rate)
    biased(learner.network, [0.0, 0.0, 1.0, 0.0, 0.0])
    learner.train()
    wanted = torch.full((ACTIONS,), rate / ACTIONS)
    wanted[2] += 1.0 - rate
    torch.testing.assert_close(learner._task.counts(), wanted, atol=0.04 if rate else 0.0, rtol=0.0)


def test_a_q_update_bootstraps_from_the_target_network_which_is_soft_updated():
    learner = of(madqn, buffer_steps=20, batch=16, soft_update=0.25)
    redrawn(learner.target, 5)
    learner._adam = torch.optim.SGD(learner.network.parameters(), lr=0.1)
    network, target = copy.deepcopy(learner.network), copy.deepcopy(learner.target)
    seen = learner._task.reset()
    for step in range(20):
        action = torch.tensor([step, step + 1, step + 2]) % ACTIONS
        learner.replay.add(seen, action, -0.1 * action, learner._task.reset())
    batch = learner.replay.sample(16, 3, twin(learner._generator))
    loss = torch.zeros(())
    for n in range(3):
        wanted = batch.reward[n] + 0.5 * alone(target, n, batch.then[n]).detach().max(1).values
        value = alone(network, n, batch.seen[n])[torch.arange(16), batch.action[n]]
        loss = loss + functional.mse_loss(value, wanted)
    wanted_network = stepped(network, loss, 0.1)
    learner._learn()
    assert_is(learner.network, wanted_network)
    assert_is(learner.target, between(target, learner.network, 0.25))


# ------------------------------------------------------------ IAC


def test_an_entropy_bonus_evens_out_the_choices():
    """The actors prefer an action without a reason: all rewards are equal, and the critics have learned
    this."""
    learner = of(iac, learning_rate=1e-2, entropy=0.1)
    learner._task.worth = 0.0
    biased(learner.actor, [2.0, 1.0, 0.0, 0.0, 0.0])
    biased(learner.critic, [0.0])

    def entropy():
        p = torch.softmax(learner.actor.of_all(torch.zeros(1, 3, 3)), -1).detach()
        return -(p * p.log()).sum(-1)

    before = entropy()
    for _ in range(10):
        learner.train()
    assert (entropy() > before + 0.01).all()


def test_an_actor_critic_update_is_worked_out_by_hand():
    learner = of(iac, entropy=0.1, gradient_clip=UNCLIPPED)
    learner._adam = torch.optim.SGD(learner._parameters, lr=0.1)
    actor, critic = copy.deepcopy(learner.actor), copy.deepcopy(learner.critic)
    seen = [learner._task.reset() for _ in range(3)]
    path = [
        (seen[0], torch.tensor([0, 1, 2]), torch.tensor([-1.0, 0.0, 0.5])),
        (seen[1], torch.tensor([4, 1, 0]), torch.tensor([0.0, -2.0, 0.5])),
    ]
    actor_loss, critic_loss = torch.zeros(()), torch.zeros(())
    for n in range(3):
        last = path[1][2][n] + 0.5 * alone(critic, n, seen[2][n]).item()
        for step, wanted in enumerate((path[0][2][n] + 0.5 * last, last)):
            missing = wanted - alone(critic, n, seen[step][n]).squeeze()
            p = torch.softmax(alone(actor, n, seen[step][n]).squeeze(), 0)
            critic_loss = critic_loss + missing.square() / 2.0
            good = missing.item() * p[path[step][1][n]].log() - 0.1 * (p * p.log()).sum()
            actor_loss = actor_loss - good / 2.0
    wanted_actor, wanted_critic = stepped(actor, actor_loss, 0.1), stepped(critic, critic_loss, 0.1)
    learner._learn(path, seen[2])
    assert_is(learner.actor, wanted_actor)
    assert_is(learner.critic, wanted_critic)


# ------------------------------------------------------------ MADDPG


@pytest.fixture
def filled():
    """A MADDPG learner with a full buffer, before its first update; its target networks differ from its
    networks."""
    return full_maddpg(policy_gradient="gumbel", reward="standardised", entropy=1e-12, first_entropy=1e-12)


def full_maddpg(**changes):
    changes = {"gradient_clip": UNCLIPPED} | changes
    learner = of(maddpg, buffer_steps=20, batch=16, learn_every=21, soft_update=0.25, **changes)
    learner._task.worth = 4.0
    learner.train()
    for seed, stack in enumerate(
        (learner.actor, learner.critic, learner.actor_target, learner.critic_target)
    ):
        redrawn(stack, seed)
    learner._actor_adam = torch.optim.SGD(learner.actor.parameters(), lr=0.1)
    learner._critic_adam = torch.optim.SGD(learner.critic.parameters(), lr=0.1)
    return learner


def drawn(logits, generator):
    """One-hot choices, and the softmax from which they are drawn."""
    noise = -torch.empty_like(logits).exponential_(generator=generator).log()
    soft = torch.softmax(logits + noise, -1)
    return functional.one_hot(soft.argmax(-1), ACTIONS).float(), soft


def together(seen, choice):
    """Observations and actions of the whole fleet, (batch, fleet's row)."""
    return torch.cat([part for n in range(3) for part in (seen[n], choice[n])], -1)


def test_a_maddpg_update_is_worked_out_by_hand(filled):
    s, generator = filled.settings, twin(filled._generator)
    actor, critic = copy.deepcopy(filled.actor), copy.deepcopy(filled.critic)
    actor_target, critic_target = copy.deepcopy(filled.actor_target), copy.deepcopy(filled.critic_target)
    rewards = filled.replay.reward
    assert rewards.unique().tolist() == [-4.0, 0.0]
    batch = filled.replay.sample_steps(16, generator)
    taken = functional.one_hot(batch.action, ACTIONS).float()

    logits = torch.stack([alone(actor_target, n, batch.then[n]) for n in range(3)])
    then = together(batch.then, drawn(logits, generator)[0])
    loss = torch.zeros(())
    for n in range(3):
        standard = (batch.reward[n] - rewards.mean()) / rewards.std()
        wanted = standard + 0.5 * alone(critic_target, n, then)[:, 0].detach()
        loss = loss + functional.mse_loss(alone(critic, n, together(batch.seen, taken))[:, 0], wanted)
    wanted_critic = stepped(critic, loss, 0.1)

    filled._learn()
    assert_is(filled.critic, wanted_critic)

    logits = torch.stack([alone(actor, n, batch.seen[n]) for n in range(3)])
    hard, soft = drawn(logits, generator)
    loss = torch.zeros(())
    for n in range(3):
        choice = taken.clone()
        choice[n] = hard[n] + soft[n] - soft[n].detach()
        value = alone(filled.critic, n, together(batch.seen, choice))
        loss = loss - value.mean() + s.logit_cost * logits[n].square().mean()
    assert_is(filled.actor, stepped(actor, loss, 0.1))

    assert_is(filled.actor_target, between(actor_target, filled.actor, 0.25))
    assert_is(filled.critic_target, between(critic_target, filled.critic, 0.25))


def test_an_exact_maddpg_gradient_is_the_sum_over_all_choices():
    learner = full_maddpg(policy_gradient="exact", reward="log", first_entropy=0.3, actor_batch=10)
    s, generator = learner.settings, twin(learner._generator)
    actor = copy.deepcopy(learner.actor)
    rewards = learner.replay.reward
    assert rewards.unique().tolist() == pytest.approx([-math.log(4.02), -math.log(0.02)])
    batch = learner.replay.sample_steps(16, generator)
    seen = batch.seen[:, :10]
    taken = functional.one_hot(batch.action, ACTIONS).float()[:, :10]

    learner._learn()

    loss = torch.zeros(())
    for n in range(3):
        logits = alone(actor, n, seen[n])
        share = torch.softmax(logits, -1)
        for action in range(ACTIONS):
            choice = taken.clone()
            choice[n] = functional.one_hot(torch.tensor(action), ACTIONS).float()
            value = alone(learner.critic, n, together(seen, choice))[:, 0].detach()
            loss = loss - (share[:, action] * value).mean()
        entropy = -(share * share.log()).sum(-1)
        loss = loss - 0.3 * entropy.mean() + s.logit_cost * logits.square().mean()
    assert_is(learner.actor, stepped(actor, loss, 0.1))


def test_maddpg_explores_by_a_share_of_random_choices():
    learner = of(maddpg, uavs=100, steps=30, exploration=0.5, **FILLED_BY_ONE)
    biased(learner.actor, [20.0, 0.0, 0.0, 0.0, 0.0])
    learner.train()
    torch.testing.assert_close(learner._task.counts(), torch.full((5,), 0.2), atol=0.04, rtol=0.0)
    learner._task.taken.clear()
    learner.train()
    wanted = torch.tensor([0.6, 0.1, 0.1, 0.1, 0.1])
    torch.testing.assert_close(learner._task.counts(), wanted, atol=0.04, rtol=0.0)


class Signposts(Bandit):
    """A task in which the observation shows the best choice: the column of the greatest number. A policy that
    ignores the observation is wrong in two of three choices."""

    def step(self, action):
        best = self._seen.argmax(-1)
        lost = 1.0 * (action != best)
        return self.reset(), -lost, lost

    def reset(self):
        self._seen = super().reset()
        return self._seen


@pytest.mark.parametrize(
    ("module", "episodes", "changes"),
    [
        (madqn, 60, {"buffer_steps": 400, "batch": 64, "learning_rate": 5e-3, "exploration_episodes": 60}),
        (iac, 200, {"learning_rate": 2e-2}),
        (
            maddpg,
            60,
            {"buffer_steps": 400, "batch": 64, "learn_every": 1, "actor_rate": 5e-3, "critic_rate": 1e-2},
        ),
    ],
    ids=["madqn", "iac", "maddpg"],
)
def test_choices_depend_on_the_observation(monkeypatch, module, episodes, changes):
    """A learner that always makes the same choice for an aircraft fails this test."""
    monkeypatch.setattr(module, "PaperTask", Signposts)
    learner = of(module, **{"hidden": (32,), "discount": 0.0} | changes)
    for _ in range(episodes):
        learner.train()
    seen = torch.rand(200, 3, 3, generator=torch.Generator().manual_seed(2))
    right = (learner._best(seen) == seen.argmax(-1)).float().mean((0,))
    assert right.min() > 0.85


# ------------------------------------------------------------ the paper's task


@pytest.fixture(scope="module")
def task():
    return PaperTask(TaskSettings(uavs=4), torch.Generator().manual_seed(1))


@pytest.mark.parametrize(
    ("weights", "wanted"),
    [
        ((1.0, 1.0), [0.1, -0.3, 0.0, -1.3]),
        ((1.0, 0.0), [-0.1, -0.3, 0.0, -0.8]),
        ((0.0, 2.0), [0.4, 0.0, 0.0, -1.0]),
    ],
)
def test_reward_is_local_and_global(task, monkeypatch, weights, wanted):
    """r = -alpha d + beta (mean d - d), and 0 for an aircraft that reaches nobody."""
    local, shared = weights
    monkeypatch.setattr(task, "settings", TaskSettings(uavs=4, local_weight=local, global_weight=shared))
    monkeypatch.setattr(task._env, "act", lambda action: torch.tensor([[0.1, 0.3, 0.0, 0.8]]))
    _, reward, cost_s = task.step(torch.zeros(4, dtype=torch.long))
    assert cost_s.tolist() == pytest.approx([0.1, 0.3, 0.0, 0.8])
    assert reward.tolist() == pytest.approx(wanted, abs=1e-6)


def test_reward_is_that_of_the_fleet_before_it_moves(task):
    """The fleet has three aircraft close to each other and one that nobody hears."""
    position = torch.tensor([[[0.0, 0, 50], [30, 0, 50], [0, 60, 50], [9000, 9000, 50]]])
    still = World(
        position,
        torch.zeros(1, 4, 3),
        torch.tensor([10_000.0]),
        torch.zeros(1, 4, 4),
        torch.ones(1, 4, dtype=torch.long),
        torch.zeros(1, 4, 3),
    )
    task.reset()
    task._env.place(still)
    action = torch.tensor([0, 12, 29, 29])
    wanted = costs(task.objective, task._env.air, action[None])[0].tolist()
    _, reward, cost_s = task.step(action)
    assert cost_s.tolist() == pytest.approx(wanted)
    assert min(wanted[:3]) > 0.0 == wanted[3]
    assert len(set(wanted)) == 4
    mean = math.fsum(wanted) / 4.0
    found = [-cost + (mean - cost) for cost in wanted[:3]]
    assert reward.tolist() == pytest.approx([*found, 0.0], rel=1e-5)
    assert not torch.equal(task._env.world.position_m, position)


def test_measuring_starts_after_a_policy_observes_its_own_choices(task, monkeypatch):
    """A policy that needs two choices to get from random actions to Wi-Fi scores like Wi-Fi alone."""
    few = TaskSettings(uavs=4, validation_environments=4, validation_steps=2)
    monkeypatch.setattr(task, "settings", few)

    def settling(seen):
        return torch.where(seen[..., 0] > 0, 15, 29)  # from Bluetooth 4 via Bluetooth 5

    def wifi(seen):
        return torch.full(seen.shape[:-1], 29)

    assert task.validate(settling) == task.validate(wifi)
    assert task.validate(lambda seen: torch.full(seen.shape[:-1], 15)) != task.validate(wifi)
