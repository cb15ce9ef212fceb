"""A decision is given the same neighbours whether or not it is remembered which tracks cannot matter."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.law import settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from companion.errors import ConfigError
from ground_tools.campaign.vehicles import Fleet
from ground_tools.campaign.world import World
from ground_tools.city.draws import put_arrival
from ground_tools.city.flights import Wish, flights_of
from ground_tools.city.judging import judge_of
from ground_tools.city.links import Grid
from ground_tools.city.loop import GIVEN
from ground_tools.city.simulation import Simulation
from ground_tools.city.tables import NOBODY, Tracks, new_air, new_fleet, new_tracks
from ground_tools.city.tracks import TURNS, Desk, Scope, look, needed_m, receive

MOST = 60
PERIOD_S = 0.2
WORLD = World().conditions(PERIOD_S)


def message(rng: np.random.Generator, own: Floats, velocity: Floats, now: float) -> Floats:
    """Time, position and velocity of an aircraft somewhere around, or on a collision course ahead."""
    theirs = rng.uniform(-1.0, 1.0, 3) * rng.choice([2.0, 15.0]) * [1.0, 1.0, 0.2]
    away = rng.choice([100.0, 600.0, 2000.0]) * rng.uniform(-1.0, 1.0, 3) * [1.0, 1.0, 0.05]
    if rng.random() < 0.5:
        away = (
            rng.uniform(0.0, 2000.0)
            * (velocity - theirs)
            / max(float(np.linalg.norm(velocity - theirs)), 1.0)
        )
    return np.array([now - rng.choice([0.0, 2.0]), *(own + away), *theirs])


def take(rng: np.random.Generator, tracks: Tracks, row: int, sent: Floats, now: float, who: int) -> None:
    """A new message, as `tracks._take` writes it, with any growth and gap."""
    past = np.array(k.NO_PAST)
    past[:7] = sent
    past[7:10] = (
        rng.choice([0.0, 3.0]) * rng.random(),
        rng.choice([0.0, 3.0]) * rng.random(),
        rng.uniform(1, 8),
    )
    tracks.past[0, row], tracks.who[0, row], tracks.got_s[0, row] = past, who, now
    tracks.beyond_m[0, row] = -math.inf


def new_desk() -> Desk:
    return Desk(
        np.zeros((MOST, k.OTHER_COLUMNS)), np.zeros(MOST, np.int64), np.zeros(MOST, np.int64),
        np.zeros(2, np.int64), np.full((2, TURNS), math.inf), np.zeros((1, 7), np.int64),
        np.zeros(1, np.int64),
    )  # fmt: skip


def looked(
    now: float, own: k.Own, law: k.Settings, scope: Scope, craft: Fleet, tracks: Tracks
) -> tuple[list[int], list[list[float]], list[int]]:
    """Flights and rows of the neighbours that are given to the decision, and all tracks that are kept."""
    desk = new_desk()
    asked, count = look(now, WORLD, 0, own, law, scope, craft, tracks, desk)
    assert asked == count  # nothing is known of the own velocities
    rows = desk.order[:count]
    flights = tracks.who[0, rows].tolist()
    assert flights == sorted(flights)
    return flights, desk.neighbours[:count].tolist(), tracks.who[0].tolist()


def law_of() -> k.Settings:
    path = Trajectory([0.0, 300.0], [(0.0, 0.0, 0.0), (3e3, 0.0, 0.0)])
    return k.Settings(*settings_of(AvoidanceConfig(), LimitsConfig(max_speed_mps=15.0), path))


@pytest.mark.parametrize("seed", range(8))
def test_a_track_that_is_not_looked_at_does_not_matter(seed: int) -> None:
    """Aircraft that turn, stop and jump, with all kinds of neighbours: the same result as with a look at each
    track, although most of them are not looked at."""
    rng = np.random.default_rng(seed)
    law = law_of()
    craft, tracks, other = new_fleet(1, WORLD), new_tracks(1, MOST), new_tracks(1, MOST)
    tracks.used[0] = other.used[0] = MOST
    position, velocity = np.array([0.0, 0.0, -80.0]), np.array([10.0, 0.0, 0.0])
    craft.clock[0] = rng.uniform(-1.0, 1.0)
    turned, skipped, mattered, kept = 2.0, 0, 0, 0
    for step in range(300):
        now = 100.0 + step * PERIOD_S
        for row in range(MOST):
            if step == 0 or rng.random() < 0.03:
                sent, who = message(rng, position, velocity, now), int(rng.integers(1000))
                state = rng.bit_generator.state
                take(rng, tracks, row, sent, now, who)
                rng.bit_generator.state = state
                take(rng, other, row, sent, now, who)
        if rng.random() < 0.03:
            velocity = rng.uniform(-15.0, 15.0, 3) * [1.0, 1.0, 0.2] * rng.choice([0.0, 1.0])
            turned = float(rng.choice([0.0, 0.0, 3.0, 12.0]))
        position = position + PERIOD_S * velocity + rng.normal(0.0, 0.2, 3) + (rng.random(3) < 0.01) * 30.0
        own = k.Own(k.Vector(*position), k.Vector(*velocity), 1.5, now, now, math.inf, -math.inf)
        scope = Scope(2.0 if rng.random() < 0.8 else float(rng.choice([8.0, 33.0])), turned)
        other.anchor[0] = -math.inf  # nothing is remembered
        found = looked(now, own, law, scope, craft, tracks)
        assert found == looked(now, own, law, scope, craft, other)
        skipped += int((tracks.beyond_m[0] >= needed_m(now, 0, own, law, scope, tracks)).sum())
        mattered, kept = mattered + len(found[0]), kept + sum(who != NOBODY for who in found[2])
    assert kept > 100 * MOST
    assert skipped > 0.2 * kept
    assert mattered > 0.05 * kept


def test_tracks_that_do_not_matter_yet_are_looked_at_in_time() -> None:
    """Aircraft that hover straight ahead, a metre apart, and deviate more and more: nothing else than the own
    speed and their growing volumes brings them nearer, and the bound leaves no room for anything else."""
    law, craft = law_of(), new_fleet(1, WORLD)
    tracks, other = new_tracks(1, MOST), new_tracks(1, MOST)
    past, numbers = np.array(k.NO_PAST), []
    past[[0, 7, 8, 9]] = 99.8, 3.0, 3.0, 1.0
    for kept in (tracks, other):
        kept.used[0], kept.who[0], kept.got_s[0] = MOST, np.arange(MOST), 100.0
        kept.past[0] = past
        kept.past[0, :, 1] = 380.0 + np.arange(MOST)
        kept.past[0, :, 3] = -80.0
    for step in range(11):
        now = 100.0 + step * PERIOD_S
        own = k.Own(k.Vector(10.0 * (now - 100.0), 0.0, -80.0), k.Vector(10.0, 0.0, 0.0), 1.5, now, now,
                    math.inf, -math.inf)  # fmt: skip
        other.anchor[0] = -math.inf  # nothing is remembered
        found = looked(now, own, law, Scope(2.0, 0.0), craft, tracks)
        assert found == looked(now, own, law, Scope(2.0, 0.0), craft, other)
        numbers.append(len(found[0]))
    assert 0 < numbers[0] < numbers[-1] < MOST


def test_a_new_message_of_a_track_that_could_not_matter_counts_at_once() -> None:
    craft, air, tracks, desk = new_fleet(2, WORLD), new_air(2), new_tracks(2, MOST), new_desk()
    air.flight[:] = 0, 1
    links = Grid(2, np.full(3, 100.0), craft.sent.shape[1], 1.0).find(craft.position, air, np.ones(2, bool))
    own = k.Own(k.Vector(0.0, 0.0, -80.0), k.Vector(0.0, 0.0, 0.0), 1.5, 0.0, 0.0, math.inf, -math.inf)
    for sent_s, north_m, flights in ((100.0, 3000.0, []), (101.0, 50.0, [1])):
        now = sent_s + 0.2
        craft.sent[1, 0] = sent_s, north_m, 0.0, -80.0, 0.0, 0.0, 0.0
        put_arrival(links, int(links.start[0]), 0, now, 1)
        receive(now, WORLD, 0, craft, air, tracks, links, judge_of(AvoidanceConfig()), desk)
        found = looked(now, own._replace(now_s=now), law_of(), Scope(2.0, 0.0), craft, tracks)
        assert found[0] == flights
        assert found[2][0] == 1
        assert (tracks.beyond_m[0, 0] > 0.0) == (flights == [])


def test_messages_that_are_too_frequent_are_refused() -> None:
    """Every message must count for `note_track`, whose memory holds the latest one."""
    wish = Wish(0.0, np.array([0.0, 60.0]), np.array([[0.0, 0.0, -30.0], [300.0, 0.0, -30.0]]), 10.0)
    rng = np.random.default_rng(1)
    avoidance = AvoidanceConfig()
    with pytest.raises(ConfigError, match="message_s"):
        Simulation(
            flights_of([wish], avoidance),
            avoidance,
            World(message_s=0.5),
            GIVEN,
            np.array([500.0, 0.0, 0.0]),
            rng,
            rng,
        )
