"""The containment of a flight: its walls and heights, for missions that are known and for others."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import msgspec
import numpy as np
import pytest

from companion.authority.course import Course
from companion.authority.influence.containment import Containment, _hull, area_around
from companion.avoidance import kernels as k
from companion.avoidance.law import new_law
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, Config, IdentityConfig, LimitsConfig
from companion.events import GlobalPosition

CONFIG = Config(identity=IdentityConfig(uas_id="OWN"))


@dataclass
class Own:
    """The own state that the containment reads."""

    place: tuple[float, float] = (0.0, 0.0)
    height_m: float = 50.0
    home_alt_msl_m: float = 0.0
    """The vehicle's home; that of the flight is 0."""

    def position_ned_m(self, now_s):
        return (*self.place, -self.height_m)

    @property
    def position(self):
        return GlobalPosition(
            time_boot_s=0.0, lat_deg=0.0, lon_deg=0.0, alt_msl_m=self.height_m,
            height_above_home_m=self.height_m - self.home_alt_msl_m, velocity_ned_mps=(0.0, 0.0, 0.0),
        )  # fmt: skip


@dataclass
class Flight:
    """A course along a mission of places (north, east, height), taken at `own`."""

    limits: LimitsConfig = field(default_factory=LimitsConfig)
    own: Own = field(default_factory=Own)

    def __post_init__(self):
        self.course = Course()
        path = Trajectory([0.0, 100.0], [(0.0, 0.0, -50.0), (300.0, 0.0, -50.0)])
        self.course.begin(new_law(AvoidanceConfig(), self.limits, path), 0.0, 0.0)
        self.course.lowest_height_m = 50.0
        config = msgspec.structs.replace(CONFIG, limits=self.limits)
        self.containment = Containment(config, self.own, self.course)

    def lead(self, *places, leg=((0.0, 50.0), (100.0, 50.0))):
        self.course.lead([(n, e, -h) for n, e, h in places], [h for _, _, h in places], leg)
        return self

    def heights(self, now_s=0.0):
        return self.containment.keep(now_s)

    def reach(self, north, east):
        """How far the walls let the aircraft go from its place in a direction."""
        fence = self.course.law._fence
        far = np.arange(0.0, 2000.0)
        n, e = self.own.place
        within = [k.inside(fence, 0, len(fence), k.Point(n + f * north, e + f * east)) for f in far]
        return float(far[np.argmin(within)])


def test_a_hull_is_the_outer_corners():
    places = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0), (5.0, 5.0), (5.0, 0.0), (10.0, 0.0)]
    assert sorted(_hull(places)) == [(0.0, 0.0), (0.0, 10.0), (10.0, 0.0), (10.0, 10.0)]


def test_no_point_is_farther_from_the_hull_than_allowed_and_few_are_much_nearer():
    rng = np.random.default_rng(1)
    for _ in range(20):
        places = [tuple(p) for p in rng.uniform(-500.0, 500.0, (rng.integers(2, 8), 2)).tolist()]
        hull = np.array(_hull(places))
        for wall in area_around(places, 100.0):
            for corner in (wall[2:4], wall[4:6], 0.5 * (wall[2:4] + wall[4:6])):
                ends = np.stack([hull, np.roll(hull, -1, axis=0)], axis=1)
                along = ends[:, 1] - ends[:, 0]
                size2 = np.maximum((along**2).sum(axis=1), 1e-9)
                share = np.clip(((corner - ends[:, 0]) * along).sum(axis=1) / size2, 0.0, 1.0)
                away = np.hypot(*(ends[:, 0] + share[:, None] * along - corner).T).min()
                assert 100.0 * math.cos(math.pi / 12.0) - 1e-6 <= away <= 100.0 + 1e-6


def test_the_whole_missions_hull_and_the_present_legs_heights():
    flight = Flight().lead((0.0, 0.0, 50.0), (300.0, 0.0, 50.0), (300.0, 400.0, 90.0))
    assert flight.heights() == (20.0, 80.0)
    assert flight.reach(-1.0, 0.0) == pytest.approx(150.0, abs=6.0)
    assert flight.reach(0.0, -1.0) == pytest.approx(150.0, abs=6.0)
    assert flight.reach(1.0, 0.0) == pytest.approx(450.0, abs=6.0)


def test_heights_follow_the_path_within_floor_and_ceiling():
    places = (0.0, 0.0, 20.0), (300.0, 0.0, 100.0)
    flight = Flight().lead(*places, leg=((0.0, 20.0), (80.0, 100.0), (400.0, 100.0)))
    assert flight.heights(0.0) == (15.0, 80.0)
    assert flight.heights(50.0) == (15.0, 130.0)
    assert flight.heights(111.0) == (70.0, 130.0)
    low = Flight(LimitsConfig(floor_height_m=40.0, ceiling_height_m=60.0)).lead(*places)
    assert low.heights() == (40.0, 60.0)


def test_without_a_ceiling_it_is_120_m_or_30_m_above_the_mission():
    for top, ceiling in ((60.0, 90.0), (110.0, 140.0), (200.0, 230.0)):
        flight = Flight(own=Own(height_m=top)).lead((0.0, 0.0, top), leg=((0.0, top),))
        assert flight.heights()[1] == ceiling
    config = msgspec.structs.replace(
        CONFIG, containment=msgspec.structs.replace(CONFIG.containment, above_m=60.0)
    )
    flight = Flight().lead((0.0, 0.0, 50.0), (50.0, 0.0, 70.0), leg=((0.0, 70.0),))
    flight.containment.configure(config)
    assert flight.heights()[1] == 130.0


def test_a_floor_above_the_mission_leaves_room():
    flight = Flight(LimitsConfig(floor_height_m=90.0), Own(height_m=92.0)).lead((0.0, 0.0, 50.0))
    floor, ceiling = flight.heights()
    assert (floor, ceiling) == (90.0, 95.0)


def test_an_unknown_mission_is_where_the_aircraft_was_taken():
    flight = Flight(own=Own((500.0, 0.0))).lead(leg=((0.0, 50.0),))
    assert flight.heights() == (20.0, 80.0)
    assert {round(flight.reach(*way), -1) for way in ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0))} == {150.0}


def test_taken_again_where_an_earlier_push_left_it_the_volume_does_not_move():
    flight = Flight().lead((0.0, 0.0, 50.0))
    flight.heights()
    for n in range(5):
        flight.containment.let_go()
        assert len(flight.course.law._fence) == 0
        flight.own.place, flight.own.height_m = (140.0, 0.0), 78.0
        # The leg begins where the aircraft was taken.
        flight.lead((0.0, 0.0, 50.0), leg=((0.0, 78.0), (50.0, 50.0)))
        assert flight.heights(1.0 + n) == (20.0, 80.0)
        assert flight.reach(1.0, 0.0) == pytest.approx(10.0, abs=2.0)


@pytest.mark.parametrize("home_m", [-60.0, 0.3, 60.0])
def test_a_home_that_is_moved_in_flight_moves_no_volume(home_m):
    flight = Flight().lead((0.0, 0.0, 50.0))
    flight.heights()
    flight.containment.let_go()
    flight.own.home_alt_msl_m = home_m
    flight.lead((0.0, 0.0, 50.0))
    assert flight.heights(1.0) == (20.0, 80.0)


def test_outside_of_the_mission_when_taken_the_larger_volume_or_another_one_holds():
    flight = Flight(own=Own((300.0, 0.0))).lead((0.0, 0.0, 50.0))
    assert flight.heights() == (15.0, 146.25)
    assert flight.reach(1.0, 0.0) == pytest.approx(462.5, abs=6.0)  # 762 m from the mission
    flight.own.place = (100.0, 0.0)  # back
    assert flight.heights(1.0) == (20.0, 80.0)
    away = Flight(own=Own((3000.0, 0.0), height_m=400.0)).lead((0.0, 0.0, 50.0), leg=((0.0, 400.0),))
    assert away.heights()[1] == 430.0
    assert away.reach(1.0, 0.0) == pytest.approx(150.0, abs=6.0)


def test_crewed_traffic_widens_it_until_the_aircraft_is_back():
    flight = Flight().lead((0.0, 0.0, 50.0))
    assert flight.heights() == (20.0, 80.0)
    flight.containment.note_conflict(0.0, crewed=True)
    assert flight.heights(0.2) == (15.0, 146.25)
    assert flight.reach(1.0, 0.0) == pytest.approx(762.5, abs=26.0)
    flight.own.place = (400.0, 0.0)
    assert flight.heights(60.0) == (15.0, 146.25)
    flight.own.place, flight.own.height_m = (100.0, 0.0), 80.5
    assert flight.heights(60.5) == (15.0, 146.25), "it is not back in the height"
    flight.own.height_m = 80.0
    assert flight.heights(61.0) == (20.0, 80.0)
    assert flight.reach(1.0, 0.0) == pytest.approx(50.0, abs=6.0)


@pytest.mark.parametrize(("height_m", "floor_m"), [(19.5, 20.0), (81.0, 20.0), (1.0, 15.0)])
def test_pressed_to_its_border_and_taken_again_it_gains_no_larger_volume(height_m, floor_m):
    """The error of the own height is enough to be outside. 19 m lower, nobody pressed it there."""
    flight = Flight().lead((0.0, 0.0, 50.0))
    flight.heights()
    flight.containment.let_go()
    flight.own.height_m = height_m
    flight.lead((0.0, 0.0, 50.0), leg=((0.0, height_m), (50.0, 50.0)))
    assert flight.heights(1.0)[0] == floor_m


@pytest.mark.parametrize(("now_s", "floor_m"), [(0.0, 2.0), (200.0, 15.0)])
def test_crewed_traffic_presses_lower_only_where_the_leg_is_lower(now_s, floor_m):
    """The path begins 2 m above home and is at 80 m later."""
    flight = Flight(own=Own(height_m=80.0))
    flight.course.lowest_height_m = 2.0
    flight.lead((0.0, 0.0, 2.0), (300.0, 0.0, 80.0), leg=((0.0, 2.0), (60.0, 80.0), (400.0, 80.0)))
    flight.containment.note_conflict(now_s, crewed=True)
    assert flight.heights(now_s)[0] == floor_m
