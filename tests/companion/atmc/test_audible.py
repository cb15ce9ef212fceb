"""The guard: what a policy may choose while few aircraft are heard."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from companion.atmc.actions import PAPER_ACTIONS, SET_ACTIONS, TRANSPORTS, able, legal
from companion.atmc.audible import audible
from companion.atmc.rule import fixed
from companion.remote_id.region import Region

NONE = Region()
US = Region(name="us", transport_sets=(("wifi",), ("ble4", "ble5")), location_period_s=1.0)
BLE = Region(name="ble", transport_sets=(("ble4", "ble5"),), location_period_s=1.0)
RADIOS = [some for count in range(1, 4) for some in itertools.combinations(TRANSPORTS, count)]


@pytest.mark.parametrize("region", [NONE, US, BLE], ids=lambda region: region.name)
@pytest.mark.parametrize("radios", RADIOS, ids="+".join)
def test_every_choice_contains_the_fixed_set_that_would_fly_without_a_policy(region, radios):
    allowed = legal(SET_ACTIONS, region) & able(SET_ACTIONS, radios)
    least = fixed(region, radios)
    found = audible(SET_ACTIONS, allowed)
    assert not (found & ~allowed).any()
    assert found.any() == allowed.any() == (least is not None)
    for action in itertools.compress(SET_ACTIONS, found):
        assert all(rate >= at_least for rate, at_least in zip(action, least, strict=True))


def test_with_all_radios_only_ble_5_is_left_to_choose():
    found = audible(SET_ACTIONS, np.ones(len(SET_ACTIONS), bool))
    assert set(itertools.compress(SET_ACTIONS, found)) == {(10, ble5, 10) for ble5 in (0, 2, 5, 10)}


def test_the_papers_policies_which_have_one_transport_each_are_left_alone():
    assert audible(PAPER_ACTIONS, np.ones(len(PAPER_ACTIONS), bool)).all()
