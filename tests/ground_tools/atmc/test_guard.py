"""`evaluate` measures a policy with the guard that is used aboard."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from companion.atmc.actions import SET_ACTIONS
from companion.atmc.audible import CROWD
from ground_tools.atmc.commands.evaluate import Frozen
from ground_tools.atmc.env.environment import Observation

POLICY = Path(__file__).parents[3] / "config" / "policies" / "atmc.safetensors"
FLEETS, AIRCRAFT = 8, 40


def observed(heard: int) -> Observation:
    """Random observations in which every aircraft hears the given number of others."""
    generator = torch.Generator().manual_seed(5)
    own = torch.rand((FLEETS, AIRCRAFT, 16), generator=generator)
    rows = torch.rand((FLEETS, AIRCRAFT, AIRCRAFT, 8), generator=generator)
    mask = (torch.arange(AIRCRAFT) < heard).float().expand(FLEETS, AIRCRAFT, AIRCRAFT)
    return Observation(own, rows, mask)


def chosen(heard: int, *, guarded: bool) -> list[tuple[int, int, int]]:
    fleet = Frozen(POLICY.read_bytes(), POLICY.name, guarded=guarded)
    decided = fleet.decide(observed(heard), torch.zeros((FLEETS, AIRCRAFT), dtype=torch.long))
    return [SET_ACTIONS[index] for index in decided.flatten().tolist()]


@pytest.mark.parametrize("heard", [0, 1, CROWD - 1])
def test_with_few_neighbours_the_guard_sends_at_least_the_fixed_set(heard: int) -> None:
    assert all(ble4 == wifi == 10 for ble4, _, wifi in chosen(heard, guarded=True))
    assert any(ble4 < 10 or wifi < 10 for ble4, _, wifi in chosen(heard, guarded=False))


@pytest.mark.parametrize("heard", [CROWD, AIRCRAFT])
def test_in_a_crowd_the_policy_decides_alone(heard: int) -> None:
    assert chosen(heard, guarded=True) == chosen(heard, guarded=False)
