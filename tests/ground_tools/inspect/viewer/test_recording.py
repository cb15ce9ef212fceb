"""The Rerun recording, read back: it passes Rerun's own check and contains the data of the run."""

import dataclasses
import itertools
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from companion.autopilot.tlog import TlogCounts
from companion.errors import ConfigError
from companion.event_record import Step
from companion.events import (
    Decision,
    GnssFix,
    RemoteIdHeard,
    TransportsChosen,
)
from companion.remote_id.messages import Location
from ground_tools.inspect.explain.why import HalfSpace
from ground_tools.inspect.read.flown import flown, separations
from ground_tools.inspect.read.link_health import ComponentHealth, LinkHealth
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.viewer import drawing, recording, shapes, writer
from ground_tools.inspect.viewer.blueprint import blueprint
from ground_tools.inspect.viewer.palette import AUTHORITY, LEVELS
from tests.ground_tools.inspect.viewer.reading import Read, packed, verify
from tests.support import needs
from tests.support.place import HOME

pytestmark = needs.rerun


def test_the_file_passes_reruns_check_which_detects_a_cut_off_file(saved: Path, tmp_path: Path) -> None:
    result = verify(saved)
    assert result.returncode == 0, result.stdout + result.stderr
    torn = tmp_path / "torn.rrd"
    torn.write_bytes(saved.read_bytes()[:-2000])
    assert verify(torn).returncode != 0


def test_the_aircraft_is_drawn_at_its_own_position_in_enu(found: Read) -> None:
    rows = found.column("/aircraft/DMUCA001/own", "positions")
    assert len(rows) == 601 + 1
    # The origin is the first position: 150 m south of the crossing, 50 m high.
    assert rows[250] == (pytest.approx(25.0), [pytest.approx([0.0, 125.0, 0.0], abs=0.1)])
    # No aircraft is drawn after its last position is stale.
    assert rows[-1] == (pytest.approx(60.0 + drawing.SHOWN_S), [])
    sizes = found.column("/aircraft/DMUCA001/volume", "half_sizes")
    assert sizes[0][1] == [pytest.approx([5.0, 5.0, 5.0 / 0.85])]


def test_pieces_join_without_a_gap(found: Read) -> None:
    """The pieces are before, in and after the encounter. At their borders no row is lost, duplicated or
    blank."""
    rows = found.column("/aircraft/DMUCA001/own", "positions")[:-1]
    assert np.diff([time for time, _ in rows]) == pytest.approx(0.1, abs=1e-6)
    assert all(len(points) == 1 for _, points in rows)
    strips = found.column("/aircraft/DMUCA001/flown", "strips")
    assert len(strips) == 3
    points = [strip for _, (strip,) in strips]
    assert all(before[-1] == after[0] for before, after in itertools.pairwise(points))
    assert sum(len(strip) for strip in points) == 601 + len(points) - 1


def test_received_and_predicted_positions_are_drawn(found: Read) -> None:
    heard = "/aircraft/DMUCA001/heard/c2\\:00\\:00\\:00\\:00\\:02"
    rows = found.column(heard, "positions")
    assert len(rows) == 61 + 1
    # The position of the other aircraft half a second before: 20 m north of the crossing, flying east.
    assert rows[40] == (pytest.approx(40.0), [pytest.approx([47.5, 170.0, 0.0], abs=0.1)])
    predicted = found.column("/aircraft/DMUCA001/predicted", "positions")
    assert len(predicted) == 301 + 1
    assert predicted[200] == (pytest.approx(40.0), [pytest.approx([50.0, 170.0, 0.0], abs=0.1)])
    (label,) = found.column("/aircraft/DMUCA001/predicted", "labels")[200][1]
    assert label == "DMUCA002 as DMUCA001 predicts it, 0.5 s old"


def test_a_track_in_the_way_has_the_volume_that_was_used(found: Read) -> None:
    """The conflict lasts while the distance is below 20 m, from about 30.5 to 33.5 s."""
    rows = found.column("/aircraft/DMUCA001/in\\ the\\ way", "half_sizes")
    drawn = [time for time, sizes in rows if sizes]
    assert (min(drawn), max(drawn)) == (pytest.approx(30.0, abs=0.3), pytest.approx(34.0, abs=0.3))
    assert next(sizes for _, sizes in rows if sizes) == [pytest.approx([10.0, 10.0, 10.0 / 0.85])]
    sight = dict(found.column("/aircraft/DMUCA001/sight", "strips"))
    own = dict(found.column("/aircraft/DMUCA001/own", "positions"))
    assert sight[32.0][0][0] == pytest.approx(own[32.0][0], abs=0.05)


def test_distances_are_those_of_the_run(found: Read, built: Path) -> None:
    (pair,) = separations(flown(read_run(built)).paths)
    rows = found.column("/separation/DMUCA001\\ -\\ DMUCA002", "scalars")
    times, values = np.array([t for t, _ in rows]), np.array([v[0] for _, v in rows])
    assert values.min() == pytest.approx(pair.minimum_m, abs=0.01)
    assert np.abs(values - np.interp(times, pair.time_s, pair.distance_m)).max() < 0.01
    assert np.diff(times).max() < 2.0 * writer.DRAWN_S
    closest = found.column("/separation/closest\\ two", "scalars")
    assert [v for _, v in closest] == [v for _, v in rows]
    assert {v[0] for _, v in found.column("/separation/required\\ 10\\ m", "scalars")} == {10.0}


def test_no_minimum_is_lost_where_distances_are_thinned() -> None:
    time = np.array([0.0, 0.05, 0.1, 0.2, 0.35, 1.0])
    times, values = writer.least_in_bins(time, np.array([5.0, 3.0, 4.0, 2.0, 2.5, 9.0]), 0.2)
    assert (times.tolist(), values.tolist()) == ([0.05, 0.2, 1.0], [3.0, 2.0, 9.0])


def test_lanes_contain_the_states(found: Read) -> None:
    rows = found.column("/authority/DMUCA002", "state")
    assert [(pytest.approx(time), state) for time, (state,) in rows] == [(0.0, "watching"), (5.0, "flying")]
    assert found.fixed("/authority/DMUCA002", "colors")[0] == packed(AUTHORITY["standby"])
    assert "standby" in found.fixed("/authority/DMUCA002", "values")


def test_events_are_logged_and_marked_at_their_place(found: Read) -> None:
    lines = [
        (time, level, text)
        for (time, (text,)), (_, (level,)) in zip(
            found.column("/events/DMUCA001", "text"), found.column("/events/DMUCA001", "level"), strict=True
        )
    ]
    assert (10.0, "CRITICAL", "DMUCA001: autopilot: battery low") in lines
    assert (10.0, "ERROR", "DMUCA001: mode external was refused: denied") in lines
    assert (5.0, "INFO", "DMUCA001: to the pilot: companion flies") in lines
    ((at, text),) = [(time, text) for time, _, text in lines if "conflict with" in text]
    assert "conflict with DMUCA002: 3 m in 1 s, received 0.5 s ago" in text
    marks = dict(found.column("/markers/DMUCA001", "positions"))
    colours = dict(found.column("/markers/DMUCA001", "colors"))
    assert marks[at] == [pytest.approx([0.0, 5.0 * at, 0.0], abs=0.1)]
    assert colours[at] == [packed(LEVELS["WARN"])]
    ((when, (words,)),) = found.column("/markers/closest", "labels")
    assert (when, words) == (pytest.approx(32.0, abs=0.05), "DMUCA001 - DMUCA002 closest: 14.1 m (10 m kept)")


def test_speeds_and_the_map(found: Read) -> None:
    assert found.column("/speed/DMUCA001/flown", "scalars")[0][1] == [0.0]
    ((lat, lon),) = found.column("/map/DMUCA001/own", "positions")[300][1]
    assert (lat, lon) == (pytest.approx(HOME.lat_deg, abs=1e-6), pytest.approx(HOME.lon_deg, abs=1e-6))
    lines = [line for _, (line,) in found.column("/map/DMUCA001/flown", "line_strings")]
    assert lines[0][0] == pytest.approx([HOME.lat_deg - 0.001349, HOME.lon_deg], abs=1e-5)
    assert lines[-1][-1] == pytest.approx([HOME.lat_deg + 0.001349, HOME.lon_deg], abs=1e-5)


def test_a_run_with_one_aircraft_and_an_odd_name_is_drawn_too(tmp_path: Path, made: SimpleNamespace) -> None:
    made.write_events(tmp_path, "Åse's 1: x", made.steps(made.northbound, made.eastbound(20.0)))
    recording.write(read_run(tmp_path), tmp_path / "one.rrd")
    assert verify(tmp_path / "one.rrd").returncode == 0
    assert any("own" in entity for entity in Read(tmp_path / "one.rrd").batches)


def test_an_unwritable_recording_is_reported(run_folder: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be written"):
        recording.write(read_run(run_folder), run_folder / "no" / "such" / "folder.rrd")


def test_north_east_down_is_drawn_east_north_up() -> None:
    assert shapes.enu(np.array([[1.0, 2.0, -3.0]])).tolist() == [[2.0, 1.0, 3.0]]


def test_reported_altitudes_are_drawn_above_mean_sea_level(tmp_path: Path, made: SimpleNamespace) -> None:
    """Remote ID reports ellipsoid altitudes; sea level is 47 m above the ellipsoid here."""
    lat, lon, alt = made.home.to_geodetic(30.0, 40.0, -50.0)
    fix = GnssFix(fix_type=3, lat_deg=lat, lon_deg=lon, alt_msl_m=alt, alt_ellipsoid_m=alt + 47.0)
    report = Location(lat_deg=lat, lon_deg=lon, alt_geodetic_m=alt + 47.0)
    nowhere = Location(alt_geodetic_m=alt)
    heard = RemoteIdHeard(transport="wifi", address="c2", messages=(report, nowhere), rssi_dbm=-60.0)
    first, *others = made.steps(made.northbound, made.eastbound(20.0))
    step = msgspec.structs.replace(first, events=(*first.events, fix, heard))
    made.write_events(tmp_path, "a", [step, *others])
    recording.write(read_run(tmp_path), tmp_path / "a.rrd")
    found = Read(tmp_path / "a.rrd")
    rows = found.column("/aircraft/a/heard/c2", "positions")
    # The frame's origin: the first position, 150 m south of home and 50 m above it.
    assert rows == [(0.0, [pytest.approx([40.0, 180.0, 0.0], abs=0.05)]), (drawing.SHOWN_S, [])]
    assert found.column("/link/a\\ hears\\ c2\\ \\(dBm\\)", "scalars") == [(0.0, [-60.0])]


def test_distances_assumed_by_the_law_are_drawn(found: Read) -> None:
    rows = dict(found.column("/range/DMUCA002\\ at\\ DMUCA001", "scalars"))
    # The minimum of each second. Closest at 32 s, when both are 10 m from the crossing.
    assert min(rows.values()) == [pytest.approx(math.hypot(10.0, 10.0), abs=0.01)]
    assert rows[0.8] == [pytest.approx(math.dist((-146.0, 0.0), (20.0, -146.0)), abs=0.05)]


def test_the_choosing_component_has_a_lane(tmp_path: Path, made: SimpleNamespace) -> None:
    first, *others = made.steps(made.northbound, made.eastbound(20.0), end_s=10.0)
    by_policy = TransportsChosen(rates=(("wifi", 5), ("bluetooth", 1)), by="policy", reason="crowded")
    by_rule = TransportsChosen(rates=(("wifi", 1),), by="fallback", reason="no answer")
    others[20] = msgspec.structs.replace(others[20], commands=(*others[20].commands, by_rule))
    first = msgspec.structs.replace(first, commands=(*first.commands, by_policy))
    made.write_events(tmp_path, "a", [first, *others])
    recording.write(read_run(tmp_path), tmp_path / "a.rrd")
    rows = Read(tmp_path / "a.rrd").column("/choice/a", "state")
    assert rows == [(0.0, ["policy: wifi 5/s, bluetooth 1/s"]), (2.1, ["fallback: wifi 1/s"])]


def test_link_quality_is_drawn(tmp_path: Path, made: SimpleNamespace) -> None:
    """Times are on the run's time line, which begins 20 s before the paths."""
    steps = made.steps(made.northbound, made.eastbound(20.0), end_s=15.0)
    made.write_events(tmp_path, "a", steps, start_utc_s=made.utc_s + 20.0)
    autopilot = ComponentHealth(
        system_id=1,
        component_id=1,
        frames=30,
        missing=4,
        repeated=0,
        gaps_s=np.array([[3.5, 4.0]]),
        seconds=np.array([[2.0, 10.0, 0.0], [3.0, 10.0, 3.0], [7.0, 10.0, 1.0]]),
    )
    link = LinkHealth(
        components=(autopilot,),
        radio=np.array([[5.0, 200.0, 190.0, 40.0, 41.0, 7.0, 8.0, 99.0]]),
        reboots_s=np.array([9.0]),
        counts=TlogCounts(),
        unknown=0,
        bad_values=0,
    )
    run = read_run(tmp_path)
    run = dataclasses.replace(run, aircraft=(dataclasses.replace(run.aircraft[0], link_of=lambda: link),))
    recording.write(run, tmp_path / "a.rrd")
    found = Read(tmp_path / "a.rrd")
    missing = found.column("/link/a\\ 1\\/1\\ missing\\ frames", "scalars")
    assert missing == [(-18.0, [0.0]), (-17.0, [3.0]), (-13.0, [1.0])]
    assert found.column("/link/a\\ radio\\ noise", "scalars") == [(-15.0, [40.0])]
    assert found.column("/link/a\\ radio\\ free\\ buffer", "scalars") == [(-15.0, [99.0])]
    texts = [(time, text) for time, (text,) in found.column("/events/a", "text") if "link: " in text]
    assert texts == [
        (-16.5, "a: link: nothing was received from 1/1 for 4.0 s"),
        (-11.0, "a: link: the vehicle's clock started again from 0"),
    ]


def test_without_positions_the_rest_is_drawn(
    tmp_path: Path, made: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a bench test: there are authority states, texts and broadcasts, but no decisions of the law."""
    plans: list[Any] = []

    def kept(*arguments: Any, **options: Any) -> Any:
        plans.append(blueprint(*arguments, **options))
        return plans[-1]

    monkeypatch.setattr(recording, "blueprint", kept)
    steps = [
        msgspec.structs.replace(
            step, commands=tuple(command for command in step.commands if not isinstance(command, Decision))
        )
        for step in made.steps(made.northbound, made.eastbound(20.0), positions=False)
    ]
    made.write_events(tmp_path, "a", steps)
    recording.write(read_run(tmp_path), tmp_path / "a.rrd")
    assert verify(tmp_path / "a.rrd").returncode == 0
    found = Read(tmp_path / "a.rrd")
    assert [state for _, (state,) in found.column("/authority/a", "state")] == ["watching", "flying"]
    texts = [text for _, (text,) in found.column("/events/run", "text")]
    assert texts[1] == "No aircraft recorded a position, so nothing is drawn in space."
    assert not any(entity.endswith("/own") for entity in found.batches)
    # There is no 3D view at the left.
    assert type(plans[0].root_container).__name__ == "Vertical"


def test_the_greatest_age_of_each_time_is_drawn(tmp_path: Path, made: SimpleNamespace) -> None:
    """The age is 0.5 s, except in one decision at 22 s."""

    def late(step: Step) -> Step:
        commands = tuple(
            msgspec.structs.replace(c, tracks=(msgspec.structs.replace(c.tracks[0], age_s=7.0),))
            if isinstance(c, Decision) and step.now_s == 22.0
            else c
            for c in step.commands
        )
        return msgspec.structs.replace(step, commands=commands)

    made.write_events(tmp_path, "a", [late(s) for s in made.steps(made.northbound, made.eastbound(500.0))])
    recording.write(read_run(tmp_path), tmp_path / "a.rrd")
    rows = Read(tmp_path / "a.rrd").column("/age/DMUCA002\\ at\\ a", "scalars")
    assert len(rows) == 60.0 / writer.AGE_S + 1
    assert [(time, age) for time, (age,) in rows if age != 0.5] == [(22.0, 7.0)]


def test_arrows_point_along_the_velocity(tmp_path: Path, made: SimpleNamespace) -> None:
    def turned(step: Step) -> Step:
        commands = tuple(
            msgspec.structs.replace(c, wanted_ned_mps=(1.0, 2.0, -3.0), chosen_ned_mps=(3.0, 0.0, 0.5))
            if isinstance(c, Decision)
            else c
            for c in step.commands
        )
        return msgspec.structs.replace(step, commands=commands)

    made.write_events(tmp_path, "a", [turned(s) for s in made.steps(made.northbound, made.eastbound(20.0))])
    recording.write(read_run(tmp_path), tmp_path / "a.rrd")
    found = Read(tmp_path / "a.rrd")
    assert found.column("/aircraft/a/wanted", "vectors")[5][1] == [pytest.approx([10.0, 5.0, 15.0])]
    assert found.column("/aircraft/a/chosen", "vectors")[5][1] == [pytest.approx([0.0, 15.0, -2.5])]
    # A second after the start, 5 m north of the frame's origin.
    assert found.column("/aircraft/a/wanted", "origins")[5][1] == [pytest.approx([0.0, 5.0, 0.0], abs=0.05)]
    assert found.column("/speed/a/chosen", "scalars")[5][1] == [pytest.approx(np.hypot(3.0, 0.5))]


def test_a_half_spaces_square_lies_on_its_plane_and_points_to_the_allowed_side() -> None:
    space = HalfSpace("b", True, (0.6, 0.8, 0.0), 2.0, True)
    place, velocity = np.array([10.0, 20.0, -30.0]), np.array([3.0, 1.0, 0.5])
    line = (shapes.square(place, velocity, space) - place) / shapes.ARROW_S
    assert line[1:] @ np.array(space.normal_ned) == pytest.approx(2.0)
    assert line[0] @ np.array(space.normal_ned) > 2.0
    assert line[1] == pytest.approx(velocity + (2.0 - 2.6) * np.array(space.normal_ned))
