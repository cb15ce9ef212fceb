"""Eviction agrees with `companion.traffic.eviction`, and neighbours that cannot matter change no decision."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.avoidance import kernels as k
from companion.avoidance.kernels.neighbours import volume_of
from companion.avoidance.kernels.timelines import own_velocity_at
from companion.avoidance.law import settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from companion.traffic.eviction import HOLD_S, Judgement, Motion, Ranking, Trust, margin_m
from ground_tools.campaign.world import World
from ground_tools.city.judging import COLUMNS, PLACES, give_up, judge_of
from ground_tools.city.tables import NOBODY, Tracks, new_fleet, new_tracks
from ground_tools.city.tracks import (
    TURNS,
    Scope,
    certain,
    everything,
    matters,
    note_turns,
    turned_since,
)

NOW_S = 100.0
MOST = 12
WORLD = World().conditions(0.2)


def full_table(rng: np.random.Generator, spread_m: float) -> Tracks:
    tracks = new_tracks(1, MOST)
    tracks.used[0] = MOST
    tracks.who[0] = rng.permutation(50)[:MOST]
    tracks.past[0] = np.array(k.NO_PAST)
    tracks.heard[0, :, 0] = NOW_S - rng.uniform(0.0, 5.0, MOST)
    tracks.heard[0, :, 1:4] = rng.uniform(-spread_m, spread_m, (MOST, 3)) * [1.0, 1.0, 0.2]
    tracks.heard[0, :, 4:7] = rng.uniform(-10.0, 10.0, (MOST, 3)) * [1.0, 1.0, 0.1]
    tracks.messages[0] = rng.integers(1, 6, MOST)
    tracks.together[0] = rng.random(MOST) < 0.3
    tracks.threat_s[0] = np.where(rng.random(MOST) < 0.3, NOW_S - 2.0, -math.inf)
    return tracks


def given_up_aboard(tracks: Tracks, message: list[float], who: int) -> int:
    """Row that `companion.traffic.eviction` gives up; NOBODY: the newcomer."""
    judgement, ranking = Judgement(AvoidanceConfig()), Ranking()
    rows = [*tracks.heard[0].tolist(), message]
    names = [*tracks.who[0].tolist(), who]
    for row, (sent, name) in enumerate(zip(rows, names, strict=True)):
        new = row == MOST
        age = NOW_S - sent[0]
        margin = margin_m(WORLD.declared_m, WORLD.sigma_mps, age, 0.0)
        motion = Motion((sent[1], sent[2], sent[3]), (sent[4], sent[5], sent[6]), age, margin)
        trust = Trust.FRESH if new or tracks.messages[0, row] < 3 else Trust.ESTABLISHED
        held = not new and NOW_S - tracks.threat_s[0, row] <= HOLD_S
        standing, _ = judgement.standing(motion, trust, not new and bool(tracks.together[0, row]), 0, held)
        ranking.place(f"{name:04d}", standing)
    first = names.index(int(ranking.first()))
    return NOBODY if first == MOST else first


def test_a_full_table_evicts_the_same_track_as_aboard() -> None:
    rng = np.random.default_rng(1)
    craft = new_fleet(1, WORLD)
    found = []
    for spread_m in (60.0, 300.0, 2000.0):
        for _ in range(30):
            tracks = full_table(rng, spread_m)
            message = [NOW_S - 0.5, *rng.uniform(-spread_m, spread_m, 3), *rng.uniform(-10.0, 10.0, 3)]
            aboard = given_up_aboard(tracks, message, 77)
            here = give_up(
                NOW_S, WORLD, 0, np.array(message), 77, craft, tracks, judge_of(AvoidanceConfig()),
                np.zeros((MOST + 1, COLUMNS), np.int64), np.zeros(PLACES, np.int64),
            )  # fmt: skip
            assert here == aboard
            found.append(here)
    assert NOBODY in found
    assert len(set(found)) > 5


def past_of(rng: np.random.Generator, own: k.Own, turns: float) -> tuple[k.History, int]:
    """A history of own velocities in the last ten seconds that differ from each other, and its length."""
    times, velocities = np.zeros(64), np.zeros((64, 3))
    times[:50] = own.now_s - 0.2 * np.arange(50, 0, -1)
    steps = turns * rng.normal(size=(50, 3)) * [1.0, 1.0, 0.1]
    velocities[:50] = np.array(own.velocity) + np.cumsum(steps[::-1], axis=0)[::-1]
    return k.History(times, velocities), 50


def test_turns_are_bounded_for_the_velocity_that_the_law_uses_for_a_message() -> None:
    """Also for messages older than `note_turns` looks back, and in the first seconds of a flight."""
    rng = np.random.default_rng(3)
    law = settings_of(
        AvoidanceConfig(), LimitsConfig(), Trajectory([0.0, 9.0], [(0.0, 0.0, 0.0), (9.0, 0.0, 0.0)])
    )
    velocity, tight = k.Vector(5.0, -1.0, 0.3), 0
    own = k.Own(k.Vector(0.0, 0.0, -80.0), velocity, 1.5, 50.0, 45.0, math.inf, -math.inf)
    for _ in range(300):
        past, samples = past_of(rng, own, 0.5)
        first = 0 if rng.random() < 0.7 else int(rng.integers(samples + 1))  # few velocities are known yet
        times, velocities = np.zeros(64), np.zeros((64, 3))
        samples -= first
        times[:samples], velocities[:samples] = past.times_s[first:50], past.velocities[first:50]
        history = k.History(times, velocities)
        farthest = float(np.linalg.norm(velocities[:samples] - velocity, axis=1).max(initial=0.0))
        note_turns(own, history, samples, known := np.zeros((2, TURNS)))
        samples = k.note_velocity(times, velocities, samples, own.now_s, (velocity.n, velocity.e, velocity.d))
        for age_s in (0.0, 0.2, *rng.uniform(0.0, 4.0, 20).tolist()):
            then = own_velocity_at(history, samples, own.now_s - age_s)
            bound = turned_since(own, age_s, law, Scope(2.0, farthest), known)
            assert math.dist(then, velocity) <= bound + 1e-12
            tight += bound < farthest
    assert tight > 2000


@pytest.mark.parametrize("turns", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("change", [8.0, math.inf])
@pytest.mark.parametrize("speed_mps", [8.0, 1.0])
def test_a_neighbour_that_cannot_matter_changes_no_decision(
    change: float, turns: float, speed_mps: float
) -> None:
    """Random neighbours at all distances. Decisions are the same without those that `matters` excludes, given
    what `turned_since` says of the own velocity at the time of their messages. With the lower limit the own
    aircraft is faster than its law allows."""
    rng = np.random.default_rng(2)
    avoidance, limits = AvoidanceConfig(), LimitsConfig(max_speed_mps=speed_mps)
    path = k.Path(np.array([0.0, 300.0]), np.array([[0.0, 0.0, -80.0], [2000.0, 0.0, -80.0]]))
    law = settings_of(avoidance, limits, Trajectory(path.times_s.tolist(), path.points.tolist()))
    table, some, work = np.zeros((40, k.OTHER_COLUMNS)), np.zeros((40, k.OTHER_COLUMNS)), k.workspace(0, 40)
    left_out = compared = conflicts = 0
    for _ in range(60):
        velocity = k.Vector(float(rng.uniform(3.0, 8.0)), float(rng.uniform(-2.0, 2.0)), 0.3)
        own = k.Own(k.Vector(300.0, 0.0, -80.0), velocity, 1.5, 50.0, 45.0, math.inf, -math.inf)
        most = everything(own, law)
        within = min(change, most)
        past, samples = past_of(rng, own, turns)
        farthest = float(np.linalg.norm(past.velocities[:samples] - velocity, axis=1).max())
        note_turns(own, past, samples, known := np.zeros((2, TURNS)))
        kept = 0
        places = rng.uniform(-1.0, 1.0, (40, 3)) * rng.choice([250.0, 2500.0], (40, 1)) * [1.0, 1.0, 0.02]
        for row in range(40):
            other = k.Other._make(
                [
                    *(places[row] + [300.0, 0.0, -80.0]).tolist(),
                    *(rng.uniform(-8.0, 8.0, 3) * [1, 1, 0.1]).tolist(),
                    *(float(rng.uniform(0.0, 6.0)), 1.5, 0.3, float(rng.choice([0.0, 3.0]))),
                    *(float(rng.random() < 0.2), 0.5, 1.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.0),
                ]
            )
            k.put_other(table, row, other)
            turned = turned_since(own, other.age_s, law, Scope(within, farthest), known)
            assert turned <= farthest
            if matters(own, other, volume_of(other, own, law), law, Scope(within, turned)):
                k.put_other(some, kept, other)
                kept += 1
        decisions = []
        for neighbours, count in ((table, 40), (some, kept)):
            history = k.History(past.times_s.copy(), past.velocities.copy())
            state = k.first_state(law, samples)
            decisions.append(k.decide(neighbours, count, own, path, k.NO_WALLS, law, state, history, work))
        if within < most and not certain(own, law, decisions[1], within):
            continue
        compared += 1
        left_out += 40 - kept
        assert decisions[0].chosen == decisions[1].chosen
        assert decisions[0].solved == decisions[1].solved
        assert decisions[0].conflict == decisions[1].conflict
        conflicts += decisions[0].conflict
    assert compared > 15
    assert left_out > 10 * compared
    assert conflicts > 3
