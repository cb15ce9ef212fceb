"""The PettingZoo environment: the library's own tests, and agreement with the batched environment."""

from __future__ import annotations

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

from companion.atmc.actions import PAPER_ACTIONS
from ground_tools.atmc.env.objective import awareness_objective
from ground_tools.atmc.env.parallel_env import AtmcParallelEnv


def test_the_environment_passes_pettingzoos_tests(recwarn):
    parallel_api_test(AtmcParallelEnv(steps=20), num_cycles=60)
    assert not [str(w.message) for w in recwarn if "pettingzoo" in str(w.filename)]


def test_the_same_seed_gives_the_same_episode():
    parallel_seed_test(lambda: AtmcParallelEnv(steps=20), num_cycles=10)


def test_an_episode_ends_by_time_only():
    env = AtmcParallelEnv(aircraft=3, steps=2)
    env.reset(seed=1)
    for over in (False, True):
        _, _, terminated, truncated, _ = env.step(dict.fromkeys(env.agents, 0))
        assert not any(terminated.values())
        assert set(truncated.values()) == {over}
    assert env.agents == []


def test_reward_is_the_paper_s():
    env = AtmcParallelEnv(steps=5)
    env.reset(seed=3)
    for action in (29, 8):
        _, reward, _, _, infos = env.step(dict.fromkeys(env.agents, action))
        cost_s = np.array([info["delay_s"] for info in infos.values()])
        wanted = np.where(cost_s > 0, -cost_s + (cost_s.mean() - cost_s), 0.0)
        assert list(reward.values()) == pytest.approx(wanted, abs=1e-5)


def test_the_task_of_the_policy_that_flies_has_one_reward_for_all(recwarn):
    env = AtmcParallelEnv(aircraft=3, steps=20, objective=awareness_objective())
    parallel_api_test(env, num_cycles=30)
    assert env.action_space("uav_0").n > len(PAPER_ACTIONS)
    env.reset(seed=3)
    _, reward, _, _, infos = env.step(dict.fromkeys(env.agents, 4))
    costs_s = [info["cost_s"] for info in infos.values()]
    assert min(costs_s) >= 0.0 < max(costs_s)
    assert list(reward.values()) == pytest.approx([-np.mean(costs_s)] * 3)


def test_an_objective_has_its_own_actions():
    with pytest.raises(ValueError, match="leave out both arguments"):
        AtmcParallelEnv(actions=PAPER_ACTIONS, objective=awareness_objective())
