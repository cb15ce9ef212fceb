"""The core with ADS-B, a geofence and alerts: what it asks for, refuses and says."""

from __future__ import annotations

import msgspec
import pytest

from companion.authority.table import HOLDING, State
from companion.avoidance.alerts import Level
from companion.avoidance.law import horizon_s
from companion.avoidance.path import check_path
from companion.config import (
    AvoidanceConfig,
    Config,
    FlightConfig,
    IdentityConfig,
    LimitsConfig,
    TrajectoryFile,
    Waypoint,
)
from companion.core import Companion
from companion.errors import ConfigError
from companion.events import (
    AdsbVehicle,
    AlertChanged,
    DownloadFence,
    DownloadMission,
    FenceArea,
    FenceDownloaded,
    FenceRefused,
    FlightMode,
    Landed,
    MissionDownloaded,
    MissionItem,
    Say,
    SetMode,
)
from companion.geometry import LocalFrame
from tests.support.place import HOME

HERE = LocalFrame(HOME.lat_deg, HOME.lon_deg, 450.0)
"""Where the bench stands; its path leads 1200 m north."""


def area(south_m, north_m, half_width_m, *, inclusion=True):
    corners = (
        (south_m, -half_width_m),
        (north_m, -half_width_m),
        (north_m, half_width_m),
        (south_m, half_width_m),
    )
    points = tuple(HERE.to_geodetic(north, east, 0.0)[:2] for north, east in corners)
    return FenceArea(inclusion=inclusion, points=points)


ROOMY = area(-500.0, 2000.0, 500.0)
SHORT = area(-500.0, 600.0, 500.0)
KEPT = "at least 4.0 m are kept (2 m and two standard deviations of the own position)"
"""The bench's GNSS is good to 1 m."""


def rebuilt(bench, **sections):
    """The bench with a core whose configuration has other sections."""
    return type(bench)(Companion(msgspec.structs.replace(bench.core.config, **sections)))


def times_of(bench, kind):
    return [at_s for at_s, c in bench.log if isinstance(c, kind)]


def refusals(bench):
    return [c.text for _, c in bench.log if isinstance(c, Say) and "path refused" in c.text]


@pytest.fixture
def fenced(make_bench):
    """A bench whose core is to keep the vehicle's own fence."""
    return rebuilt(make_bench(), limits=LimitsConfig(fence="vehicle"))


# ------------------------------------------------------------ the vehicle's fence


@pytest.mark.parametrize("areas", [(ROOMY,), ()])
def test_the_fence_is_asked_for_before_the_vehicle_is_taken(fenced, areas):
    fenced.until(lambda: times_of(fenced, DownloadFence))
    commands = fenced.step(100)
    assert fenced.core.state is State.STANDBY
    assert not fenced.setpoints(commands)
    assert not times_of(fenced, SetMode)
    fenced.extra = [FenceDownloaded(areas=areas)]
    fenced.until(lambda: fenced.mode is FlightMode.EXTERNAL, limit=20)
    assert fenced.core.state in HOLDING
    assert len(times_of(fenced, DownloadFence)) == 1
    assert refusals(fenced) == []


def test_a_fence_is_not_asked_for_while_the_vehicle_could_not_be_taken(fenced):
    fenced.mode = FlightMode.OTHER
    fenced.step(200)
    assert not times_of(fenced, DownloadFence)


@pytest.mark.parametrize(
    ("areas", "reason"),
    [
        (
            (ROOMY, SHORT),
            "fence: area[1] (inclusion): the path crosses its border between waypoint[0] and "
            f"waypoint[1]; {KEPT}",
        ),
        (
            (area(300.0, 400.0, 50.0, inclusion=False),),
            "fence: area[0] (exclusion): the path crosses its border between waypoint[0] and "
            f"waypoint[1]; {KEPT}",
        ),
        (
            (ROOMY, area(100.0, 2000.0, 50.0)),
            "fence: area[1] (inclusion): the path begins outside of it",
        ),
        (
            (area(-50.0, 50.0, 50.0, inclusion=False),),
            "fence: area[0] (exclusion): the path begins in it",
        ),
        (
            (area(-500.0, 2000.0, 3.5),),
            "fence: area[0] (inclusion): the path comes within 3.5 m of its border between "
            f"waypoint[0] and waypoint[1]; {KEPT}",
        ),
    ],
)
def test_a_path_that_the_fence_forbids_is_refused_naming_the_area(fenced, areas, reason):
    fenced.until(lambda: times_of(fenced, DownloadFence))
    fenced.extra = [FenceDownloaded(areas=areas)]
    commands = fenced.step(500)
    assert refusals(fenced) == [f"DMUCA: path refused: {reason}"]
    assert fenced.core.state is State.STANDBY
    assert not fenced.setpoints(commands)


def test_a_fence_that_the_pilot_has_changed_is_seen(fenced):
    """The refused path is tried again, after 90 s with the fence that the vehicle holds then."""
    fenced.until(lambda: times_of(fenced, DownloadFence))
    fenced.extra = [FenceDownloaded(areas=(SHORT,))]
    refused_s = fenced.now_s
    fenced.until(lambda: len(times_of(fenced, DownloadFence)) == 2, limit=2200)
    assert 89.0 < fenced.now_s - refused_s < 105.0
    fenced.extra = [FenceDownloaded(areas=(ROOMY,))]
    fenced.until(lambda: fenced.core.state in HOLDING, limit=20)


def test_a_download_that_fails_is_said_and_tried_again_later(fenced):
    for count in (1, 2, 3):
        fenced.until(lambda count=count: len(times_of(fenced, DownloadFence)) == count)
        fenced.extra = [FenceRefused(reason="no answer after 5 tries")]
        fenced.step()
    assert refusals(fenced) == ["DMUCA: path refused: the vehicle's fence: no answer after 5 tries"]
    first, second, third = times_of(fenced, DownloadFence)
    assert second - first == pytest.approx(10.0, abs=0.1)
    assert third - second == pytest.approx(10.0, abs=0.1)
    assert fenced.core.state is State.STANDBY
    fenced.until(lambda: len(times_of(fenced, DownloadFence)) == 4)
    fenced.extra = [FenceDownloaded(areas=(ROOMY,))]
    fenced.until(lambda: fenced.core.state in HOLDING, limit=20)


@pytest.mark.parametrize("kind", [DownloadFence, DownloadMission])
def test_a_download_under_way_is_not_begun_anew(make_bench, kind):
    """A link that is asked again begins at the first item."""
    if kind is DownloadFence:
        bench = rebuilt(make_bench(), limits=LimitsConfig(fence="vehicle"))
    else:
        bench = make_bench(trajectory="mission", mission_speed_mps=3.0)
        bench = rebuilt(bench, path=None)
    bench.until(lambda: times_of(bench, kind))
    bench.step(1480)
    assert len(times_of(bench, kind)) == 1
    bench.until(lambda: len(times_of(bench, kind)) == 2, limit=300)
    first_s, second_s = times_of(bench, kind)
    assert 75.0 <= second_s - first_s < 86.0


def test_each_flight_asks_for_the_fence_anew(fenced):
    fenced.until(lambda: times_of(fenced, DownloadFence))
    fenced.extra = [FenceDownloaded(areas=(ROOMY,))]
    fenced.until(lambda: fenced.core.state in HOLDING, limit=20)
    fenced.landed, fenced.armed, fenced.mode = Landed.ON_GROUND, False, FlightMode.HOLD
    fenced.step(650)
    fenced.landed, fenced.armed = Landed.IN_AIR, True
    fenced.step(20)
    assert len(times_of(fenced, DownloadFence)) == 2
    assert fenced.core.state is State.STANDBY


def test_the_fence_comes_before_the_mission(make_bench):
    bench = make_bench(trajectory="mission", mission_speed_mps=3.0)
    bench = rebuilt(bench, limits=LimitsConfig(fence="vehicle"), path=None)
    bench.until(lambda: times_of(bench, DownloadFence))
    bench.step(100)
    assert not times_of(bench, DownloadMission)
    bench.extra = [FenceDownloaded(areas=(ROOMY,))]
    bench.until(lambda: times_of(bench, DownloadMission), limit=5)
    assert len(times_of(bench, DownloadFence)) == 1


def item(seq, north_m):
    lat, lon, _ = HERE.to_geodetic(north_m, 0.0, 0.0)
    return MissionItem(seq=seq, command=16, frame=6, lat_deg=lat, lon_deg=lon, alt_m=50.0)


@pytest.mark.parametrize(("fence_s", "mission_s"), [(2.0, 35.0), (60.0, 60.0)])
def test_a_mission_may_take_long_after_the_fence(make_bench, fence_s, mission_s):
    """The fence does not grow old over it: neither is asked for twice."""
    bench = make_bench(trajectory="mission", mission_speed_mps=3.0)
    bench = rebuilt(bench, limits=LimitsConfig(fence="vehicle"), path=None)
    mission = MissionDownloaded(items=(item(1, 0.0), item(2, 300.0), item(3, 600.0)))
    bench.until(lambda: times_of(bench, DownloadFence))
    bench.step(round(fence_s / 0.05))
    bench.extra = [FenceDownloaded(areas=(ROOMY,))]
    bench.until(lambda: times_of(bench, DownloadMission), limit=5)
    bench.step(round(mission_s / 0.05))
    bench.extra = [mission]
    bench.until(lambda: bench.core.state in HOLDING, limit=20)
    assert len(times_of(bench, DownloadFence)) == len(times_of(bench, DownloadMission)) == 1


@pytest.mark.parametrize(("areas", "taken"), [((ROOMY,), True), ((ROOMY, SHORT), False)])
def test_a_fence_from_a_file_is_not_asked_for(make_bench, areas, taken):
    bench = rebuilt(make_bench(), limits=LimitsConfig(fence="fence.toml"), fence=areas)
    bench.step(100)
    assert not times_of(bench, DownloadFence)
    assert (bench.core.state in HOLDING) is taken
    assert [("area[1] (inclusion)" in text) for text in refusals(bench)] == [True] * (not taken)


def test_a_path_that_the_fence_of_the_file_forbids_is_refused_before_the_flight(make_config):
    made = msgspec.structs.replace(make_config(), fence=(ROOMY,))
    check_path(made, "x")
    with pytest.raises(ConfigError, match=r"fence: area\[1\] \(inclusion\): the path crosses"):
        check_path(msgspec.structs.replace(made, fence=(ROOMY, SHORT)), "x")


# ------------------------------------------------------------ the floor


@pytest.mark.parametrize(
    ("floor_m", "heights_m", "lowest_m"),
    [
        (None, (50.0, 50.0), 15.0),
        (None, (50.0, 8.0), 8.0),
        (30.0, (50.0, 50.0), 30.0),
        (2.0, (50.0, 8.0), 2.0),
    ],
)
def test_without_a_floor_it_goes_no_lower_than_15_m_or_its_path(make_bench, floor_m, heights_m, lowest_m):
    """Away from crewed traffic above, down is as good as up."""
    points = [HERE.to_geodetic(1200.0 * number, 0.0, 0.0)[:2] for number in range(2)]
    path = TrajectoryFile(
        altitude="home",
        waypoint=tuple(
            Waypoint(t_s=400.0 * number, lat_deg=lat, lon_deg=lon, alt_m=height_m)
            for number, ((lat, lon), height_m) in enumerate(zip(points, heights_m, strict=True))
        ),
    )
    bench = rebuilt(make_bench(), limits=LimitsConfig(floor_height_m=floor_m), path=path)
    bench.until(lambda: bench.core.state in HOLDING)
    assert bench.core.plan.course.floor_height_m(bench.core.config.limits) == pytest.approx(lowest_m)


# ------------------------------------------------------------ ADS-B and alerts


def crewed(east_m=0.0, north_m=1500.0, *, icao=0x4B1234, speed_mps=50.0):
    """Head-on at our height, its altitude geometric."""
    lat, lon, alt_msl_m = HERE.to_geodetic(north_m, east_m, 0.0)
    return AdsbVehicle(
        icao=icao,
        lat_deg=lat,
        lon_deg=lon,
        alt_m=alt_msl_m + 47.0,
        alt_geometric=True,
        velocity_ned_mps=(-speed_mps, 0.0, 0.0),
    )


def levels_after(bench, seconds, **over):
    """Highest level of every aircraft heard by ADS-B while crewed traffic comes nearer."""
    highest = {}
    for tick in range(round(seconds / 0.05)):
        if tick % 20 == 0:
            bench.extra.append(crewed(north_m=1500.0 - 2.5 * tick, **over))
        bench.step()
        for (adsb, name), level in bench.core.alerts.levels.items():
            assert adsb
            highest[name] = max(level, highest.get(name, Level.NONE))
    return highest


@pytest.fixture
def watching(make_bench):
    bench = make_bench(use="watch")
    bench.step(20)
    return bench


def test_what_comes_near_is_a_warning(watching):
    assert levels_after(watching, 5.0) == {"4B1234": Level.WARNING}


@pytest.mark.parametrize("own", ["4b1234", "4B1234"])
def test_our_own_transponder_is_no_threat(watching, own):
    watching = rebuilt(watching, identity=IdentityConfig(uas_id="OWN", icao=own))
    watching.step(20)
    assert levels_after(watching, 5.0) == {}
    assert levels_after(watching, 5.0, icao=0x4B1235) == {"4B1235": Level.WARNING}


@pytest.mark.parametrize(
    ("change", "value"), [("landed", Landed.ON_GROUND), ("stuck_position", True), ("fix_type", 1)]
)
def test_no_alerts_on_the_ground_or_without_an_own_state(watching, change, value):
    setattr(watching, change, value)
    watching.armed = change != "landed"
    watching.step(40)
    before = len(watching.log)
    levels_after(watching, 5.0)
    assert not [c for _, c in watching.log[before:] if isinstance(c, AlertChanged)]


@pytest.mark.parametrize("mode", [FlightMode.OTHER, FlightMode.HOLD])
def test_alerts_go_on_after_the_pilot_took_over(make_bench, mode):
    bench = make_bench()
    bench.until(lambda: bench.mode is FlightMode.EXTERNAL)
    bench.step(5)
    bench.mode = mode
    bench.step(5)
    assert bench.core.state is State.YIELDED
    assert levels_after(bench, 5.0) == {"4B1234": Level.WARNING}
    assert not any(c.acting for _, c in bench.log if isinstance(c, AlertChanged))


def test_alerts_are_judged_once_a_period_not_at_every_step(watching):
    """Three looks raise a level: 0.4 s after the first one, not 0.1 s."""
    watching.step(3)
    ahead_s = 0.75 * horizon_s(AvoidanceConfig(), crewed=True)
    watching.extra.append(crewed(north_m=50.0 * ahead_s))
    heard_s = watching.now_s + 0.05
    watching.until(lambda: watching.core.alerts.levels, limit=40)
    assert 0.35 < watching.now_s - heard_s < 0.65


def test_places_in_another_frame_are_forgotten(watching):
    assert levels_after(watching, 5.0) == {"4B1234": Level.WARNING}
    watching.armed, watching.lat_deg = False, watching.lat_deg + 0.2
    watching.step(60)
    assert watching.core.adsb.neighbours(watching.now_s, 0.0) == []


def test_without_an_own_position_no_place_is_taken():
    core = Companion(Config(identity=IdentityConfig(uas_id="OWN"), flight=FlightConfig(use="watch")))
    assert not [c for c in core.step(0.0, [crewed()]) if isinstance(c, AlertChanged)]
    assert core.adsb.neighbours(0.0, 0.0) == []
