"""Allowances, decision by decision, without a law."""

from __future__ import annotations

import msgspec
import pytest

from companion.avoidance.law import ASIDE
from companion.config import ContainmentConfig
from companion.events import AllowanceSpent, Say
from companion.traffic.places import SIGNAL_PLACE
from tests.companion.authority.influence.sky import SHORT, ZERO, Sky, other


def test_a_track_that_has_spent_its_allowance_is_left_out_and_others_are_not():
    sky = Sky()
    assert sky.run(39.0, other("A")) == ["A"]
    assert sky.run(2.0, other("A", at=(60.0, 0.0, 0.0)), other("B")) == ["B"]
    assert sky.scopes() == [("track", True)]
    assert [c.text for c in sky.told if isinstance(c, Say)] == [
        "DMUCA: A has held us for 40 s: it is not avoided any more"
    ]


def test_silence_and_another_flight_renew_nothing_but_time_does():
    sky = Sky(msgspec.structs.replace(SHORT, total_s=1000.0))
    sky.run(41.0, other("A"))
    sky.run(100.0)
    assert sky.run(1.0, other("A")) == []
    sky.run(380.0)
    assert sky.run(0.2, other("A")) == []
    sky.run(45.0)  # half of it is whole again
    assert sky.run(1.0, other("A")) == ["A"]


def test_nothing_is_charged_while_the_vehicle_is_not_held():
    sky = Sky()
    assert sky.run(200.0, other("A"), held=False) == ["A"]
    assert not sky.told


def test_a_proven_track_is_neither_charged_nor_left_out():
    sky = Sky()
    assert sky.run(500.0, other("A", proven=True), other("H", proven=True, adsb=True, crewed=True)) == [
        "A",
        "H",
    ]
    assert not sky.told
    assert sky.hold is None


def test_inside_its_volume_a_track_has_less():
    sky = Sky()
    near = other("A", at=(-10.0, 0.0, 0.0))
    assert sky.run(19.0, near, radius_m=30.0) == ["A"]
    assert sky.run(2.0, other("A", at=(-5.0, 0.0, 0.0)), radius_m=30.0) == []


@pytest.mark.parametrize(
    ("radius_m", "height_m", "above_m", "inside"),
    [
        (60.0, 15.0, 14.0, True),
        (60.0, 15.0, 16.0, False),
        (15.0, 60.0, 59.0, True),
        (15.0, 60.0, 61.0, False),
        # A law of a plug-in tells no height: 1 / 0.85 as tall as wide.
        (17.0, 0.0, 19.9, True),
        (17.0, 0.0, 20.1, False),
    ],
)
def test_a_volume_is_as_tall_as_the_law_has_it(radius_m, height_m, above_m, inside):
    sky = Sky()
    above = other("A", at=(0.0, 0.0, -above_m), velocity=ZERO)
    assert sky.run(22.0, above, radius_m=radius_m, height_m=height_m) == ([] if inside else ["A"])


def test_a_new_name_inside_takes_over_what_the_last_one_used():
    sky = Sky()
    sky.run(15.0, other("A", at=(-7.0, 0.0, 0.0)), radius_m=30.0)
    assert sky.run(10.0, other("B", at=(-5.0, 0.0, 0.0)), radius_m=30.0) == []
    # One that comes from farther away has an allowance of its own.
    assert sky.run(10.0, other("C", at=(-50.0, 0.0, 0.0)), radius_m=30.0) == ["C"]


@pytest.mark.parametrize(("away_s", "less"), [(4.0, True), (8.0, False)])
def test_one_that_pressed_has_no_heir_after_twice_the_time_that_it_was_inside(away_s, less):
    sky = Sky()
    sky.run(3.0, other("A", at=(-7.0, 0.0, 0.0), velocity=ZERO))
    sky.run(away_s, other("A", at=(200.0, 0.0, 0.0), velocity=ZERO))
    sky.run(1.0, other("B", at=(-5.0, 0.0, 0.0), velocity=ZERO))
    assert (sky.all._tracks[False, "B"].inside.used_s > 2.0) is less


def test_a_track_that_is_gone_is_not_charged():
    """The law may still show it for a step."""
    sky = Sky()
    sky.run(1.0, other("A"))
    sky.run(1.0)
    assert not sky.all._places


def test_a_group_shares_and_each_of_it_keeps_a_quarter_of_a_tracks():
    sky = Sky()
    for name in "ABCD":
        sky.run(14.0, other(name, group="g"))
    assert sky.run(8.0, other("E", group="g")) == ["E"]
    assert ("group", True) in sky.scopes()
    assert sky.run(8.0, other("E", group="g")) == []  # 10 s of 40 s
    assert sky.run(1.0, other("F", group="g"), other("G")) == ["F", "G"]


def test_the_last_quarter_of_the_total_is_for_tracks_that_were_heard_before():
    sky = Sky()
    old = other("OLD", at=(900.0, 0.0, 0.0), velocity=(-4.0, 0.0, 0.0))
    for name in "ABC":
        sky.run(1.0, old, held=False)
        sky.run(26.0, other(name))
    assert sky.scopes()[-1] == ("low", True)
    assert sky.run(1.0, other("NEW"), old) == ["OLD"]
    # It is not given up in the middle of an encounter, but with the total.
    assert sky.run(15.0, old) == ["OLD"]
    assert sky.run(15.0, old) == []


def test_where_the_total_is_spent_all_are_left_out_but_those_that_stand_then_the_vehicle_holds():
    sky = Sky()
    for name in "ABCD":
        sky.run(30.0, other(name))
    sky.run(30.0, back=False)
    assert ("total", True) in sky.scopes()
    assert sky.run(1.0, other("E")) == []
    assert sky.hold is None
    standing = other("S", at=(20.0, 5.0, 0.0), velocity=(0.0, 0.0, 0.0))
    sky.run(40.0, standing)
    assert sky.hold == "unproven traffic has held us for 100 s: S"


def test_with_hold_nobody_is_left_out_by_the_total():
    sky = Sky(msgspec.structs.replace(SHORT, then="hold"))
    for name in "ABCD":
        sky.run(30.0, other(name))
    assert sky.hold == "unproven traffic has held us for 100 s: D"
    assert sky.run(1.0, other("E")) == ["E"]


@pytest.mark.parametrize("then", ["hold", "resume"])
def test_crewed_traffic_has_a_total_of_its_own(then):
    sky = Sky(msgspec.structs.replace(SHORT, crewed_then=then))
    heli = other("H", velocity=(3.0, 0.0, 0.0), adsb=True, crewed=True)
    assert sky.run(49.0, heli) == ["H"]
    assert sky.run(3.0, heli, other("A", at=(70.0, 0.0, 0.0))) == (["H", "A"] if then == "hold" else ["A"])
    assert sky.hold == ("crewed traffic has held us for 50 s: H" if then == "hold" else None)
    what = "the vehicle is asked to hold" if then == "hold" else "not avoided any more"
    assert [c.text for c in sky.told if isinstance(c, Say)] == [
        f"DMUCA: crewed traffic has held us for 50 s: {what}"
    ]
    assert sky.scopes() == [("crewed", True)]


@pytest.mark.parametrize(("use", "charged"), [("guard", True), ("fly", False)])
def test_a_guarded_vehicle_is_charged_until_it_is_given_back(use, charged):
    """Short conflicts, each of which holds a guarded vehicle for a minute."""
    sky = Sky(use=use)
    for n in range(12):
        sky.run(1.0, other(f"A{n}"))
        sky.run(59.0, back=True)
    assert (("total", True) in sky.scopes()) is charged


def test_the_pilot_is_told_of_single_tracks_at_most_every_five_seconds():
    sky = Sky()
    sky.run(41.0, other("A"), other("B", at=(0.0, 20.0, 0.0)))
    assert sorted(c.track_id for c in sky.told if isinstance(c, AllowanceSpent)) == ["A", "B"]
    assert len([c for c in sky.told if isinstance(c, Say)]) == 1


def test_what_is_remembered_is_bounded():
    sky = Sky()
    sky.all.admitted(0.0, ZERO, ZERO, [other("A")])
    for n in range(30):
        sky.all.admitted(1.0 + 0.2 * n, ZERO, ZERO, [other(f"{n}/{m}") for m in range(100)])
    assert len(sky.all._tracks) == 1000
    sky.all.admitted(100.0, ZERO, ZERO, [])
    assert not sky.all._tracks


def test_all_that_are_heard_at_once_are_remembered():
    """`traffic.max_tracks` may exceed what is remembered of the silent. Each has its charge all the same."""
    crowd = [other(f"A{n}", at=(1.0, 0.0, 0.0)) for n in range(1200)]
    sky = Sky()
    assert len(sky.run(1.0, *crowd)) == 1200
    assert sum(known.entered for known in sky.all._tracks.values()) == 1200


def test_another_place_of_a_track_has_no_allowance_of_its_own():
    """The aircraft may be there too: both are charged as one, and both are left out together."""
    sky = Sky()
    assert sky.run(39.0, other("A"), other(f"A{ASIDE}1", at=(0.0, 60.0, 0.0))) == ["A", f"A{ASIDE}1"]
    assert not sky.run(2.0, other("A", at=(60.0, 0.0, 0.0)), other(f"A{ASIDE}1", at=(0.0, 60.0, 0.0)))
    assert sky.scopes() == [("track", True)]


def test_no_name_of_a_sender_is_taken_for_another_place():
    """Whatever it is called, it is charged as itself, and it does not stand while it moves."""
    sky = Sky()
    assert sky.run(39.0, other("A~1"), other("A")) == ["A~1", "A"]
    assert sky.scopes() == []
    sky.run(2.0, other("A~1"))
    assert [c.track_id for c in sky.told if isinstance(c, AllowanceSpent)] == ["A~1"]


def test_another_place_of_a_reserved_track_is_avoided_to_the_end():
    sky = Sky(msgspec.structs.replace(SHORT, track_s=80.0))
    sky.run(70.0, other("B"))
    sky.run(2.0, other("A"))
    sky.run(6.0, other("B"))
    assert sky.run(5.0, other("A"), other(f"A{ASIDE}1", at=(0.0, 60.0, 0.0))) == ["A", f"A{ASIDE}1"]
    assert sky.run(1.0, other("C")) == []


def test_the_time_after_a_conflict_is_charged_for_a_minute():
    """Far away, on the way back: 30 s of conflict and 60 s after it, of 100 s; a second minute is free."""
    sky = Sky(msgspec.structs.replace(SHORT, refill_s=86_400.0))
    sky.run(30.0, other("A"))
    sky.run(200.0)
    assert sky.all._total.used_s == pytest.approx(30.0 + 60.0, abs=0.5)


def test_a_track_that_appears_inside_takes_over_the_most_of_what_others_have_used():
    sky = Sky()
    sky.run(6.0, other("B", at=(5.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)))
    sky.run(12.0, other("A", at=(5.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)))
    sky.run(0.4, other("C", at=(5.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0)))
    first = sky.all._tracks[False, "A"]
    heir = sky.all._tracks[False, "C"]
    assert first.used.used_s == pytest.approx(18.0, abs=1.0)
    assert heir.used.used_s == pytest.approx(18.8, abs=1.0)
    assert heir.inside.used_s == pytest.approx(18.8, abs=1.0)
    assert heir.pressed_s == pytest.approx(18.8, abs=1.0)


def test_it_is_recorded_when_a_total_is_whole_again():
    sky = Sky(msgspec.structs.replace(SHORT, track_s=300.0))
    sky.run(101.0, other("A"))
    sky.run(700.0)
    assert ("total", True) in sky.scopes()
    assert ("total", False) in sky.scopes()


def test_a_newcomer_is_remembered_however_many_have_used_something():
    """More names than are remembered have held the aircraft; the next one appears within its volume."""
    sky = Sky(ContainmentConfig())
    for batch in range(6):
        sky.run(0.4, *(other(f"F{batch}-{n}") for n in range(200)))
    assert sky.run(0.4, other("NEW", at=(5.0, 0.0, 0.0))) == ["NEW"]


def test_the_signal_place_of_a_moving_proven_track_does_not_stand():
    """A proven track is not remembered, but the place that its signal strength points to is."""
    sky = Sky()
    track = other("A", velocity=(5.0, 0.0, 0.0), proven=True)
    place = msgspec.structs.replace(track, track_id=f"A{SIGNAL_PLACE}", proven=False)
    assert sky.run(30.0, track, place) == ["A", f"A{SIGNAL_PLACE}"]
    assert sky.run(25.0, track, place) == ["A"]


def test_who_takes_off_beside_a_hovering_aircraft_inherits_nothing_from_it():
    """The one that hovers inside its volume has spent its allowance there, and is still avoided."""
    sky = Sky()
    hovers = other("A", at=(15.0, 0.0, 0.0), velocity=ZERO)
    assert sky.run(35.0, hovers, radius_m=26.0) == ["A"]
    assert sky.scopes() == [("track", True)]
    comes = other("B", at=(0.0, 20.0, 0.0), velocity=(0.0, -1.0, 0.0))
    assert sky.run(15.0, hovers, comes, radius_m=26.0) == ["A", "B"]
