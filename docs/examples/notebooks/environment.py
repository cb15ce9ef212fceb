# %% [markdown]
# # The training environment with a learner from outside
#
# `AtmcParallelEnv` is a [PettingZoo](https://pettingzoo.farama.org) `ParallelEnv`: every aircraft is an
# agent that chooses its transports and rates. It needs the extra `train`. Without more words it is the
# paper's task; with `awareness_objective()` it is the task of the policy that flies.

# %%
import numpy as np

from dmuca.training import AtmcParallelEnv, EnvSettings, WorldSettings, awareness_objective

AIRCRAFT = 4
square = EnvSettings(world=WorldSettings(sides=500.0))  # m
paper = AtmcParallelEnv(AIRCRAFT, settings=square)
aware = AtmcParallelEnv(AIRCRAFT, settings=square, objective=awareness_objective())
observations, _ = paper.reset(seed=1)
print(observations["uav_0"].shape, paper.action_space("uav_0"), aware.action_space("uav_0"))

# %% [markdown]
#     (30,) Discrete(30) Discrete(47)
#
# An observation has six numbers of the own transports, then eight for each neighbour, of which the last
# is 1 if it is heard. The learner below sees only how many are heard: a table of the mean reward of each
# action, of which it takes the best half of the time.

# %%
HEARD = slice(6 + 7, None, 8)


def flown(env, choose, steps, learn=None):
    """Mean cost (s) of an agent's messages over some steps, the same ones for every `choose`."""
    observations, _ = env.reset(seed=1)
    costs = []
    for _ in range(steps):
        heard = {agent: int(row[HEARD].sum()) for agent, row in observations.items()}
        actions = {agent: choose(number) for agent, number in heard.items()}
        observations, rewards, _, over, infos = env.step(actions)
        costs += [cost for info in infos.values() for cost in info.values()]
        for agent in heard if learn else ():
            learn(heard[agent], actions[agent], rewards[agent])
        if any(over.values()):
            observations, _ = env.reset()
    return float(np.mean(costs))


def learned(env, steps):
    """The best action for each number of aircraft that are heard."""
    count = int(env.action_space("uav_0").n)
    rng = np.random.default_rng(1)
    total, times = np.zeros((AIRCRAFT, count)), np.full((AIRCRAFT, count), 1e-9)

    def learn(heard, action, reward):
        total[heard, action] += reward
        times[heard, action] += 1.0

    def choose(heard):
        best = int((total[heard] / times[heard]).argmax())
        return int(rng.integers(count)) if rng.random() < 0.5 else best

    flown(env, choose, steps, learn)
    return np.where(times < 1.0, -np.inf, total / times).argmax(1)


# %% [markdown]
# The cost of the paper's task is the mean delay of an aircraft's messages. That of awareness is the age
# of what others know of it, weighted by how soon they could be in conflict. In both the table has less
# than three quarters of the cost of random choices:

# %%
rng = np.random.default_rng(2)
for env in (paper, aware):
    count, best = int(env.action_space("uav_0").n), learned(env, 1000)
    chance = flown(env, lambda heard, count=count: int(rng.integers(count)), 200)
    table = flown(env, lambda heard, best=best: int(best[heard]), 200)
    print(table < 0.75 * chance)

# %% [markdown]
#     True
#     True
#
# [outside_learner.py](../examples/outside_learner.py) is a network for the paper's task that learns from
# whole observations; `freeze_layers` makes a policy file of it, which flies in
# `sitl-mocks demo --policy`. [library.md](../library.md#the-training-environment) shows the environment of
# many fleets at once that the project's own learners use.
