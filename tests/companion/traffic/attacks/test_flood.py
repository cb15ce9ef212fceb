"""Floods of 5,000 frames a second: what is heard in them, and what they may take. Speed is in bench/."""

from __future__ import annotations

import math
import random

import pytest

from companion.config import TrafficConfig
from companion.events import RemoteIdHeard
from companion.geometry import LocalFrame
from companion.remote_id.messages import BasicId, IdType, Location, SelfId, UaType
from companion.traffic.flood import choice
from companion.traffic.tracks import Traffic
from tests.companion.traffic.attacks.test_eviction import heard
from tests.support.place import HOME

UTC_OFFSET_S = 1_767_225_600.0
STEP_S, A_STEP, STEPS = 0.05, 250, 24
OWN_MPS = (6.0, 0.0, 0.0)
MOST = 200
ADDRESS = "00:aa:bb:00:00:01"


class Sky:
    """An aircraft that flies north at 6 m/s, with 64 established tracks; one comes towards it at 6 m/s."""

    def __init__(self, established=True):
        self.traffic = Traffic(TrafficConfig(max_tracks=MOST), "OWN")
        self.now_s, self.count, self.sent, self.known = 100.0, 0, 0, 0
        for _ in range(80 if established else 0):
            self.step([], established=True)

    @property
    def own(self):
        return 6.0 * (self.now_s - 100.0), 0.0, 0.0

    def honest(self):
        place = 260.0 - 6.0 * (self.now_s - 100.0), 4.0, 0.0
        return heard("HONEST", ADDRESS, place, (-6.0, 0.0, 0.0), self.now_s)

    def bystander(self, n):
        away, turn = 200.0 + 5.0 * n, 0.1 * n
        place = self.own[0] + away * math.cos(turn), away * math.sin(turn), 0.0
        return heard(f"N{n}", f"00:aa:bb:00:01:{n:02x}", place, OWN_MPS, self.now_s)

    def step(self, flood, *, established=True):
        """One step with 64 established tracks: the honest one sends five times a second, in the middle."""
        frames, middle = list(flood), len(flood) // 2
        sends = established and self.count % 4 == 0
        if established:
            frames[middle:middle] = [self.bystander(n) for n in range(63) if self.count % 20 == n % 20]
        if sends:
            frames.insert(middle, self.honest())
        self.hear(frames)
        track = self.traffic.tracks.get("HONEST")
        self.sent += sends
        self.known += sends and track is not None and track.received_s == self.now_s
        self.count += 1
        self.now_s = round(self.now_s + STEP_S, 3)

    def hear(self, frames):
        self.traffic.note_own(self.now_s, self.own, OWN_MPS)
        self.traffic.hear_all(frames, self.now_s, UTC_OFFSET_S, HOME, 47.0)
        self.traffic.expire(self.now_s)

    def flood(self, kind):
        start = A_STEP * self.count
        return [kind(self, start + k) for k in range(A_STEP)]


def beside(sky, k):
    """In conflict with nobody, ever nearer."""
    away, turn = 900.0 - 0.05 * (k % 16_000), 2.4 * k
    return (sky.own[0] + away * math.cos(turn), away * math.sin(turn), 0.0), OWN_MPS


def closing(sky, k):
    """In conflict, ever sooner, from all directions."""
    away, turn = 300.0 - 0.01 * (k % 16_000), 2.4 * k
    place = sky.own[0] + away * math.cos(turn), away * math.sin(turn), 0.0
    return place, (6.0 - 12.0 * math.cos(turn), -12.0 * math.sin(turn), 0.0)


def mac(k):
    return f"02:00:{k >> 24 & 255:02x}:{k >> 16 & 255:02x}:{k >> 8 & 255:02x}:{k & 255:02x}"


def anew(where):
    return lambda sky, k: heard(f"F{k}", mac(k), *where(sky, k), sky.now_s)


def one_address(where):
    return lambda sky, k: heard(f"F{k}", mac(0), *where(sky, k), sky.now_s)


def known(where):
    return lambda sky, k: heard("F", mac(0), *where(sky, 0), sky.now_s)


def some(where, number):
    return lambda sky, k: heard(f"F{k % number}", mac(k % number), *where(sky, k % number), sky.now_s)


def nameless(where):
    def made(sky, k):
        whole = heard("", mac(k), *where(sky, k), sky.now_s)
        return RemoteIdHeard(transport="ble4", address=mac(k), messages=whole.messages[1:])

    return made


def copied_address(sky, k):
    """Names and places of its own, from the honest aircraft's radio address: 40 m beside it and elsewhere."""
    (_, location) = sky.honest().messages
    lat = location.lat_deg + (k % 7 + 1) * 4e-4
    at = Location(lat_deg=lat, lon_deg=location.lon_deg, alt_geodetic_m=447.0, speed_mps=6.0,
                  direction_deg=180.0, horizontal_accuracy_m=3.0,
                  timestamp_s=location.timestamp_s)  # fmt: skip
    basic = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.OTHER, uas_id=f"C{k}")
    return RemoteIdHeard(transport="wifi", address=ADDRESS, messages=(basic, at))


def names_alone(_sky, k):
    basic = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.OTHER, uas_id=f"F{k}")
    return RemoteIdHeard(transport="ble4", address=mac(k), messages=(basic,))


def texts(_sky, k):
    return RemoteIdHeard(
        transport="ble4", address=mac(k), messages=(SelfId(description_type=0, text=f"{k}"),)
    )


FLOODS = {
    "new names and addresses": anew(beside),
    "new names and addresses, in conflict": anew(closing),
    "new names, one address": one_address(beside),
    "new names, one address, in conflict": one_address(closing),
    "one name": known(beside),
    "one name, in conflict": known(closing),
    "200 names, in conflict": some(closing, 200),
    "400 names, in conflict": some(closing, 400),
    "no names": nameless(beside),
    "no names, in conflict": nameless(closing),
    "the honest aircraft's address": copied_address,
    "Basic IDs alone": names_alone,
    "Self IDs alone": texts,
}


@pytest.mark.parametrize("kind", FLOODS.values(), ids=FLOODS)
def test_an_established_threat_is_heard_in_a_flood_and_the_flood_is_bounded(kind):
    sky = Sky()
    sky.sent = sky.known = 0
    for _ in range(STEPS):
        sky.step(sky.flood(kind))
        assert len(sky.traffic.tracks) <= MOST
    assert sky.sent == STEPS // 4
    assert sky.known >= 0.95 * sky.sent
    assert len(sky.traffic._table.sources) <= 4 * MOST
    assert len(sky.traffic._table.ranking) == len(sky.traffic.tracks)
    used = STEPS * A_STEP - sky.traffic.counts.crowded
    assert used <= STEPS * (choice.KNOWN + choice.STRANGE + choice.NAMELESS)


@pytest.mark.parametrize(
    "name",
    [
        "new names and addresses",
        "new names and addresses, in conflict",
        "new names, one address, in conflict",
        "200 names, in conflict",
    ],
)
@pytest.mark.parametrize("flood_steps", [1, 10])
def test_a_threat_that_appears_in_a_flood_is_tracked_from_its_first_message(name, flood_steps):
    """A flood that is in conflict comes from behind, so that the threat has a direction of its own."""
    kind, sky = FLOODS[name], Sky(established=False)

    def flood():
        made = (kind(sky, 2 * A_STEP * sky.count + k) for k in range(2 * A_STEP))
        return [frame for frame in made if is_behind(sky, frame)]

    for _ in range(flood_steps):
        sky.step(flood(), established=False)
    frames = flood()
    for place in (0, len(frames) // 2, len(frames)):
        frames.insert(place, sky.honest())
        sky.hear(frames)
        assert "HONEST" in sky.traffic.tracks
        del frames[place]
        sky.now_s = round(sky.now_s + STEP_S, 3)


def is_behind(sky, made):
    """Whether a frame is in no conflict, or comes from behind."""
    (_, location) = made.messages
    north, _, _ = HOME.to_ned(location.lat_deg, location.lon_deg, 0.0)
    return north < sky.own[0] - 50.0 or location.speed_mps == pytest.approx(6.0)


@pytest.mark.parametrize("separation_m", [47.0, None])
def test_the_rough_place_of_a_frame_is_where_its_track_is(separation_m):
    """A height above the ellipsoid is none above the sea where the difference is not known."""
    at = Location(lat_deg=HOME.lat_deg + 2e-3, lon_deg=HOME.lon_deg - 3e-3, alt_geodetic_m=HOME.alt_m + 107.0,
                  speed_mps=8.0, direction_deg=120.0, vertical_speed_mps=2.5, horizontal_accuracy_m=3.0,
                  timestamp_s=99.9)  # fmt: skip
    frame = RemoteIdHeard(transport="wifi", address=ADDRESS, messages=(at,))
    traffic = Traffic(TrafficConfig(), "OWN")
    traffic.hear(frame, 100.0, UTC_OFFSET_S, HOME, separation_m)
    (track,) = traffic.tracks.values()
    (row,) = choice._places([frame], HOME, separation_m).tolist()
    assert row[:2] == pytest.approx(track.position_ned_m[:2], rel=0.01)
    assert row[3:6] == pytest.approx(track.velocity_ned_mps)
    assert row[5] == -2.5
    if separation_m is None:
        assert math.isnan(row[2])
        assert not track.vertical_known
    else:
        assert row[2] == pytest.approx(track.position_ned_m[2], abs=0.2)
        assert row[2] == pytest.approx(-60.0, abs=0.2)


def test_up_to_the_bound_every_frame_is_used():
    sky = Sky(established=False)
    kind = FLOODS["new names and addresses"]
    for _ in range(5):
        sky.hear([kind(sky, 1000 * sky.count + k) for k in range(choice.ALL)])
        sky.count += 1
    assert sky.traffic.counts.crowded == 0


def test_many_established_fakes_do_not_starve_one_that_sends_less_often():
    """200 of them, each in every step: those that have waited longest come first."""
    sky = Sky()
    fakes = some(closing, 200)
    for _ in range(40):
        sky.step([fakes(sky, k) for k in range(200)])
    assert sum(t.messages > 3 for t in sky.traffic.tracks.values()) > 150
    sky.sent = sky.known = 0
    for _ in range(STEPS):
        sky.step([fakes(sky, k) for k in range(200)])
    assert sky.known >= 0.95 * sky.sent


def test_the_urgency_of_many_agrees_with_the_judgement_of_each():
    """Whoever is a threat for the table is one here, with the same direction and class."""
    sky = Sky()
    judgement = sky.traffic.judgement
    frames = [kind(sky, k) for kind in (anew(beside), anew(closing)) for k in range(60)]
    rows = choice._places(frames, HOME, 47.0)
    loss_s, away_m, sector, part = judgement.urgency(rows)
    threats = alike = same_class = 0
    for k, frame in enumerate(frames):
        fresh = Traffic(TrafficConfig(), "OWN")
        fresh.note_own(sky.now_s, sky.own, OWN_MPS)
        fresh.hear(frame, sky.now_s, UTC_OFFSET_S, HOME, 47.0)
        (track_id,) = fresh.tracks
        standing = fresh._table.ranking.standing(track_id)
        if standing.threat:
            threats += 1
            assert math.isfinite(loss_s[k])
            alike += sector[k] == standing.sector
            same_class += part[k] == standing.part
        assert away_m[k] == pytest.approx(math.dist(fresh.tracks[track_id].position_ned_m, sky.own), rel=0.01)
    assert 50 <= threats <= 70
    assert min(alike, same_class) >= 0.95 * threats  # the others are on a border


@pytest.mark.parametrize("lon_deg", [10.0, 179.9995, -179.9995])
def test_a_flood_hides_no_aircraft_on_the_other_side_of_the_antimeridian(lon_deg):
    """It comes towards us; two hundred others in each step fly away."""
    frame, rng = LocalFrame(0.0, lon_deg, 0.0), random.Random(1)
    traffic = Traffic(TrafficConfig(), "OWN")
    ahead = math.copysign(1.0, lon_deg)

    def sent(address, north, east, v_north, v_east):
        lat_deg, lon_deg, _ = frame.to_geodetic(north, east, -50.0)
        place = Location(
            lat_deg=lat_deg, lon_deg=lon_deg, alt_geodetic_m=50.0, speed_mps=math.hypot(v_north, v_east),
            direction_deg=math.degrees(math.atan2(v_east, v_north)) % 360.0, vertical_speed_mps=0.0,
            horizontal_accuracy_m=3.0, vertical_accuracy_m=3.0,
        )  # fmt: skip
        name = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.OTHER, uas_id=address)
        return RemoteIdHeard(transport="wifi", address=address, messages=(name, place))

    for step in range(20):
        now = 0.2 * step
        traffic.note_own(now, (0.0, 0.0, -50.0), (0.0, 10.0 * ahead, 0.0))
        frames = []
        for number in range(200):
            angle, away = rng.uniform(0.0, 6.28), rng.uniform(300.0, 500.0)
            n, e = math.cos(angle), math.sin(angle)
            frames.append(sent(f"F{step}-{number}", away * n, away * e, 8.0 * n, 8.0 * e))
        frames.append(sent("TRUE", 0.0, ahead * (200.0 - 10.0 * now), 0.0, -10.0 * ahead))
        traffic.hear_all(frames, now, UTC_OFFSET_S, frame, 0.0)
    assert "TRUE" in traffic.tracks
