"""The Rerun recording: sound by rerun's own check, and holding what the run holds."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from companion.errors import ConfigError
from companion.events import GnssFix, RemoteIdHeard
from companion.record import Step
from companion.remote_id.messages import Location
from ground_tools.inspect import recording
from ground_tools.inspect.blueprint import ENCOUNTER, encounter_time
from ground_tools.inspect.read_run import read_run

pytest.importorskip("rerun")


def chunks(path: Path) -> dict[str, int]:
    """Rows with a time, by entity path."""
    from rerun.chunk import RrdReader

    rows: dict[str, int] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        if not chunk.is_static:
            rows[str(chunk.entity_path)] = rows.get(str(chunk.entity_path), 0) + chunk.num_rows
    return rows


@pytest.fixture
def saved(run_folder: Path) -> Path:
    path = run_folder / "inspect.rrd"
    recording.write(read_run(run_folder), path)
    return path


def test_the_file_is_sound(saved: Path) -> None:
    program = Path(sys.executable).with_name("rerun")
    result = subprocess.run(
        [program, "rrd", "verify", saved], capture_output=True, text=True, timeout=60, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr


def test_the_check_would_notice_a_file_cut_off(saved: Path) -> None:
    saved.write_bytes(saved.read_bytes()[:-2000])
    program = Path(sys.executable).with_name("rerun")
    result = subprocess.run([program, "rrd", "verify", saved], capture_output=True, timeout=60, check=False)
    assert result.returncode != 0


def test_every_part_of_the_run_is_in_it(saved: Path) -> None:
    rows = chunks(saved)
    heard = "/aircraft/DMUCA001/heard/c2\\:00\\:00\\:00\\:00\\:02"
    # Positions end with a row of none, so that none is drawn for ever.
    assert rows["/aircraft/DMUCA001/own"] == 601 + 1
    assert rows[heard] == 61 + 1
    assert rows["/aircraft/DMUCA001/predicted/DMUCA002"] == 301 + 1
    assert rows["/authority/DMUCA002"] == 2
    assert rows["/events/DMUCA001"] == 4
    assert rows["/separation/DMUCA001\\ -\\ DMUCA002"] > 1000
    assert rows["/separation/required\\ 10\\ m"] == 2
    assert rows["/separation/closest\\ two"] > 1000


def test_a_run_with_one_aircraft_and_an_odd_name_is_drawn_too(tmp_path: Path, made: SimpleNamespace) -> None:
    made.write_events(tmp_path, "Åse's 1: x", made.steps(made.northbound, made.eastbound(20.0)))
    recording.write(read_run(tmp_path), tmp_path / "one.rrd")
    assert any("own" in entity for entity in chunks(tmp_path / "one.rrd"))


def test_a_place_that_cannot_be_written_is_said(run_folder: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be written"):
        recording.write(read_run(run_folder), run_folder / "no" / "such" / "folder.rrd")


def test_a_position_is_not_drawn_when_no_other_follows() -> None:
    times, lengths = recording._until_stale(np.array([0.0, 1.0, 9.0]))
    assert (times.tolist(), lengths.tolist()) == ([0.0, 1.0, 4.0, 9.0, 12.0], [1, 1, 0, 1, 0])


def test_the_encounter_counts_from_the_closest_approach_and_holds_what_lies_around_it(saved: Path) -> None:
    """Closest at 32 s of 60: all before it lies within the encounter's time before."""
    from rerun.chunk import RrdReader

    ((start, end),) = [
        (column[0].as_py(), column[-1].as_py())
        for chunk in RrdReader(saved).stream().to_chunks()
        if str(chunk.entity_path) == "/aircraft/DMUCA001/own" and not chunk.is_static
        for column in [chunk.to_record_batch().column(ENCOUNTER)]
    ]
    assert start.total_seconds() == pytest.approx(-32.0, abs=0.01)
    assert end.total_seconds() == pytest.approx(60.0 + recording.SHOWN_S - 32.0, abs=0.01)
    assert encounter_time(np.array([0.0, 100.0, 500.0]), 100.0).tolist() == [-40.0, 0.0, 60.0]


def test_north_east_down_is_drawn_east_north_up() -> None:
    drawn = recording._enu(np.array([[1.0, 2.0, -3.0]]))
    assert drawn.tolist() == [[2.0, 1.0, 3.0]]


@pytest.mark.parametrize(
    ("severity", "level"),
    [(0, "CRITICAL"), (2, "CRITICAL"), (3, "ERROR"), (4, "WARN"), (6, "INFO"), (7, "INFO")],
)
def test_severities(severity: int, level: str) -> None:
    assert recording._level(severity) == level


def test_reported_altitudes_are_drawn_above_mean_sea_level(tmp_path: Path, made: SimpleNamespace) -> None:
    """Remote ID reports ellipsoid altitudes; sea level lies 47 m above the ellipsoid here."""
    lat, lon, alt = made.home.to_geodetic(30.0, 40.0, -50.0)
    fix = GnssFix(fix_type=3, lat_deg=lat, lon_deg=lon, alt_msl_m=alt, alt_ellipsoid_m=alt + 47.0)
    report = Location(lat_deg=lat, lon_deg=lon, alt_geodetic_m=alt + 47.0)
    nowhere = Location(alt_geodetic_m=alt)
    heard = RemoteIdHeard(transport="wifi", address="c2:00:00:00:00:02", messages=(report, nowhere))
    step = Step(now_s=7.0, events=(fix, heard), commands=())
    origin = made.home.to_geodetic(0.0, 0.0, 0.0)
    made.write_events(tmp_path, "a", [step])
    ((address, time, position),) = recording._heard(read_run(tmp_path).aircraft[0], origin)
    assert (address, time.tolist()) == ("c2:00:00:00:00:02", [7.0])
    assert position[0] == pytest.approx((30.0, 40.0, -50.0), abs=0.01)
