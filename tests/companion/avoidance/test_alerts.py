"""Alert levels: how urgent an aircraft is, when that changes, what is said and told of it."""

from __future__ import annotations

import math

import pytest

from companion.avoidance.alerts import Alerts, Level, approach
from companion.avoidance.law import LawResult, Neighbour
from companion.config import AvoidanceConfig
from companion.events import AlertChanged, Say, Severity, Threat, TrackView

PERIOD_S = 0.2
CONFIG = AvoidanceConfig()
"""Horizon 20 s (crewed 60 s), separation 10 m (crewed the ellipsoid around 150 m and 50 m)."""
CREWED_M = math.sqrt(2.0) * 150.0
OWN, SPEED = (0.0, 0.0, -50.0), (10.0, 0.0, 0.0)
NONE, ADVISORY, CAUTION, WARNING = 100.0, 25.0, 15.0, 5.0
"""Times to loss (s) that are seen as these levels."""


def other(loss_s: float, name: str = "X", **over: object) -> Neighbour:
    """One that stands straight ahead; its separation is lost after `loss_s`."""
    radius = CREWED_M if over.get("crewed") else 10.0
    values = {"position_ned_m": (radius + 10.0 * loss_s, 0.0, -50.0), "velocity_ned_mps": (0.0, 0.0, 0.0)}
    return Neighbour(name, **{**values, "age_s": 0.0, "sigma_m": 1.0, **over})  # type: ignore[arg-type]


def decision(*views: TrackView, limits: tuple[str, ...] = ()) -> LawResult:
    still = (0.0, 0.0, 0.0)
    return LawResult(still, still, True, True, False, limits, views)


def view(name: str = "X", *, conflict: bool = True, active: bool = True) -> TrackView:
    return TrackView(
        track_id=name,
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
            levels.append(self.alerts.levels.get("X", Level.NONE))
        return levels

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
@pytest.mark.parametrize(("crewed", "times"), [(False, 1.0), (True, 3.0)])
def test_levels_by_the_time_to_loss(loss_s, level, crewed, times):
    """Crewed traffic: three times the horizon, and a separation of its own."""
    looks = Looks()
    for _ in range(3):
        looks.look(other(times * loss_s, crewed=crewed))
    assert looks.alerts.levels.get("X", Level.NONE) is level


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
    assert looks.alerts.levels.get("X", Level.NONE) is level


def test_crewed_traffic_beside_us_has_the_wide_separation():
    beside = {"position_ned_m": (0.0, 200.0, -50.0), "velocity_ned_mps": SPEED}
    looks = Looks()
    for _ in range(3):
        looks.look(other(0.0, "DRONE", **beside), other(0.0, "CREWED", crewed=True, **beside))
    assert looks.alerts.levels == {"CREWED": Level.WARNING}


def test_a_horizon_longer_than_that_of_crewed_traffic_holds_for_both():
    looks = Looks(AvoidanceConfig(horizon_s=80.0))
    for _ in range(3):
        looks.look(other(75.0, "DRONE"), other(75.0, "CREWED", crewed=True))
    assert looks.alerts.levels == {"DRONE": Level.CAUTION, "CREWED": Level.CAUTION}


@pytest.mark.parametrize(("known", "level"), [(True, Level.NONE), (False, Level.WARNING)])
def test_a_height_that_is_not_known_does_not_separate(known, level):
    looks = Looks()
    far_below = {"position_ned_m": (60.0, 0.0, 450.0), "vertical_known": known}
    commands = looks.look(other(0.0, **far_below))
    assert looks.alerts.levels.get("X", Level.NONE) is level
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


def test_a_level_falls_after_four_seconds_and_not_before():
    looks = Looks()
    looks.see(*[CAUTION] * 3)
    raised_s, last_seen_s = looks.of(AlertChanged)[0][0], 0.4
    looks.see(*[NONE] * 30)
    assert looks.changes() == [(raised_s, 2), (pytest.approx(last_seen_s + 4.0, abs=PERIOD_S), 0)]
    assert looks.changes()[1][0] >= last_seen_s + 4.0


def test_it_falls_to_the_highest_level_seen_meanwhile():
    looks = Looks()
    looks.see(WARNING, NONE, CAUTION, ADVISORY, *[NONE] * 60)
    assert [level for _, level in looks.changes()] == [3, 2, 0]
    (_, (second_s, _), (third_s, _)) = looks.changes()
    assert second_s == pytest.approx(4.0, abs=PERIOD_S)
    assert third_s == pytest.approx(8.0, abs=2 * PERIOD_S)


@pytest.mark.parametrize(
    ("pattern", "level"),
    [((WARNING, NONE), 3), ((CAUTION, CAUTION, CAUTION, *[NONE] * 17), 2), ((WARNING, CAUTION), 3)],
)
def test_a_level_that_flickers_does_not_flap(pattern, level):
    """None of the pauses is as long as 4 s."""
    looks = Looks()
    looks.see(*pattern * (200 // len(pattern)))
    assert [now for _, now in looks.changes()] == [level]


def test_a_forgotten_track_begins_anew():
    looks = Looks()
    looks.see(*[CAUTION] * 3)
    assert looks.look() == []
    assert looks.alerts.levels == {}
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
        reason="warning X: closest 6 m aside, 3 m in height, in 4 s; avoiding; bounded by fence, speed",
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
    ],
)
def test_reasons(where, result, reason):
    assert Looks().look(other(0.0, position_ned_m=where), result=result)[0].reason == reason


def test_the_end_is_told_as_clear_and_parting():
    looks = Looks()
    looks.see(WARNING)
    behind = other(0.0, position_ned_m=(-300.0, 0.0, -50.0))
    for _ in range(25):
        looks.look(behind)
    assert looks.of(AlertChanged)[-1][1].reason == "clear X: parting"


# ------------------------------------------------------------ COLLISION


def test_a_threat_is_told_once_a_second_while_it_lasts_and_once_at_its_end():
    looks = Looks()
    looks.see(*[WARNING] * 26, *[NONE] * 60)
    told = looks.of(Threat)
    # The level is held for 4 s after the last look at 5.0 s; then a Threat of level 0 ends it.
    assert [c.level for _, c in told] == [2] * 9 + [0]
    assert [at_s for at_s, _ in told[:-1]] == pytest.approx([float(k) for k in range(9)])
    assert told[-1][0] == pytest.approx(9.0, abs=PERIOD_S)


def test_levels_of_threats():
    looks = Looks()
    looks.see(*[CAUTION] * 3, *[WARNING] * 6)
    assert [c.level for _, c in looks.of(Threat)] == [1, 2]


def test_an_advisory_is_never_a_threat_and_has_no_end():
    looks = Looks()
    looks.see(*[ADVISORY] * 10, *[NONE] * 60)
    assert [level for _, level in looks.changes()] == [1, 0]
    assert looks.of(Threat) == []
    assert looks.of(Say) == []


def test_what_a_threat_says():
    near = other(0.0, "4B1234", position_ned_m=(40.0, 6.0, -47.0), adsb=True)
    (threat,) = [c for c in Looks().look(near, result=decision(view("4B1234"))) if isinstance(c, Threat)]
    assert threat == Threat(
        track_id="4B1234",
        adsb=True,
        level=2,
        acting=True,
        time_to_closest_s=pytest.approx(4.0),
        horizontal_m=pytest.approx(6.0),
        vertical_m=pytest.approx(3.0),
    )


def test_at_most_five_are_told_at_a_time_the_most_urgent_first():
    looks = Looks()
    warnings = [other(9.0 - number, f"W{number}") for number in range(4)]
    cautions = [other(12.0 + number, f"C{number}") for number in range(4)]
    for _ in range(2):
        looks.look(*cautions)
    told = [c.track_id for c in looks.look(*cautions, *warnings) if isinstance(c, Threat)]
    assert told == ["W3", "W2", "W1", "W0", "C0"]


# ------------------------------------------------------------ STATUSTEXT


def test_of_what_rises_together_the_most_urgent_is_said():
    looks = Looks()
    for _ in range(2):
        looks.look(other(CAUTION, "A"))
    commands = looks.look(other(CAUTION, "A"), other(WARNING, "B"))
    (said,) = [c for c in commands if isinstance(c, Say)]
    assert said.severity is Severity.WARNING
    assert said.text.startswith("DMUCA warning B: closest ")


def test_a_caution_is_a_notice():
    looks = Looks()
    looks.see(*[CAUTION] * 3)
    ((_, said),) = looks.of(Say)
    assert said.severity is Severity.NOTICE
    assert said.text.startswith("DMUCA caution X: ")


def test_not_more_than_one_text_a_second():
    looks = Looks()
    present = []
    for number in range(20):
        present.append(other(WARNING, f"X{number}"))
        looks.look(*present)
    assert len(looks.of(AlertChanged)) == 20
    assert [at_s for at_s, _ in looks.of(Say)] == pytest.approx([0.0, 1.0, 2.0, 3.0])
