"""Hostile floods: nothing grows without bound, nothing raises, no message costs more than another."""

from __future__ import annotations

import random
import sys

import pytest

from companion.avoidance.law import ASIDE
from companion.config import TrafficConfig
from companion.errors import PeerDataError
from companion.events import RemoteIdHeard
from companion.geometry import LocalFrame
from companion.remote_id.codec import decode
from companion.remote_id.messages import Authentication, BasicId, IdType, Location, Message, Status, UaType
from companion.traffic.tracks import Traffic
from tests.support.place import HOME

UTC_OFFSET_S = 1_767_225_600.0
FRAMES = 60_000
PLACES = [
    (HOME.lat_deg, HOME.lon_deg),
    (90.0, 0.0),
    (-90.0, 180.0),
    (0.0, 180.0),
    (0.0, -180.0),
    (89.9999, -179.9999),
]
"""Own positions: an ordinary one, the poles, the antimeridian."""


class Hostile:
    """Frames made to be as unpleasant as the codec lets them be."""

    def __init__(self, seed: int, lat_deg: float, lon_deg: float) -> None:
        self._random = random.Random(seed)
        self._lat_deg, self._lon_deg = lat_deg, lon_deg

    def frame(self, now_s: float) -> RemoteIdHeard:
        r = self._random
        kinds = (self._location, self._location, self._basic, self._authentication, self._noise)
        return RemoteIdHeard(
            transport=r.choice(("ble4", "ble5", "wifi", "nan")),
            address=f"{r.randrange(10 ** r.randrange(1, 7)):012x}",
            messages=tuple(
                message for _ in range(r.randrange(1, 6)) if (message := r.choice(kinds)(now_s)) is not None
            ),
            rssi_dbm=r.choice((None, -60.0)),
        )

    def _basic(self, now_s: float) -> Message:
        r = self._random
        number = r.randrange(10 ** r.randrange(1, 6))
        identity = r.choice(("X", "OWN", "", "X#2", f"X#{number % 100}", f"I{number}", "ble4/000000000001"))
        return BasicId(id_type=IdType(r.randrange(6)), ua_type=UaType.OTHER, uas_id=identity)

    def _location(self, now_s: float) -> Message:
        r = self._random
        near = r.random() < 0.7
        lat = self._lat_deg + r.gauss(0.0, 0.01) if near else r.uniform(-90.0, 90.0)
        lon = self._lon_deg + r.gauss(0.0, 0.01) if near else r.uniform(-180.0, 180.0)
        return Location(
            status=Status(r.randrange(16)),
            lat_deg=r.choice((max(-90.0, min(90.0, lat)), 90.0, -90.0, None)),
            lon_deg=r.choice((max(-180.0, min(180.0, lon)), 180.0, -180.0)),
            alt_geodetic_m=r.choice((None, r.uniform(-999.5, 31_767.5))),
            direction_deg=r.choice((None, r.uniform(0.0, 359.0))),
            speed_mps=r.choice((None, 0.0, r.uniform(0.0, 254.25))),
            vertical_speed_mps=r.choice((None, r.uniform(-62.0, 62.0))),
            horizontal_accuracy_m=r.choice((None, 1.0, 18_520.0)),
            vertical_accuracy_m=r.choice((None, 1.0, 150.0)),
            timestamp_s=r.choice((None, r.uniform(0.0, 3600.0), (now_s + r.gauss(0.0, 3.0)) % 3600.0)),
        )

    def _authentication(self, now_s: float) -> Message:
        r = self._random
        kind, page, size = r.randrange(16), r.randrange(16), r.randrange(16)
        if page % 3:
            return Authentication(auth_type=kind, page=page, data=r.randbytes(23))
        return Authentication(
            auth_type=r.choice((1, 3, kind)),
            page=0,
            data=r.randbytes(17),
            last_page=size,
            length=r.randrange(18 + 23 * size),
            timestamp_utc_s=UTC_OFFSET_S + int(now_s),
        )

    def _noise(self, now_s: float) -> Message | None:
        try:
            return decode(bytes((self._random.randrange(6) << 4 | 2,)) + self._random.randbytes(24))
        except PeerDataError:
            return None


def check_bounds(traffic: Traffic, max_tracks: int) -> None:
    """Every container of the tracker holds what its bound allows, and they agree with each other."""
    tracks = traffic.tracks
    assert len(tracks) <= max_tracks
    assert len(traffic._table.ranking) == len(tracks)
    tiers = traffic._table.ranking._tiers.values()
    assert sum(tier.size for tier in tiers) == len(tracks)
    assert traffic._table.ranking._places.size <= len(tracks)
    assert sum(traffic._table.groups.values()) == len(tracks)
    assert len(traffic._table.burst._times_s) <= 10
    twins = traffic._table.by_identity
    assert sum(map(len, twins.values())) == len(tracks)
    assert all(1 <= len(group) <= 16 for group in twins.values())
    assert len(traffic._table.sources) <= 4 * max_tracks
    assert len(traffic._assembler) <= 256
    assert traffic._assembler.held_bytes() <= 256 * (17 + 30 * 23)
    assert len(traffic._judge.reports) <= len(tracks)
    assert len(traffic._own) <= 100
    for track_id, track in tracks.items():
        assert track.track_id == track_id
        assert track in twins[track.identity]
        assert len(track.leads_s) <= 5
        assert len(track.sources) <= 4
        assert len(track.doubts.evidence) <= 12


@pytest.mark.parametrize("keys", [False, True])
def test_sixty_thousand_hostile_frames(keys):
    """Half of them with keys to check signatures with."""
    config = TrafficConfig(max_tracks=50, keys={"X": "ab" * 32, "I1": "00" * 32} if keys else {})
    heard = 0
    for seed, (lat_deg, lon_deg) in enumerate(PLACES):
        traffic = Traffic(config, "OWN")
        frame = LocalFrame(lat_deg, lon_deg, 400.0)
        hostile = Hostile(seed, lat_deg, lon_deg)
        for k in range(FRAMES // len(PLACES) // 2):
            now_s = 100.0 + 0.002 * k
            if k % 50 == 0:
                traffic.note_own(now_s, (0.1 * k, 0.0, 0.0), (0.0, 0.0, 0.0))
                traffic.expire(now_s)
                traffic.flagged(now_s)
                names = [n.track_id for n in traffic.neighbours(now_s)]
                assert len(set(names)) == len(names)
                assert {name.partition(ASIDE)[0] for name in names} == set(traffic.tracks)
                assert len(names) <= 2 * len(traffic.tracks) + 50
            if k % 997 == 0:
                check_bounds(traffic, 50)
            utc_offset_s = None if k % 1000 < 20 else UTC_OFFSET_S
            separation_m = None if k % 1000 < 300 else 47.0
            traffic.hear(hostile.frame(now_s), now_s, utc_offset_s, frame, separation_m)
            heard += 1
        check_bounds(traffic, 50)
        assert traffic.counts.updates
        traffic.clear()
        check_bounds(traffic, 50)
        assert not traffic.tracks
    assert heard * 2 >= FRAMES - 2 * len(PLACES)


# ---------------------------------------------------------------- the cost of a message


def lines_run(action, *args) -> int:
    """Lines of Python executed: the cost of an action without a clock."""
    count = 0

    def trace(*_):
        nonlocal count
        count += 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        action(*args)
    finally:
        sys.settrace(before)
    return count


def location_at(north_m: float, timestamp_s: float) -> Location:
    return Location(
        lat_deg=HOME.lat_deg + north_m / 111_200.0,
        lon_deg=HOME.lon_deg,
        speed_mps=5.0,
        direction_deg=90.0,
        timestamp_s=timestamp_s,
    )


def full_table(max_tracks: int) -> tuple[Traffic, LocalFrame]:
    """As many tracks and addresses as the table holds, with the names of splits squatted upon."""
    traffic = Traffic(TrafficConfig(max_tracks=max_tracks), "OWN")
    traffic.note_own(10.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for k in range(max_tracks):
        identity = f"X#{k}" if k % 2 else f"I{k}"
        hear(traffic, HOME, 10.0, identity, location_at(20.0 + 30_000.0 * k / max_tracks, 10.0), f"s{k}")
    assert len(traffic.tracks) == max_tracks
    return traffic, HOME


def hear(traffic, frame, now_s, identity, location, address):
    name = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.OTHER, uas_id=identity)
    heard = RemoteIdHeard(transport="wifi", address=address, messages=(name, location))
    traffic.hear(heard, now_s, UTC_OFFSET_S, frame, None)


def messages_to_a_full_table(max_tracks: int) -> dict[str, int]:
    """The dearest of a few messages of each kind."""
    traffic, frame = full_table(max_tracks)
    dearest = dict.fromkeys(("update", "newcomer", "refused", "split"), 0)
    for k in range(40):
        t = 10.5 + 0.1 * k
        frames = {
            "update": ("I0", location_at(20.0, t), "s0"),
            "newcomer": (f"N{k}", location_at(10.0, t), f"n{k}"),
            # It sounds like those that fill the table: with a sound of its own it would get a place.
            "refused": (f"R{k}", location_at(40_000.0, t), f"s{max_tracks + k}"),
            "split": ("I0", location_at(5.0 if k % 2 else 900.0 + 90 * k, t), f"t{k}"),
        }
        for kind, (identity, location, address) in frames.items():
            cost = lines_run(hear, traffic, frame, t, identity, location, address)
            dearest[kind] = max(dearest[kind], cost)
    assert traffic.counts.refused_full
    assert traffic.counts.evicted
    assert traffic.counts.split
    return dearest


def test_no_message_costs_more_in_a_larger_table():
    """Fifty times the tracks, the same work, counted in lines run (C loops are bounded by `check_bounds`)."""
    small, large = messages_to_a_full_table(100), messages_to_a_full_table(5_000)
    for kind, cost in large.items():
        assert cost <= 1.2 * small[kind] + 20, kind


def test_squatted_names_of_splits_are_not_tried_over_and_over():
    traffic, frame = full_table(400)
    tried = []
    for k in range(60):
        before = traffic._split_number
        hear(traffic, frame, 11.0 + 0.1 * k, "I0", location_at(1_000.0 * (k % 30 + 1), 11.0 + 0.1 * k), "s0")
        tried.append(traffic._split_number - before)
    assert traffic.counts.split >= 50
    assert sum(tried) <= 400 + 60
