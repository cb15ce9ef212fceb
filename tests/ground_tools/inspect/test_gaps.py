"""If positions are missing, no output of a run has a leg over the gap."""

from __future__ import annotations

import gzip
import json
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from companion.arrays import Floats
from ground_tools.inspect.export import kml, mcap, rosbag
from ground_tools.inspect.export.kml import GX
from ground_tools.inspect.read.flown import MAX_GAP_S, Flown, flown, gap_s, unbroken
from ground_tools.inspect.read.read_run import Run, read_run
from ground_tools.inspect.viewer import recording
from tests.ground_tools.inspect.viewer.reading import Read

LOG = Path(__file__).parents[2] / "data" / "ardupilot_sitl_odid_adsb.tlog.gz"
LONGEST_LEG_M = 3.0
"""Bound of the distance between two consecutive positions of this log without a gap between them."""


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Flown]:
    """The log of an ArduPilot that has no position from 0.6 to 10.8 s."""
    path = tmp_path_factory.mktemp("log") / LOG.stem
    with gzip.open(LOG) as packed, path.open("wb") as plain:
        shutil.copyfileobj(packed, plain)
    run = read_run(path)
    return run, flown(run)


def two_pieces(pieces: list[Floats], count: int) -> None:
    """Check that these pieces of a line, (n, 3) in m, are the whole path except for the leg over the gap."""
    assert len(pieces) == 2
    assert sum(map(len, pieces)) == count
    legs = np.concatenate([np.linalg.norm(np.diff(piece, axis=0), axis=1) for piece in pieces])
    assert legs.max() < LONGEST_LEG_M
    assert np.linalg.norm(pieces[1][0] - pieces[0][-1]) == pytest.approx(231.0, abs=5.0), "it has the gap"


def test_the_recording(flight: tuple[Run, Flown], tmp_path: Path):
    pytest.importorskip("rerun")
    run, ways = flight
    recording.write(run, tmp_path / "x.rrd")
    found = Read(tmp_path / "x.rrd")
    (path,) = ways.paths
    name = path.name.replace(" ", "\\ ")
    for entity, component in (("aircraft", "strips"), ("map", "line_strings")):
        rows = found.column(f"/{entity}/{name}/flown", component)
        pieces = [np.array(strip) for _, strips in rows for strip in strips]
        if entity == "map":
            lat, lon, _ = ways.origin
            east_north = [pymap3d.geodetic2enu(*piece.T, 0.0, lat, lon, 0.0)[:2] for piece in pieces]
            pieces = [np.column_stack([*each, np.zeros(len(each[0]))]) for each in east_north]
        # Pieces of the time line are joined: the last position of one is the first of the next.
        joined = [pieces[0]]
        for piece in pieces[1:]:
            if np.array_equal(piece[0], joined[-1][-1]):
                joined[-1] = np.concatenate([joined[-1], piece[1:]])
            else:
                joined.append(piece)
        two_pieces(joined, len(path.time_s))


def test_mcap(flight: tuple[Run, Flown], tmp_path: Path):
    run, ways = flight
    mcap.write(run, ways, [], tmp_path / "x.mcap")
    with (tmp_path / "x.mcap").open("rb") as stream:
        scenes: list[dict[str, Any]] = [
            json.loads(message.data)
            for schema, _, message in make_reader(stream).iter_messages()
            if schema is not None and schema.name == "foxglove.SceneUpdate"
        ]
    (scene,) = scenes
    lines = scene["entities"][0]["lines"]
    pieces = [np.array([[p["x"], p["y"], p["z"]] for p in line["points"]]) for line in lines]
    two_pieces(pieces, len(ways.paths[0].time_s))


def test_a_ros_bag(flight: tuple[Run, Flown], tmp_path: Path):
    run, ways = flight
    rosbag.write(run, ways, [], tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as reader:
        paths = [
            (ns, reader.deserialize(raw, connection.msgtype))
            for connection, ns, raw in reader.messages()
            if connection.msgtype == "nav_msgs/msg/Path"
        ]
    pieces = [
        np.array([[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in path.poses])
        for _, path in paths
    ]
    two_pieces(pieces, len(ways.paths[0].time_s))
    first, second = (ns for ns, _ in paths)
    assert (second - first) * 1e-9 > MAX_GAP_S


def test_kml(flight: tuple[Run, Flown], tmp_path: Path):
    run, ways = flight
    kml.write(run, ways, [], tmp_path / "x.kml")
    found = ET.parse(tmp_path / "x.kml").getroot().iter(f"{{{GX}}}MultiTrack")
    (several,) = found
    assert several.findtext(f"{{{GX}}}interpolate") == "0"
    pieces = []
    for track in several.iter(f"{{{GX}}}Track"):
        places = [list(map(float, (one.text or "").split())) for one in track.iter(f"{{{GX}}}coord")]
        assert len(list(track)) == 2 * len(places) + 1
        lon, lat, alt = np.array(places).T
        pieces.append(np.column_stack(pymap3d.geodetic2enu(lat, lon, alt, *ways.origin)))
    count = sum(map(len, pieces))
    assert count > 0.5 * len(ways.paths[0].time_s)
    two_pieces(pieces, count)


def test_the_usual_interval_of_rare_positions_is_no_gap():
    every_5_s = np.arange(0.0, 100.0, 5.0)
    assert unbroken(every_5_s, gap_s(every_5_s)) == [slice(0, 20)]
    often = np.array([0.0, 0.2, 0.4, 2.3, 2.5, 4.6, 4.8])
    assert unbroken(often, gap_s(often)) == [slice(0, 5), slice(5, 7)]
    assert unbroken(np.zeros(1), gap_s(np.zeros(1))) == [slice(0, 1)]
