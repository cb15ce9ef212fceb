"""When a transmitted track and a sensed object agree: the edges in place, velocity, height, age and time."""

from __future__ import annotations

import math
from typing import Any

import pytest

from companion.avoidance.law import ASIDE, Neighbour
from companion.geometry import Vec3
from companion.traffic.sensed.fusing import Fusing
from companion.traffic.sensed.objects import Followed, _Axis
from tests.companion.traffic.sensed.made import AT_S, edge, followed

ROOM_M, HIGH_M, ROOM_MPS = 2.0, 20.0, 2.5
OWN_SIGMA_M = 1.5


def heard(position: Vec3 = (30.0, 0.0, 0.0), velocity: Vec3 = (0.0, 0.0, 0.0), **more: Any) -> Neighbour:
    values: dict[str, Any] = {"track_id": "OTHER", "age_s": 0.0, "sigma_m": 2.0} | more
    return Neighbour(position_ned_m=position, velocity_ned_mps=velocity, **values)


def left(other: Neighbour, one: Followed, *more: Neighbour) -> list[str]:
    """The tracks that are left after looking at them for long at the same place."""
    fusing, names = Fusing(), []
    for second in range(9):
        one.at_s = AT_S + second
        names = [o.track_id for o in fusing.look(AT_S + second, [other, *more], [one], OWN_SIGMA_M)]
    return names


def agrees(other: Neighbour, one: Followed | None = None) -> bool:
    return left(other, one or followed()) == []


@pytest.mark.parametrize(("way", "sign"), [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)])
def test_places_agree_within_three_deviations_of_both_and_the_width_and_two_metres(
    way: int, sign: float
) -> None:
    def near(off: float, sigma_m: float, across_m: float) -> bool:
        place = [30.0, 0.0, 0.0]
        place[way] += sign * off
        return agrees(heard((place[0], place[1], 0.0), sigma_m=sigma_m), followed(across_m=across_m))

    # A declared error of more than 3 m makes no more room.
    for sigma_m, across_m in ((2.0, 1.0), (3.0, 0.0), (6.0, 0.0)):
        expected = ROOM_M + across_m + 3.0 * math.hypot(min(sigma_m, 3.0), OWN_SIGMA_M)
        found = edge(lambda off, s=sigma_m, a=across_m: near(off, s, a), 90.0)
        assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_heights_agree_within_twenty_metres_where_both_are_known(sign: float) -> None:
    assert edge(lambda off: agrees(heard((30.0, 0.0, sign * off))), 99.0) == pytest.approx(HIGH_M, rel=1e-6)
    assert agrees(heard((30.0, 0.0, 90.0), vertical_known=False))
    assert agrees(heard((30.0, 0.0, 90.0)), followed(vertical_known=False))


MOVING: dict[str, Any] = {"velocity": (-4.0, 3.0, 0.0), "moves": True}


def test_velocities_agree_within_two_and_a_half_metres_per_second() -> None:
    for north, east in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)):
        for base, one in (((0.0, 0.0), {}), ((-4.0, 3.0), MOVING)):
            # The object is looked at when it was just measured, where its velocity moves it nowhere.
            found = edge(
                lambda off, n=north, e=east, b=base, one=one: agrees(
                    heard(velocity=(b[0] + off * n, b[1] + off * e, 0.0)), followed(**one)
                ),
                40.0,
            )
            assert found == pytest.approx(ROOM_MPS, rel=1e-6)


def test_what_stands_has_no_velocity_whatever_the_filter_says() -> None:
    assert agrees(heard(), followed(velocity=(-4.0, 3.0, 0.0)))
    assert not agrees(heard(velocity=(-4.0, 3.0, 0.0)), followed(velocity=(-4.0, 3.0, 0.0)))


@pytest.mark.parametrize("which", ["along", "across"])
def test_a_velocity_that_errs_by_more_than_that_agrees_with_nothing(which: str) -> None:
    for sigma, yes in ((2.45, True), (2.55, False)):
        assert agrees(heard(), followed(**{which: _Axis(0.1, 0.0, sigma**2)})) is yes


def test_a_message_of_more_than_three_seconds_ago_agrees_with_nothing() -> None:
    assert agrees(heard(age_s=3.0))
    assert not agrees(heard(age_s=3.05))


def test_a_transmitted_track_is_compared_where_it_is_now() -> None:
    one = followed(**MOVING)
    there = (30.0 + 2.5 * 4.0, -2.5 * 3.0, 2.5 * 6.0)
    velocity = (-4.0, 3.0, -6.0)
    assert agrees(heard(there, velocity, age_s=2.5), one)
    assert not agrees(heard((30.0, 0.0, 0.0), velocity, age_s=2.5), one)
    down = (there[0], there[1], 24.0)
    assert agrees(heard(down, velocity, age_s=2.5), one), "9 m below by now"
    assert not agrees(heard((there[0], there[1], 36.0), velocity, age_s=2.5), one), "21 m below"
    assert not agrees(heard((there[0], there[1], -6.0), velocity, age_s=2.5), one), "21 m above"


def test_a_sensed_object_is_compared_where_it_is_now() -> None:
    fusing = Fusing()
    one = followed(**MOVING)
    for quarter in range(17):
        now_s = AT_S + 0.25 * quarter
        place = 30.0 - 4.0 * 0.25 * quarter, 3.0 * 0.25 * quarter, 0.0
        names = fusing.look(now_s, [heard(place, (-4.0, 3.0, 0.0))], [one], OWN_SIGMA_M)
    assert names == []


def look(fusing: Fusing, at_s: float, *others: Neighbour, sensed: tuple[Followed, ...] = ()) -> list[str]:
    return [o.track_id for o in fusing.look(at_s, others, sensed or (followed(at_s=at_s),), OWN_SIGMA_M)]


def test_a_track_is_left_out_once_both_have_agreed_for_two_seconds() -> None:
    fusing = Fusing()
    for after_s, names in (
        (0.0, ["OTHER"]), (1.0, ["OTHER"]), (1.95, ["OTHER"]), (2.0, []), (2.05, []), (9.0, []),
    ):  # fmt: skip
        assert look(fusing, AT_S + after_s, heard()) == names
        assert fusing.fused == ({} if names else {(False, "OTHER"): "1"})


def test_times_that_are_no_binary_fractions_lose_no_step() -> None:
    fusing = Fusing()
    left_out = [n for n in range(30) if not look(fusing, 0.1 + 0.2 * n, heard())]
    assert left_out[0] == 10


@pytest.mark.parametrize("gap", ["disagrees", "not heard", "not seen"])
def test_the_time_begins_anew_after_a_moment_in_which_they_do_not_agree(gap: str) -> None:
    fusing = Fusing()
    for after_s in (0.0, 1.5):
        look(fusing, AT_S + after_s, heard())
    between = {"disagrees": (heard((90.0, 0.0, 0.0)),), "not heard": (), "not seen": (heard(),)}[gap]
    if gap == "not seen":
        assert fusing.look(AT_S + 1.75, between, [], OWN_SIGMA_M) == list(between)
    else:
        look(fusing, AT_S + 1.75, *between)
    assert fusing.fused == {}
    for after_s, names in ((2.0, ["OTHER"]), (3.75, ["OTHER"]), (4.0, [])):
        assert look(fusing, AT_S + after_s, heard()) == names


def test_forgetting_begins_anew_too() -> None:
    fusing = Fusing()
    for after_s in (0.0, 2.0):
        look(fusing, AT_S + after_s, heard())
    assert fusing.fused
    fusing.clear()
    assert fusing.fused == {}
    assert look(fusing, AT_S + 2.5, heard()) == ["OTHER"]


def test_of_all_that_is_heard_only_the_aircraft_that_is_seen_is_left_out_and_the_order_stays() -> None:
    others = heard((90.0, 0.0, 0.0), track_id="B"), heard((-90.0, 0.0, 0.0), track_id="A")
    assert left(heard(), followed(), *others) == ["B", "A"]


def test_a_name_on_another_radio_is_another_track() -> None:
    assert left(heard(adsb=True), followed(), heard((90.0, 0.0, 0.0))) == ["OTHER"]


def test_two_tracks_at_one_object_and_two_objects_at_one_track_stay() -> None:
    assert left(heard(), followed(), heard(track_id="SECOND")) == ["OTHER", "SECOND"]
    fusing, pair = Fusing(), (followed(), followed(name="2", position=(31.0, 0.0, 0.0)))
    for after_s in (0.0, 1.0, 2.0, 3.0):
        assert look(fusing, AT_S + after_s, heard(), sensed=pair) == ["OTHER"]
    assert fusing.fused == {}


def test_two_tracks_at_two_objects_are_both_left_out() -> None:
    fusing, pair = Fusing(), (followed(), followed(name="2", position=(-30.0, 0.0, 0.0)))
    for after_s in (0.0, 2.0):
        names = look(fusing, AT_S + after_s, heard(), heard((-30.0, 0.0, 0.0), track_id="B"), sensed=pair)
    assert names == []
    assert fusing.fused == {(False, "OTHER"): "1", (False, "B"): "2"}


def test_a_track_that_may_be_elsewhere_stays_with_all_its_places() -> None:
    """Also where the place that agrees is the other one."""
    there = f"OTHER{ASIDE}1"
    assert left(heard(), followed(), heard((90.0, 0.0, 0.0), track_id=there)) == ["OTHER", there]
    assert left(heard((90.0, 0.0, 0.0)), followed(), heard(track_id=there)) == ["OTHER", there]
    assert left(heard(), followed(), heard((90.0, 0.0, 0.0), track_id=f"B{ASIDE}1")) == [f"B{ASIDE}1"]
    elsewhere = heard((90.0, 0.0, 0.0), track_id=there, adsb=True)
    assert left(heard(), followed(), elsewhere) == [there], "that is another track of the same name"


def test_crewed_traffic_and_silent_tracks_stay() -> None:
    assert not agrees(heard(crewed=True))
    assert not agrees(heard(silent=True))
