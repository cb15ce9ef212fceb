"""The policy of a plug-in, as something that chooses transports (`choice.Mind`).

The plug-in is untrusted: after an exception, or any answer but the index of an allowed action, the chooser
uses its fall-back, as it does for an observation outside a policy's training.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from companion import plugins
from companion.arrays import AnyFloats, Bools
from companion.atmc.actions import Action, legal
from companion.atmc.choice import Choice, Refused, Why
from companion.atmc.networks import PolicyError
from companion.atmc.observation import NEIGHBOUR_COLUMNS, OWN_COLUMNS
from companion.config import policy_plugin
from companion.plugins import Plugin
from companion.remote_id.region import Region
from companion.remote_id.transports import MAX_RATE

_MOST_ACTIONS = 10_000


class OwnPolicy(Protocol):
    """The policy of one aircraft, as a plug-in of `dmuca.policies` returns it when called without arguments.

    Its answers must depend only on the arguments of this and earlier calls, because a replay repeats the
    calls and expects the same answers.
    """

    @property
    def actions(self) -> Sequence[Action]:
        """All actions that it can choose, which never change."""
        ...

    def choose(
        self, own_row: AnyFloats, neighbour_rows: AnyFloats, allowed: Bools, current: int | None
    ) -> int:
        """Choose the action to use now. Returns its index in `actions`.

        Args:
            own_row: shape (own columns,), as in `observation.OWN_COLUMNS`.
            neighbour_rows: shape (neighbours, neighbour columns), as in `observation.NEIGHBOUR_COLUMNS`.
            allowed: shape (actions,); True for the actions that are legal and that the radios can send.
            current: index of the action in use now; None if it is not one of `actions`.
        """
        ...


class PluginPolicy:
    """The policy of a plug-in; implements `Mind`.

    Raises:
        PolicyError: the plug-in makes no policy.
    """

    def __init__(self, plugin: Plugin) -> None:
        self.plugin = plugin
        try:
            self._policy: OwnPolicy = plugin.loaded()
            self._actions = _actions_of(self._policy)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            raise PolicyError(f"{plugin} makes no policy: {plugins.cause(error)}") from error

    @property
    def actions(self) -> tuple[Action, ...]:
        """All actions that it can choose."""
        return self._actions

    def choose(
        self,
        own_row: AnyFloats,
        neighbour_rows: AnyFloats,
        allowed: Bools,
        current: int | None,
        agent: int = 0,
    ) -> Choice | Refused:
        """See `Mind`. The plug-in is not asked where nothing is allowed."""
        if not allowed.any():
            return Refused(Why.NOTHING_ALLOWED, "no set of transports is legal and can be sent")
        arrays = own_row.copy(), neighbour_rows.copy(), allowed.copy()
        try:
            index = operator.index(self._policy.choose(*arrays, current))
            if not 0 <= index < len(self._actions) or not allowed[index]:
                return Refused(Why.BROKEN, f"policy {self.plugin} chose {index}, which is not allowed")
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # also asyncio's CancelledError, which is no Exception
            return Refused(Why.BROKEN, f"policy {self.plugin} failed: {plugins.cause(error)}")
        return Choice(index, self._actions[index])


def plugin_policy(policy: str | None) -> PluginPolicy | None:
    """The policy that a value of `atmc.policy` names, if it names a plug-in; otherwise None.

    Raises:
        ConfigError: the plug-in cannot be loaded.
        PolicyError: it makes no policy.
    """
    name = policy_plugin(policy)
    return None if name is None else PluginPolicy(plugins.load(plugins.POLICIES, name))


def try_out(policy: PluginPolicy, region: Region) -> int:
    """Let a policy make one choice on the ground. Returns the number of its actions that are legal.

    Raises:
        PolicyError: it fails, or none of its actions is legal.
    """
    allowed = legal(policy.actions, region)
    if not allowed.any():
        raise PolicyError(f"policy {policy.plugin}: none of its actions is legal in region {region.name}")
    answer = policy.choose(np.zeros(len(OWN_COLUMNS)), np.zeros((1, len(NEIGHBOUR_COLUMNS))), allowed, None)
    if isinstance(answer, Refused):
        raise PolicyError(answer.text)
    return int(allowed.sum())


def _actions_of(policy: OwnPolicy) -> tuple[Action, ...]:
    """The actions of a policy.

    Raises:
        ValueError: they are no actions.
    """
    actions: list[Action] = []
    for action in policy.actions:
        ble4, ble5, wifi = map(operator.index, action)
        if not all(0 <= rate <= MAX_RATE for rate in (ble4, ble5, wifi)) or not (ble4 or ble5 or wifi):
            raise ValueError(f"actions: {action} is not three rates of 0 to {MAX_RATE}, one of them above 0")
        actions.append((ble4, ble5, wifi))
        if len(actions) > _MOST_ACTIONS:
            raise ValueError(f"actions: there are more than {_MOST_ACTIONS}")
    if not actions or len(set(actions)) < len(actions):
        raise ValueError("actions: there is none, or one is listed twice")
    return tuple(actions)
