"""Allowances, decision by decision, without a law."""

from __future__ import annotations

import msgspec
import pytest

from companion.authority.influence.allowance import Allowances
from companion.avoidance.law import ASIDE, LawResult, Neighbour
from companion.config import Config, ContainmentConfig, IdentityConfig
from companion.events import AllowanceSpent, Say, TrackView

SHORT = ContainmentConfig(
    track_s=40.0, inside_s=20.0, group_s=60.0, total_s=100.0, refill_s=1000.0, crewed_total_s=50.0
)

ZERO = (0.0, 0.0, 0.0)


def other(name, *, at=(20.0, 0.0, 0.0), velocity=(1.0, 0.0, 0.0), **fields):
    return Neighbour(name, at, velocity, 0.0, 3.0, **fields)


class Sky:
    """What is heard, how far it moves, and what the law would say of it: all of it is in conflict."""

    def __init__(self, config=SHORT, use="fly"):
        made = Config(identity=IdentityConfig(uas_id="OWN"), containment=config)
        flight = msgspec.structs.replace(made.flight, use=use)
        self.all = Allowances(msgspec.structs.replace(made, flight=flight))
        self.now_s = 0.0
        self.told = []
        self.hold = None
        self.quiet = set()
        """Tracks that are in no conflict."""

    def run(self, seconds, *others, radius_m=10.0, height_m=0.0, held=True, back=False):
        """Names of the tracks that were avoided at the end."""
        admitted = []
        for _ in range(round(seconds / 0.2)):
            self.now_s += 0.2
            others = [
                msgspec.structs.replace(
                    o,
                    position_ned_m=tuple(
                        p + 0.2 * v for p, v in zip(o.position_ned_m, o.velocity_ned_mps, strict=True)
                    ),
                )
                for o in others
            ]
            admitted = self.all.admitted(self.now_s, ZERO, ZERO, others)
            views = tuple(
                TrackView(
                    track_id=o.track_id, position_ned_m=o.position_ned_m, velocity_ned_mps=o.velocity_ned_mps,
                    age_s=0.0, radius_m=radius_m, conflict=o.track_id not in self.quiet,
                    time_to_closest_s=5.0, closest_m=0.0, active=o.track_id not in self.quiet, adsb=o.adsb,
                    height_m=height_m, yields=o.yields,
                )
                for o in admitted
            )  # fmt: skip
            result = LawResult(ZERO, ZERO, True, bool(views), False, (), views)
            self.all.charge(self.now_s, ZERO, ZERO, result, held=held, back=back)
            self.told += self.all.told()
            self.hold = self.hold or self.all.hold
        self.yielding = {o.track_id for o in admitted if o.yields}
        self.pressing = {o.track_id for o in admitted if o.presses}
        return [o.track_id for o in admitted]

    def scopes(self):
        return [(c.scope, c.spent) for c in self.told if isinstance(c, AllowanceSpent)]


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
    assert sky.yielding == ({"A"} if together else set())


def test_a_track_that_is_gone_is_not_charged():
    """The law may still show it for a step."""
    sky = Sky()
    sky.run(1.0, other("A"))
    sky.run(1.0)
    assert not sky.all._places


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
    what = "the vehicle is to hold" if then == "hold" else "not avoided any more"
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
