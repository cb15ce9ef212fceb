"""A learner from outside: it trains on the paper's task through PettingZoo, and its policy flies.

    python docs/examples/outside_learner.py --steps 3000 --out outside.safetensors      # two minutes
    sitl-mocks demo --policy outside.safetensors

The learner is forty lines of PyTorch that know nothing of this project but the environment's observations and
delays. It learns the value of each action for the next step (discount 0) with one network for all aircraft.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from torch import nn

from ground_tools.atmc import AtmcParallelEnv, freeze_layers
from ground_tools.atmc.env.paper_task import PaperTask, TaskSettings

BATCH, LEAST_EXPLORATION = 512, 0.05


def train(env: AtmcParallelEnv, steps: int, seed: int) -> nn.Sequential:
    """Train one Q network for all agents: epsilon-greedy, replay of everything, mean square error."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    agents = env.possible_agents
    inputs = env.observation_space(agents[0]).shape[0]
    actions = int(env.action_space(agents[0]).n)
    q = nn.Sequential(
        nn.Linear(inputs, 256), nn.ReLU(), nn.Linear(256, 128), nn.ReLU(), nn.Linear(128, actions)
    )
    adam = torch.optim.Adam(q.parameters(), lr=1e-3)
    seen = torch.zeros(steps * len(agents), inputs)
    taken = torch.zeros(steps * len(agents), dtype=torch.long)
    value = torch.zeros(steps * len(agents))
    observations, _ = env.reset(seed)
    for step in range(steps):
        rows = torch.from_numpy(np.stack([observations[agent] for agent in agents]))
        exploration = max(1.0 - 2.0 * step / steps, LEAST_EXPLORATION)
        with torch.no_grad():
            best = q(rows).argmax(-1).numpy()
        chosen = np.where(
            rng.random(len(agents)) < exploration, rng.integers(actions, size=len(agents)), best
        )
        observations, _, _, over, infos = env.step(dict(zip(agents, chosen.tolist(), strict=True)))
        at = slice(step * len(agents), (step + 1) * len(agents))
        seen[at], taken[at] = rows, torch.from_numpy(chosen)
        # The logarithm of the agent's own delay: halving a short one counts as much as halving a long one.
        value[at] = -torch.tensor([infos[agent]["delay_s"] + 0.02 for agent in agents]).log()
        some = torch.from_numpy(rng.integers(at.stop, size=BATCH))
        found = q(seen[some]).gather(1, taken[some, None])[:, 0]
        loss = (found - value[some]).square().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
        if any(over.values()):
            observations, _ = env.reset()
    return q


def mean_delay_ms(env: AtmcParallelEnv, choose: nn.Module | int, episodes: int, seed: int) -> float:
    """Mean delay of an aircraft over some episodes; an int is the action that all take at every step."""
    agents = env.possible_agents
    delays = []
    observations, _ = env.reset(seed)
    for episode in range(episodes):
        if episode:
            observations, _ = env.reset()
        while env.agents:
            rows = torch.from_numpy(np.stack([observations[agent] for agent in agents]))
            with torch.no_grad():
                all_take = (
                    [choose] * len(agents) if isinstance(choose, int) else choose(rows).argmax(-1).tolist()
                )
            observations, _, _, _, infos = env.step(dict(zip(agents, all_take, strict=True)))
            delays += [1000.0 * infos[agent]["delay_s"] for agent in agents]
    return float(np.mean(delays))


def system_delay_ms(q: nn.Module) -> float:
    """The paper's measure: ten aircraft, the mean over its six sizes, on a fixed validation set."""
    task = PaperTask(TaskSettings(), torch.Generator().manual_seed(1))

    def choose(rows: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            return q(rows).argmax(-1)

    return task.validate(choose)["score"]


def main() -> None:
    """Train, compare with the best fixed action, and write the policy file."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=3000, help="steps of ten aircraft to learn from")
    parser.add_argument("--episodes", type=int, default=2, help="episodes of 100 steps to measure with")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("outside.safetensors"))
    options = parser.parse_args()
    torch.set_num_threads(1)
    env = AtmcParallelEnv()
    q = train(env, options.steps, options.seed)
    ours = mean_delay_ms(env, q, options.episodes, seed=7)
    fixed = {
        action: mean_delay_ms(env, action, options.episodes, seed=7)
        for action in range(int(env.action_space(env.possible_agents[0]).n))
    }
    best = min(fixed, key=fixed.__getitem__)
    print(
        f"mean delay of an aircraft: learned {ours:.0f} ms; best fixed action ({best}) {fixed[best]:.0f} ms"
    )
    print(f"system delay over the paper's six sizes: {system_delay_ms(q):.0f} ms")
    layers = [
        (layer.weight.detach().numpy().T, layer.bias.detach().numpy())
        for layer in q
        if isinstance(layer, nn.Linear)
    ]
    observations, _ = env.reset(seed=9)
    examples = np.stack([observations[agent] for agent in env.possible_agents])
    options.out.write_bytes(freeze_layers(layers, examples, name="outside learner"))
    print(f"wrote {options.out}")


if __name__ == "__main__":
    main()
