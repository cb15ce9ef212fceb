"""True positions beside the records: they are preferred if complete; and the run folders that contain
them."""

import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from companion.errors import ConfigError, PeerDataError
from ground_tools.inspect.read.flown import OWN, TRUE, flown, separations
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.read.truth import HEADER, read_truth
from ground_tools.inspect.report.summary import describe, text
from sitl_mocks.encounters import demo
from sitl_mocks.encounters.scenario_file import PathSettings, Scenario


@pytest.fixture
def with_truth(run_folder: Path, made: SimpleNamespace) -> Path:
    """A run whose closest approach is 20 / sqrt(2) m by own positions and 30 / sqrt(2) m by true ones."""
    made.write_truth(run_folder, "DMUCA001", made.northbound)
    made.write_truth(run_folder, "DMUCA002", made.eastbound(30.0))
    return run_folder


def test_distances_are_true_where_the_truth_is_known(with_truth: Path) -> None:
    figures = describe(read_run(with_truth))
    assert figures["positions"] == TRUE
    (pair,) = figures["separations"]
    assert pair["minimum_m"] == pytest.approx(30.0 / math.sqrt(2.0), abs=0.002)
    assert pair["minimum_time_s"] == pytest.approx(33.0, abs=0.02)
    assert "distances from true positions" in text(figures)
    assert figures["problems"] == []


def test_own_positions_stay_beside_the_true_ones_in_one_frame(with_truth: Path) -> None:
    ways = flown(read_run(with_truth))
    true, own = ways.paths[0], ways.own[0]
    assert true.position_ned_m[[0, -1]] == pytest.approx(own.position_ned_m[[0, -1]], abs=0.02)
    assert ways.own[1].position_ned_m[0, 0] == pytest.approx(20.0, abs=0.02)
    assert ways.paths[1].position_ned_m[0, 0] == pytest.approx(30.0, abs=0.02)


def test_the_closest_approach_is_found_between_rows(run_folder: Path, made: SimpleNamespace) -> None:
    made.write_truth(run_folder, "DMUCA001", made.northbound, period_s=1.0)
    made.write_truth(run_folder, "DMUCA002", made.eastbound(0.37), period_s=1.0)
    pair = separations(flown(read_run(run_folder)).paths)[0]
    assert pair.minimum_m == pytest.approx(0.37 / math.sqrt(2.0), abs=0.002)
    assert pair.minimum_time_s == pytest.approx(30.037, abs=0.002)


def far_away(path: Path) -> None:
    header, *rows = path.read_text().splitlines()
    moved = (f"{row.split(',')[0]},9000,0,-50" for row in rows)
    path.write_text("\n".join([header, *moved]) + "\n")


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (Path.unlink, "those of DMUCA002 are missing"),
        (far_away, "those of DMUCA002 are 8980 m from"),
        (lambda path: path.write_text("nonsense\n"), "line 1 must be utc_s"),
    ],
)
def test_own_positions_are_used_if_one_truth_file_is_unusable(
    with_truth: Path, damage: object, words: str
) -> None:
    assert callable(damage)
    damage(with_truth / "DMUCA002.truth.csv")
    figures = describe(read_run(with_truth))
    assert figures["positions"] == OWN
    assert figures["separations"][0]["minimum_m"] == pytest.approx(20.0 / math.sqrt(2.0), abs=0.02)
    assert words in "\n".join(figures["problems"])


def test_truth_needs_utc(tmp_path: Path, made: SimpleNamespace) -> None:
    other = made.eastbound(20.0)
    made.write_events(tmp_path, "a", made.steps(made.northbound, other))
    made.write_events(tmp_path, "b", made.steps(other, made.northbound, utc=False))
    made.write_truth(tmp_path, "a", made.northbound)
    made.write_truth(tmp_path, "b", made.eastbound(30.0))
    ways = flown(read_run(tmp_path))
    assert ways.positions == OWN
    assert "b recorded no UTC" in ways.problems[0]


def test_a_line_cut_off_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "a.truth.csv"
    path.write_text(f"{HEADER}\n10.0,1.0,2.0,-3.0\n10.1,1.5,2.0,-3.0\n10.2,2.0,2")
    rows = read_truth(path)
    assert rows is not None
    assert rows.tolist() == [[10.0, 1.0, 2.0, -3.0], [10.1, 1.5, 2.0, -3.0]]


@pytest.mark.parametrize("content", [None, "", HEADER, f"{HEADER}\n", f"{HEADER}\n10.0,1.0"])
def test_no_rows_are_no_truth(tmp_path: Path, content: str | None) -> None:
    path = tmp_path / "a.truth.csv"
    if content is not None:
        path.write_text(content)
    assert read_truth(path) is None


@pytest.mark.parametrize(
    "rows", ["1,2,3\n", "1,2,3,4\n1,2,3\n", "a,b,c,d\n", "1,2,nan,4\n", "2,0,0,0\n1,0,0,0\n", "1,0,0,0\n" * 2]
)
def test_damaged_rows_are_refused(tmp_path: Path, rows: str) -> None:
    path = tmp_path / "a.truth.csv"
    path.write_text(f"{HEADER}\n{rows}")
    with pytest.raises(PeerDataError, match=r"a\.truth\.csv"):
        read_truth(path)


@pytest.fixture
def swarm_folder(tmp_path: Path, made: SimpleNamespace) -> Path:
    """The folder of a swarm: true positions and manifest at the top, and a run folder for each companion
    inside."""
    folder = tmp_path / "20260101T000000Z-swarm"
    other = made.eastbound(20.0)
    made.write_events(folder / "20260101T000002Z-A[1]", "A[1]", made.steps(made.northbound, other))
    made.write_events(folder / "20260101T000001Z-B", "B", made.steps(other, made.northbound))
    made.write_truth(folder, "A[1]", made.northbound)
    made.write_truth(folder, "B", made.eastbound(30.0))
    (folder / "manifest.json").write_text(json.dumps({"aircraft": ["A[1]", "B"]}))
    return folder


def test_a_swarm_is_one_run(swarm_folder: Path) -> None:
    run = read_run(swarm_folder)
    assert [(one.name, one.facts.steps) for one in run.aircraft] == [("A[1]", 601), ("B", 601)]
    assert run.problems == ()
    ways = flown(run)
    assert ways.positions == TRUE
    assert separations(ways.paths)[0].minimum_m == pytest.approx(30.0 / math.sqrt(2.0), abs=0.002)


def test_missing_and_duplicate_aircraft_of_a_swarm_are_reported(
    swarm_folder: Path, made: SimpleNamespace
) -> None:
    (swarm_folder / "20260101T000001Z-B" / "B.events").unlink()
    made.write_events(swarm_folder / "20260101T000009Z-A[1]", "A[1]", [])
    run = read_run(swarm_folder)
    assert [(one.name, one.facts.steps) for one in run.aircraft] == [("A[1]", 0)]
    assert run.problems == (
        "A[1]: there are 2 event records; the last one is shown",
        "B: the event record is missing",
    )


def test_the_folder_of_all_runs_is_no_run(run_folder: Path) -> None:
    with pytest.raises(ConfigError, match="no event record") as refused:
        read_run(run_folder.parent)
    assert str(refused.value).endswith(f"but it contains a run; give its path: {run_folder}")


def test_figures_agree_with_the_verdict_of_the_demo(tmp_path: Path) -> None:
    """Two aircraft fly for 10 s and cross 4 m apart. The demo uses every tick; the tool reads the folder."""
    scenario = Scenario(
        duration_s=10.0,
        path=(
            PathSettings(points=((0.0, -15.0, 0.0, -60.0), (10.0, 15.0, 0.0, -60.0))),
            PathSettings(points=((0.0, 4.0, -15.0, -60.0), (10.0, 4.0, 15.0, -60.0))),
        ),
    )
    outcome = demo._fly_one(scenario, 1, 0, avoided=False, folder=tmp_path)
    (pair,), run = outcome.pairs, read_run(tmp_path)
    assert run.aircraft[0].truth is not None
    assert np.diff(run.aircraft[0].truth[:, 0]) == pytest.approx(0.1, abs=0.002)
    figures = describe(run)
    assert figures["positions"] == TRUE
    (found,) = figures["separations"]
    assert found["minimum_m"] == pytest.approx(pair.min_separation_m, abs=0.01)
    assert found["minimum_time_s"] == pytest.approx(pair.at_s, abs=0.06)
    assert found["kept"] is False
