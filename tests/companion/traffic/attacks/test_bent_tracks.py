"""Forged messages after each true one that bend its track: what the true one said is believed beside it."""

from __future__ import annotations

import itertools
import math
import random

import pytest

from companion.avoidance.law import ASIDE
from companion.config import AvoidanceConfig
from companion.geometry import Vec3
from companion.traffic.eviction import Judgement
from companion.traffic.track import _BELIEFS
from tests.companion.traffic.attacks.attacked import ADDRESS, NAME, STEP_S, Attack, Sky, fly
from tests.companion.traffic.flights import Listener, basic, location, seconds, straight
from tests.companion.traffic.flights import fly as hear

KEPT_M = 10.0
DELAY_S = 0.3
PHASE = random.Random(1).random()
"""Of the honest aircraft's messages in `attacked.fly`."""


def bend(
    step_m: Vec3,
    step_mps: Vec3,
    count: int = 1,
    *,
    own_address: bool = True,
    lead_s: float = 0.0,
    accuracy_m: float = 3.0,
) -> Attack:
    """Messages in the honest aircraft's name, 0.1 s after each of its own: the first is by one step off its
    place and velocity, each other one by a step more."""
    numbers = itertools.count(1)

    def attack(sky: Sky) -> None:
        after_s = (sky.now_s - 100.0 - DELAY_S + PHASE) % 1.0
        k = math.floor(after_s / STEP_S + 1e-6) - 1
        if not 1 <= k <= count:
            return
        place = tuple(p + k * s for p, s in zip(sky.honest, step_m, strict=True))
        velocity = tuple(v + k * s for v, s in zip(sky.honest_velocity, step_mps, strict=True))
        address = ADDRESS if own_address else f"02:00:00:00:00:{next(numbers):02x}"
        sky.send(NAME, address, place, velocity, lead_s, accuracy_m)

    return attack


def high(up_m: float) -> Attack:
    """Twenty messages a second at its place, but higher."""

    def attack(sky: Sky) -> None:
        north, east, down = sky.honest
        sky.send(NAME, ADDRESS, (north, east, down - up_m), sky.honest_velocity)

    return attack


@pytest.mark.parametrize(
    ("attack", "own_mps", "other_mps", "angle_deg"),
    [
        (bend((0.0, 0.0, 0.0), (0.0, 100.0, 0.0), own_address=False), 6.0, 12.0, 180.0),
        (bend((0.0, 8.0, 0.0), (0.0, 6.0, 0.0)), 12.0, 5.0, 170.0),
        (bend((0.0, 1.5, 0.0), (0.0, 3.4, 0.0), 3, lead_s=1.9), 8.0, 8.0, 180.0),
        (bend((0.0, 20.0, 0.0), (0.0, 1.0, 0.0), lead_s=1.9), 12.0, 5.0, 170.0),
        (bend((0.0, 15.0, 0.0), (0.0, 6.0, 0.0), 10), 10.0, 8.0, 110.0),
        (bend((0.0, 8.0, 0.0), (0.0, 1.0, 0.0), 18), 6.0, 12.0, 180.0),
        (high(60.0), 6.0, 20.0, 75.0),
        (high(-15.0), 6.0, 20.0, 75.0),
    ],
    ids=["address", "turned", "row", "clock", "walk", "slow walk", "above", "little below"],
)
def test_no_message_hides_an_aircraft_by_bending_its_track(attack, own_mps, other_mps, angle_deg):
    assert fly(attack, own_mps, other_mps, angle_deg, meet_s=25.0).least_m > KEPT_M


@pytest.mark.parametrize("aside_m", [9.0, 12.0, 14.0])
@pytest.mark.parametrize("count", [1, 18])
def test_ghosts_beside_it_do_not_take_its_place(aside_m, count):
    """Each of their states nearly agrees with the one before it."""
    attack = bend((0.0, aside_m, 0.0), (0.0, 2.9, 0.0), count)
    assert fly(attack, 6.0, 12.0, 180.0, meet_s=25.0).least_m > KEPT_M


@pytest.mark.parametrize("aside_m", [20.0, 30.0, 36.0, 43.0])
def test_a_ghost_of_poor_accuracy_does_not_take_its_place(aside_m):
    """What differs by as much as three standard deviations of both would be passed where the aircraft is."""
    attack = bend((0.0, aside_m, 0.0), (0.0, 2.9, 0.0), accuracy_m=10.0)
    assert fly(attack, 6.0, 12.0, 180.0, meet_s=25.0).least_m > KEPT_M


def test_what_a_message_said_is_believed_until_its_sender_is_silent():
    """A second message contradicts it, within what one aircraft could do."""
    listener = Listener()
    hear(listener, straight(), seconds(10))
    told = location(lambda t: (200.0 + 18.0, *straight()(t)[1:]), 19.3)
    listener.hear(19.4, basic(), told)
    (track,) = listener.traffic.tracks.values()
    names = [n.track_id for n in listener.traffic.neighbours(19.5)]
    assert names == ["X", f"X{ASIDE}1"]
    assert len(listener.traffic.neighbours(19.2 + track.believed_s)) == 2
    assert len(listener.traffic.neighbours(19.5 + track.believed_s)) == 1


@pytest.mark.parametrize("offset_m", [10.0, 18.0])
@pytest.mark.parametrize("lead_s", [0.0, 1.9])
def test_whoever_sends_more_often_does_not_make_the_other_old(offset_m, lead_s):
    """Twenty a second beside it: the true message is older than the track's when it arrives."""
    listener = Listener()
    motion = straight()
    for k in range(200):
        now_s = 10.0 + 0.05 * k
        if k % 20 == 0:
            hear(listener, motion, [now_s - 0.3], delay_s=0.3)
        beside = location(
            lambda t: (200.0 + offset_m, *motion(t)[1:]), now_s, timestamp_s=round(now_s + lead_s, 1)
        )
        listener.hear(now_s, basic(), beside)
        if k > 60:
            places = [
                math.hypot(
                    n.position_ned_m[0] - 200.0,
                    n.position_ned_m[1] + n.age_s * n.velocity_ned_mps[1] - motion(now_s)[1],
                )
                for n in listener.traffic.neighbours(now_s)
            ]
            assert min(places) < 11.0


def oncoming(t):
    return 200.0 - 15.0 * (t - 10.0), 0.0, -15.0, 0.0, 50.0


def test_the_beliefs_of_a_track_are_bounded_and_the_urgent_ones_stay():
    listener = Listener()
    draw = random.Random(3)
    listener.traffic.note_own(10.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for k in range(200):
        now_s = 10.0 + 0.05 * k
        if k % 20 == 0:
            hear(listener, oncoming, [now_s], delay_s=0.0)
        north, east, aside = (draw.uniform(-12.0, 12.0) for _ in range(3))
        bent = oncoming(now_s)[0] + north, east, -15.0, 0.25 * aside, 50.0
        told = location(lambda t, bent=bent: bent, now_s)
        listener.hear(now_s + 0.01, basic(), told)
        assert all(len(t.beliefs) <= _BELIEFS for t in listener.traffic.tracks.values())


def test_a_sound_sender_is_believed_to_be_in_one_place():
    for rate_hz in (1.0, 5.0, 10.0):
        listener = Listener()
        hear(listener, straight(), seconds(round(60 * rate_hz), rate_hz=rate_hz))
        assert len(listener.traffic.neighbours(70.0)) == 1


@pytest.mark.parametrize("rate_hz", [1.0, 4.0])
def test_a_fast_sender_stays_one_track_in_one_place(rate_hz):
    """Its earlier state is up to 1.75 s old: 175 m of way."""
    listener = Listener()
    for at_s in seconds(round(20 * rate_hz), rate_hz=rate_hz):
        hear(listener, straight(100.0), [at_s])
        assert [n.track_id for n in listener.traffic.neighbours(at_s + 0.3)] == ["X"]


def test_how_soon_separation_is_lost_counts_from_our_own_height():
    judgement = Judgement(AvoidanceConfig())
    judgement.position, judgement.velocity = (0.0, 0.0, -100.0), (0.0, 0.0, 0.0)
    assert judgement.loss_s((100.0, 0.0, -100.0), (-10.0, 0.0, 0.0)) < 10.0
    assert judgement.loss_s((100.0, 0.0, 100.0), (-10.0, 0.0, 0.0)) == math.inf
    assert judgement.loss_s((100.0, 0.0, -200.0), (-10.0, 0.0, 0.0)) == math.inf
