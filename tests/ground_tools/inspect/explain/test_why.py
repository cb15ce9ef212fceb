"""Reasons for a chosen velocity: the half-spaces equal the core's, and the outcomes of alternatives."""

import math

import numpy as np
import pytest

from companion.avoidance import kernels as k
from companion.avoidance.kernels.neighbours import volume_of
from companion.avoidance.law import settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import Config, IdentityConfig, LimitsConfig
from companion.core import Companion
from companion.events import Decision, FenceArea
from companion.ownship import Ownship
from ground_tools.inspect.explain.why import Explainer, alternatives
from tests.ground_tools.inspect.flights import decision, guarded, track
from tests.support.place import HOME

CONFIG = Config(identity=IdentityConfig(uas_id="ONE"), limits=LimitsConfig(max_speed_mps=6.0))


def named(look, start):
    return next(one for one in look.alternatives if one.name.startswith(start))


def test_the_half_spaces_are_those_of_the_core():
    config, steps = guarded()[0]
    core, own, explainer = Companion(config), Ownship(), Explainer(config)
    compared = 0
    for step in steps:
        commands = core.step(step.now_s, step.events)
        for event in step.events:
            own.observe(event, step.now_s)
        explainer.note(step.now_s, own.velocity_ned_mps)
        for one in (c for c in commands if isinstance(c, Decision) and c.tracks):
            if core.plan.course.law is None or not any(t.active for t in one.tracks):
                continue
            look = explainer.look(step.now_s, one, own.position.height_above_home_m, own.sigma_m)
            planes = core.plan.course.law._work.asked[: len(one.tracks), 0]
            mine = [(*s.normal_ned, s.least_mps) for s in look.half_spaces if s.track]
            np.testing.assert_allclose(mine, planes, atol=1e-9)
            solved = core.plan.course.law._solved
            np.testing.assert_allclose(look.alternatives[0].velocity_ned_mps, solved, atol=1e-6)
            compared += 1
    assert compared > 50


def test_each_alternative_says_how_near_it_would_have_come():
    look = alternatives(decision(track()), CONFIG)
    kept = named(look, "keep the")
    assert (kept.closest_track, kept.enters) == ("TWO", ("TWO",))
    assert kept.closest_m == pytest.approx(1.0)
    assert kept.closest_in_s == pytest.approx(20.0)
    stop = named(look, "stop")
    assert stop.closest_in_s == pytest.approx(30.0)  # still 50 m away when the law looks no farther
    assert stop.closest_m == pytest.approx(math.hypot(50.0, 1.0))
    climb = named(look, "climb at 2.0")
    assert climb.velocity_ned_mps[2] == -2.0
    assert climb.closest_m == pytest.approx((200.0 * 2.0 - 1.0 * 10.0) / math.hypot(10.0, 2.0))
    for one in look.alternatives:
        assert math.hypot(*one.velocity_ned_mps) <= 6.0 + 1e-9


def test_what_excludes_an_alternative_is_a_half_space_that_it_breaks():
    look = alternatives(decision(track(position_ned_m=(100.0, 0.0, -50.0))), CONFIG)
    space = next(s for s in look.half_spaces if s.cause == "TWO")
    kept = named(look, "keep the")
    assert [cause for cause, _ in kept.excluded_by] == ["TWO"]
    short = space.least_mps - np.dot(space.normal_ned, kept.velocity_ned_mps)
    assert kept.excluded_by[0][1] == pytest.approx(short)
    assert space.short_mps(space.point_ned_mps) == pytest.approx(0.0, abs=1e-12)
    found = look.alternatives[0]
    assert not found.excluded_by


def test_a_yielding_aircraft_excludes_nothing_beside_others():
    ghost = track("GHOST", position_ned_m=(100.0, 0.0, -50.0), yields=True)
    far = track("FAR", position_ned_m=(0.0, 900.0, -50.0), velocity_ned_mps=(0.0, 0.0, 0.0))
    alone, both = (
        named(alternatives(decision(*some), CONFIG), "keep the") for some in ((ghost,), (ghost, far))
    )
    assert [cause for cause, _ in alone.excluded_by] == ["GHOST"]
    assert not both.excluded_by
    assert "GHOST" in both.enters


def test_a_turn_is_the_smallest_that_is_allowed():
    look = alternatives(decision(track(position_ned_m=(100.0, -8.0, -50.0))), CONFIG)
    right, left = named(look, "turn right"), named(look, "turn left")
    assert not right.excluded_by
    smaller = int(right.name.split()[-2]) - 15
    assert left.name == "turn left by 45 deg" or int(left.name.split()[-2]) > smaller
    assert right.velocity_ned_mps[1] > 0.0 > left.velocity_ned_mps[1]
    assert math.hypot(*right.velocity_ned_mps) == pytest.approx(5.0)


def test_crewed_traffic_has_no_half_space_and_is_still_avoided():
    """It comes towards us, 30 m to the side; the law descends and moves sideways."""
    near = {"position_ned_m": (800.0, 30.0, -50.0), "velocity_ned_mps": (-40.0, 0.0, 0.0), "adsb": True}
    look = alternatives(decision(track("ABCDEF", radius_m=900.0, age_s=0.0, **near)), CONFIG)
    assert not [space for space in look.half_spaces if space.track]
    north, east, down = look.alternatives[0].velocity_ned_mps
    assert (north, east, down) != pytest.approx((5.0, 0.0, 0.0), abs=0.5)


def test_a_track_of_unknown_height_cannot_be_passed_above_or_below():
    """Such a track is predicted at exactly the own height."""
    sinks = (-5.0, 0.0, 1.0)
    look = alternatives(decision(track(position_ned_m=(100.0, 3.0, -50.0), velocity_ned_mps=sinks)), CONFIG)
    above = alternatives(decision(track(position_ned_m=(100.0, 3.0, -62.0), velocity_ned_mps=sinks)), CONFIG)
    assert next(s for s in look.half_spaces if s.track).normal_ned[2] == 0.0
    assert next(s for s in above.half_spaces if s.track).normal_ned[2] > 0.1
    assert named(look, "climb").closest_m < 5.0


def test_a_fence_and_a_floor_exclude_too():
    corners = ((-100.0, -30.0), (12.0, -30.0), (12.0, 30.0), (-100.0, 30.0))
    area = FenceArea(inclusion=True, points=tuple(HOME.to_geodetic(n, e, 0.0)[:2] for n, e in corners))
    config = Config(
        identity=CONFIG.identity, limits=LimitsConfig(max_speed_mps=6.0, floor_height_m=50.0), fence=(area,)
    )
    look = Explainer(config).look(0.0, decision(track(conflict=False, active=False)), height_m=50.0)
    assert "fence" in dict(named(look, "keep the").excluded_by)
    assert "descent or floor" in dict(named(look, "descend").excluded_by)
    assert not named(look, "stop").excluded_by
    assert "descent or floor" not in dict(named(alternatives(decision(), CONFIG), "descend").excluded_by)


def test_without_tracks_nothing_is_excluded():
    look = alternatives(decision(), CONFIG)
    assert all(one.closest_m is None and not one.excluded_by for one in look.alternatives)


@pytest.mark.parametrize(
    ("radius_m", "height_m", "above_m", "enters"),
    [
        # Wider because of manoeuvres to the side, and not taller; and the other way round.
        (40.0, 15.0, 14.0, True),
        (40.0, 15.0, 16.0, False),
        (14.0, 50.0, 49.0, True),
        (14.0, 50.0, 51.0, False),
        # If the record has no height, the ratio of height to width is 1 / 0.85.
        (17.0, 0.0, 19.9, True),
        (17.0, 0.0, 20.1, False),
    ],
)
def test_an_alternative_enters_a_volume_as_tall_as_it_was(radius_m, height_m, above_m, enters):
    level = {"position_ned_m": (200.0, 0.0, -50.0 - above_m), "velocity_ned_mps": (-5.0, 0.0, 0.0)}
    look = alternatives(decision(track(radius_m=radius_m, height_m=height_m, **level)), CONFIG)
    assert named(look, "keep the").enters == (("TWO",) if enters else ())


@pytest.mark.parametrize("crewed", [False, True])
@pytest.mark.parametrize(("growth_mps", "growth_down_mps"), [(0.0, 0.0), (2.0, 0.0), (0.0, 3.0), (1.0, 2.5)])
def test_the_volume_of_a_track_is_the_logged_one(crewed, growth_mps, growth_down_mps):
    settings = settings_of(CONFIG.avoidance, CONFIG.limits, Trajectory([0.0, 1.0], [(0, 0, 0), (5, 0, 0)]))
    own = k.Own(k.Vector(0, 0, -50), k.Vector(5, 0, 0), 1.5, 0.0, 0.0, math.inf, -math.inf)
    growths = (0.0, 0.0) if crewed else (growth_mps, growth_down_mps)
    there = k.Other(
        200, 0, -51, -5, 0, 0, 1.5, 3.0, 0.4, growths[0], 0.0, 0.5, 1.0, float(crewed), growths[1],
        0.0, 0.0, 0.0, 0.0,
    )  # fmt: skip
    flown = volume_of(there, own, settings)
    view = track(radius_m=flown.radius, height_m=flown.radius / flown.scale, age_s=1.5, adsb=crewed)
    again = Explainer(CONFIG)._neighbour(view, decision(view), 1.5)
    assert volume_of(again, own, settings) == pytest.approx(flown)


@pytest.mark.parametrize("sigma_m", [0.1, 0.7, 4.0])
def test_the_volume_of_a_sensed_track_is_the_logged_one(sigma_m):
    """The volume may be smaller than the own error alone would make it."""
    settings = settings_of(CONFIG.avoidance, CONFIG.limits, Trajectory([0.0, 1.0], [(0, 0, 0), (5, 0, 0)]))
    own = k.Own(k.Vector(0, 0, -50), k.Vector(5, 0, 0), 2.0, 0.0, 0.0, math.inf, -math.inf)
    there = k.Other(*[20.0, 0.0, -50.0, -5.0, 0.0, 0.0, 0.5, sigma_m, *[0.0] * 3, 1.0, *[0.0] * 6, 1.0])
    flown = volume_of(there, own, settings)
    view = track(radius_m=flown.radius, height_m=flown.radius / flown.scale, age_s=0.5)
    again = Explainer(CONFIG)._neighbour(view, decision(view), 2.0)
    assert volume_of(again, own, settings) == pytest.approx(flown)
