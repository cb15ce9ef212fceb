"""The rule, the fixed set and the fall-back."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.atmc.actions import PAPER_ACTIONS, SET_ACTIONS, TRANSPORTS, able, legal, transports_of
from companion.atmc.choice import Refused
from companion.atmc.observation import neighbour_rows
from companion.atmc.rule import BLE4_RANGE_M, FIXED, FIXED_SETS, FLYING_RULE, PAPER_RULE, fixed
from companion.remote_id.region import Region
from tests.companion.atmc.policies import FO

OWN = np.zeros(FO)


def rows(*distance_m):
    distance = np.array(distance_m, float)
    return neighbour_rows(np, distance, np.zeros(len(distance)), np.zeros((len(distance), 3)))


@pytest.mark.parametrize(
    ("rule", "near", "far"),
    [
        (PAPER_RULE, (0, 0, 10), (9, 0, 0)),
        (FLYING_RULE, (10, 0, 10), (0, 0, 10)),
        (FIXED, FIXED_SETS[0], FIXED_SETS[0]),
    ],
)
def test_near_and_far(rule, near, far):
    allowed = np.ones(len(rule.actions), bool)
    for heard, action in (
        ((), far),
        ((BLE4_RANGE_M + 1.0, 900.0), far),
        ((900.0, BLE4_RANGE_M - 1.0), near),
    ):
        choice = rule.choose(OWN, rows(*heard), allowed, None)
        assert choice.action == action
        assert rule.actions[choice.index] == action


def test_the_sets_are_among_the_actions():
    assert set(FIXED_SETS) <= set(SET_ACTIONS)
    assert {PAPER_RULE.near, PAPER_RULE.far} <= set(PAPER_ACTIONS)


@pytest.mark.parametrize(
    ("region", "can_send", "action"),
    [
        ("us", TRANSPORTS, (10, 0, 10)),
        ("us", ("ble4", "ble5"), (10, 10, 0)),
        ("us", ("wifi",), (0, 0, 10)),
        ("us", ("ble4",), None),
        ("us", ("ble5", "nan"), None),
        ("eu", ("ble4", "ble5"), (10, 10, 0)),
        ("eu", ("ble5",), (0, 10, 0)),
        ("eu", ("ble4", "nan"), None),
        ("none", ("ble4",), (10, 0, 0)),
        ("none", (), None),
    ],
)
def test_the_fall_back_is_the_best_that_is_legal_and_able(region, can_send, action):
    path = Path(__file__).parents[3] / "config" / "regions" / f"{region}.toml"
    assert fixed(msgspec.toml.decode(path.read_bytes(), type=Region), can_send) == action


@given(
    sets=st.lists(st.sets(st.sampled_from([*TRANSPORTS, "nan"]), min_size=1), max_size=3),
    can_send=st.sets(st.sampled_from([*TRANSPORTS, "nan"])),
    distance_m=st.lists(st.floats(1.0, 3000.0), max_size=3),
    rule=st.sampled_from([PAPER_RULE, FLYING_RULE, FIXED]),
)
def test_never_illegal_or_unable(sets, can_send, distance_m, rule):
    region = Region(transport_sets=tuple(tuple(sorted(names)) for names in sets))
    allowed = legal(rule.actions, region) & able(rule.actions, can_send)
    answer = rule.choose(OWN, rows(*distance_m), allowed, None)
    chosen = [] if isinstance(answer, Refused) else [answer.action]
    assert bool(chosen) == bool(allowed.any())
    fall_back = fixed(region, can_send)
    for action in chosen if fall_back is None else [*chosen, fall_back]:
        assert transports_of(action) <= can_send
        assert not sets or any(names <= transports_of(action) for names in sets)
