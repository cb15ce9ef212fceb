"""The campaign's flights: the law is that of the aircraft, and vehicles and messages are as documented."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from companion.avoidance import kernels as k
from companion.avoidance.law import Law, Neighbour, Situation, settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from ground_tools.campaign import flight, outcome, vehicles
from ground_tools.campaign.cells import Cell, look
from ground_tools.campaign.generators import APART_M, HEIGHT_M, MEETING_S, NAMES, draw
from ground_tools.campaign.world import World

EXACT = World(sigma_m=0.0, sigma_mps=0.0, declared_m=0.0, quantised=False, delay_s=(0.0, 0.0))
DMUCA, ALONE = AvoidanceConfig(), AvoidanceConfig(law="none")


def fly(times, points, world, avoidance=DMUCA, seed=1, steps=0, kinds=None):
    paths = [Trajectory(t.tolist(), p.tolist()) for t, p in zip(times, points, strict=True)]
    kinds = np.zeros(len(paths)) if kinds is None else np.array(kinds, float)
    settings = [settings_of(avoidance, LimitsConfig(), path) for path in paths]
    for i in np.flatnonzero(kinds != vehicles.AVOIDS):
        settings[i] = settings[i]._replace(law=k.NONE)
    trace, result = np.zeros((steps, len(paths), 3)), np.zeros(outcome.FLIGHT_ENTRIES)
    flight.fly(
        np.random.default_rng(seed),
        world.conditions(avoidance.period_s),
        times,
        points,
        k.NO_WALLS,
        np.array(settings),
        kinds,
        trace,
        outcome.new_log(len(paths)),
        np.zeros((len(paths), len(paths), outcome.PAIR_ENTRIES)),
        result,
    )
    return result, trace


def not_compiled(monkeypatch):
    """Run the loop of a flight and the parts of the law that it calls as plain Python."""
    for name in ("_fly", "loop_of", "flying_law"):
        monkeypatch.setattr(flight, name, getattr(flight, name).py_func)


def straight(*ways):
    """Paths of 60 s from (north, east) to (north, east), 100 m up."""
    points = np.array([[(n, e, -100.0), (m, f, -100.0)] for n, e, m, f in ways], float)
    return np.tile([0.0, 60.0], (len(ways), 1)), points


# ---------------------------------------------------------------- the law


class Core:
    """Repeats every decision of a flight with `Law`, from situations and neighbours."""

    def __init__(self, times, points, avoidance):
        self.laws = [
            Law(avoidance, LimitsConfig(), Trajectory(t.tolist(), p.tolist()))
            for t, p in zip(times, points, strict=True)
        ]
        self.decide = k.decide
        self.decisions = 0
        self.ages = []
        self._of = {}

    def __call__(self, neighbours, count, own, path, *others):
        decision = self.decide(neighbours, count, own, path, *others)
        law = self.laws[self._of.setdefault(path.times_s.__array_interface__["data"][0], len(self._of))]
        heard = [
            Neighbour(
                f"uas-{i}",
                (other.n, other.e, other.d),
                (other.vn, other.ve, other.vd),
                other.age_s,
                other.sigma_m,
                other.sigma_mps,
                other.growth_mps,
                other.silent == 1.0,
                other.share,
                other.vertical_known == 1.0,
                other.crewed == 1.0,
            )
            for i, other in enumerate(k.Other(*row) for row in neighbours[:count].tolist())
        ]
        view = Situation(own.now_s, own.path_time_s, own.position, own.velocity, own.sigma_m, heard)
        result = law.decide(view)
        assert result.chosen_ned_mps == decision.chosen
        assert result.wanted_ned_mps == decision.wanted
        assert (result.feasible, result.conflict) == (decision.feasible, decision.conflict)
        self.decisions += 1
        self.ages += [other.age_s for other in heard]
        return decision


@pytest.mark.parametrize("law", ["dmuca", "paper"])
def test_every_command_is_the_one_that_the_core_gives(law, monkeypatch):
    """The commands agree bit for bit, and the compiled flight equals the recorded one."""
    avoidance = AvoidanceConfig(law=law)
    times, points = draw("crossing", 3, 5.0, 4)
    world = World(start_s=MEETING_S - 40.0, end_s=MEETING_S + 20.0, delay_s=(1.0, 2.0))
    compiled, _ = fly(times, points, world, avoidance)
    core = Core(times, points, avoidance)
    monkeypatch.setattr(k, "decide", core)
    not_compiled(monkeypatch)
    result, _ = fly(times, points, world, avoidance)
    assert core.decisions == 3 * 300
    assert result[outcome.F_MANOEUVRES] > 0.0
    assert result == pytest.approx(compiled, rel=1e-9)
    # 1 s between messages, 1 to 2 s of delay, and up to 0.2 s until the next decision.
    assert 1.0 <= min(core.ages) < 1.2
    assert 2.5 < max(core.ages) <= 3.2


# ---------------------------------------------------------------- vehicles and air


def test_a_fleet_that_does_not_avoid_flies_its_paths():
    times, points = straight((-100.0, 0.0, 100.0, 0.0), (0.0, -101.0, 0.0, 99.0))
    result, trace = fly(times, points, replace(EXACT, end_s=60.0), ALONE, steps=600)
    assert result[outcome.F_SEPARATION] == pytest.approx(1.0 / math.sqrt(2.0), abs=0.05)
    assert result[outcome.F_TIME] == pytest.approx(30.0, abs=0.5)
    assert (result[outcome.F_FIRST], result[outcome.F_SECOND]) == (0.0, 1.0)
    assert result[outcome.F_DEVIATION] < 2.0  # from starting and stopping
    assert result[outcome.F_AWAY] == 0.0
    assert trace[299, 0] == pytest.approx((0.0, 0.0, -100.0), abs=1.5)


def test_avoiding_costs_a_detour_that_is_measured():
    times, points = straight((-100.0, 0.0, 100.0, 0.0), (0.0, -101.0, 0.0, 99.0))
    result, _ = fly(times, points, replace(EXACT, end_s=60.0))
    assert result[outcome.F_SEPARATION] > 10.0
    assert result[outcome.F_MANOEUVRES] >= 2.0
    assert result[outcome.F_DEVIATION] > 5.0


def test_without_messages_nobody_is_avoided():
    times, points = straight((-100.0, 0.0, 100.0, 0.0), (0.0, -101.0, 0.0, 99.0))
    deaf, _ = fly(times, points, replace(EXACT, end_s=60.0, loss=1.0))
    alone, _ = fly(times, points, replace(EXACT, end_s=60.0), ALONE)
    assert deaf[outcome.F_MANOEUVRES] == 0.0
    assert deaf[outcome.F_SEPARATION] == pytest.approx(alone[outcome.F_SEPARATION], abs=1e-6)


def test_errors_are_as_large_and_as_slow_as_asked():
    """An aircraft that follows a wrong position is off by the error, which changes slowly."""
    times, points = straight((0.0, 0.0, 0.1, 0.0), (5000.0, 0.0, 5000.1, 0.0))
    times[:, 1] = 4000.0
    world = replace(EXACT, end_s=4000.0, sigma_m=3.0, sigma_memory_s=100.0)
    _, trace = fly(times, points, world, ALONE, steps=40_000)
    east = trace[:, :, 1]
    assert np.sqrt((east**2).mean()) == pytest.approx(3.0, rel=0.35)
    assert np.abs(np.diff(east, axis=0)).max() < 0.3


def test_messages_are_quantised():
    message = np.array([0.0, 3.217, -8.141, -100.31, 2.13, -1.07, 0.8])
    vehicles._quantise(message)
    speed, course = math.hypot(message[4], message[5]), math.degrees(math.atan2(message[5], message[4]))
    assert (speed / 0.25) % 1.0 == pytest.approx(0.0, abs=1e-9)
    assert speed == pytest.approx(math.hypot(2.13, 1.07), abs=0.125)
    assert course == pytest.approx(round(course), abs=1e-9)
    assert (message[3], message[6]) == (-100.5, 1.0)
    assert message[1:3] == pytest.approx((3.217, -8.141), abs=0.006)


def test_same_seed_same_flight_other_seed_another():
    times, points = draw("S2", 4, 5.0, 3)
    world = World(start_s=200.0, end_s=300.0)
    first, again, other = (fly(times, points, world, seed=seed)[0] for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert first[outcome.F_SEPARATION] != other[outcome.F_SEPARATION]


# ---------------------------------------------------------------- encounters


@pytest.mark.parametrize("name", NAMES)
def test_generators(name):
    """The same seed gives the same paths, the ends are far apart, and nearly all lose separation if flown as
    planned."""
    lost = 0
    for seed in range(10):
        times, points = draw(name, 8, 5.0, seed)
        again = draw(name, 8, 5.0, seed)
        np.testing.assert_array_equal(points, again[1])
        assert times.shape[0] == points.shape[0] == 8
        assert (np.diff(times) > 0.0).all()
        for ends in (points[:, 0], points[:, -1]):
            gaps = np.linalg.norm(ends[:, None] - ends[None], axis=2)[np.triu_indices(8, 1)]
            assert gaps.min() > APART_M
        assert np.abs(points[:, :, 2] + HEIGHT_M).max() < 60.0
        way = np.linalg.norm(np.diff(points, axis=1), axis=2) / np.diff(times)
        assert way.max() <= 3.76
        at = np.linspace(times[0, 0], times[0, -1], 2000)
        place = np.array(
            [[np.interp(at, t, p[:, c]) for c in range(3)] for t, p in zip(times, points, strict=True)]
        )
        gaps = np.linalg.norm(place[:, None] - place[None], axis=2)[np.triu_indices(8, 1)]
        lost += gaps.min() < 10.0
    assert lost >= 8


def test_errors_of_drawing_are_reported():
    with pytest.raises(ValueError, match="allowed: S1, S2, S3, head-on"):
        draw("spiral", 4, 5.0, 1)
    with pytest.raises(ValueError, match="at least 2"):
        draw("wall", 1, 5.0, 1)
    with pytest.raises(ValueError, match="at least 40 m apart"):
        draw("circle", 60, 1.0, 1)


# ---------------------------------------------------------------- what makes it hard


HEAD_ON = straight((-60.0, 0.0, 60.0, 0.0), (60.0, 1.0, -60.0, 1.0))
SHORT = replace(EXACT, end_s=60.0)


def least(world=SHORT, kinds=None, seed=1):
    return fly(*HEAD_ON, world, seed=seed, kinds=kinds)[0][outcome.F_SEPARATION]


def test_silent_aircraft_and_liars_are_avoided_less():
    assert least() > 10.0
    silent = fly(*HEAD_ON, replace(SHORT, silent_m=15.0), kinds=[vehicles.AVOIDS, vehicles.SILENT])[0]
    assert silent[outcome.F_SEPARATION] < 10.0
    assert least(kinds=[vehicles.AVOIDS, vehicles.LIAR]) < least(kinds=[vehicles.AVOIDS, vehicles.BLIND])
    assert least(replace(SHORT, lie_m=0.0), kinds=[vehicles.AVOIDS, vehicles.LIAR]) > 10.0


def test_a_turning_aircraft_leaves_its_path_within_its_speed():
    times, points = HEAD_ON
    _, straight_on = fly(times, points, SHORT, ALONE, steps=600)
    _, turning = fly(times, points, SHORT, ALONE, steps=600, kinds=[vehicles.AVOIDS, vehicles.TURNING])
    assert np.abs(turning[:, 0] - straight_on[:, 0]).max() == 0.0
    assert np.abs(turning[:, 1] - straight_on[:, 1]).max() > 3.0
    spans = turning[1:, 1] - turning[:-1, 1]
    assert (np.linalg.norm(spans, axis=1) / 0.1).max() < 5.0 + 1e-6


def test_a_frozen_aircraft_turns_likewise_but_reports_its_first_velocity(monkeypatch):
    seen = {}
    decide = k.decide

    def spy(neighbours, count, own, *others):
        if not any(getattr(other, "law", None) == k.NONE for other in others):
            sent = k.Other(*neighbours[:count].T)
            seen[kind].update(zip(sent.vn.tolist(), sent.ve.tolist(), strict=True))
        return decide(neighbours, count, own, *others)

    monkeypatch.setattr(k, "decide", spy)
    not_compiled(monkeypatch)
    flown = {}
    for kind in (vehicles.TURNING, vehicles.FROZEN):
        seen[kind] = set()
        flown[kind] = fly(*HEAD_ON, EXACT, steps=100, kinds=[vehicles.AVOIDS, kind])[1][:, 1]
    assert np.array_equal(flown[vehicles.TURNING], flown[vehicles.FROZEN])
    assert len(seen[vehicles.TURNING]) > 3
    assert len(seen[vehicles.FROZEN]) == 1


def test_wind_clock_errors_and_velocity_errors_have_an_effect(monkeypatch):
    calm = fly(*HEAD_ON, SHORT, ALONE, steps=600)[1]
    shaken = fly(*HEAD_ON, replace(SHORT, gust_mps2=0.6), ALONE, steps=600)[1]
    assert 0.2 < np.abs(shaken - calm).max() < 15.0
    heard = []
    decide = k.decide

    def spy(neighbours, count, own, *others):
        heard.append((own.velocity.n, *k.Other(*neighbours[:count].T).age_s.tolist()))
        return decide(neighbours, count, own, *others)

    monkeypatch.setattr(k, "decide", spy)
    not_compiled(monkeypatch)
    fly(*HEAD_ON, replace(SHORT, end_s=20.0, clock_s=0.5), seed=3)
    ages = np.array([h[1] for h in heard if len(h) > 1])
    assert ages.min() == 0.0  # even with a clock that is ahead, no message has a negative age
    assert ages.max() > 0.9
    own = np.array([h[0] for h in heard])
    heard.clear()
    world = replace(SHORT, end_s=20.0, clock_s=0.5, own_sigma_mps=0.3)
    fly(*HEAD_ON, world, seed=3)
    assert np.abs(np.array([h[0] for h in heard])[:2] - own[:2]).max() > 0.02


def test_floor_and_ceiling_hold():
    times, points = straight((-60.0, 0.0, 60.0, 0.0), (60.0, 1.0, -60.0, 1.0))
    points[0, 1, 2], points[1, 1, 2] = -160.0, -40.0  # the path leads through both
    world = replace(SHORT, floor_m=70.0, ceiling_m=130.0)
    _, trace = fly(times, points, world, steps=600)
    assert -130.5 < trace[:, :, 2].min() < -128.0
    assert -72.0 < trace[:, :, 2].max() < -69.5


def test_tracks_with_large_gaps_are_kept_longer():
    """Decisions use ages beyond the 15 s of a track without gaps, up to 30 s."""
    ages_s = look(Cell(generator="S2", aircraft=5, loss=0.8), 1).log.others[..., 6]
    ages_s = ages_s[np.isfinite(ages_s)]
    assert (ages_s > 15.0).sum() > 500
    assert ages_s.max() <= 30.0
    regular = look(Cell(generator="S2", aircraft=5), 1).log.others[..., 6]
    assert regular[np.isfinite(regular)].max() <= 15.0
