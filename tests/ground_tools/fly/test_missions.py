"""Mission files and scenarios are converted to the uploaded items."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from companion.autopilot.lists.mission import path_from_mission
from companion.errors import ConfigError
from companion.events import MissionItem
from companion.geometry import LocalFrame
from ground_tools.fly import missions
from sitl_mocks.encounters.scenario_file import PathSettings, Scenario, load
from tests.support.place import HOME

ROOT = Path(__file__).parents[3]
ORIGIN = (HOME.lat_deg, HOME.lon_deg, HOME.alt_m)


def simple(
    command: int = 16, frame: int = 3, params: object = (2, 0, 0, None, 47.4, 8.5, 30)
) -> dict[str, object]:
    return {"type": "SimpleItem", "autoContinue": True, "command": command, "frame": frame, "params": params,
            "doJumpId": 1}  # fmt: skip


def plan(tmp_path: Path, *items: object, **parts: object) -> Path:
    path = tmp_path / "m.plan"
    whole = {"fileType": "Plan", "version": 1, "mission": {"version": 2, "items": items}, **parts}
    path.write_text(json.dumps(whole))
    return path


def test_a_plan_becomes_items(tmp_path):
    takeoff, speed = simple(22, params=[0, 0, 0, None, 0, 0, 12]), simple(178, 2, [1, 4, -1, 0, 0, 0, 0])
    items = missions.load(plan(tmp_path, takeoff, speed, simple(), geoFence={"polygons": [], "circles": []}))
    assert [(item.seq, item.command, item.frame) for item in items] == [(1, 22, 3), (2, 178, 2), (3, 16, 3)]
    assert items[2].params == (2.0, 0.0, 0.0, None)
    assert (items[2].lat_deg, items[2].lon_deg, items[2].alt_m) == (47.4, 8.5, 30.0)
    assert missions.begins_with_takeoff(items)
    assert not missions.begins_with_takeoff(items[1:])


def test_a_wpl_file_becomes_items_without_home(tmp_path):
    path = tmp_path / "m.waypoints"
    path.write_text(
        "QGC WPL 110\r\n0\t1\t0\t16\t0\t0\t0\t0\t47.1\t8.1\t400\t1\r\n"
        "1\t0\t3\t22\t0\t0\t0\tnan\t0\t0\t15\t1\r\n2\t0\t3\t16\t5\t0\t0\t0\t47.4\t8.5\t30\t1\r\n"
    )
    takeoff, waypoint = missions.load(path)
    assert (takeoff.seq, takeoff.command, takeoff.alt_m, takeoff.params[3]) == (1, 22, 15.0, None)
    assert (waypoint.params[0], waypoint.lat_deg, waypoint.lon_deg) == (5.0, 47.4, 8.5)


@pytest.mark.parametrize(
    ("item", "words"),
    [
        ({"type": "ComplexItem", "complexItemType": "survey"}, "item 2: 'survey' is not supported"),
        (simple(frame=1), "item 2: command 16: MAV_FRAME 1; allowed: 2, 0, 3, 5, 6, 10, 11"),
        (simple(params=[0, 0, 0, 0, None, 8.5, 30]), "item 2: command 16: latitude, longitude or altitude"),
        (simple(params=[0, 0, 0, 0, 0, 0, 30]), "item 2: command 16: latitude 0, longitude 0 means"),
        (simple(params=[0, 0, 0, 0, 97, 8.5, 30]), "item 2: command 16: latitude 97"),
        (simple(frame=2), "item 2: command 16: MAV_FRAME 2 has no position"),
        (simple(177, 2, [1, 3, 0, 0, 0, 0, 0]), "item 2: command 177: DO_JUMP"),
        (simple(params=[0, 0, 0]), "item 2: Expected `array` of length 7"),
        (simple() | {"autoContinue": False}, "item 2: autoContinue: a mission that stops after an item"),
        ({"type": "SimpleItem", "command": 16}, "item 2: Object missing required field `frame`"),
    ],
)  # fmt: skip
def test_an_item_that_is_not_understood_is_named(tmp_path, item, words):
    path = plan(tmp_path, simple(), item)
    with pytest.raises(ConfigError) as error:
        missions.load(path)
    assert str(error.value).startswith(f"{path}: {words}")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"geoFence": {"polygons": [{}], "circles": []}}, "geoFence"),
        ({"rallyPoints": {"points": [[1, 2, 3]]}}, "rallyPoints"),
        ({"fileType": "Other"}, "neither a QGroundControl plan nor"),
        ({"mission": {"items": []}}, "no item"),
    ],
)
def test_a_plan_with_more_than_a_mission_is_refused(tmp_path, parts, words):
    with pytest.raises(ConfigError, match=words):
        missions.load(plan(tmp_path, simple(), **parts))


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("QGC WPL 120\n", "line 1: 'QGC WPL 120'"),
        ("QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 400 1\n1 0 3 16 0 0 0 0 47 8 x 1\n", "line 3: a field is not"),
        ("QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 400 1\n2 0 3 16 0 0 0 0 47 8 30 1\n", "line 3: index 2 is"),
        ("QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 400 1\n1 0 3\n", "line 3: it has 3 fields; allowed: 12"),
        ("QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 400 1\n1 0 3 16 0 0 0 inf 47 8 30 1\n", "item 1: .* not finite"),
        ("QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 400 1\n1 0 3 16 0 0 0 0 47 8 30 0\n", "line 3: AUTOCONTINUE: a"),
        ("QGC WPL 110\n0 1 3 22 0 0 0 0 47 8 15 1\n1 0 3 16 0 0 0 0 47 8 30 1\n", "line 2: .* is not home"),
        ("QGC WPL 110\n0 1 3 16 0 0 0 0 47 8 15 1\n1 0 3 16 0 0 0 0 47 8 30 1\n", "line 2: .* is not home"),
        ("QGC WPL 110\n0 1 0 16 0 0 0 0 47 8 400 1\n", "no item"),
    ],
)  # fmt: skip
def test_a_wpl_row_that_is_not_understood_is_named(tmp_path, rows, words):
    path = tmp_path / "m.waypoints"
    path.write_text(rows)
    with pytest.raises(ConfigError, match=words):
        missions.load(path)


def test_missing_and_binary_files_are_refused(tmp_path):
    (tmp_path / "m").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="byte 0 is not UTF-8"):
        missions.load(tmp_path / "m")
    with pytest.raises(ConfigError, match="cannot be read"):
        missions.load(tmp_path / "nothing")


def test_a_scenario_becomes_one_mission_an_aircraft_at_its_speeds():
    """The companion's own mission reader recovers the scenario's timed path."""
    scenario = load(ROOT / "config/scenarios/head_on.toml")
    turn = PathSettings(points=((0.0, 0.0, 0.0, -20.0), (10.0, 0.0, 0.0, -20.0), (20.0, 40.0, 0.0, -20.0),
                                (30.0, 40.0, 20.0, -25.0)))  # fmt: skip
    scenario = msgspec.structs.replace(scenario, path=(scenario.path[0], turn))
    uploaded = missions.scenario_missions(scenario, 1, ORIGIN)
    assert [item.command for item in uploaded[0]] == [16, 178, 16]
    assert uploaded[0][0].params[0] == missions.GATE_S
    assert uploaded[0][1].params[:2] == (1.0, pytest.approx(3.0))
    frame = LocalFrame(*ORIGIN)
    start = (uploaded[1][0].lat_deg, uploaded[1][0].lon_deg, 20.0)
    path = path_from_mission(
        uploaded[1][1:],
        speed_mps=1.0,
        max_climb_mps=2.0,
        max_descent_mps=2.0,
        start=start,
        home_alt_msl_m=400.0,
    )
    flown = [(w.t_s, *frame.to_ned(w.lat_deg, w.lon_deg, 400.0 + w.alt_m)) for w in path.waypoint]
    assert len(flown) == 4
    for row, wanted in zip(flown, turn.points, strict=True):
        assert row == pytest.approx(wanted, abs=0.02)


def test_a_path_that_begins_later_is_held_at_its_beginning():
    paths = tuple(
        PathSettings(points=((begin_s, n, 0.0, -5.0), (begin_s + 9.0, n, 9.0, -5.0)))
        for begin_s, n in ((2.0, 0.0), (12.0, 50.0))
    )
    first, later = missions.scenario_missions(Scenario(path=paths), 1, ORIGIN)
    assert [item.command for item in first] == [16, 178, 16]
    assert [item.command for item in later] == [16, 16, 178, 16]
    assert later[1] == msgspec.structs.replace(later[0], seq=2, params=(10.0, *later[0].params[1:]))


def test_a_path_under_the_ground_is_refused():
    paths = tuple(
        PathSettings(points=((0.0, n, 0.0, -5.0), (9.0, n, 9.0, d))) for n, d in ((0.0, -5.0), (9.0, 1.0))
    )
    with pytest.raises(ConfigError, match=r"path\[1\].*1 m down"):
        missions.scenario_missions(Scenario(path=paths), 1, ORIGIN)


def waypoint(**changes: object) -> MissionItem:
    item = MissionItem(
        seq=1, command=16, frame=3, params=(2.5, 1.0, 0.0, None), lat_deg=47.4, lon_deg=8.5, alt_m=30.0
    )
    return msgspec.structs.replace(item, **changes)


@pytest.mark.parametrize(
    "changes",
    [{"frame": 6}, {"params": (2.0, 0.0, 0.0, 0.0)}, {"lat_deg": 47.4 + 1e-7}, {"alt_m": 30.01}, {"seq": 0}],
)
def test_differences_that_a_vehicle_may_store(changes):
    assert missions.difference([waypoint()], [waypoint(**changes)]) is None


@pytest.mark.parametrize(
    "changes",
    [{"frame": 0}, {"params": (1.0, 1.0, 0.0, None)}, {"lat_deg": 47.4 + 5e-7}, {"alt_m": 30.1},
     {"command": 17}, {"lon_deg": None}],
)  # fmt: skip
def test_differences_that_make_another_mission(changes):
    assert missions.difference([waypoint()], [waypoint(**changes)]).startswith("item 1: command 16 2.5")


def test_speeds_and_counts_are_compared():
    slow = MissionItem(seq=1, command=178, frame=2, params=(1.0, 3.0, -1.0, 0.0))
    fast = msgspec.structs.replace(slow, params=(1.0, 3.5, -1.0, 0.0), frame=0)
    assert missions.difference([slow], [msgspec.structs.replace(slow, frame=0)]) is None
    assert missions.difference([slow], [fast]) is not None
    assert "2 items were sent, but 1 came back" in missions.difference([slow, slow], [slow])
