"""Flights under attack, with the real tracks and the real law: the honest aircraft stays 10 m away."""

from __future__ import annotations

import pytest

from tests.companion.traffic.attacks.attacked import clone, crowd, fly, nobody

KEPT_M = 10.0


def test_without_avoidance_they_hit_and_without_an_attack_they_do_not():
    """The harness shows what it is to show."""
    assert fly(nobody, 6.0, 12.0, 180.0, meet_s=20.0, avoids=False).least_m < 1.0
    assert fly(nobody, 6.0, 12.0, 180.0, meet_s=20.0).least_m > 2.0 * KEPT_M
    assert fly(nobody, 6.0, 12.0, 180.0, meet_s=20.0, sends=False).least_m < 1.0


@pytest.mark.parametrize(
    ("attack", "own_mps", "other_mps", "angle_deg", "appears_s"),
    [
        (crowd(200, 40.0, 36.0, 44.0), 6.0, 20.0, 180.0, 15.0),
        (crowd(200, 40.0, 36.0, 44.0, from_s=8.0), 20.0, 15.0, 75.0, 1.0),
        (crowd(230, 250.0, 33.0, 48.0, imitates=True), 13.0, 11.0, 120.0, 12.0),
    ],
    ids=["before it appears", "after it appeared", "imitating it"],
)
def test_a_crowd_beside_us_hides_nobody(attack, own_mps, other_mps, angle_deg, appears_s):
    flown = fly(attack, own_mps, other_mps, angle_deg, appears_s=appears_s, meet_s=25.0)
    assert flown.traffic.counts.evicted
    assert flown.least_m > KEPT_M


@pytest.mark.parametrize(
    ("attack", "own_mps", "other_mps", "angle_deg"),
    [
        (clone(2.0, (0.0, 40.0, 0.0)), 6.0, 12.0, 180.0),
        (clone(2.0, (0.0, 40.0, 0.0), lead_s=4.8), 20.0, 12.0, 75.0),
        (clone(9.0, (0.0, -17.0, 0.0), lead_s=3.0), 8.0, 15.0, 110.0),
        (clone(5.0, (0.0, 0.0, 0.0), velocity=(0.0, 0.1, 0.0)), 10.0, 15.0, 180.0),
    ],
    ids=["beside", "beside and ahead in time", "near", "in its place, standing"],
)
def test_a_clone_of_name_and_address_hides_nobody(attack, own_mps, other_mps, angle_deg):
    assert fly(attack, own_mps, other_mps, angle_deg, meet_s=25.0).least_m > KEPT_M
