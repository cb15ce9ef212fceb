"""A frozen policy: it chooses transports and their rates from an observation (the paper's section "Algorithm
Design"). It is loaded from bytes, checked with its own golden cases and run in NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from companion.arrays import AnyFloats, Bools, Float32s
from companion.atmc.actions import Action
from companion.atmc.choice import Choice, Refused, Why
from companion.atmc.networks import FlatNetwork, Network, PolicyError, SetNetwork, Tensors
from companion.atmc.observation import NEIGHBOUR_COLUMNS, OWN_COLUMNS
from companion.atmc.policy_file import MAX_BYTES, Bounds, Golden, Metadata, read, write

__all__ = [
    "MAX_BYTES",
    "Bounds",
    "Golden",
    "Metadata",
    "Policy",
    "PolicyError",
    "check_flyable",
    "encode",
    "golden_of",
    "load",
]

GOLDEN_TOLERANCE: Final = 1e-5
"""Largest deviation of a value q from its golden case, relative to max(1, |q|)."""
SLACK: Final = 0.05
"""How far a value may lie outside the bounds of training, in the column's own unit. Every column is of the
order of one."""
_DISTANCE: Final = NEIGHBOUR_COLUMNS.index("log_distance")


class Policy:
    """A loaded policy; implements `Mind`. Its golden cases are not checked here, but in `load`.

    Raises:
        PolicyError: the tensors do not fit the metadata.
    """

    def __init__(self, metadata: Metadata, tensors: Tensors, name: str) -> None:
        m = self.metadata = metadata
        self.name = name
        self._actions: tuple[Action, ...] = m.actions
        own, columns, actions = len(m.own_columns), len(m.neighbour_columns), len(m.actions)
        self._network: Network
        if m.kind == "set":
            self._network = SetNetwork(tensors, own, columns, actions, name)
        else:
            self._network = FlatNetwork(tensors, own, columns, actions, m.neighbours, m.agents, name)
        self._own_columns = _columns(m.own_columns, OWN_COLUMNS)
        self._columns = _columns(m.neighbour_columns, NEIGHBOUR_COLUMNS)
        names = m.neighbour_columns
        self._distance = names.index("log_distance") if "log_distance" in names else None
        b = m.bounds
        self._own_low, self._own_high = _widened(b.own_low, b.own_high)
        self._low, self._high = _widened(b.neighbour_low, b.neighbour_high)

    @property
    def actions(self) -> tuple[Action, ...]:
        """All actions that it can choose."""
        return self._actions

    def values(self, own_row: AnyFloats, neighbour_rows: AnyFloats, agent: int = 0) -> Float32s:
        """Q of each action, shape (actions,). Higher is better; the unit is seconds of cost.

        Args:
            own_row: shape (own columns,), all columns of the schema.
            neighbour_rows: shape (neighbours, neighbour columns), all columns of the schema, in any order of
                rows. A "flat" policy uses only the nearest `metadata.neighbours`.
            agent: which network to use, if each aircraft has its own.
        """
        return self._values(*self._selected(own_row, neighbour_rows), agent)

    def choose(
        self,
        own_row: AnyFloats,
        neighbour_rows: AnyFloats,
        allowed: Bools,
        current: int | None,
        agent: int = 0,
    ) -> Choice | Refused:
        """See `Mind`. Neighbours farther away than any in training are ignored. Refuses observations outside
        the range of training, and network outputs that are not finite."""
        if not allowed.any():
            return Refused(Why.NOTHING_ALLOWED, "none of the policy's actions is legal and can be sent")
        own, rows = self._selected(own_row, neighbour_rows)
        # Negated, so that NaN counts as outside.
        if not ((own >= self._own_low) & (own <= self._own_high)).all():
            return self._outside(own[None], self._own_low, self._own_high, self.metadata.own_columns)
        if self._distance is not None:
            # A neighbour farther away than any in training is irrelevant and must not cause a refusal.
            rows = rows[~(rows[:, self._distance] > self._high[self._distance])]
        most = self.metadata.neighbours
        count = len(neighbour_rows) if self.metadata.kind == "flat" else len(rows)
        if count > most:
            return Refused(Why.TOO_MANY, f"{count} neighbours, trained with up to {most}")
        if not ((rows >= self._low) & (rows <= self._high)).all():
            return self._outside(rows, self._low, self._high, self.metadata.neighbour_columns)
        q = self._values(own, rows, agent)
        if not np.isfinite(q).all():
            return Refused(Why.NO_NUMBER, "the network's answer is not a finite number")
        if current is not None:
            q[current] += self.metadata.switch_price
        index = int(np.where(allowed, q, -np.inf).argmax())
        return Choice(index, self._actions[index])

    def _selected(self, own_row: AnyFloats, neighbour_rows: AnyFloats) -> tuple[Float32s, Float32s]:
        """Columns that the network uses; for a flat network only the nearest neighbours, nearest first."""
        if self.metadata.kind == "flat":
            nearest = np.argsort(neighbour_rows[:, _DISTANCE], kind="stable")[: self.metadata.neighbours]
            neighbour_rows = neighbour_rows[nearest]
        own, rows = own_row.astype(np.float32), neighbour_rows.astype(np.float32)
        if self._own_columns is not None:
            own = own[self._own_columns]
        return own, rows if self._columns is None else rows[:, self._columns]

    def _values(self, own: Float32s, rows: Float32s, agent: int) -> Float32s:
        with np.errstate(all="ignore"):  # the caller checks the result for overflow
            return self._network.values(own, rows, agent)

    def _outside(self, rows: Float32s, low: Float32s, high: Float32s, names: Sequence[str]) -> Refused:
        at, column = np.argwhere(~((rows >= low) & (rows <= high)))[0]
        what = "own" if low is self._own_low else "a neighbour's"
        text = f"{what} {names[column]} {rows[at, column]:.3g}, trained with "
        return Refused(Why.OUTSIDE, f"{text}{low[column] + SLACK:.3g} to {high[column] - SLACK:.3g}")


def _columns(names: Sequence[str], known: Sequence[str]) -> list[int] | None:
    """Indices of the columns; None if they are all known columns in their order."""
    return None if tuple(names) == tuple(known) else [known.index(name) for name in names]


def _widened(low: Sequence[float], high: Sequence[float]) -> tuple[Float32s, Float32s]:
    return np.array(low, np.float32) - np.float32(SLACK), np.array(high, np.float32) + np.float32(SLACK)


def golden_of(policy: Policy, own_row: AnyFloats, neighbour_rows: AnyFloats, agent: int = 0) -> Golden:
    """A golden case from the values that a policy gives now."""
    q = policy.values(own_row, neighbour_rows, agent)
    rows = tuple(tuple(map(float, row)) for row in neighbour_rows)
    return Golden(own=tuple(map(float, own_row)), rows=rows, agent=agent, q=tuple(map(float, q)))


def load(data: bytes, name: str) -> Policy:
    """Read a policy and check it with its golden cases.

    Args:
        data: content of the file.
        name: name of the file, for messages.

    Raises:
        PolicyError: the file cannot be used; the message names the file and what is wrong with it.
    """
    metadata, tensors = read(data, name)
    policy = Policy(metadata, tensors, name)
    for number, case in enumerate(metadata.golden):
        rows = np.array(case.rows, float).reshape(len(case.rows), len(NEIGHBOUR_COLUMNS))
        q, wanted = policy.values(np.array(case.own), rows, case.agent), np.array(case.q)
        # Negated, so that NaN counts as wrong.
        if not (np.abs(q - wanted) <= GOLDEN_TOLERANCE * np.maximum(1.0, np.abs(wanted))).all():
            raise PolicyError(
                f"{name}: golden[{number}]: its outputs differ from those recorded when the policy was frozen"
            )
    return policy


def encode(metadata: Metadata, tensors: Tensors) -> bytes:
    """Content of a policy file, checked by loading it again.

    Args:
        metadata: with its golden cases (`golden_of`); the checksum is filled in.
        tensors: float32, by name, in the layout of torch.nn.Linear.

    Raises:
        PolicyError: `load` would refuse the file.
    """
    data = write(metadata, tensors)
    load(data, metadata.name)
    return data


def check_flyable(policy: Policy, agent: int | None) -> None:
    """Check that a policy can be used on a single aircraft.

    Args:
        agent: which of the policy's networks the aircraft uses; None: not configured.

    Raises:
        PolicyError: the policy has one network for each aircraft of its training, and `agent` names none.
    """
    agents = policy.metadata.agents
    if agents == 1:
        return
    holds = f"{policy.name}: holds {agents} networks, one for each aircraft of its training"
    if agent is None:
        raise PolicyError(f"{holds}; atmc.agent must say which one flies: 0 to {agents - 1}")
    if agent >= agents:
        raise PolicyError(f"{holds}; atmc.agent: {agent} is out of range; allowed: 0 to {agents - 1}")
