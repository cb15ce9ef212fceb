"""Alert levels: how urgent an aircraft is, when that changes, what is said and told of it."""

from __future__ import annotations

import math

import msgspec
import pytest

from companion.avoidance.alerts import HOLD_S, Alerts, Level, approach, time_to_cylinder
from companion.avoidance.law import LawResult, Neighbour, horizon_s
from companion.config import AvoidanceConfig
from companion.events import AlertChanged, Say, Threat, TrackView

PERIOD_S = 0.2
CONFIG = AvoidanceConfig(crewed_horizontal_m=150.0, crewed_vertical_m=50.0)
"""Horizon 20 s, separation 10 m (crewed 150 m or 50 m)."""
CREWED_M = math.sqrt(2.0) * 150.0
OWN, SPEED = (0.0, 0.0, -50.0), (10.0, 0.0, 0.0)
NONE, ADVISORY, CAUTION, WARNING = 100.0, 25.0, 15.0, 5.0
"""Times to loss (s) that are seen as these levels."""


def other(loss_s: float, name: str = "X", **over: object) -> Neighbour:
    """One that stands straight ahead; its separation is lost after `loss_s`."""
    radius = CONFIG.crewed_horizontal_m if over.get("crewed") else 10.0
    values = {"position_ned_m": (radius + 10.0 * loss_s, 0.0, -50.0), "velocity_ned_mps": (0.0, 0.0, 0.0)}
    return Neighbour(name, **{**values, "age_s": 0.0, "sigma_m": 1.0, **over})  # type: ignore[arg-type]


def decision(*views: TrackView, limits: tuple[str, ...] = ()) -> LawResult:
    still = (0.0, 0.0, 0.0)
    return LawResult(still, still, True, True, False, limits, views)


def view(name: str = "X", *, conflict: bool = True, active: bool = True, adsb: bool = False) -> TrackView:
    return TrackView(
        track_id=name,
        adsb=adsb,
        position_ned_m=(0.0, 0.0, 0.0),
        velocity_ned_mps=(0.0, 0.0, 0.0),
        age_s=0.0,
        radius_m=10.0,
        conflict=conflict,
        time_to_closest_s=0.0,
        closest_m=0.0,
        active=active,
    )


class Looks:
    """Alerts that look every `PERIOD_S`, and all that they said."""

    def __init__(self, config: AvoidanceConfig = CONFIG) -> None:
        self.alerts = Alerts(config)
        self.count = 0
        self.log: list[tuple[float, object]] = []

    @property
    def now_s(self) -> float:
        """Time of the next look."""
        return round(self.count * PERIOD_S, 6)

    def look(self, *others: Neighbour, result: LawResult | None = None) -> list[object]:
        commands = self.alerts.look(self.now_s, OWN, SPEED, others, result)
        self.log += [(self.now_s, c) for c in commands]
        self.count += 1
        return list(commands)

    def see(self, *losses_s: float) -> list[Level]:
        """Looks at one aircraft with these times to loss; the level after each."""
        levels = []
        for loss_s in losses_s:
            self.look(other(loss_s))
            levels.append(self.level())
        return levels

    def level(self, name: str = "X") -> Level:
        """Of a track of Remote ID now."""
        return self.alerts.levels.get((False, name), Level.NONE)

    def texts(self) -> list[str]:
        """What was said, without the reason."""
        return [" ".join(said.text.split(":")[0].split()[1:]) for _, said in self.of(Say)]

    def of(self, kind: type) -> list[tuple[float, object]]:
        return [(at_s, c) for at_s, c in self.log if isinstance(c, kind)]

    def changes(self) -> list[tuple[float, int]]:
        return [(at_s, c.level) for at_s, c in self.of(AlertChanged)]


# ------------------------------------------------------------ approach


@pytest.mark.parametrize(
    ("position", "velocity", "radius_m", "scale", "time_s", "horizontal_m", "vertical_m", "loss_s"),
    [
        # Head-on: 100 m away, 10 m/s, lost at 10 m.
        ((100, 0, 0), (10, 0, 0), 10.0, 1.0, 10.0, 0.0, 0.0, 9.0),
        # 6 m aside: 10^2 = 6^2 + 8^2, so lost 8 m before the closest point.
        ((100, 6, 0), (10, 0, 0), 10.0, 1.0, 10.0, 6.0, 0.0, 9.2),
        ((100, 10.1, 0), (10, 0, 0), 10.0, 1.0, 10.0, 10.1, 0.0, math.inf),
        # Straight down on it: heights count 0.85 times, so lost 10 / 0.85 m above it.
        ((0, 0, 100), (0, 0, 5), 10.0, 0.85, 20.0, 0.0, 0.0, (100.0 - 10.0 / 0.85) / 5.0),
        # Crewed traffic, three times as wide as tall: 80 m in height count 240 m, 60 m count 180 m.
        ((1000, 0, -80), (50, 0, 0), CREWED_M, 3.0, 20.0, 0.0, 80.0, math.inf),
        ((1000, 0, -60), (50, 0, 0), CREWED_M, 3.0, 20.0, 0.0, 60.0, (1000.0 - math.sqrt(12600.0)) / 50.0),
        # The closest point is that of the scaled distance: (20, 0, 0) along (1, 0, 2) after 20 / 5 s.
        ((20, 0, 0), (1, 0, 1), 1.0, 2.0, 4.0, 16.0, 4.0, math.inf),
        # Across: (60, -30, 0) along (3, -4, 0) is nearest after 300 / 25 s, at (24, 18, 0).
        ((60, -30, 0), (3, -4, 0), 1.0, 1.0, 12.0, 30.0, 0.0, math.inf),
        ((0, 50, 0), (0, 5, 0), 10.0, 1.0, 10.0, 0.0, 0.0, 8.0),
        # Lost already, coming nearer and parting.
        ((5, 0, 0), (1, 0, 0), 10.0, 1.0, 5.0, 0.0, 0.0, 0.0),
        ((5, 0, 0), (-1, 0, 0), 10.0, 1.0, 0.0, 5.0, 0.0, 0.0),
        ((100, 0, 7), (-10, 0, 0), 10.0, 1.0, 0.0, 100.0, 7.0, math.inf),
        # The same velocity: near or far for good.
        ((100, 0, 0), (0, 0, 0), 10.0, 1.0, 0.0, 100.0, 0.0, math.inf),
        ((5, 0, 0), (0, 0, 0), 10.0, 1.0, 0.0, 5.0, 0.0, 0.0),
    ],
)
def test_approach_by_hand(position, velocity, radius_m, scale, time_s, horizontal_m, vertical_m, loss_s):
    way = approach(position, velocity, radius_m, scale)
    assert way.time_s == pytest.approx(time_s)
    assert way.horizontal_m == pytest.approx(horizontal_m, abs=1e-9)
    assert way.vertical_m == pytest.approx(vertical_m, abs=1e-9)
    assert way.loss_s == pytest.approx(loss_s)


@pytest.mark.parametrize(
    ("position", "velocity", "loss_s"),
    [
        # Level, head-on: at 150 m aside.
        ((1000, 0, 0), (50, 0, 0), 17.0),
        # Aside by 90 m: 150^2 = 90^2 + 120^2.
        ((1000, 90, 0), (50, 0, 0), 17.6),
        ((1000, 151, 0), (50, 0, 0), math.inf),
        # Above and below, whatever the distance aside.
        ((1000, 0, -51), (50, 0, 0), math.inf),
        ((0, 0, 51), (0, 0, 0), math.inf),
        ((0, 0, -49), (0, 0, 0), 0.0),
        # It is within 150 m from 17 s to 23 s, and within 50 m of height from 19 s, 25 s, and until 16 s.
        ((1000, 0, -145), (50, 0, -5), 19.0),
        ((1000, 0, -175), (50, 0, -5), math.inf),
        ((1000, 0, 30), (50, 0, -1.25), math.inf),
        # Inside, entering from the side and parting.
        ((100, 0, 0), (1, 0, 0), 0.0),
        ((100, 0, 0), (-1, 0, 0), 0.0),
        ((200, 0, 0), (-1, 0, 0), math.inf),
        ((200, 0, 0), (0, 0, 0), math.inf),
        ((0, 0, 100), (0, 0, 5), 10.0),
    ],
)
def test_well_clear_is_lost_within_a_cylinder(position, velocity, loss_s):
    assert time_to_cylinder(position, velocity, 150.0, 50.0) == pytest.approx(loss_s)


def test_crewed_traffic_that_passes_well_clear_above_is_no_warning():
    """100 m aside and 60 m above, it is within the ellipsoid around the cylinder."""
    looks = Looks()
    for _ in range(3):
        looks.look(other(0.0, crewed=True, position_ned_m=(0.0, 100.0, -110.0)))
    assert looks.level() is Level.NONE


# ------------------------------------------------------------ levels


@pytest.mark.parametrize(
    ("loss_s", "level"),
    [
        (0.0, Level.WARNING),
        (9.9, Level.WARNING),
        (10.1, Level.CAUTION),
        (19.9, Level.CAUTION),
        (20.1, Level.ADVISORY),
        (29.9, Level.ADVISORY),
        (30.1, Level.NONE),
    ],
)
@pytest.mark.parametrize("crewed", [False, True])
def test_levels_by_the_time_to_loss(loss_s, level, crewed):
    """Of a horizon of 20 s. Crewed traffic has a longer one, and a separation of its own."""
    looks = Looks()
    for _ in range(3):
        looks.look(other(loss_s * horizon_s(CONFIG, crewed) / 20.0, crewed=crewed))
    assert looks.level() is level


@pytest.mark.parametrize(
    ("conflict", "active", "level"),
    [
        (True, True, Level.CAUTION),
        (True, False, Level.ADVISORY),
        (False, True, Level.NONE),
        (False, False, Level.NONE),
    ],
)
def test_levels_by_what_the_law_makes_of_it(conflict, active, level):
    looks = Looks()
    for _ in range(3):
        looks.look(other(NONE), result=decision(view(conflict=conflict, active=active)))
    assert looks.level() is level


def test_crewed_traffic_beside_us_has_the_wide_separation():
    beside = {"position_ned_m": (0.0, 120.0, -50.0), "velocity_ned_mps": SPEED}
    looks = Looks()
    for _ in range(3):
        looks.look(other(0.0, "DRONE", **beside), other(0.0, "CREWED", crewed=True, **beside))
    assert looks.alerts.levels == {(False, "CREWED"): Level.WARNING}


def test_a_horizon_longer_than_that_of_crewed_traffic_holds_for_both():
    longer_s = horizon_s(CONFIG, crewed=True) + 10.0
    looks = Looks(msgspec.structs.replace(CONFIG, horizon_s=longer_s))
    for _ in range(3):
        looks.look(other(longer_s - 5.0, "DRONE"), other(longer_s - 5.0, "CREWED", crewed=True))
    assert looks.alerts.levels == {(False, "DRONE"): Level.CAUTION, (False, "CREWED"): Level.CAUTION}


def test_one_name_heard_by_both_is_two_aircraft():
    """A name heard by Remote ID may be any, an ICAO address too."""
    looks = Looks()
    for _ in range(3):
        looks.look(other(WARNING, "4B1234"), other(CAUTION, "4B1234", adsb=True))
    assert looks.alerts.levels == {(False, "4B1234"): Level.WARNING, (True, "4B1234"): Level.CAUTION}
    assert [(c.adsb, c.level) for _, c in looks.of(Threat)] == [(False, 2), (True, 1)]
    looks = Looks()
    for _ in range(3):
        looks.look(
            other(NONE, "4B1234"),
            other(NONE, "4B1234", adsb=True),
            result=decision(view("4B1234", conflict=False), view("4B1234", adsb=True)),
        )
    assert looks.alerts.levels == {(True, "4B1234"): Level.CAUTION}


@pytest.mark.parametrize(("known", "level"), [(True, Level.NONE), (False, Level.WARNING)])
def test_a_height_that_is_not_known_does_not_separate(known, level):
    looks = Looks()
    far_below = {"position_ned_m": (60.0, 0.0, 450.0), "vertical_known": known}
    commands = looks.look(other(0.0, **far_below))
    assert looks.level() is level
    assert [c.vertical_m for c in commands if isinstance(c, Threat)] == ([] if known else [0.0])


def test_an_old_message_is_predicted_to_now():
    looks = Looks()
    # 250 m ahead 10 s ago, towards us at 10 m/s since: 150 m now, closing at 20 m/s.
    commands = looks.look(
        other(0.0, position_ned_m=(250.0, 0.0, -50.0), velocity_ned_mps=(-10.0, 0.0, 0.0), age_s=10.0)
    )
    (change,) = [c for c in commands if isinstance(c, AlertChanged)]
    assert change.time_to_closest_s == pytest.approx(7.5)


# ------------------------------------------------------------ rising and falling


def test_a_warning_is_raised_at_once():
    assert Looks().see(WARNING) == [Level.WARNING]


@pytest.mark.parametrize(
    ("seen", "levels"),
    [
        ((CAUTION, CAUTION, CAUTION), (0, 0, 2)),
        ((CAUTION, NONE, CAUTION, NONE, CAUTION), (0, 0, 0, 0, 2)),
        # Three of five agree on the lower one.
        ((ADVISORY, CAUTION, CAUTION), (0, 0, 1)),
        ((NONE, NONE, NONE, NONE, NONE, CAUTION, CAUTION, CAUTION), (0, 0, 0, 0, 0, 0, 0, 2)),
        # Two of any five.
        ((CAUTION, NONE, NONE) * 10, (0,) * 30),
    ],
)
def test_a_lower_level_is_raised_by_three_of_five_looks(seen, levels):
    assert Looks().see(*seen) == list(levels)


def test_a_level_falls_after_eight_seconds_and_not_before():
    assert HOLD_S == 8.0
    looks = Looks()
    looks.see(*[CAUTION] * 3)
    raised_s, last_seen_s = looks.of(AlertChanged)[0][0], 0.4
    looks.see(*[NONE] * 50)
    assert looks.changes() == [(raised_s, 2), (pytest.approx(last_seen_s + 8.0, abs=PERIOD_S), 0)]
    assert looks.changes()[1][0] >= last_seen_s + 8.0


def test_it_falls_to_the_highest_level_seen_meanwhile():
    looks = Looks()
    looks.see(WARNING, NONE, CAUTION, ADVISORY, *[NONE] * 90)
    assert [level for _, level in looks.changes()] == [3, 2, 0]
    (_, (second_s, _), (third_s, _)) = looks.changes()
    assert second_s == pytest.approx(8.0, abs=PERIOD_S)
    assert third_s == pytest.approx(16.0, abs=2 * PERIOD_S)


@pytest.mark.parametrize(
    ("pattern", "level"),
    [((WARNING, NONE), 3), ((CAUTION, CAUTION, CAUTION, *[NONE] * 37), 2), ((WARNING, CAUTION), 3)],
)
def test_a_level_that_flickers_does_not_flap(pattern, level):
    """None of the pauses is as long as 8 s."""
    looks = Looks()
    looks.see(*pattern * (200 // len(pattern)))
    assert [now for _, now in looks.changes()] == [level]


def test_a_forgotten_track_begins_anew():
    looks = Looks()
    looks.see(*[CAUTION] * 3)
    looks.look()
    assert looks.alerts.levels == {}
    assert looks.look() == []
    assert looks.see(CAUTION, CAUTION, CAUTION) == [0, 0, 2]


# ------------------------------------------------------------ words


def test_the_reason_names_track_distances_time_and_what_bounds():
    looks = Looks()
    # 4 s ahead, 6 m to the side, 3 m below.
    near = other(0.0, position_ned_m=(40.0, 6.0, -47.0), velocity_ned_mps=(0.0, 0.0, 0.0))
    result = decision(view(), limits=("fence", "speed"))
    change = looks.look(near, result=result)[0]
    assert change == AlertChanged(
        track_id="X",
        level=3,
        reason="warning X: closest 6 m aside, 3 m in height, in 4 s; avoiding; limited by fence, speed",
        time_to_closest_s=pytest.approx(4.0),
        horizontal_m=pytest.approx(6.0),
        vertical_m=pytest.approx(3.0),
        acting=True,
        limits=("fence", "speed"),
    )


@pytest.mark.parametrize(
    ("where", "result", "reason"),
    [
        ((8.0, 0.0, -50.0), None, "warning X: too near: closest 0 m aside, 0 m in height"),
        # What bounds us is no reason where this aircraft is not flown around.
        (
            (40.0, 6.0, -50.0),
            decision(view(active=False), limits=("fence",)),
            "warning X: closest 6 m aside, 0 m in height, in 4 s",
        ),
        (
            (40.0, 6.0, -50.0),
            decision(view()),
            "warning X: closest 6 m aside, 0 m in height, in 4 s; avoiding",
        ),
        # 8 m ahead at 10 m/s.
        ((8.0, 9.0, -50.0), None, "warning X: closest 9 m aside, 0 m in height, in 1 s"),
    ],
)
def test_reasons(where, result, reason):
    assert Looks().look(other(0.0, position_ned_m=where), result=result)[0].reason == reason


def test_the_end_is_told_as_clear_and_parting():
    looks = Looks()
    looks.see(WARNING)
    behind = other(0.0, position_ned_m=(-300.0, 0.0, -50.0))
    for _ in range(45):
        looks.look(behind)
    assert looks.of(AlertChanged)[-1][1].reason == "clear X: parting"


def test_who_is_not_heard_any_more_ends_with_a_word():
    """Its alert, what the vehicle was told of it, and that we were avoiding it."""
    looks = Looks()
    result = decision(view(), limits=("fence",))
    for _ in range(3):
        looks.look(other(WARNING), result=result)
    change, threat, said = looks.look()
    assert (change.level, change.reason) == (0, "clear X: not heard any more")
    assert (change.acting, change.limits) == (False, ())
    assert (threat.track_id, threat.level, threat.acting) == ("X", 0, False)
    assert said.text == "DMUCA clear of traffic"
    assert looks.look() == []


@pytest.mark.parametrize("seen", [NONE, ADVISORY])
def test_who_was_no_threat_goes_without_a_threats_end(seen):
    looks = Looks()
    looks.see(*[seen] * 3)
    ended = looks.look()
    assert [c.reason for c in ended] == ["clear X: not heard any more"] * (seen == ADVISORY)
