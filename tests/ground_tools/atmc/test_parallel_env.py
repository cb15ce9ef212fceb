"""The PettingZoo environment: its library's own tests, and that it is the batched one."""

from __future__ import annotations

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

from ground_tools.atmc.env.parallel_env import AtmcParallelEnv


def test_pettingzoo_takes_it(recwarn):
    parallel_api_test(AtmcParallelEnv(steps=20), num_cycles=60)
    assert not [str(w.message) for w in recwarn if "pettingzoo" in str(w.filename)]


def test_the_same_seed_gives_the_same():
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
