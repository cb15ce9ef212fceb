"""Who stays in a full table: what no sequence of fakes can do, and what fakes cost each other."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from companion.config import AvoidanceConfig, TrafficConfig
from companion.events import RemoteIdHeard, Say, Severity
from companion.remote_id.messages import BasicId, IdType, Location, UaType
from companion.traffic.eviction import (
    HOLD_S,
    THREAT,
    FullTable,
    Judgement,
    Motion,
    Ranking,
    Standing,
    Trust,
    _sector,
    sound_of,
)
from companion.traffic.tracks import Traffic
from tests.support.place import HOME

UTC_OFFSET_S = 1_767_225_600.0
MOST = 12


def heard(name, address, position, velocity, at_s, *, accuracy_m=3.0, rssi_dbm=None):
    lat, lon, _ = HOME.to_geodetic(position[0], position[1], 0.0)
    location = Location(
        lat_deg=lat,
        lon_deg=lon,
        alt_geodetic_m=447.0 - position[2],
        speed_mps=math.hypot(velocity[0], velocity[1]),
        direction_deg=math.degrees(math.atan2(velocity[1], velocity[0])) % 360.0,
        vertical_speed_mps=0.0,
        horizontal_accuracy_m=accuracy_m,
        timestamp_s=round(at_s, 1),
    )
    basic = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=name)
    return RemoteIdHeard(transport="wifi", address=address, messages=(basic, location), rssi_dbm=rssi_dbm)


class Table:
    """A small table of an aircraft that flies north at 6 m/s; a threat comes head-on at 10 m/s."""

    def __init__(self, most=MOST):
        self.traffic = Traffic(TrafficConfig(max_tracks=most), "OWN")
        self.now_s = 10.0

    @property
    def own(self):
        return (6.0 * (self.now_s - 10.0), 0.0, 0.0)

    @property
    def threat(self):
        return (280.0 - 10.0 * (self.now_s - 10.0), 2.0, 0.0)

    def step(self, seconds, frames):
        self.now_s = round(self.now_s + seconds, 3)
        self.traffic.note_own(self.now_s, self.own, (6.0, 0.0, 0.0))
        for frame in frames:
            self.traffic.hear(frame, self.now_s, UTC_OFFSET_S, HOME, 47.0)
        self.traffic.expire(self.now_s)

    def honest(self):
        return heard("HONEST", "00:aa:bb:00:00:01", self.threat, (-10.0, 0.0, 0.0), self.now_s)

    @property
    def threat_is_tracked(self):
        return any(
            math.dist(t.position_ned_m[:2], self.threat[:2]) < 25.0 and t.velocity_ned_mps[0] < -8.0
            for t in self.traffic.tracks.values()
        )


fakes = st.lists(
    st.tuples(
        st.integers(0, 40),  # who
        st.floats(0.0, math.tau),  # direction from us
        st.floats(32.0, 900.0),  # distance
        st.floats(-0.4, 0.4),  # velocity relative to ours
        st.sampled_from((1.0, 3.0)),
        st.sampled_from((None, -60.0, -61.0, -90.0)),
    ),
    min_size=1,
    max_size=25,
)


def harmless(table, fake):
    """A fake that flies along with us, in conflict with nobody."""
    who, direction, away_m, relative_mps, accuracy_m, rssi_dbm = fake
    own = table.own
    place = (own[0] + away_m * math.cos(direction), own[1] + away_m * math.sin(direction), 0.0)
    velocity = (6.0 + relative_mps * math.cos(direction), abs(relative_mps) * math.sin(direction), 0.0)
    address = f"00:aa:bb:00:01:{who:02x}"
    return heard(f"F{who}", address, place, velocity, table.now_s, accuracy_m=accuracy_m, rssi_dbm=rssi_dbm)


@given(st.lists(fakes, min_size=1, max_size=12), st.integers(0, 8))
@settings(max_examples=25, deadline=None)
def test_no_fakes_that_are_no_threats_remove_or_keep_out_a_threat(rounds, appears):
    """Nearer than it, with its manufacturer's addresses, before, while and after it appears."""
    table = Table()
    for number, frames in enumerate(rounds):
        table.step(0.5, [])
        before = [harmless(table, fake) for fake in frames]
        own = [table.honest()] if number >= appears and number % 2 == appears % 2 else []
        table.step(0.0, before[::2] + own + before[1::2])
        if number >= appears:
            assert table.threat_is_tracked
        assert len(table.traffic.tracks) <= MOST


pressing = st.lists(
    st.tuples(
        st.integers(0, 400),
        st.floats(0.6 * math.pi, 1.4 * math.pi),  # from behind
        st.floats(12.0, 22.0),
        st.floats(0.0, 0.5),  # closing speed
        st.sampled_from((None, -60.0, -75.0, -90.0)),
    ),
    min_size=5,
    max_size=30,
)


@given(st.lists(pressing, min_size=1, max_size=10), st.booleans())
@settings(max_examples=25, deadline=None)
@example([[(k, math.pi + 0.02 * k, 12.0, 0.5, None) for k in range(30)]] * 6, True)
def test_fakes_that_are_threats_remove_no_threat_from_another_direction(rounds, first):
    """All of them are too near already; the table holds fewer than they are."""
    table = Table()
    if first:
        table.step(0.1, [table.honest()])
    for number, frames in enumerate(rounds):
        sent = []
        table.step(0.5, [])
        for who, direction, away_m, closing_mps, rssi_dbm in frames:
            place = (away_m * math.cos(direction) + table.own[0], away_m * math.sin(direction), 0.0)
            velocity = (6.0 - closing_mps * math.cos(direction), -closing_mps * math.sin(direction), 0.0)
            address = f"{2 * (who % 100):02x}:aa:bb:00:01:{who % 256:02x}"
            sent.append(heard(f"F{who}", address, place, velocity, table.now_s, rssi_dbm=rssi_dbm))
        own = [table.honest()] if number % 2 == 0 else []
        table.step(0.0, sent[::2] + own + sent[1::2])
        assert table.threat_is_tracked
        assert len(table.traffic.tracks) <= MOST


def test_copies_of_its_name_do_not_keep_it_out():
    """Thirty of its name, from other addresses, established before it appears; then sixteen a second."""
    table = Table(most=100)
    for second in range(12):
        table.step(1.0, [])
        copies = [
            heard("HONEST", f"c{k}", (table.own[0], 36.0 + k, 0.0), (6.0, 0.0, 0.0), table.now_s)
            for k in range(30)
        ]
        table.step(0.0, copies[:15] + ([table.honest()] if second > 3 else []) + copies[15:])
        if second > 3:
            assert table.threat_is_tracked


def test_churned_addresses_do_not_make_us_forget_the_name_of_a_track():
    """Its Basic ID was heard once; 2000 addresses later its Location is still of that name."""
    table = Table(most=50)
    table.step(0.1, [table.honest()])
    for k in range(2_000):
        basic = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.OTHER, uas_id=f"C{k}")
        table.step(0.0005, [RemoteIdHeard(transport="wifi", address=f"churn {k}", messages=(basic,))])
    table.step(0.9, [])
    (_, location) = table.honest().messages
    table.step(0.0, [RemoteIdHeard(transport="wifi", address="00:aa:bb:00:00:01", messages=(location,))])
    assert set(table.traffic.tracks) == {"HONEST"}
    assert len(table.traffic._table.sources) <= 200


# ------------------------------------------------------------ the ranking


standings = st.builds(
    Standing,
    st.integers(0, THREAT),
    st.integers(0, 3),
    st.integers(0, 3),
    st.integers(0, 3),
    st.tuples(st.integers(-2, 0), st.integers(0, 5), st.integers(0, 5)),
)


@given(st.lists(st.tuples(st.integers(0, 12), st.one_of(st.none(), standings)), max_size=80))
def test_the_ranking_agrees_with_what_was_placed(moves):
    """Sizes are those of the tracks held, and what it gives up is of the lowest tier."""
    ranking, held = Ranking(), {}
    for number, standing in moves:
        track_id = f"t{number}"
        if standing is not None:
            ranking.place(track_id, standing)
            held[track_id] = standing
        elif track_id in held:
            ranking.remove(track_id)
            del held[track_id]
        assert len(ranking) == len(held)
        assert ranking._places.size == sum(s.tier == THREAT for s in held.values())
        if held:
            assert held[ranking.first()].tier == min(s.tier for s in held.values())


def test_the_largest_allowance_gives_up_its_farthest():
    ranking = Ranking()
    for k in range(6):
        ranking.place(f"crowd {k}", Standing(0, 1, 0, 0, (0, 0, k)))
    ranking.place("far", Standing(0, 2, 0, 0, (0, 0, 90)))
    for k in (5, 4, 3, 2):
        assert ranking.first() == f"crowd {k}"
        ranking.remove(f"crowd {k}")


def test_a_threat_of_a_direction_of_its_own_stays():
    ranking = Ranking()
    for k in range(9):
        ranking.place(f"near {k}", Standing(THREAT, k % 3, 7, 1, (0, 1, 1)))
    ranking.place("later", Standing(THREAT, 0, 3, 20, (0, 30, 20)))
    for _ in range(8):
        assert ranking.first() != "later"
        ranking.remove(ranking.first())


def threatens(velocity, position=(100.0, 0.0, 0.0), **more):
    judgement = Judgement(AvoidanceConfig())
    judgement.velocity = (6.0, 0.0, 0.0)
    motion = Motion(position, velocity, 0.0, 10.0, **more)
    return judgement.standing(motion, Trust.FRESH, False, 0, False)[0].threat


def test_a_threat_is_what_comes_nearer_than_the_separation_in_time():
    assert threatens((-10.0, 0.0, 0.0))
    assert not threatens((6.0, 0.0, 0.0))
    assert not threatens((-10.0, 0.0, 0.0), position=(-100.0, 0.0, 0.0))
    assert not threatens((-10.0, 0.0, 0.0), position=(100.0, 0.0, -60.0))
    assert threatens((-10.0, 0.0, 0.0), position=(100.0, 0.0, -60.0), vertical_known=False)
    assert threatens((6.0, 0.0, 0.0), position=(150.0, 0.0, 0.0), crewed=True)


def test_one_that_we_have_just_avoided_stays_a_threat_for_a_while():
    table = Table()
    table.step(0.1, [table.honest()])
    track = table.traffic.tracks["HONEST"]
    table.traffic.note_own(table.now_s, table.own, (0.0, 30.0, 0.0))
    for after_s, tier in ((1.0, THREAT - 1), (HOLD_S + 1.0, Trust.FRESH)):
        table.traffic._table.rank(track, table.now_s + after_s)
        assert table.traffic._table.ranking.standing("HONEST").tier == tier


@pytest.mark.parametrize(
    ("address", "rssi_dbm", "sound"),
    [
        ("00:1A:2b:03:04:05", -61.0, "wifi 00:1a:2b -60 dBm"),
        ("02:1a:2b:03:04:05", -64.0, "wifi random -66 dBm"),
        ("zz:1a:2b:03:04:05", None, "wifi zz:1a:2b"),
        ("ghost 12", None, "wifi ghost"),
        ("", None, "wifi "),
    ],
)
def test_what_sounds_alike(address, rssi_dbm, sound):
    assert sound_of("wifi", address, rssi_dbm) == sound


def test_a_crowd_is_a_group_and_one_alone_is_none():
    table = Table(most=50)
    table.step(0.1, [table.honest()])
    table.step(0.1, [heard(f"F{k}", f"f{k}", (table.own[0], 60.0 + k, 0.0), (6.0, 0.0, 0.0), table.now_s)
                     for k in range(30)])  # fmt: skip
    groups = {n.track_id: n.group for n in table.traffic.neighbours(table.now_s)}
    assert groups["HONEST"] == ""
    assert groups["F5"] == "wifi f"
    assert groups["F29"] == "together"


def test_thirty_six_directions_of_which_level_ones_are_no_others():
    """A threat keeps its place for its direction: twelve to the side, each level, below and above."""
    turn = [math.tau * (k + 0.5) / 12 for k in range(12)]
    found = {h: [_sector((math.cos(a), math.sin(a), h)) for a in turn] for h in (-2.0, -0.5, 0.0, 0.5, 2.0)}
    assert found[-0.5] == found[0.5] == found[0.0]
    assert len({*found[-2.0], *found[0.0], *found[2.0]}) == 36


# ------------------------------------------------------------ the alert


def test_a_full_table_is_told_at_once_then_every_half_minute_and_its_end():
    full = FullTable("Remote ID traffic", 200)
    said = []
    for second in range(120):
        if 10 <= second < 75:
            full.note(float(second), threat=False)
        said += [(second, say) for say in full.due(float(second))]
    assert [second for second, _ in said] == [10, 40, 70, 100, 105]
    assert [say.severity for _, say in said] == [Severity.WARNING] * 4 + [Severity.INFO]
    assert all(type(say) is Say and "Remote ID traffic" in say.text for _, say in said)


def test_threats_that_are_left_out_are_critical_also_when_the_table_was_full_before():
    full = FullTable("Remote ID traffic", 200)
    full.note(1.0, threat=False)
    assert [say.severity for say in full.due(1.0)] == [Severity.WARNING]
    full.note(2.0, threat=True)
    assert [say.severity for say in full.due(2.0)] == [Severity.CRITICAL]
    full.note(3.0, threat=True)
    assert full.due(3.0) == []
