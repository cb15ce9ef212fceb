"""Which tracks yield to others, or press, decision by decision, without a law."""

from __future__ import annotations

import pytest

from companion.avoidance.law import ASIDE
from companion.config import ContainmentConfig
from companion.events import AllowanceSpent
from tests.companion.authority.influence.sky import ZERO, Sky, other


@pytest.mark.parametrize("stands", [True, False])
def test_a_track_that_presses_yields_unless_it_stood_there_before(stands):
    sky = Sky(ContainmentConfig())
    velocity = ZERO if stands else (0.7, 0.0, 0.0)
    far = other("A", at=(120.0, 0.0, 0.0), velocity=ZERO)
    sky.run(2.4, far, radius_m=60.0)
    assert sky.run(25.0, other("A", at=(5.0, 0.0, 0.0), velocity=velocity), radius_m=60.0) == ["A"]
    assert not sky.yielding
    place = (5.0, 0.0, 0.0) if stands else (22.5, 0.0, 0.0)
    coming = other("B", at=(200.0, 0.0, 0.0), velocity=(-6.0, 0.0, 0.0))
    assert sky.run(10.0, other("A", at=place, velocity=velocity), coming, radius_m=60.0) == ["A", "B"]
    assert sky.yielding == (set() if stands else {"A"})
    assert (("squeeze", True) in sky.scopes()) is not stands


@pytest.mark.parametrize(("away_m", "yields"), [(7.0, True), (12.0, False)])
def test_who_is_first_heard_inside_its_volume_yields(away_m, yields):
    """It is avoided all the same."""
    sky = Sky()
    assert sky.run(5.0, other("A", at=(away_m, 0.0, 0.0), velocity=ZERO)) == ["A"]
    assert sky.yielding == ({"A"} if yields else set())
    sky.run(10.0, other("A", at=(200.0, 0.0, 0.0), velocity=ZERO))
    sky.run(1.0, other("A", at=(7.0, 0.0, 0.0), velocity=ZERO))
    assert sky.yielding == ({"A"} if yields else set())
    sky.run(16.0, other("A", at=(200.0, 0.0, 0.0), velocity=ZERO))
    sky.run(1.0, other("A", at=(7.0, 0.0, 0.0), velocity=ZERO))
    assert not sky.yielding


@pytest.mark.parametrize(
    ("pause_s", "away_m", "yields"),
    [(57.0, 59.0, True), (62.0, 59.0, False), (10.0, 61.0, False), (1.0, 20.0, False), (4.0, 20.0, True)],
)
def test_who_appears_near_us_after_another_one_yields(pause_s, away_m, yields):
    """A single aircraft near us may have taken off there, and a swarm is received within seconds."""
    sky = Sky()
    first = other("A", at=(40.0, 0.0, 0.0), velocity=ZERO)
    sky.run(pause_s, first)
    assert not sky.yielding
    second = other("B", at=(away_m, 0.0, 0.0), velocity=ZERO)
    sky.run(1.0, second)
    assert sky.yielding == ({"B"} if yields else set())
    sky.run(18.0, second)
    assert not sky.yielding


def test_one_that_is_received_for_long_does_not_appear_when_we_first_look():
    """It lost its proof, or a sensor saw it meanwhile."""
    sky = Sky()
    sky.run(5.0, other("A", at=(40.0, 0.0, 0.0)))
    sky.run(1.0, other("B", at=(40.0, 0.0, 0.0), known_s=2.5), other("C", at=(40.0, 0.0, 0.0), known_s=1.0))
    assert sky.yielding == {"C"}


def test_only_a_track_that_was_inside_or_follows_presses():
    """A plug-in's law leaves those out that press; it avoids an aircraft that takes off not far away."""
    sky = Sky()
    sky.run(5.0, other("X", at=(40.0, 0.0, 0.0)))
    sky.run(1.0, other("A", at=(5.0, 0.0, 0.0)), other("B", at=(40.0, 0.0, 0.0)))
    assert sky.yielding == {"A", "B"}
    assert sky.pressing == {"A"}


def test_a_second_track_of_one_name_yields_only_inside():
    """A copy has made two of an aircraft that was received from far away. Either may be the true one."""
    sky = Sky()
    sky.run(5.0, other("X", at=(40.0, 0.0, 0.0)))
    sky.run(1.0, other("A#2", at=(40.0, 0.0, 0.0), split=True), other("B#2", at=(40.0, 0.0, 0.0)))
    assert sky.yielding == {"B#2"}
    sky.run(1.0, other("C#2", at=(7.0, 0.0, 0.0), split=True))
    assert sky.yielding == {"C#2"}


def test_another_place_of_a_track_is_not_where_it_appeared():
    sky = Sky()
    sky.run(5.0, other("X", at=(40.0, 0.0, 0.0)))
    sky.run(1.0, other("A", at=(200.0, 0.0, 0.0)), other(f"A{ASIDE}1", at=(40.0, 0.0, 0.0)))
    assert not sky.yielding


@pytest.mark.parametrize("together", [True, False])
def test_a_silent_track_yields_if_it_appeared_in_a_burst(together):
    sky = Sky()
    sky.run(5.0, other("A", at=(120.0, 0.0, 0.0), together=together))
    assert not sky.yielding
    assert sky.run(1.0, other("A", at=(40.0, 0.0, 0.0), together=together, silent=True)) == ["A"]
    assert not sky.yielding, "it is heard, but reports no position"
    assert sky.run(1.0, other("A", at=(40.0, 0.0, 0.0), together=together, unheard=True)) == ["A"]
    assert sky.yielding == ({"A"} if together else set())


def test_a_name_that_somebody_else_has_used_before_does_not_yield():
    """A transmitter sends it from a place beside us for a while, before the true one is received."""
    sky = Sky()
    sky.run(15.0, other("A", at=(5.0, 0.0, 0.0)), radius_m=30.0)
    assert sky.yielding == {"A"}
    sky.run(1.8)
    sky.run(0.2, other("A", at=(200.0, 0.0, 0.0)))
    assert sky.yielding == {"A"}
    used = sky.all._tracks[False, "A"].used.used_s
    sky.run(2.2)
    sky.run(0.2, other("A", at=(200.0, 0.0, 0.0)))
    assert not sky.yielding
    assert sky.all._tracks[False, "A"].used.used_s >= used
    # A pause of the decisions is no silence of the track.
    sky = Sky()
    sky.run(5.0, other("A", at=(5.0, 0.0, 0.0)))
    sky.now_s += 60.0
    sky.run(0.2, other("A", at=(5.0, 0.0, 0.0)))
    assert sky.all._tracks[False, "A"].first_s < 1.0


def test_time_outside_counts_half_against_time_inside():
    """It presses after 30 s inside; it did not appear there."""
    sky = Sky(ContainmentConfig())
    inside, outside = ({"at": (x, 0.0, 0.0), "velocity": ZERO} for x in (5.0, 90.0))
    sky.run(2.4, other("A", **outside), radius_m=30.0)
    sky.run(24.0, other("A", **inside), radius_m=30.0)
    sky.run(16.0, other("A", **outside), radius_m=30.0)
    sky.run(12.0, other("A", **inside), radius_m=30.0)
    assert sky.all._tracks[False, "A"].pressed_s == pytest.approx(28.0, abs=0.5)
    assert not sky.yielding
    sky.run(3.0, other("A", **inside), radius_m=30.0)
    assert sky.yielding == {"A"}


def test_crewed_and_proven_traffic_never_yields():
    sky = Sky()
    near = {"at": (5.0, 0.0, 0.0)}
    sky.run(
        5.0, other("A", crewed=True, adsb=True, **near), other("B", proven=True, **near), other("C", **near)
    )
    assert sky.yielding == {"C"}


def test_it_is_told_once_that_a_track_yields_to_another():
    """Again only after it has not for a while."""
    sky, presses, other_one = Sky(), other("A", at=(5.0, 0.0, 0.0)), other("B", at=(90.0, 0.0, 0.0))

    def told():
        return [c.text for c in sky.told if isinstance(c, AllowanceSpent)]

    sky.run(3.0, presses, other_one)
    sky.run(2.0, other_one)
    sky.run(3.0, presses, other_one)
    assert told() == ["A yields to B"]
    sky.run(16.0, other_one)
    sky.run(3.0, presses, other_one)
    assert told() == ["A yields to B"] * 2
