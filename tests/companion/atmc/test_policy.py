"""A policy: its numbers, what it refuses to answer, its file, and everything that can be wrong with that."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.atmc.actions import SET_ACTIONS, TRANSPORTS, able, legal, transports_of
from companion.atmc.choice import Choice, Refused, Why
from companion.atmc.policy import (
    Bounds,
    Policy,
)
from companion.remote_id.region import Region
from tests.companion.atmc.policies import (
    metadata,
    observation,
    tensors,
)

ALL = np.ones(len(SET_ACTIONS), bool)


def made(kind="set", **changes):
    meta = metadata(kind, **changes)
    parts = tensors(meta)
    return Policy(meta, parts, "made"), parts


def by_the_book(meta, parts, own, rows, agent):
    """The forward pass in float64, row by row."""
    p = {key: value.astype(np.float64) for key, value in parts.items()}
    own_at = [list(OWN).index(c) for c in meta.own_columns]
    at = [list(NEIGHBOUR).index(c) for c in meta.neighbour_columns]
    if meta.kind == "set":
        total, most = 0.0, 0.0
        for row in rows[:, at]:
            h = np.maximum(p["phi0.weight"] @ row + p["phi0.bias"], 0.0)
            h = np.maximum(p["phi1.weight"] @ h + p["phi1.bias"], 0.0)
            total, most = total + h, np.maximum(most, h)
        size = len(p["phi1.bias"])
        z = np.concatenate([np.log(1.0 + total) + np.zeros(size), most + np.zeros(size), own[own_at]])
        for layer in ("rho0", "rho1"):
            z = np.maximum(p[f"{layer}.weight"] @ z + p[f"{layer}.bias"], 0.0)
        return p["out.weight"] @ z + p["out.bias"]
    nearest = sorted(rows.tolist(), key=lambda row: row[0])
    x = list(own[own_at])
    for k in range(meta.neighbours):
        x += [nearest[k][c] for c in at] + [1.0] if k < len(nearest) else [0.0] * (len(at) + 1)
    which = agent if meta.agents > 1 else 0
    for i in range(3):
        x = p[f"layer{i}.weight"][which] @ np.maximum(x, 0.0 if i else -np.inf) + p[f"layer{i}.bias"][which]
    return x


NEIGHBOUR, OWN = metadata().neighbour_columns, metadata().own_columns
SOME = {
    "neighbour_columns": ("wifi_rate", "log_distance"),
    "own_columns": ("wifi", "ble4"),
    "bounds": Bounds(neighbour_low=(0, 0), neighbour_high=(1, 1), own_low=(0, 0), own_high=(1, 1)),
}


@pytest.mark.parametrize("heard", [0, 1, 9, 50])
@pytest.mark.parametrize("changes", [{}, SOME, {"agents": 3}], ids=["all columns", "some columns", "agents"])
@pytest.mark.parametrize("kind", ["set", "flat"])
def test_values_are_those_of_the_equations(kind, changes, heard):
    if kind == "set" and "agents" in changes:
        pytest.skip("one network for all")
    if kind == "flat" and heard > 9:
        pytest.skip("no room for them")
    policy, parts = made(kind, **changes)
    rng = np.random.default_rng(heard)
    for agent in range(policy.metadata.agents):
        own, rows = observation(rng, heard)
        expected = by_the_book(policy.metadata, parts, own, rows, agent)
        np.testing.assert_allclose(policy.values(own, rows, agent), expected, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("kind", ["set", "flat"])
def test_the_order_of_neighbours_does_not_matter(kind):
    policy, _ = made(kind)
    rng = np.random.default_rng(1)
    own, rows = observation(rng, 9)
    expected = policy.values(own, rows)
    for _ in range(10):
        rng.shuffle(rows)
        np.testing.assert_allclose(policy.values(own, rows), expected, rtol=1e-5, atol=1e-5)


def test_a_flat_network_looks_at_the_nearest():
    policy, _ = made("flat")
    own, rows = observation(np.random.default_rng(1), 12)
    nearest = rows[np.argsort(rows[:, 0])[:9]]
    assert (policy.values(own, rows) == policy.values(own, nearest)).all()


def test_the_best_allowed_action_is_taken():
    policy, _ = made()
    own, rows = observation(np.random.default_rng(1), 4)
    order = np.argsort(-policy.values(own, rows))
    best = policy.choose(own, rows, ALL, None)
    assert best == Choice(int(order[0]), SET_ACTIONS[order[0]])
    allowed = ALL.copy()
    allowed[order[:3]] = False
    assert policy.choose(own, rows, allowed, None).index == order[3]


def test_a_switch_has_its_price():
    policy, parts = made()
    own, rows = observation(np.random.default_rng(1), 4)
    q = np.sort(policy.values(own, rows))[::-1]
    second = int(np.argsort(-policy.values(own, rows))[1])
    gap = float(q[0] - q[1])
    for price, stays in ((0.5 * gap, False), (2.0 * gap, True)):
        priced = Policy(msgspec.structs.replace(policy.metadata, switch_price=price), parts, "x")
        assert (priced.choose(own, rows, ALL, second).index == second) is stays
        assert priced.choose(own, rows, ALL, None) == policy.choose(own, rows, ALL, None)


names = st.sets(st.sampled_from([*TRANSPORTS, "nan"]), min_size=1)
POLICY = made()[0]


@given(
    sets=st.lists(names, max_size=3),
    can_send=st.sets(st.sampled_from([*TRANSPORTS, "nan"])),
    seed=st.integers(0, 1000),
    current=st.none() | st.integers(0, len(SET_ACTIONS) - 1),
)
def test_what_is_not_legal_or_not_able_is_never_chosen(sets, can_send, seed, current):
    region = Region(transport_sets=tuple(tuple(sorted(names)) for names in sets))
    allowed = legal(SET_ACTIONS, region) & able(SET_ACTIONS, can_send)
    rng = np.random.default_rng(seed)
    answer = POLICY.choose(*observation(rng, int(rng.integers(0, 8))), allowed, current)
    if isinstance(answer, Refused):
        assert answer.why is Why.NOTHING_ALLOWED
        assert not allowed.any()
        return
    used = transports_of(answer.action)
    assert used <= can_send
    assert not sets or any(names <= used for names in sets)


@pytest.mark.parametrize(
    ("change", "why", "words"),
    [
        (lambda own, rows: rows.__setitem__((2, 0), -0.3), Why.OUTSIDE, "neighbour's log_distance -0.3"),
        (lambda own, rows: rows.__setitem__((0, 1), -0.2), Why.OUTSIDE, "neighbour's conflict -0.2"),
        (lambda own, rows: rows.__setitem__((1, 7), np.nan), Why.OUTSIDE, "wifi_rate nan"),
        (lambda own, rows: own.__setitem__(6, np.inf), Why.OUTSIDE, "own ble4_success inf"),
        (
            lambda own, rows: own.__setitem__(3, np.nan),
            Why.OUTSIDE,
            "own ble4_rate nan, trained with -1 to 1",
        ),
    ],
)
def test_what_training_did_not_see_is_refused(change, why, words):
    policy, _ = made()
    own, rows = observation(np.random.default_rng(1), 4)
    change(own, rows)
    answer = policy.choose(own, rows, ALL, None)
    assert isinstance(answer, Refused)
    assert answer.why is why
    assert words in answer.text


def test_who_is_farther_than_any_in_training_is_left_out():
    policy, _ = made()
    own, rows = observation(np.random.default_rng(1), 4)
    far = rows.copy()
    far[2, 0] = 1.3
    answer = policy.choose(own, far, ALL, None)
    assert isinstance(answer, Choice)
    assert answer == policy.choose(own, np.delete(rows, 2, axis=0), ALL, None)


def test_a_little_outside_is_not_outside():
    policy, _ = made()
    own, rows = observation(np.random.default_rng(1), 4)
    rows[0, 0] = 1.24
    assert isinstance(policy.choose(own, rows, ALL, None), Choice)


def test_those_who_are_far_do_not_count():
    policy, _ = made()
    most = policy.metadata.neighbours
    own, rows = observation(np.random.default_rng(1), most + 5)
    rows[1:, 0] = 1.3
    assert policy.choose(own, rows, ALL, None) == policy.choose(own, rows[:1], ALL, None)


@pytest.mark.parametrize("kind", ["set", "flat"])
def test_more_neighbours_than_in_training_are_refused(kind):
    policy, _ = made(kind)
    most = policy.metadata.neighbours
    allowed = np.ones(len(policy.actions), bool)
    own, rows = observation(np.random.default_rng(1), most + 1)
    assert isinstance(policy.choose(own, rows[:-1], allowed, None), Choice)
    answer = policy.choose(own, rows, allowed, None)
    assert answer == Refused(Why.TOO_MANY, f"{most + 1} neighbours, trained with up to {most}")


def test_an_answer_that_is_no_number_is_refused():
    meta = metadata()
    parts = tensors(meta)
    for layer in ("rho0", "rho1"):
        parts[f"{layer}.weight"] *= np.float32(1e30)
    own, rows = observation(np.random.default_rng(1), 4)
    answer = Policy(meta, parts, "x").choose(own, rows, ALL, None)
    assert isinstance(answer, Refused)
    assert answer.why is Why.NO_NUMBER
