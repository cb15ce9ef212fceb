"""MCAP files and ROS bags, read by other projects' readers."""

import json
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jsonschema
import numpy as np
import pymap3d
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from companion.errors import ConfigError
from ground_tools.inspect.export import mcap, rosbag, topics
from ground_tools.inspect.read.flown import Flown, Separation, flown, separations
from ground_tools.inspect.read.read_run import Run, read_run
from tests.support import onboard_logs

FIELDS = {
    "foxglove.LocationFix": "timestamp frame_id latitude longitude altitude position_covariance"
    " position_covariance_type",
    "foxglove.PoseInFrame": "timestamp frame_id pose",
    "foxglove.FrameTransform": "timestamp parent_frame_id child_frame_id translation rotation",
    "foxglove.SceneUpdate": "deletions entities",
    "foxglove.Log": "timestamp level message name file line",
    "dmuca.Separation": "timestamp first second distance_m required_m",
}
"""Fields of the schemas as https://docs.foxglove.dev/docs/visualization/message-schemas lists them."""


def whole(path: Path) -> tuple[Run, Flown, list[Separation]]:
    run = read_run(path)
    ways = flown(run)
    return run, ways, separations(ways.paths)


@pytest.fixture(scope="module")
def flight(built: Path) -> tuple[Run, Flown, list[Separation]]:
    return whole(built)


Read = list[tuple[str, str, int, dict[str, Any]]]


def read_mcap(path: Path) -> Read:
    """Topic, schema, time (ns) and content of every message, each checked against its schema in the file."""
    found, schemas = [], {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            if schema.name not in schemas:
                rules = json.loads(schema.data)
                jsonschema.Draft202012Validator.check_schema(rules)
                schemas[schema.name] = jsonschema.Draft202012Validator(rules)
                assert rules["title"] == schema.name
                assert list(rules["properties"]) == FIELDS[schema.name].split()
            content = json.loads(message.data, parse_constant=pytest.fail)  # JSON has no NaN
            schemas[schema.name].validate(content)
            found.append((channel.topic, schema.name, message.log_time, content))
    return found


def test_an_mcap_file_has_every_position_where_it_was(tmp_path: Path, flight, made: SimpleNamespace):
    run, ways, pairs = flight
    count = mcap.write(run, ways, pairs, tmp_path / "run.mcap")
    found = read_mcap(tmp_path / "run.mcap")
    assert len(found) == count
    kinds = Counter(kind for _, kind, _, _ in found)
    fixes = sum(len(record.facts.fixes) for record in run.aircraft)
    assert kinds["foxglove.PoseInFrame"] == kinds["foxglove.FrameTransform"] == fixes
    for record in run.aircraft:
        rows = [(ns, place) for topic, _, ns, place in found if topic == f"/{record.name}/fix"]
        own = record.facts.fixes
        assert len(rows) == len(own)
        for ns, place in (rows[0], rows[-1]):
            row = own[abs(own[:, 0] + record.facts.utc_offset_s - ns / 1e9).argmin()]
            assert ns / 1e9 == pytest.approx(row[0] + record.facts.utc_offset_s, abs=1e-6)
            assert (place["latitude"], place["longitude"], place["altitude"]) == pytest.approx(
                row[1:4].tolist()
            )
            assert place["frame_id"] == record.name
            stamp = place["timestamp"]
            assert stamp["sec"] * 10**9 + stamp["nsec"] == ns
        poses = [pose["pose"]["position"] for topic, _, _, pose in found if topic == f"/{record.name}/pose"]
        east, north, up = pymap3d.geodetic2enu(*own[-1, 1:4], *ways.origin)
        assert (poses[-1]["x"], poses[-1]["y"], poses[-1]["z"]) == pytest.approx((east, north, up), abs=1e-6)


def test_an_mcap_file_draws_paths_volumes_and_separations(tmp_path: Path, flight):
    run, ways, pairs = flight
    mcap.write(run, ways, pairs, tmp_path / "run.mcap")
    found = read_mcap(tmp_path / "run.mcap")
    scenes = [content for _, kind, _, content in found if kind == "foxglove.SceneUpdate"]
    assert len(scenes) == len(ways.paths)
    for scene, path in zip(scenes, ways.paths, strict=True):
        drawn, volume = scene["entities"]
        (line,) = drawn["lines"]
        assert drawn["frame_id"] == topics.MAP
        assert 2 <= len(line["points"]) <= topics.MOST_POINTS
        assert line["points"][0]["y"] == pytest.approx(path.position_ned_m[0, 0])
        assert volume["frame_id"] == path.name
        assert volume["spheres"][0]["size"]["x"] == 2.0 * path.radius_m
        assert volume["texts"][0]["text"] == path.name
    (pair,) = pairs
    apart = [content for topic, _, _, content in found if topic.startswith("/separation/")]
    least = min(apart, key=lambda content: content["distance_m"])
    assert least["distance_m"] == pytest.approx(pair.minimum_m, abs=0.1)
    assert least["required_m"] == pair.required_m
    heard = {topic for topic, _, _, _ in found if "/heard/" in topic}
    assert len(heard) == 2
    log = [content for topic, _, _, content in found if topic == "/log"]
    assert {"autopilot: battery low"} <= {content["message"] for content in log}
    assert next(one["level"] for one in log if one["message"] == "autopilot: battery low") == 5


def test_a_ros_bag_has_the_same(tmp_path: Path, flight):
    run, ways, pairs = flight
    count = rosbag.write(run, ways, pairs, tmp_path / "bag")
    mcap.write(run, ways, pairs, tmp_path / "run.mcap")
    other = {(topic, ns): place for topic, kind, ns, place in read_mcap(tmp_path / "run.mcap")
             if kind in ("foxglove.LocationFix", "foxglove.PoseInFrame")}  # fmt: skip
    kinds: Counter[str] = Counter()
    least_m, texts = np.inf, []
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count == count
        for connection, ns, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            kinds[connection.msgtype] += 1
            match connection.msgtype:
                case "sensor_msgs/msg/NavSatFix":
                    place = other[connection.topic, ns]
                    assert (message.latitude, message.longitude) == (place["latitude"], place["longitude"])
                    assert message.header.frame_id == place["frame_id"]
                    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == ns
                case "geometry_msgs/msg/PoseStamped":
                    there, pose = message.pose, other[connection.topic, ns]["pose"]
                    assert there.position.x == pose["position"]["x"]
                    assert there.orientation.z == pose["orientation"]["z"]
                    assert message.header.frame_id == topics.MAP
                case "tf2_msgs/msg/TFMessage":
                    assert message.transforms[0].header.frame_id == topics.MAP
                case "std_msgs/msg/Float64":
                    least_m = min(least_m, message.data)
                case "nav_msgs/msg/Path":
                    assert len(message.poses) <= topics.MOST_POINTS
                case "rcl_interfaces/msg/Log":
                    texts.append((message.level, message.msg))
    assert least_m == pytest.approx(pairs[0].minimum_m, abs=0.1)
    assert (50, "autopilot: battery low") in texts
    assert kinds["tf2_msgs/msg/TFMessage"] == sum(len(record.facts.fixes) for record in run.aircraft)
    assert kinds["nav_msgs/msg/Path"] == len(ways.paths)


def test_an_onboard_log_is_exported_with_heights_above_the_ellipsoid(tmp_path: Path):
    run, ways, pairs = whole(onboard_logs.px4(tmp_path / "4 winds.ulg"))
    mcap.write(run, ways, pairs, tmp_path / "run.mcap")
    found = read_mcap(tmp_path / "run.mcap")
    places = [content for topic, _, _, content in found if topic == "/a_4_winds/fix"]
    assert len(places) == 10 * onboard_logs.SECONDS
    assert places[0]["altitude"] == pytest.approx(onboard_logs.ALT_M + 48.0, abs=0.01)
    traffic = [content for topic, _, _, content in found if topic == "/a_4_winds/heard/TEST123"]
    assert len(traffic) == onboard_logs.SECONDS
    # The vehicle flies north; in this frame, x points east.
    pose = next(content["pose"] for topic, _, _, content in found if topic == "/a_4_winds/pose")
    assert pose["orientation"]["z"] == pytest.approx(np.sin(np.pi / 4))


def test_without_utc_times_count_from_the_start(tmp_path: Path):
    run, ways, pairs = whole(onboard_logs.old_px4(tmp_path / "x.ulg"))
    mcap.write(run, ways, pairs, tmp_path / "run.mcap")
    found = read_mcap(tmp_path / "run.mcap")
    assert min(ns for _, _, ns, _ in found) == 0
    assert max(ns for _, _, ns, _ in found) == pytest.approx(20e9, rel=0.01)
    rosbag.write(run, ways, pairs, tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.start_time == 0


def test_names_that_differ_stay_different():
    names = topics.Topics()
    assert [names.frame(name) for name in ("UAV 1", "UAV/1", "1", "", "UAV 1")] == [
        "UAV_1", "UAV_1_2", "a_1", "a__", "UAV_1",
    ]  # fmt: skip


@pytest.mark.parametrize(("writer", "module"), [(mcap, "mcap.writer"), (rosbag, "rosbags.rosbag2")])
def test_a_missing_package_is_named_with_the_command_that_installs_it(
    tmp_path: Path, flight, monkeypatch: pytest.MonkeyPatch, writer: Any, module: str
):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigError, match=rf"{module.partition('.')[0]} is not installed.*inspect"):
        writer.write(*flight, tmp_path / "x")
    assert not (tmp_path / "x").exists()


def test_what_cannot_be_written_is_one_clear_line(tmp_path: Path, flight):
    with pytest.raises(ConfigError, match="cannot be written: No such file or directory"):
        mcap.write(*flight, tmp_path / "nowhere" / "x.mcap")
    (tmp_path / "bag").mkdir()
    with pytest.raises(ConfigError, match="it exists already"):
        rosbag.write(*flight, tmp_path / "bag")
    year_2042 = replace(flight[1], utc_at_zero_s=2.3e9)
    with pytest.raises(ConfigError, match="the last time that ROS 2 can write"):
        rosbag.write(flight[0], year_2042, flight[2], tmp_path / "late")
    assert not (tmp_path / "late").exists()
