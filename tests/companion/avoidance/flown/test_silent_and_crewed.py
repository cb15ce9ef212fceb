"""Who falls silent in flight, and crewed traffic: whole encounters of one aircraft."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.law import (
    CREWED_HORIZON_S,
    OLDEST_S,
    Law,
    Neighbour,
    Situation,
    horizon_s,
    separation_m,
)
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from tests.companion.avoidance.flown.flying import Flight, Hears, fly

LIMITS = LimitsConfig()


class Sender:
    """Flies straight until `stops_s`, then stands; its messages, one each `every_s`, end there too."""

    def __init__(self, start: Any, velocity: Any, stops_s: float = math.inf, every_s: float = 1.0) -> None:
        self.start, self.velocity = np.array(start, dtype=float), np.array(velocity, dtype=float)
        self.stops_s, self.every_s = stops_s, every_s
        self.past = k.NO_PAST
        self.noted_s = -math.inf
        self.ages_s: list[float] = []

    def place(self, t: Any) -> Floats:
        """Where it truly is, at one time or at each of some."""
        return self.start + np.multiply.outer(np.minimum(t, self.stops_s), self.velocity)

    def hears(self, now: float, p: Floats, v: Floats) -> list[Neighbour]:
        """The newest message, with what its past says; nothing once it is too old."""
        sent = self.every_s * math.floor(min(now, self.stops_s) / self.every_s + 1e-9)
        if sent > self.noted_s:
            place = self.place(sent)
            noted = k.note_track(
                tuple(self.past), sent, tuple(place.tolist()), tuple(self.velocity.tolist()), 1.0
            )
            self.past = k.Past(*noted)
            self.noted_s = sent
        self.ages_s.append(now - sent)
        return [
            Neighbour(
                "b",
                tuple(self.place(sent).tolist()),
                tuple(self.velocity.tolist()),
                now - sent,
                1.0,
                growth_mps=self.past.growth_mps,
                silent=now - sent > k.silent_after(self.past.gap_s),
            )
        ]


def own(path_speed: float = 4.0, **keys: Any) -> Law:
    path = Trajectory([0, 100], [(0, 0, -50), (100 * path_speed, 0, -50)])
    return Law(AvoidanceConfig(**keys), LIMITS, path)


def distances(flight: Flight, other: Sender) -> Floats:
    return np.linalg.norm(flight.position - other.place(flight.time_s), axis=1)


@pytest.mark.parametrize(
    ("start", "velocity", "stops_s"),
    [
        ((60.0, 0.0, -50.0), (4.0, 0.0, 0.0), 5.0),  # flies ahead, as fast
        ((50.0, 2.0, -50.0), (6.0, 0.0, 0.0), 4.0),  # ahead and faster
        ((100.0, -45.0, -50.0), (0.0, 5.0, 0.0), 9.0),  # crosses, would be gone
        ((90.0, 1.0, -40.0), (0.5, 0.0, -1.0), 8.0),  # climbs away
    ],
)
def test_who_stopped_with_its_last_message_is_not_flown_into(
    start: Any, velocity: Any, stops_s: float
) -> None:
    other = Sender(start, velocity, stops_s)
    flight = fly(own(), stops_s + OLDEST_S, velocity=(4.0, 0.0, 0.0), hears=other.hears)
    near = distances(flight, other).min()
    alone = fly(own(), stops_s + OLDEST_S, velocity=(4.0, 0.0, 0.0))
    assert distances(alone, other).min() < 10.0
    assert near > 10.0


def picture(silent: bool, age_s: float = 5.0) -> Situation:
    """It has flown on to the north by its message; it may stand 50 m ahead."""
    other = Neighbour("b", (50.0, 1.0, -50.0), (8.0, 0.0, 0.0), age_s, 1.0, silent=silent)
    return Situation(0.0, 0.0, (0.0, 0.0, -50.0), (4.0, 0.0, 0.0), 1.0, [other])


@pytest.mark.parametrize("age_s", [0.5, 5.0, 14.0])
def test_it_may_stand_only_when_it_is_silent(age_s: float) -> None:
    """However old its message is: delay alone is no silence."""
    for silent in (False, True):
        one = own()
        assert one.decide(picture(silent, age_s)).conflict == silent
        assert one._work.asked[0, 1].any() == silent


def test_where_it_would_stand_is_a_second_after_its_message() -> None:
    """The plane of an aircraft that hovers there, seen by our velocity of now."""
    silent, hovering = own(), own()
    silent.decide(picture(True))
    there = Neighbour("b", (58.0, 1.0, -50.0), (0.0, 0.0, 0.0), 5.0, 1.0)
    hovering.decide(Situation(0.0, 0.0, (0.0, 0.0, -50.0), (4.0, 0.0, 0.0), 1.0, [there]))
    np.testing.assert_allclose(silent._work.asked[0, 1], hovering._work.asked[0, 0], atol=1e-12)


def test_who_may_stand_in_the_way_is_active() -> None:
    """Flying on, as its message says, it bounds nothing."""
    assert [own().decide(picture(silent)).tracks[0].active for silent in (False, True)] == [False, True]


def test_the_published_law_knows_no_silence() -> None:
    assert not own(law="paper").decide(picture(True, 14.0)).conflict


@pytest.mark.parametrize(("every_s", "silent_s"), [(1.0, 2.2), (3.0, 6.6), (5.0, 11.0)])
def test_regular_messages_are_no_silence(every_s: float, silent_s: float) -> None:
    """However rare: whoever flies ahead, faster, and is heard, as it has been, does not stand in the way."""
    other = Sender((60.0, 0.0, -50.0), (4.5, 0.0, 0.0), every_s=every_s)
    other.hears(-every_s, *np.zeros((2, 3)))
    one = own()
    flight = fly(one, 60.0, velocity=(4.0, 0.0, 0.0), hears=other.hears)
    assert k.silent_after(other.past.gap_s) == pytest.approx(silent_s, rel=1e-9)
    assert max(other.ages_s) < silent_s
    assert not any(result.conflict for result in flight.results)
    assert abs(flight.position[:, 1]).max() < 1e-9


# ---------------------------------------------------------------- radius and share


@pytest.mark.parametrize(
    ("keys", "radius_m"),
    [
        # 10 m, 4.0 standard deviations of both places (3 m, 4 m), and 0.2 m/s of steps.
        ({"age_s": 0.0}, 10.0 + 4.0 * 5.0),
        ({"age_s": 2.0}, 10.0 + 4.0 * 5.0 + 0.4),
        # The velocity's error over the age: 2 s of 6 m/s beside the 5 m.
        ({"age_s": 2.0, "sigma_mps": 6.0}, 10.0 + 4.0 * 13.0 + 0.4),
        # Manoeuvres from the message to 4 s from now, where they are more than the steps.
        ({"age_s": 2.0, "growth_mps": 1.5}, 10.0 + 4.0 * 5.0 + 1.5 * 6.0),
        ({"age_s": 2.0, "growth_mps": 0.05}, 10.0 + 4.0 * 5.0 + 0.4),
        ({"age_s": 0.0, "growth_mps": 3.0}, 10.0 + 4.0 * 5.0 + 12.0),
        ({"age_s": 2.0, "growth_mps": 1.5, "crewed": True}, 610.0 * math.sqrt(2.0) + 4.0 * 5.0 + 9.0),
    ],
)
def test_radius(keys: dict[str, Any], radius_m: float) -> None:
    other = Neighbour("b", (900.0, 0.0, -50.0), (0.0, 0.0, 0.0), sigma_m=3.0, **{"sigma_mps": 0.0, **keys})
    view = Situation(0.0, 0.0, (0.0, 0.0, -50.0), (4.0, 0.0, 0.0), 4.0, [other])
    assert own().decide(view).tracks[0].radius_m == pytest.approx(radius_m, rel=1e-12)
    paper = 610.0 * math.sqrt(2.0) if keys.get("crewed") else 10.0
    assert own(law="paper").decide(view).tracks[0].radius_m == pytest.approx(paper, rel=1e-12)


@pytest.mark.parametrize("share", [0.5, 0.8, 1.0])
def test_the_share_that_is_ours(share: float) -> None:
    """Of the way out of the obstacle, along its normal."""
    start, p, velocity, speed = (0.0, 0.0, -50.0), (60.0, 4.0, 0.0), (4.0, 0.0, 0.0), (-2.0, 0.0, 0.0)
    other = Neighbour("b", (60.0, 4.0, -50.0), speed, 0.0, 0.0, share=share)
    one = own()
    one.decide(Situation(0.0, 0.0, start, velocity, 0.0, [other]))
    relative = k.minus(k.Vector(*velocity), k.Vector(*speed))
    normal, way = k.half_space(k.Vector(*p), relative, 12.0, 20.0, 2.0)
    assert way > 0.1
    offset = normal[0] * 4.0 + share * way
    assert one._work.asked[0, 0].tolist() == pytest.approx([*normal, offset], abs=1e-12)


# ---------------------------------------------------------------- crewed traffic


def test_separations_of_crewed_traffic() -> None:
    """The ellipsoid touches the cylinder's rim, 610 m aside and 77 m above, and looks farther ahead."""
    avoidance = AvoidanceConfig()
    radius, scale = separation_m(avoidance, True)
    assert math.hypot(610.0, scale * 77.0) == pytest.approx(radius)
    assert horizon_s(avoidance, True) == CREWED_HORIZON_S
    assert separation_m(avoidance, False) == (10.0, 0.85)
    assert horizon_s(avoidance, False) == 20.0


def crewed(start: Any, velocity: Any) -> tuple[Hears, Any]:
    def place(t: Any) -> Floats:
        return np.array(start, dtype=float) + np.multiply.outer(t, np.array(velocity, dtype=float))

    def hears(now: float, p: Floats, v: Floats) -> list[Neighbour]:
        sent = math.floor(now)
        return [
            Neighbour(
                "c",
                tuple(place(sent).tolist()),
                velocity,
                now - sent,
                5.0,
                sigma_mps=0.5,
                share=1.0,
                crewed=True,
            )
        ]

    return hears, place


@pytest.mark.parametrize("bearing_deg", range(0, 360, 45))
@pytest.mark.parametrize("climb_mps", [0.0, 2.0])
def test_the_cylinder_of_crewed_traffic_is_kept(bearing_deg: int, climb_mps: float) -> None:
    """50 m/s through the middle of an aircraft of 5 m/s: 610 m aside, or 77 m in height."""
    angle, meets_s = math.radians(bearing_deg), 90.0
    velocity = (50.0 * math.cos(angle), 50.0 * math.sin(angle), -climb_mps)
    at = (2.0 * meets_s, 0.0, -150.0)
    start = tuple(a - meets_s * v for a, v in zip(at, velocity, strict=True))
    hears, place = crewed(start, velocity)
    path = Trajectory([0, 400], [(0, 0, -150), (800, 0, -150)])
    flight = fly(Law(AvoidanceConfig(), LIMITS, path), 130.0, velocity=(2.0, 0.0, 0.0), hears=hears)
    gap = flight.position - place(flight.time_s)
    aside, height = np.hypot(gap[:, 0], gap[:, 1]), abs(gap[:, 2])
    assert np.maximum(aside / 610.0, height / 77.0).min() >= 1.0
