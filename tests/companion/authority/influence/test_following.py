"""Who moves with us, and who flies its own way."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.authority.influence.following import Followers
from companion.avoidance.law import Neighbour

PERIOD_S = 0.2


class Pair:
    """The own aircraft and others, decision by decision; it is pushed to the east from 10 s on."""

    def __init__(self, *, pushed_mps=4.0, message_s=0.5, noise_m=0.0, seed=1):
        self.followers = Followers()
        self.now_s = 0.0
        self.own, self.own_mps = np.zeros(3), np.array([7.0, 0.0, 0.0])
        self._pushed_mps, self._message_s, self._noise_m = pushed_mps, message_s, noise_m
        self._rng = np.random.default_rng(seed)
        self._last = {}

    def step(self, **others):
        """Others by name: place and reported velocity. Returns the names of those that follow."""
        self.now_s += PERIOD_S
        if self.now_s > 10.0:
            self.own_mps = np.array([7.0, self._pushed_mps, 0.0])
        self.own = self.own + PERIOD_S * self.own_mps
        found = set()
        for name, (place, mps) in others.items():
            at_s, held = self._last.get(name, (-math.inf, None))
            if self.now_s - at_s >= self._message_s:
                noisy = np.array(place) + self._noise_m * self._rng.standard_normal(3)
                self._last[name] = at_s, held = self.now_s, (noisy, np.array(mps))
            other = Neighbour(name, tuple(held[0]), tuple(held[1]), self.now_s - at_s, 3.0)
            own = tuple(self.own.tolist()), tuple(self.own_mps.tolist())
            if self.followers.hear(self.now_s, name, *own, other):
                found.add(name)
            self.followers.conflict(self.now_s, name, *own, other)
        return found

    def fly(self, seconds, name, where):
        """When the track first followed (s); None: never."""
        first = None
        for _ in range(round(seconds / PERIOD_S)):
            if self.step(**{name: where(self)}) and first is None:
                first = self.now_s
        return first


def ghost(offset, closing_mps=0.0):
    """Keeps its place beside us, and says that it comes nearer."""
    out = np.array(offset) / np.linalg.norm(offset)
    return lambda pair: (pair.own + offset, pair.own_mps - closing_mps * out)


@pytest.mark.parametrize("closing_mps", [0.0, 0.5, 1.0, 2.0, 4.0, 8.0])
@pytest.mark.parametrize("offset", [(0.0, -12.0, 0.0), (-10.0, -20.0, 8.0), (0.0, -35.0, 0.0)])
def test_one_that_keeps_its_place_beside_us_while_we_are_pushed_follows(offset, closing_mps):
    first = Pair(noise_m=1.0).fly(30.0, "GHOST", ghost(np.array(offset), closing_mps))
    assert 13.0 < first < 21.0


def line(start, mps):
    return lambda pair: (np.array(start) + pair.now_s * np.array(mps), mps)


def turning(start, speed, course, turn):
    def where(pair):
        angle = course + turn * pair.now_s
        gone = speed / turn * np.array([math.sin(angle) - math.sin(course),
                                        math.cos(course) - math.cos(angle), 0.0])  # fmt: skip
        return np.array(start) + gone, (speed * math.cos(angle), speed * math.sin(angle), 0.0)

    return where


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(
    "where",
    [
        line((0.0, -20.0, 0.0), (7.0, 0.0, 0.0)),  # parallel
        line((0.0, -60.0, 0.0), (7.0, 3.9, 0.0)),  # we fly along before it, pushed
        line((0.0, -30.0, 0.0), (6.0, 2.0, 0.0)),  # converging
        line((200.0, 0.0, 0.0), (-7.0, 0.5, 0.0)),
        lambda pair: ((0.0, -15.0, 0.0) + pair.now_s * np.array([7.0, 0.0, 0.0]), (7.0, 0.0, 0.0)),
        turning((0.0, -25.0, 0.0), 7.0, 0.0, -0.05),
        turning((100.0, -90.0, 0.0), 9.0, 1.2, -0.04),
    ],
)
def test_blind_aircraft_that_fly_straight_or_turn_do_not_follow(where, seed):
    assert Pair(message_s=1.0, noise_m=2.0, seed=seed).fly(40.0, "HONEST", where) is None


@pytest.mark.parametrize("gap_s", [1.4, 5.4, 7.0])
def test_one_that_flies_straight_and_is_in_conflict_now_and_then_does_not_follow(gap_s):
    """When the conflict began we were pushed already, and then flew straight on beside it. What it reports is
    followed across the gaps, under its own name and under another's."""
    pair = Pair(pushed_mps=0.0)
    where = line((0.0, -20.0, 0.0), (7.0, 0.0, 0.0))
    pair.followers.conflict(
        0.1, "HONEST", (0.0, 0.0, 0.0), (7.0, 4.0, 0.0), Neighbour("HONEST", *where(pair), 0.0, 3.0)
    )
    for n in range(12):
        assert pair.fly(2.4, ("HONEST", "OTHER")[n // 3 % 2], where) is None
        pair.now_s += gap_s
        pair.own = pair.own + gap_s * pair.own_mps


def test_one_that_avoids_by_turning_the_other_way_does_not_follow():
    def where(pair):
        away = -4.0 * max(pair.now_s - 10.0, 0.0)
        return (7.0 * pair.now_s, -20.0 + away, 0.0), (7.0, -4.0 if pair.now_s > 10.0 else 0.0, 0.0)

    assert Pair().fly(30.0, "HONEST", where) is None


def test_another_name_at_the_same_place_goes_on_where_it_was():
    offset = np.array((0.0, -30.0, 0.0))
    pair = Pair()
    assert pair.fly(16.0, "A", ghost(offset, 3.0)) is not None
    assert pair.fly(3.0, "B", ghost(offset, 3.0)) <= 17.6
    assert pair.fly(2.0, "C", ghost(-offset, 3.0)) is None


def test_names_that_change_faster_than_one_can_be_judged_are_judged_together():
    pair, offset, first = Pair(), np.array((0.0, -30.0, 0.0)), None
    for number in range(10):
        found = pair.fly(1.0, f"G{number}", ghost(offset, 2.0))
        first = first or found
    for number in range(10, 20):
        first = first or pair.fly(1.0, f"G{number}", ghost(offset, 2.0))
    assert first < 19.0


def test_one_that_followed_does_not_follow_any_more_15_s_after_the_conflict():
    """Whatever it does meanwhile: nearness alone is no way back."""
    pair, offset = Pair(), np.array((0.0, -24.0, 0.0))
    assert pair.fly(16.0, "A", ghost(offset)) is not None
    other = Neighbour("A", tuple(pair.own - [0.0, 5.0, 0.0]), (7.0, 0.0, 0.0), 0.0, 3.0)
    for later_s, follows in ((1.0, True), (14.9, True), (15.1, False)):
        own = tuple(pair.own.tolist()), tuple(pair.own_mps.tolist())
        assert pair.followers.hear(pair.now_s + later_s, "A", *own, other) is follows


def test_a_ghost_cannot_choose_its_heir():
    """Having followed us, it moves to where an honest aircraft will be in conflict."""
    pair, offset = Pair(), np.array((0.0, -24.0, 0.0))
    assert pair.fly(16.0, "GHOST", ghost(offset)) is not None
    honest = pair.own + np.array((0.0, 45.0, 0.0))
    for step in range(30):
        place = honest + step * PERIOD_S * np.array([7.0, 0.0, 0.0])
        moved = pair.own + np.array((0.0, min(-24.0 + 8.0 * step, 45.0), 0.0))
        others = {"GHOST": (moved, (7.0, 0.0, 0.0))}
        if step > 10:
            others["HONEST"] = (place, (7.0, 0.0, 0.0))
        assert "HONEST" not in pair.step(**others)
    assert pair.fly(3.0, "HEIR", ghost(offset)) is not None


def test_a_name_of_before_is_another_track_and_has_an_heir():
    pair, offset = Pair(), np.array((0.0, -24.0, 0.0))
    assert pair.fly(16.0, "A", ghost(offset)) is not None
    pair.followers.forget("A")
    pair.followers.forget("NOBODY")
    assert "A" not in pair.followers
    assert pair.fly(3.0, "B", ghost(offset)) is not None


@pytest.mark.parametrize(("silent_s", "heir"), [(2.6, True), (4.0, False)])
def test_whoever_comes_to_that_place_later_is_no_heir(silent_s, heir):
    pair, offset = Pair(), np.array((0.0, -24.0, 0.0))
    assert pair.fly(16.0, "GHOST", ghost(offset)) is not None
    last_s = pair.now_s
    while pair.now_s < last_s + silent_s:
        pair.step()
    assert (pair.fly(2.0, "LATER", ghost(offset)) is not None) is heir


@pytest.mark.parametrize(("age_s", "heir"), [(0.0, True), (3.2, False)])
def test_the_pause_counts_from_the_message_not_from_the_last_prediction(age_s, heir):
    pair, offset = Pair(), np.array((0.0, -24.0, 0.0))
    assert pair.fly(16.0, "GHOST", ghost(offset)) is not None
    own = tuple(pair.own.tolist()), tuple(pair.own_mps.tolist())
    old = Neighbour("GHOST", tuple((pair.own + offset).tolist()), own[1], age_s, 3.0)
    pair.followers.hear(pair.now_s, "GHOST", *own, old)
    for _ in range(4):
        pair.step()
    assert (pair.fly(3.0, "LATER", ghost(offset)) is not None) is heir


@pytest.mark.parametrize(("silent_after_s", "heir"), [(3.0, True), (6.0, False)])
def test_who_falls_silent_when_the_other_one_is_long_there_has_no_heir(silent_after_s, heir):
    """Until then, both keep the same place beside us."""
    pair, offset = Pair(), np.array((0.0, -24.0, 0.0))
    assert pair.fly(16.0, "GHOST", ghost(offset)) is not None
    straight = pair.own + offset
    begun_s = pair.now_s
    for step in range(50):
        there = straight + step * PERIOD_S * np.array([7.0, 4.0, 0.0])
        others = {"OTHER": (there, (7.0, 4.0, 0.0))}
        own = tuple(pair.own.tolist()), tuple(pair.own_mps.tolist())
        silent = pair.now_s - begun_s > silent_after_s
        known = Neighbour("GHOST", tuple(there.tolist()), own[1], 0.0, 3.0, silent=silent, unheard=silent)
        if step:
            pair.followers.hear(pair.now_s, "GHOST", *own, known)
            pair.followers._conflicts["GHOST"].heard_s = begun_s
        found = pair.step(**others)
    assert ("OTHER" in found) is heir


def test_an_honest_aircraft_at_the_place_of_a_ghost_is_no_heir_of_it():
    """We are pushed to where it flies; the ghost goes on."""
    pair, offset = Pair(), np.array((0.0, -24.0, 0.0))
    assert pair.fly(16.0, "GHOST", ghost(offset)) is not None
    honest = pair.own + offset
    for step in range(60):
        place = honest + step * PERIOD_S * np.array([7.0, 0.0, 0.0])
        found = pair.step(GHOST=ghost(offset)(pair), HONEST=(place, (7.0, 0.0, 0.0)))
        assert "HONEST" not in found
        assert "GHOST" in found


def test_what_is_remembered_is_bounded():
    pair = Pair()
    for number in range(300):
        place = pair.own - np.array([0.0, 20.0 + 15.0 * number, 0.0])
        pair.step(**{f"N{number}": (place, (7.0, 0.0, 0.0))})
    assert len(pair.followers._conflicts) <= 32
    assert "LATER" not in pair.followers
    pair.now_s += 20.0
    pair.step(LATER=(pair.own + np.array([0.0, -24.0, 0.0]), (7.0, 0.0, 0.0)))
    assert "LATER" in pair.followers


def test_an_heir_that_falls_silent_itself_still_inherits_the_record():
    """The ghost goes on under a new name, which falls silent too before the old one counts as gone."""
    pair = Pair(message_s=PERIOD_S)
    assert pair.fly(25.0, "FIRST", ghost((0.0, -20.0, 0.0))) is not None
    last_s = pair.now_s

    def conflict(name, now_s, heard_s):
        age_s = now_s - heard_s
        own, mps = tuple(pair.own.tolist()), tuple(pair.own_mps.tolist())
        place = pair.own + np.array([0.0, -20.0, 0.0]) - age_s * pair.own_mps
        other = Neighbour(name, tuple(place.tolist()), mps, age_s, 3.0, unheard=age_s > 2.0)
        follows = pair.followers.hear(now_s, name, own, mps, other)
        pair.followers.conflict(now_s, name, own, mps, other)
        return follows

    for tenths in range(5, 45):
        now_s = last_s + 0.1 * tenths
        pair.own = pair.own + 0.1 * pair.own_mps
        # The old name's last message came at last_s, one of the new name's just before its conflict began.
        pair.followers.hear(now_s, "FIRST", tuple(pair.own.tolist()), tuple(pair.own_mps.tolist()),
                            Neighbour("FIRST", (0.0, 0.0, 0.0), (7.0, 4.0, 0.0), now_s - last_s, 3.0,
                                      unheard=now_s - last_s > 3.0))  # fmt: skip
        follows = conflict("SECOND", now_s, last_s + 0.4)
    assert follows
