from __future__ import annotations

import math
from typing import Any

import pytest

from companion.autopilot.lists.mission import path_from_mission, place_of, speed_changes, speeds_at
from companion.avoidance.path import local_path
from companion.avoidance.trajectory import check_speeds
from companion.config import LimitsConfig, TrajectoryFile
from companion.errors import ConfigError
from companion.events import MissionItem
from companion.geometry import LocalFrame
from tests.support.place import HOME

START = (HOME.lat_deg, HOME.lon_deg, 30.0)
FRAME = LocalFrame(HOME.lat_deg, HOME.lon_deg, 0.0)


def waypoint(
    seq: int, north_m: float, height_m: float = 30.0, hold_s: float = 0.0, **over: Any
) -> MissionItem:
    lat_deg, lon_deg, _ = FRAME.to_geodetic(north_m, 0.0, 0.0)
    values = {
        "command": 16,
        "frame": 3,
        "params": (hold_s, 0.0, 0.0, None),
        "lat_deg": lat_deg,
        "lon_deg": lon_deg,
        "alt_m": height_m,
    }
    return MissionItem(seq=seq, **(values | over))


def simple(seq: int, command: int, *params: float) -> MissionItem:
    one, two, three, four = (*params, 0.0, 0.0, 0.0, 0.0)[:4]
    return MissionItem(seq=seq, command=command, frame=2, params=(one, two, three, four))


def fly(
    *items: MissionItem, home: float | None = 400.0, speed: float = 5.0, climb: float = 9.0, sink: float = 9.0
) -> TrajectoryFile:
    return path_from_mission(
        items,
        speed_mps=speed,
        max_climb_mps=climb,
        max_descent_mps=sink,
        start=START,
        home_alt_msl_m=home,
    )


def times(path: TrajectoryFile) -> list[float]:
    return [w.t_s for w in path.waypoint]


def test_legs_are_timed_by_their_length() -> None:
    path = fly(waypoint(1, 100.0), waypoint(2, 100.0, height_m=55.0))
    assert path.altitude == "home"
    assert times(path) == pytest.approx([0.0, 20.0, 25.0], abs=0.01)
    assert [w.alt_m for w in path.waypoint] == [30.0, 30.0, 55.0]


def test_legs_too_steep_for_the_speed_are_flown_as_slowly_as_the_limits_ask() -> None:
    """ArduCopter's AUTO, taken 1 m below and 0.4 m beside its first waypoint."""
    path = fly(waypoint(1, 0.4, height_m=31.0), waypoint(2, 100.0, height_m=31.0), climb=2.0, sink=1.0)
    assert times(path) == pytest.approx([0.0, 1.0 / 1.8, 1.0 / 1.8 + 99.6 / 5.0], abs=0.01)
    down = fly(waypoint(1, 0.0, height_m=12.0), climb=2.0, sink=0.5)
    assert times(down) == pytest.approx([0.0, 40.0], abs=0.01)
    check_speeds(local_path(down, FRAME, 0.0), LimitsConfig(max_descent_mps=0.5))


def test_hold_time_is_flown() -> None:
    path = fly(waypoint(1, 50.0, hold_s=7.0), waypoint(2, 100.0))
    assert times(path) == pytest.approx([0.0, 10.0, 17.0, 27.0], abs=0.01)
    assert path.waypoint[1].lat_deg == path.waypoint[2].lat_deg


def test_loitering_for_a_time_and_delays_are_held() -> None:
    path = fly(waypoint(1, 50.0, command=19, hold_s=7.0), simple(2, 93, 3.0), waypoint(3, 100.0))
    assert times(path) == pytest.approx([0.0, 10.0, 17.0, 20.0, 30.0], abs=0.01)


def test_the_speed_that_a_mission_has_asked_for() -> None:
    items = (waypoint(1, 50.0), simple(2, 178, 1.0, 3.0), waypoint(3, 100.0), simple(4, 178, 0.0, -1.0))
    assert [speeds_at(items, seq) for seq in (1, 2, 3, 4)] == [{None}, {3.0}, {3.0}, {3.0}]
    assert speeds_at((*items, simple(5, 178, 2.0, 9.0)), 9) == {3.0}, "the climb's speed is another"


@pytest.mark.parametrize(
    ("items", "changes", "own"),
    [
        ([], [], True),
        ([waypoint(1, 50.0)], [], True),
        ([waypoint(1, 50.0), simple(2, 178, 1.0, 3.0), waypoint(3, 90.0)], [(2, 3.0)], True),
        # A take-off is not guarded.
        ([simple(1, 22), simple(2, 178, 0.0, 3.0), waypoint(3, 90.0)], [(2, 3.0)], False),
        ([simple(1, 178, 1.0, 3.0), waypoint(2, 5.0), simple(3, 178, 1.0, 9.0)], [(1, 3.0), (3, 9.0)], False),
        ([simple(1, 177, 3.0, 2.0), simple(2, 178, 1.0, 3.0), waypoint(3, 90.0)], [(2, 3.0)], True),
        # No change, a climb's speed, one that nobody flies.
        ([simple(1, 178, 1.0, -1.0), simple(2, 178, 2.0, 9.0), simple(3, 178, 1.0, 101.0)], [], True),
    ],
)
def test_the_speeds_that_a_mission_is_flown_at(
    items: list[MissionItem], changes: list[tuple[int, float]], own: bool
) -> None:
    assert speed_changes(items) == (changes, own)


@pytest.mark.parametrize(
    ("jump", "target", "speeds"),
    [
        # Back over a speed: at item 3 it may be the first one or the last.
        (6, 3, [{None, 3.0, 8.0}, {3.0, 8.0}, {3.0, 8.0}]),
        # Forward past the first one.
        (0, 3, [{None, 3.0, 8.0}] * 3),
    ],
)
def test_a_jump_leaves_open_which_speed_holds(
    jump: int, target: int, speeds: list[set[float | None]]
) -> None:
    items = [waypoint(1, 50.0), simple(2, 178, 1.0, 3.0), waypoint(3, 90.0), simple(4, 178, 1.0, 8.0)]
    items += [waypoint(5, 120.0), simple(jump, 177, float(target), 2.0)]
    items.sort(key=lambda item: item.seq)
    assert [speeds_at(items, seq) for seq in (1, 3, 5)] == speeds


def test_a_jump_among_items_of_one_speed_leaves_nothing_open() -> None:
    items = [simple(1, 178, 1.0, 3.0), waypoint(2, 50.0), waypoint(3, 90.0), simple(4, 177, 2.0, 2.0)]
    assert [speeds_at(items, seq) for seq in (1, 2, 3)] == [{3.0}] * 3
    assert speeds_at([waypoint(1, 50.0), simple(2, 177, 1.0, 2.0)], 1) == {None}


@pytest.mark.parametrize(
    ("item", "height_m"),
    [
        (waypoint(1, 50.0), 30.0),
        (waypoint(1, 50.0, frame=0, height_m=450.0), 50.0),
        (waypoint(1, 50.0, frame=10), 42.0),
        (waypoint(1, 50.0, alt_m=None), 42.0),
        (waypoint(1, 50.0, alt_m=0.0), 42.0),
        (waypoint(1, 50.0, alt_m=0.0, frame=0), 42.0),
        (waypoint(1, 50.0, command=82), 30.0),
        (waypoint(1, 50.0, command=17), 30.0),
        (waypoint(1, 50.0, command=21), None),
        (waypoint(1, 50.0, lat_deg=None), None),
        (waypoint(1, 50.0, lat_deg=0.0, lon_deg=0.0), None),
        (simple(1, 93), None),
    ],
)
def test_where_an_item_leads(item: MissionItem, height_m: float | None) -> None:
    place = place_of(item, 42.0, 400.0)
    assert place == (None if height_m is None else (item.lat_deg, item.lon_deg, height_m))


def test_speed_changes_are_honoured() -> None:
    path = fly(
        waypoint(1, 50.0),
        simple(2, 178, 1.0, 10.0),
        waypoint(3, 100.0),
        simple(4, 178, 1.0, -1.0),
        waypoint(5, 0.0),
    )
    assert times(path) == pytest.approx([0.0, 10.0, 15.0, 25.0], abs=0.01)


def test_a_waypoint_at_the_start_adds_no_time() -> None:
    path = fly(waypoint(1, 0.0), waypoint(2, 50.0))
    assert times(path) == pytest.approx([0.0, 10.0], abs=0.01)


@pytest.mark.parametrize("frame", [0, 5])
def test_altitudes_above_sea_level_become_heights(frame: int) -> None:
    path = fly(waypoint(1, 50.0, height_m=435.0, frame=frame))
    assert path.waypoint[1].alt_m == 35.0


@pytest.mark.parametrize("frame", [3, 6])
def test_heights_above_home_need_no_home_altitude(frame: int) -> None:
    assert fly(waypoint(1, 50.0, frame=frame), home=None).waypoint[1].alt_m == 30.0


def test_takeoff_before_the_first_waypoint_is_left_out() -> None:
    path = fly(simple(1, 178, 1.0, 5.0), simple(2, 22), waypoint(3, 50.0))
    assert len(path.waypoint) == 2


@pytest.mark.parametrize("end", [20, 21])
def test_the_path_ends_where_landing_begins(end: int) -> None:
    path = fly(waypoint(1, 50.0), simple(2, end), waypoint(3, 500.0))
    assert len(path.waypoint) == 2


@pytest.mark.parametrize(
    ("item", "words"),
    [
        (simple(4, 82), ["item 4", "NAV_SPLINE_WAYPOINT (82)", "allowed: NAV_WAYPOINT"]),
        (simple(4, 177), ["DO_JUMP"]),
        (simple(4, 18), ["NAV_LOITER_TURNS"]),
        (simple(4, 93, -1.0), ["NAV_DELAY", "hold time -1.0 s"]),
        (simple(4, 22), ["NAV_TAKEOFF", "before the first waypoint"]),
        (simple(4, 60000), ["unknown command (60000)"]),
        (simple(4, 178, 2.0, 5.0), ["speed type 2.0", "allowed: 0"]),
        (simple(4, 178, 1.0, 0.0), ["speed 0.0 m/s", "allowed: above 0"]),
        (simple(4, 178, 1.0, -2.0), ["speed -2.0 m/s"]),
        (waypoint(4, 9.0, frame=10), ["MAV_FRAME 10", "allowed: 0 and 5"]),
        (waypoint(4, 9.0, frame=1), ["MAV_FRAME 1"]),
        (waypoint(4, 9.0, lat_deg=0.0, lon_deg=0.0), ["current position"]),
        (waypoint(4, 9.0, alt_m=None), ["left open"]),
        (waypoint(4, 9.0, alt_m=0.0), ["altitude 0"]),
        (waypoint(4, 9.0, lat_deg=None), ["left open"]),
        (waypoint(4, 9.0, hold_s=-1.0), ["hold time -1.0 s", "allowed: 0 to"]),
        (waypoint(4, 9.0, lat_deg=10.0), ["km from the point before"]),
    ],
)
def test_what_cannot_be_flown_is_named(item: MissionItem, words: list[str]) -> None:
    with pytest.raises(ConfigError) as error:
        fly(waypoint(3, 5.0), item)
    assert "mission item 4" in str(error.value)
    for word in words:
        assert word in str(error.value)


def test_sea_level_without_home_is_refused() -> None:
    with pytest.raises(ConfigError, match="home's is not known"):
        fly(waypoint(1, 50.0, frame=0), home=None)


@pytest.mark.parametrize("items", [[], [simple(1, 22)], [simple(1, 21)]])
def test_a_mission_without_a_waypoint_is_refused(items: list[MissionItem]) -> None:
    with pytest.raises(ConfigError, match="no waypoint"):
        fly(*items)


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan, 1000.0])
def test_absurd_speeds_are_refused(speed: float) -> None:
    with pytest.raises(ConfigError, match="mission speed"):
        fly(waypoint(1, 50.0), speed=speed)
