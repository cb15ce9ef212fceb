"""One companion with one mock vehicle in virtual time: crewed traffic, fences and alerts, over real bytes."""

from __future__ import annotations

import io
import math

import msgspec
import numpy as np
import pytest

from companion import event_record, replay
from companion.authority.table import HOLDING, State
from companion.autopilot.wire import MavlinkReader
from companion.avoidance.alerts import Level
from companion.config import (
    AvoidanceConfig,
    Config,
    FlightConfig,
    IdentityConfig,
    LimitsConfig,
    TrajectoryFile,
    VehicleConfig,
    Waypoint,
)
from companion.events import (
    AdsbVehicle,
    AlertChanged,
    Decision,
    DownloadFence,
    FenceArea,
    FenceDownloaded,
    Firmware,
    RemoteIdHeard,
    Say,
    SetMode,
    Threat,
    VelocitySetpoint,
)
from companion.remote_id.messages import BasicId, IdType, Location, Status, UaType
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from sitl_mocks.vehicle.traffic import CrewedFlight
from tests.sitl_mocks.with_companion.pair import TICK_S, UTC_AT_ZERO_S, Pair
from tests.support.place import HOME

VEHICLES_OWN = {"fence": "vehicle"}
SPEED_MPS = 3.0
MEETS_S = 70.0
"""With this look-ahead, crewed traffic is a caution before it is a warning."""
WELL_CLEAR = AvoidanceConfig()
BOTH = pytest.mark.parametrize("firmware", Firmware)


def polygon(*corners, inclusion=True):
    points = tuple(HOME.to_geodetic(north, east, 0.0)[:2] for north, east in corners)
    return FenceArea(inclusion=inclusion, points=points)


def corridor(west_m, east_m, *, north_m=2000.0):
    """A corridor along the path."""
    return polygon((-200.0, west_m), (north_m, west_m), (north_m, east_m), (-200.0, east_m))


def path():
    """Due north at 3 m/s, 50 m above home."""
    places = [HOME.to_geodetic(north, 0.0, -50.0) for north in (0.0, 400.0 * SPEED_MPS)]
    return TrajectoryFile(
        altitude="msl",
        waypoint=tuple(
            Waypoint(t_s=t, lat_deg=lat, lon_deg=lon, alt_m=alt)
            for t, (lat, lon, alt) in zip((0.0, 400.0), places, strict=True)
        ),
    )


def crossing(at_s=50.0, **over):
    """Crewed traffic at 50 m/s from the west that meets the path's point at `at_s`."""
    start = (SPEED_MPS * (at_s - 2.0), -50.0 * at_s, -50.0)
    return CrewedFlight(
        **{
            "icao": 0x4B1234,
            "start_ned_m": start,
            "velocity_ned_mps": (0.0, 50.0, 0.0),
            "callsign": "HBABC",
            **over,
        }
    )


def place_of(flight, now_s):
    return np.add(flight.start_ned_m, np.multiply(flight.velocity_ned_mps, now_s))


class Meeting(Pair):
    """A companion that flies the path, or watches, and meets others."""

    def __init__(
        self, firmware=Firmware.PX4, *, use="fly", law="dmuca", fence_file=(), limits=None, **options
    ):
        config = Config(
            identity=IdentityConfig(uas_id="PAIR"),
            vehicle=VehicleConfig(system_id=1),
            flight=FlightConfig(use=use, take_in_flight=True),
            limits=LimitsConfig(max_speed_mps=5.0, **(limits or {})),
            avoidance=AvoidanceConfig(law=law),
            path=path(),
            fence=fence_file,
        )
        super().__init__(firmware, config, **{"velocity_lag_s": 0.5, **options})

    def texts(self):
        """STATUSTEXT as sent, with its chunks joined. A text with id 0 is whole."""
        chunks = [m for m in MavlinkReader().feed(b"".join(self.sent)) if m.get_type() == "STATUSTEXT"]
        found = {}
        for number, m in enumerate(chunks):
            key = m.id or -number
            found[key] = found.get(key, "") + m.text
        return list(found.values())

    def record(self):
        """Records of the flight, read from its event file."""
        header = event_record.Header(aircraft="PAIR", software="test", config=self.config)
        return event_record.MAGIC + b"".join(event_record.encode(item) for item in (header, *self.steps))

    def least(self, flight):
        """Least distances of the flight (m): horizontal while not well clear in height, and whenever."""
        own = np.array(self.places)
        other = np.array([place_of(flight, TICK_S * tick) for tick in range(len(own))])
        aside = np.hypot(*(own - other)[:, :2].T)
        level = np.abs((own - other)[:, 2]) < WELL_CLEAR.crewed_vertical_m
        return aside[level].min(initial=math.inf), aside.min()


# ------------------------------------------------------------ crewed traffic


@pytest.fixture(scope="module", params=Firmware)
def crossed(request):
    """A flight whose path crewed traffic crosses. That aircraft reports its barometric altitude."""
    return Meeting(request.param, traffic=(crossing(MEETS_S),)).run(MEETS_S + 26.0)


def test_crewed_traffic_that_crosses_the_path_is_kept_clear_of(crossed):
    """It climbs, because the floor leaves too little room below."""
    assert crossed.least(crossing(MEETS_S))[0] >= WELL_CLEAR.crewed_horizontal_m
    alone = Meeting(law="none", traffic=(crossing(MEETS_S),)).run(MEETS_S + 2.0)
    assert alone.least(crossing(MEETS_S))[1] < 20.0


@BOTH
def test_or_it_is_passed_above_or_below(firmware):
    """It climbs away from traffic that is 20 m lower, instead of leaving it aside."""
    flight = crossing(geometric=True, start_ned_m=(SPEED_MPS * 48.0, -2500.0, -30.0))
    pair = Meeting(firmware, traffic=(flight,)).run(58.0)
    level, beside = pair.least(flight)
    assert level >= WELL_CLEAR.crewed_horizontal_m
    assert beside < 150.0
    assert max(-down for _, _, down in pair.places) > 80.0


def test_its_alerts_are_logged_with_reasons(crossed):
    first, *_, last = [c for _, c in crossed.timed(AlertChanged)]
    assert (first.track_id, first.level, first.acting) == ("4B1234", Level.CAUTION, True)
    assert first.reason.startswith("caution 4B1234: closest ")
    assert "; avoiding" in first.reason
    assert (last.level, last.reason) == (Level.NONE, "clear 4B1234: parting")
    views = [v for _, d in crossed.timed(Decision) for v in d.tracks]
    assert {v.track_id for v in views} == {"4B1234"}
    assert any(v.conflict and v.active for v in views)


def test_what_rises_is_said(crossed):
    """Avoided in time, it is never a warning."""
    first, last = (c for _, c in crossed.timed(AlertChanged))
    assert [first.level, last.level] == [Level.CAUTION, Level.NONE]
    assert [c.text for _, c in crossed.timed(Say) if "4B1234" in c.text] == [f"DMUCA {first.reason}"]
    told = [text for text in crossed.texts() if not text.startswith("DMUCA: path")]
    assert told[-2:] == [f"DMUCA {first.reason}", "DMUCA clear of traffic"]


def test_its_threats_are_told_once_a_second_until_the_end(crossed):
    times, threats = zip(*crossed.timed(Threat), strict=True)
    assert {(c.track_id, c.adsb) for c in threats} == {("4B1234", True)}
    assert {c.level for c in threats[:-1]} == {1}
    assert threats[-1].level == 0
    assert 0.95 <= np.diff(times[:-1]).min() <= np.diff(times[:-1]).max() <= 1.25


def test_such_a_flight_replays_the_same(crossed):
    result = replay.replay_record(event_record.read(io.BytesIO(crossed.record()), "x"), "x", 0.0)
    assert (result.differences, result.inexact) == (0, 0)
    assert result.steps == len(crossed.steps)
    assert crossed.events(AdsbVehicle)


@pytest.mark.parametrize("kind", [AlertChanged, Threat, Say])
def test_a_replay_misses_no_alert(crossed, kind):
    """Removing one alert from the record makes the replay differ."""
    items = list(event_record.read(io.BytesIO(crossed.record()), "x"))
    at = next(k for k, i in enumerate(items[1:], 1) if any(isinstance(c, kind) for c in i.commands))
    kept = tuple(c for c in items[at].commands if not isinstance(c, kind))
    items[at] = msgspec.structs.replace(items[at], commands=kept)
    assert replay.replay_record(items, "x", 0.0).differences == 1


def told_to_the_vehicle(pair):
    """Actions of the COLLISION messages that reached it; all of them name the crewed aircraft."""
    told = [m for _, m in pair.vehicle.collisions]
    assert {(m.src, m.id) for m in told} == {(0, 0x4B1234)}
    assert told[-1].threat_level == 0
    return {m.action for m in told}


def test_threats_reach_the_vehicle(crossed):
    assert told_to_the_vehicle(crossed) == {1, 4}


@pytest.mark.parametrize("down_m", [-50.0, -60.0, -70.0])
@BOTH
def test_crewed_traffic_above_does_not_press_us_into_the_ground(firmware, down_m):
    """No floor is configured, so the floor is 15 m above home, or the path's lowest point if that is
    lower."""
    flight = crossing(geometric=True, start_ned_m=(144.0, -2500.0, down_m))
    pair = Meeting(firmware, traffic=(flight,)).run(58.0)
    assert min(-down for _, _, down in pair.places) > 14.0
    assert pair.state in HOLDING


@BOTH
def test_a_hovering_helicopter_is_one_alert(firmware):
    hovering = crossing(start_ned_m=(150.0, 0.0, -50.0), velocity_ned_mps=(0.0, 0.0, 0.0))
    pair = Meeting(firmware, use="watch", traffic=(hovering,)).run(60.0)
    assert len(pair.timed(AlertChanged)) == 1


# ------------------------------------------------------------ fences


@BOTH
def test_the_vehicles_fence_is_fetched_before_it_is_taken(firmware):
    pair = Meeting(firmware, limits=VEHICLES_OWN, fence=(corridor(-200.0, 200.0),)).run(8.0)
    (fetched,) = pair.events(FenceDownloaded)
    assert len(fetched.areas) == 1
    at = next(k for k, s in enumerate(pair.steps) if fetched in s.events)
    assert not any(isinstance(c, VelocitySetpoint | SetMode) for s in pair.steps[:at] for c in s.commands)
    assert pair.state in HOLDING


@BOTH
def test_a_path_that_leaves_the_vehicles_fence_is_refused(firmware):
    fence = (corridor(-200.0, 200.0), corridor(-200.0, 200.0, north_m=600.0))
    pair = Meeting(firmware, limits=VEHICLES_OWN, fence=fence).run(30.0)
    assert pair.state is State.STANDBY
    (refused,) = [c.text for _, c in pair.timed(Say) if "refused" in c.text]
    assert "fence: area[1] (inclusion): the path crosses its border" in refused
    assert not pair.timed(VelocitySetpoint)
    assert len(pair.timed(DownloadFence)) == 1


def intruder(now_s, north_m):
    """A drone that flies south on our path at 3 m/s, `north_m` north of home at 0 s; once a second."""
    if round(now_s / TICK_S) % 20:
        return None
    lat, lon, _ = HOME.to_geodetic(north_m - SPEED_MPS * now_s, 0.0, -50.0)
    return RemoteIdHeard(
        transport="wifi",
        address="02:00:00:00:00:01",
        messages=(
            BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="OTHER"),
            Location(
                status=Status.AIRBORNE,
                lat_deg=lat,
                lon_deg=lon,
                alt_geodetic_m=497.0,
                direction_deg=180.0,
                speed_mps=SPEED_MPS,
                vertical_speed_mps=0.0,
                horizontal_accuracy_m=1.0,
                vertical_accuracy_m=3.0,
                timestamp_s=round((UTC_AT_ZERO_S + now_s) % 3600.0, 1),
            ),
        ),
    )


@BOTH
def test_beside_a_fence_a_conflict_is_solved_inside_and_the_reason_says_so(firmware):
    """On the right, to which it would turn, there are 5 m of room."""
    largest, nearest = {}, {}
    for east_m in (200.0, 5.0):
        pair = Meeting(firmware, fence_file=(corridor(-200.0, east_m),), limits={"fence": "fence.toml"})
        pair.heard = lambda now_s: intruder(now_s, 200.0)
        pair.run(45.0)
        others = [(200.0 - SPEED_MPS * TICK_S * tick, 0.0, -50.0) for tick in range(len(pair.places))]
        nearest[east_m] = np.linalg.norm(np.subtract(pair.places, others), axis=1).min()
        largest[east_m] = max(east for _, east, _ in pair.places)
    assert largest[200.0] > 10.0
    assert largest[5.0] < 3.0
    assert min(nearest.values()) > 10.0
    alerts = [c for _, c in pair.timed(AlertChanged) if c.level]
    assert alerts[-1].limits == ("fence",)
    assert alerts[-1].reason.endswith("; avoiding; limited by fence")
    assert f"DMUCA {alerts[-1].reason}" in pair.texts()


def test_a_flight_with_a_fence_replays_the_same():
    """The record's header contains the fence."""
    pair = Meeting(fence_file=(corridor(-200.0, 5.0),), limits={"fence": "fence.toml"})
    pair.heard = lambda now_s: intruder(now_s, 200.0)
    pair.run(30.0)
    items = list(event_record.read(io.BytesIO(pair.record()), "x"))
    assert any("fence" in c.limits for i in items[1:] for c in i.commands if isinstance(c, Decision))
    assert replay.replay_record(items, "x", 0.0).differences == 0
    header = msgspec.structs.replace(items[0], config=msgspec.structs.replace(items[0].config, fence=()))
    assert replay.replay_record([header, *items[1:]], "x", 0.0).differences > 0


# ------------------------------------------------------------ watch


@BOTH
def test_watching_it_tells_and_never_commands(firmware):
    mode = VehicleMode.EXTERNAL if firmware is Firmware.ARDUPILOT else VehicleMode.HOLD
    pair = Meeting(firmware, use="watch", traffic=(crossing(start_ned_m=(0.0, -50.0 * MEETS_S, -50.0)),))
    pair.run(MEETS_S + 36.0)
    levels = [c.level for _, c in pair.timed(AlertChanged)]
    assert sorted({*levels} - {Level.NONE, Level.ADVISORY}) == [Level.CAUTION, Level.WARNING]
    assert levels[-1] == Level.NONE
    assert not any(c.acting for _, c in pair.timed(AlertChanged))
    assert {c.level for _, c in pair.timed(Threat)} == {0, 1, 2}
    assert not any(c.acting for _, c in pair.timed(Threat))
    assert told_to_the_vehicle(pair) == {1}
    assert any(text.startswith("DMUCA warning 4B1234: ") for text in pair.texts())
    assert not pair.timed(VelocitySetpoint)
    assert not pair.timed(SetMode)
    assert pair.vehicle.setpoints_received == 0
    assert pair.vehicle.mode is mode
    assert pair.state is State.STANDBY


@BOTH
def test_on_the_ground_nobody_is_a_threat(firmware):
    over_home = crossing(start_ned_m=(0.0, -2500.0, -20.0))
    pair = Meeting(
        firmware,
        use="watch",
        airborne=False,
        start_position_ned_m=(0.0, 0.0, 0.0),
        traffic=(over_home,),
    ).run(60.0)
    assert pair.events(AdsbVehicle)
    assert not pair.timed(AlertChanged)
    assert not pair.timed(Threat)
    assert not pair.timed(Say)
