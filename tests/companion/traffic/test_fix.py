"""One Location as the law gets it: where, when, how accurate, and what of it counts as unknown."""

from __future__ import annotations

import math

import msgspec
import pytest

from companion.remote_id.messages import Location
from companion.traffic.fix import Belief, hold, make_fix
from tests.support.place import HOME

SEPARATION_M = 47.0
OFFSET_S = 1_767_225_600.0
"""A full hour, so that a timestamp equals our monotonic time within the first hour."""


def fix_of(now_s=10.0, utc_offset_s=OFFSET_S, separation_m=SEPARATION_M, most_s=5.0, **content):
    values = {"lat_deg": HOME.lat_deg, "lon_deg": HOME.lon_deg, "alt_geodetic_m": 447.0, "timestamp_s": 10.0}
    message = Location(**{**values, **content})
    return make_fix(message, now_s, utc_offset_s, HOME, separation_m, most_s)


@pytest.mark.parametrize(
    "missing", [{"lat_deg": None}, {"lon_deg": None}, {"lat_deg": None, "lon_deg": None}]
)
def test_half_a_position_is_none(missing):
    assert fix_of() is not None
    assert fix_of(**missing) is None


@pytest.mark.parametrize(
    ("content", "separation_m", "known", "down_m"),
    [
        # 500 m above the ellipsoid are 453 m above the sea, 53 m above the frame.
        ({"alt_geodetic_m": 500.0}, 47.0, True, -53.0),
        ({"alt_geodetic_m": 500.0, "vertical_accuracy_m": 10.0}, 47.0, True, -53.0),
        # An inaccurate height is carried on for the display, but does not count.
        ({"alt_geodetic_m": 500.0, "vertical_accuracy_m": 10.1}, 47.0, False, -53.0),
        ({"alt_geodetic_m": None}, 47.0, False, 0.0),
        ({"alt_geodetic_m": 500.0}, None, False, 0.0),
    ],
)
def test_when_a_height_is_known(content, separation_m, known, down_m):
    fix = fix_of(separation_m=separation_m, **content)
    assert fix.vertical_known is known
    assert fix.position == pytest.approx((0.0, 0.0, down_m), abs=1e-6)


@pytest.mark.parametrize(
    ("accuracy_m", "timestamp_s", "sigma_m"),
    [
        (3.0, 10.0, 3.0),
        (14.9, 10.0, 14.9),
        (15.1, 10.0, 15.0),
        (None, 10.0, 5.0),
        # Dated by its reception, another 5 m in quadrature: half a second at 10 m/s.
        (12.0, None, 13.0),
        (3750.0, None, math.sqrt(250.0)),
        (None, None, math.sqrt(50.0)),
    ],
)
def test_the_deviation_of_a_position(accuracy_m, timestamp_s, sigma_m):
    fix = fix_of(horizontal_accuracy_m=accuracy_m, timestamp_s=timestamp_s)
    assert fix.sigma_m == pytest.approx(sigma_m)


@pytest.mark.parametrize(("accuracy_mps", "sigma_mps"), [(0.3, 0.3), (0.6, 0.5), (10.0, 0.5), (None, 0.5)])
def test_the_deviation_of_a_velocity(accuracy_mps, sigma_mps):
    assert fix_of(speed_accuracy_mps=accuracy_mps).sigma_mps == sigma_mps


@pytest.mark.parametrize(
    ("timestamp_s", "now_s", "lead_s"),
    [
        (10.0, 11.0, -1.0),
        (12.0, 11.0, 1.0),
        # Across the full hour, either way.
        (3599.5, 3600.5, -1.0),
        (0.5, 3599.5, 1.0),
        # Not quite half an hour off in either direction is taken for what it is, half an hour and more for
        # the neighbouring hour.
        (10.0, 10.0 + 1799.0, -1799.0),
        (10.0, 10.0 + 1801.0, 1799.0),
        (10.0, 7200.0 + 12.0, -2.0),
    ],
)
def test_the_hour_of_a_timestamp_is_the_nearest(timestamp_s, now_s, lead_s):
    fix = fix_of(now_s, timestamp_s=timestamp_s, most_s=3600.0)
    assert fix.lead_s == pytest.approx(lead_s, abs=1e-6)
    assert fix.stamp_s == pytest.approx(now_s + lead_s, abs=1e-6)


@pytest.mark.parametrize("lead_s", [5.0, -5.0])
@pytest.mark.parametrize("beyond_s", [-0.1, 0.1])
def test_a_timestamp_too_far_from_our_utc_is_reported_but_does_not_date_the_message(lead_s, beyond_s):
    lead_s += math.copysign(beyond_s, lead_s * beyond_s)
    fix = fix_of(now_s=100.0, timestamp_s=100.0 + lead_s, horizontal_accuracy_m=3.0)
    assert fix.lead_s == pytest.approx(lead_s, abs=1e-6)
    if beyond_s > 0.0:
        assert fix.stamp_s is None
        assert fix.sigma_m > 3.0
    else:
        assert fix.stamp_s == pytest.approx(100.0 + lead_s, abs=1e-6)
        assert fix.sigma_m == 3.0


@pytest.mark.parametrize("unknown", [{"timestamp_s": None}, {"utc_offset_s": None}])
def test_without_a_timestamp_or_our_utc_there_is_no_lead(unknown):
    fix = fix_of(**unknown)
    assert (fix.lead_s, fix.stamp_s) == (None, None)


@pytest.mark.parametrize(
    ("speed_mps", "direction_deg", "climb_mps", "velocity"),
    [
        (10.0, 0.0, 2.0, (10.0, 0.0, -2.0)),
        (10.0, 90.0, -2.0, (0.0, 10.0, 2.0)),
        (10.0, 210.0, None, (-8.660254, -5.0, 0.0)),
        # Who hovers has no direction.
        (0.0, None, 1.0, (0.0, 0.0, -1.0)),
        (0.0, None, None, (0.0, 0.0, 0.0)),
        (10.0, None, 1.0, None),
        (None, 90.0, 1.0, None),
    ],
)
def test_the_declared_velocity(speed_mps, direction_deg, climb_mps, velocity):
    fix = fix_of(speed_mps=speed_mps, direction_deg=direction_deg, vertical_speed_mps=climb_mps)
    assert fix.velocity == (None if velocity is None else pytest.approx(velocity, abs=1e-6))


# ------------------------------------------------------------ states that agree


def told(north_m=0.0, up_m=0.0, at_s=10.0, told_s=10.0, speed_mps=0.0, **more):
    """A state declared to 3 m in both directions; it flies north."""
    values = {"sigma_m": 3.0, "sigma_mps": 0.5, "vertical_known": True, "height_m": 3.0} | more
    return Belief(at_s, told_s, told_s, (north_m, 0.0, -up_m), (speed_mps, 0.0, 0.0), **values)


@pytest.mark.parametrize(
    ("off", "agree"),
    [
        # Two standard deviations of both positions, 2 * 4.24 m, and 2 m: half of what the law keeps.
        ({"north_m": 10.4}, True),
        ({"north_m": 10.6}, False),
        ({"north_m": 6.6, "sigma_m": 0.0}, True),
        ({"north_m": 8.1, "sigma_m": 0.0}, False),
        # Twice both errors of the height, and 2 m.
        ({"up_m": 13.9}, True),
        ({"up_m": 14.1}, False),
        ({"up_m": -14.1}, False),
        ({"up_m": 9.9, "height_m": 1.0}, True),
        ({"up_m": 10.1, "height_m": 1.0}, False),
        ({"up_m": 500.0, "vertical_known": False}, True),
        ({"speed_mps": 2.4}, True),
        ({"speed_mps": 2.6}, False),
        # In two seconds it may have manoeuvred with 5 m/s^2, if as much time passed here.
        ({"north_m": 20.4, "at_s": 12.0, "told_s": 12.0}, True),
        ({"north_m": 20.6, "at_s": 12.0, "told_s": 12.0}, False),
        ({"north_m": 10.6, "at_s": 12.0}, False),
        ({"north_m": 10.6, "told_s": 12.0}, False),
    ],
)
def test_states_agree_within_noise_and_a_gentle_manoeuvre(off, agree):
    assert told().agrees(told(**off)) is agree
    assert told(**off).agrees(told()) is agree


def test_a_state_is_compared_with_where_the_other_one_leads():
    assert told(speed_mps=20.0).agrees(told(40.0, at_s=12.0, told_s=12.0, speed_mps=20.0))
    assert not told(speed_mps=20.0).agrees(told(0.0, at_s=12.0, told_s=12.0, speed_mps=20.0))


def test_a_belief_with_which_a_message_agrees_is_as_fresh_as_that_message():
    """Also one that is kept, because the message followed it too soon to replace it."""
    first = told(at_s=0.0, told_s=0.0, north_m=0.0, speed_mps=5.0)
    later = told(at_s=1.0, told_s=1.0, north_m=5.0, speed_mps=5.0)
    for least_s, kept in ((3.0, first), (0.5, later)):
        beliefs = [first]
        hold(beliefs, later, 1.0, least_s)
        assert beliefs == [msgspec.structs.replace(kept, agreed_s=1.0)]
