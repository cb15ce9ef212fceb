"""Chooses the transports of many aircraft at a time: by a fixed set, the rule, or the frozen policy.

The observations are those of `companion.atmc.senses`, from what the city's aircraft heard. The network of a
policy is evaluated for many aircraft at once; a test compares the choices with `companion.atmc.policy`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Protocol

import numpy as np

from companion.arrays import Bools, Float32s, Floats, Integers
from companion.atmc.actions import TRANSPORTS, Action, legal
from companion.atmc.observation import (
    IDENTITY_BITS,
    LEAST_CLOSING_MPS,
    LOOK_AHEAD_S,
    NEIGHBOUR_COLUMNS,
    SEPARATION_M,
    identity_of,
    own_row,
)
from companion.atmc.policy import SLACK, Policy
from companion.atmc.policy_file import read
from companion.atmc.rule import FLYING_RULE, fixed
from companion.atmc.senses import FEWEST_EXPECTED, FEWEST_SENDERS, NEAR_M, SCAN_SHARE
from companion.errors import ConfigError
from companion.remote_id.region import Region
from companion.traffic.senders.reception import HEARD_S, SHARE_MEMORY_S
from ground_tools.campaign.vehicles import M_POSITION, M_TIME, M_VELOCITY
from ground_tools.city.compiled import compiled, fetch
from ground_tools.city.draws import AHEAD
from ground_tools.city.loop import State
from ground_tools.city.radio.network import SetValues, admit
from ground_tools.city.tables import NOBODY

_SURE_AGAIN: Final = 5
"""Decisions in a row that a policy must not refuse, after a refusal, before it is followed again; as in
`companion.atmc.chooser`."""
_CODE: Final = np.array([1_000_000, 1_000, 1])
"""The product of a set's rates with this is a number that no other set has."""
_compiled = compiled()


class Chooser(Protocol):
    """Chooses the transports of many aircraft."""

    def choose(self, now_s: float, turn: Integers, state: State, rng: np.random.Generator) -> None:
        """Set the rates of the aircraft in these slots."""
        ...

    def refused(self) -> float:
        """Share of the decisions that a policy refused, so that the fall-back was used."""
        ...


@dataclass(frozen=True, slots=True)
class Fixed:
    """Always uses the same set.

    Args:
        action: Locations per second by transport.
    """

    action: Action

    def choose(self, now_s: float, turn: Integers, state: State, rng: np.random.Generator) -> None:
        """See `Chooser`."""
        state.air.rates[turn] = self.action

    def refused(self) -> float:
        """See `Chooser`."""
        return 0.0


class ByRule:
    """The rule of `companion.atmc.rule`: it adds BLE 4 if any aircraft is heard within the range of BLE 4.

    Args:
        region: region whose rules limit the sets.

    Raises:
        ConfigError: a set that the rule wants is not legal in the region.
    """

    def __init__(self, region: Region, most: int) -> None:
        rule = FLYING_RULE
        if not legal((rule.near, rule.far), region).all():
            raise ConfigError(f"region {region.name}: the rule's sets are not legal there")
        self._near, self._far, self._within_m = rule.near, rule.far, rule.within_m
        self._senses = Senses(most)

    def choose(self, now_s: float, turn: Integers, state: State, rng: np.random.Generator) -> None:
        """See `Chooser`."""
        if not len(turn):
            return
        seen = self._senses.look(now_s, turn, state, rng)
        limit = math.log10(self._within_m) / 4.0
        near = seen.least_log_distance <= limit
        state.air.rates[turn] = np.where(near[:, None], self._near, self._far)

    def refused(self) -> float:
        """See `Chooser`."""
        return 0.0


@dataclass(frozen=True, slots=True)
class Seen:
    """Observations of B aircraft; R rows of neighbours in all."""

    own: Floats
    """(B, own columns)."""
    rows: Float32s
    """(R, neighbour columns): all neighbours, one aircraft after the other."""
    count: Integers
    """(B,): number of neighbours of each."""
    least_log_distance: Floats
    """(B,): least value of the column "log_distance"; infinite if nobody is heard."""


class Senses:
    """Builds observations.

    Args:
        most: greatest number of neighbours of one aircraft.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._rows = np.zeros((1, len(NEIGHBOUR_COLUMNS)), np.float32)

    def look(self, now_s: float, turn: Integers, state: State, rng: np.random.Generator) -> Seen:
        """The observations of the aircraft in these slots.

        The share of packets that survive is measured on the nearest senders, with the random error of
        counting for about ten seconds.
        """
        if len(self._rows) < len(turn) * self._most:
            self._rows = np.zeros((len(turn) * self._most, len(NEIGHBOUR_COLUMNS)), np.float32)
        count, least = np.zeros(len(turn), np.int64), np.zeros(len(turn))
        sums = np.zeros((len(turn), 2, len(TRANSPORTS)))
        near = np.zeros((FEWEST_SENDERS, 3))
        used = _observe(now_s, turn, self._most, state, self._rows, count, least, sums, near)
        expected, arriving = sums[:, 0] * SHARE_MEMORY_S, sums[:, 1] * SHARE_MEMORY_S
        measured = (expected >= FEWEST_EXPECTED).astype(float)
        arrived = rng.poisson(arriving)
        share = np.minimum(arrived / np.maximum(expected, 1e-9) / SCAN_SHARE, 1.0)
        rates = state.air.rates[turn]
        identity = np.array([_identity(f) for f in state.air.flight[turn].tolist()])
        own = own_row(np, rates, share, measured, identity.reshape(len(turn), IDENTITY_BITS))
        return Seen(own, self._rows[:used], count, least)


def name_of(flight: int) -> str:
    """Remote ID identity of a flight."""
    return f"city-{flight:07d}"


@lru_cache(maxsize=1 << 16)
def _identity(flight: int) -> tuple[float, ...]:
    return identity_of(name_of(flight))


class ByPolicy:
    """A frozen policy, with the fall-back of `companion.atmc.chooser`.

    Args:
        data, name: contents and name of the policy file.
        region: region whose rules limit the sets.
        slots: number of slots.
        most: capacity of each table of tracks.

    Raises:
        ConfigError: the file cannot be used, or its policy is made for a fixed number of neighbours.
    """

    def __init__(self, data: bytes, name: str, region: Region, slots: int, most: int) -> None:
        metadata, tensors = read(data, name)
        policy = Policy(metadata, tensors, name)
        if metadata.kind != "set" or tuple(metadata.neighbour_columns) != NEIGHBOUR_COLUMNS:
            raise ConfigError(f"{name}: the city needs a policy of kind set, with all columns")
        self._metadata, self._network, bounds = metadata, SetValues(tensors), metadata.bounds
        self._bounds = _widened(bounds.neighbour_low, bounds.neighbour_high)
        self._own_bounds = _widened(bounds.own_low, bounds.own_high)
        self._kept = np.zeros((0, len(NEIGHBOUR_COLUMNS)), np.float32)
        self._allowed: Bools = legal(policy.actions, region)
        self._actions = np.array(policy.actions, np.int64)
        fall_back = fixed(region, TRANSPORTS)
        if fall_back is None or not self._allowed.any():
            raise ConfigError(f"region {region.name}: no set of transports is legal")
        self._fall_back = fall_back
        self._most = most
        self._senses = Senses(most)
        self._doubts, self._flights = np.zeros(slots, np.int64), np.full(slots, NOBODY, np.int64)
        self._decisions = self._refusals = 0

    def choose(self, now_s: float, turn: Integers, state: State, rng: np.random.Generator) -> None:
        """See `Chooser`."""
        if not len(turn):
            return
        air = state.air
        new = air.flight[turn] != self._flights[turn]
        self._doubts[turn[new]], self._flights[turn] = 0, air.flight[turn]
        seen = self._senses.look(now_s, turn, state, rng)
        q, refused = self.values(seen)
        current = (air.rates[turn] @ _CODE)[:, None] == self._actions @ _CODE
        q = np.where(self._allowed, q + np.float32(self._metadata.switch_price) * current, -np.inf)
        chosen = self._actions[q.argmax(axis=1)]
        self._doubts[turn] = np.where(refused, _SURE_AGAIN, np.maximum(self._doubts[turn] - 1, 0))
        follow, doubting = ~refused & (self._doubts[turn] == 0), ~refused & (self._doubts[turn] > 0)
        kept = np.where(doubting[:, None], air.rates[turn], self._fall_back)
        air.rates[turn] = np.where(follow[:, None], chosen, kept)
        self._decisions += len(turn)
        self._refusals += int((~follow).sum())

    def refused(self) -> float:
        """See `Chooser`."""
        return self._refusals / max(self._decisions, 1)

    def values(self, seen: Seen) -> tuple[Float32s, Bools]:
        """Value of each action, (B, actions), and whether the policy refuses the observation, (B,)."""
        own = seen.own.astype(np.float32)
        low, high = self._own_bounds
        refused: Bools = np.asarray(~((own >= low) & (own <= high)).all(axis=1))
        if len(self._kept) < len(seen.rows):
            self._kept = np.zeros((len(seen.rows), len(NEIGHBOUR_COLUMNS)), np.float32)
        count = seen.count.copy()
        distance, most = NEIGHBOUR_COLUMNS.index("log_distance"), self._metadata.neighbours
        used = admit(seen.rows, count, *self._bounds, distance, most, refused, self._kept)
        values = self._network.of(own, self._kept[:used], count)
        return values, np.asarray(refused | ~np.isfinite(values).all(axis=1))


def _widened(low: Sequence[float], high: Sequence[float]) -> tuple[Float32s, Float32s]:
    return np.array(low, np.float32) + np.float32(-SLACK), np.array(high, np.float32) + np.float32(SLACK)


@_compiled
def _observe(
    now: float, turn: Integers, most: int, state: State, rows: Float32s, counts: Integers, least: Floats,
    sums: Floats, near: Floats,
) -> int:  # fmt: skip
    """Write what the aircraft in these slots hear. Returns the number of rows written.

    Args:
        sums: shape (B, 2, 3): written; Location messages per second that the nearest senders send, and how
            many arrive.
        near: shape (FEWEST_SENDERS, 3): working space; overwritten.
    """
    air, tracks, links = state.air, state.tracks, state.links
    used = 0
    for t in range(len(turn)):
        i = turn[t]
        least[t], first = math.inf, used
        close = 0
        near[:, 0] = math.inf
        end = links.start[i + 1]
        for e in range(links.start[i], end):
            if e + AHEAD < end and links.row[e + AHEAD] != NOBODY:
                fetch(tracks.on_s, (i, links.row[e + AHEAD], 0))
                fetch(tracks.heard, (i, links.row[e + AHEAD], 0))
            j, row = links.other[e], links.row[e]
            if row == NOBODY or tracks.who[i, row] != air.flight[j] or used - first == most:
                continue
            heard = False
            for m in range(len(SCAN_SHARE)):
                rows[used, 5 + m] = 0.0
                if now - tracks.on_s[i, row, m] <= HEARD_S:
                    heard = True
                    rows[used, 5 + m] = max(air.rates[j, m], 1) / 10.0
                rows[used, 2 + m] = 1.0 if rows[used, 5 + m] > 0.0 else 0.0
            if not heard:
                continue
            distance, closing = _relative(now, i, row, state)
            rows[used, 0] = math.log10(max(distance, 1.0)) / 4.0
            gap = max(distance - SEPARATION_M, 0.0)
            ratio = gap / (max(closing, LEAST_CLOSING_MPS) * LOOK_AHEAD_S)
            rows[used, 1] = 2.0 ** (-ratio * ratio)
            least[t] = min(least[t], rows[used, 0])
            close += int(distance <= NEAR_M)
            back = links.back[e]
            if distance <= NEAR_M:
                _add(rows[used], links.chance[back], sums[t])
            _keep(distance, used, back, near)
            used += 1
        counts[t] = used - first
        if close < FEWEST_SENDERS:
            sums[t] = 0.0
            for n in range(len(near)):
                if near[n, 0] < math.inf:
                    _add(rows[int(near[n, 1])], links.chance[int(near[n, 2])], sums[t])
    return used


@_compiled
def _add(row: Float32s, fails: Float32s, sums: Floats) -> None:
    """Add the rates and arrivals of a sender to the sums.

    Args:
        row: its row of the observation.
        fails: log probability that one frame on a transport is not received.
    """
    for m in range(len(SCAN_SHARE)):
        if row[5 + m] > 0.0:
            rate = 10.0 * row[5 + m]
            sums[0, m] += rate
            sums[1, m] -= rate * math.expm1(fails[m])


@_compiled
def _keep(distance: float, row: int, link: int, near: Floats) -> None:
    """Keep a sender if it is among the nearest so far.

    Args:
        near: the nearest senders, nearest first: distance, row of the observation, and link to the sender.
    """
    at = len(near)
    while at > 0 and near[at - 1, 0] > distance:
        at -= 1
    if at == len(near):
        return
    for n in range(len(near) - 1, at, -1):
        for c in range(near.shape[1]):
            near[n, c] = near[n - 1, c]
    near[at, 0], near[at, 1], near[at, 2] = distance, row, link


@_compiled
def _relative(now: float, i: int, row: int, state: State) -> tuple[float, float]:
    """Distance (m) of a track now, and the speed (m/s) at which it shrinks."""
    craft, m = state.craft, state.tracks.heard[i, row]
    age = max(now - m[M_TIME], 0.0)
    square = product = 0.0
    for c in range(3):
        speed = m[M_VELOCITY + c]
        away = m[M_POSITION + c] + age * speed - craft.position[i, c] - craft.error[i, c]
        square += away * away
        product += away * (speed - craft.velocity[i, c] - craft.own_error[i, c])
    distance = math.sqrt(square)
    return distance, -product / max(distance, 1.0)
