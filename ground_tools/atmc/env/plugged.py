"""The policy of a plug-in as a `Decider` of whole fleets."""

from __future__ import annotations

import torch
from torch import Tensor

from companion.arrays import Bools
from companion.atmc.audible import CROWD, audible
from companion.atmc.choice import Refused
from companion.atmc.plugin_policy import PluginPolicy
from companion.errors import ConfigError
from ground_tools.atmc.env.environment import Observation


class Plugged:
    """Asks the policy of a plug-in for one aircraft after the other. A `Decider`.

    One policy decides for all aircraft, so it must not keep state from earlier decisions.

    Args:
        allowed: shape (actions,), which actions may be chosen.
        guarded: whether the guard that is used aboard decides with it (`companion.atmc.audible`).
    """

    def __init__(self, policy: PluginPolicy, allowed: Bools, *, guarded: bool = False) -> None:
        self._policy = policy
        self._allowed = allowed
        self._of_few = audible(policy.actions, allowed) if guarded else allowed

    def decide(self, seen: Observation, action: Tensor) -> Tensor:
        """See `Decider.decide`.

        Raises:
            ConfigError: the policy fails or refuses. In flight the fall-back would decide instead, and the
                measurement would be that of the fall-back.
        """
        own, rows, heard = seen.own.double().numpy(), seen.rows.double().numpy(), seen.heard.numpy() > 0
        chosen = torch.empty_like(action)
        for fleet in range(action.shape[0]):
            for aircraft in range(action.shape[1]):
                at = fleet, aircraft
                allowed = self._of_few if heard[at].sum() < CROWD else self._allowed
                answer = self._policy.choose(own[at], rows[at][heard[at]], allowed, int(action[at]))
                if isinstance(answer, Refused):
                    raise ConfigError(answer.text)
                chosen[at] = answer.index
        return chosen
