"""Reading run folders: damage, the common time line and frame, and separations against closed forms."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from companion.errors import ConfigError
from ground_tools.inspect.read import flown as flown_module
from ground_tools.inspect.read.flown import Flown, Separation, flown, from_frame, separations
from ground_tools.inspect.read.read_run import read_run, read_unavoided
from ground_tools.inspect.read.timeline import time_line
from ground_tools.inspect.report.summary import describe, text


def closest(ways: Flown) -> Separation:
    return separations(ways.paths)[0]


def test_a_whole_folder_is_read(run_folder: Path) -> None:
    run = read_run(run_folder)
    assert run.name == "20260101T000000Z-demo"
    assert (run.manifest, run.summary) == ({"what": "test", "seed": 1}, {"ok": True})
    assert [(one.name, one.facts.steps) for one in run.aircraft] == [("DMUCA001", 601), ("DMUCA002", 601)]
    assert run.aircraft[0].header is not None
    assert run.problems == ()
    assert read_unavoided(run_folder) is not None
    assert read_unavoided(run_folder / "unavoided") is None


def test_only_the_torn_tail_of_a_record_is_lost(run_folder: Path) -> None:
    path = run_folder / "DMUCA001.events"
    path.write_bytes(path.read_bytes()[:-7])
    run = read_run(run_folder)
    assert [one.facts.steps for one in run.aircraft] == [600, 601]
    (problem,) = run.problems
    assert problem.startswith("DMUCA001.events: the file is cut off; its last ")


def test_a_record_is_read_up_to_damage_which_is_reported(run_folder: Path) -> None:
    path = run_folder / "DMUCA002.events"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    (run_folder / "manifest.json").write_text("{broken")
    run = read_run(run_folder)
    assert 100 < run.aircraft[1].facts.steps < 500
    assert run.manifest is None
    assert [problem.split(":")[0] for problem in run.problems] == ["manifest.json", "DMUCA002.events"]
    assert "read up to there" in run.problems[1]
    assert "problem: DMUCA002.events" in text(describe(run))


def test_distances_are_the_same_taken_part_by_part(run_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only one part is in memory at a time, so a long flight needs no more memory."""
    ways = flown(read_run(run_folder))
    (whole,) = separations(ways.paths)
    monkeypatch.setattr(flown_module, "PART_S", 7.0)
    (parted,) = separations(ways.paths)
    (least,) = flown_module.closest(ways.paths)
    assert (parted.minimum_m, parted.minimum_time_s) == pytest.approx((whole.minimum_m, whole.minimum_time_s))
    assert (least.minimum_m, least.minimum_time_s) == (parted.minimum_m, parted.minimum_time_s)
    assert len(least.time_s) == len(least.distance_m) == 0
    assert (np.diff(parted.time_s) > 0.0).all()
    assert np.interp(whole.time_s, parted.time_s, parted.distance_m) == pytest.approx(whole.distance_m)
    (thin,) = flown_module.thinned(ways.paths, 5.0)
    assert thin.minimum_m == least.minimum_m
    assert thin.distance_m.min() == parted.distance_m.min()
    # At the border of two parts, one of the two samples belongs to both.
    assert 13 <= len(thin.time_s) <= 13 + 8
    # The grid at 20 Hz, plus at most the samples of two aircraft at 10 Hz.
    assert max(len(time) for time, _ in flown_module._relative(*ways.paths)) <= 7 * 40 + 3


@pytest.mark.parametrize("content", [None, b"", b"not a record"])
def test_paths_that_are_no_run_are_refused(tmp_path: Path, content: bytes | None) -> None:
    folder = tmp_path / "run"
    if content is not None:
        folder.mkdir()
        (folder / "a.events").write_bytes(content)
    with pytest.raises(ConfigError):
        flown(read_run(folder))


def test_an_empty_folder_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no event record"):
        read_run(tmp_path)


def test_the_closest_approach_is_that_of_the_geometry(run_folder: Path) -> None:
    """Two straight crossing paths at one speed: the minimum is miss / sqrt(2), at half the time of the miss
    distance after the crossing."""
    pair = closest(flown(read_run(run_folder)))
    assert (pair.first, pair.second, pair.required_m) == ("DMUCA001", "DMUCA002", 10.0)
    assert pair.minimum_m == pytest.approx(20.0 / math.sqrt(2.0), abs=0.02)
    assert pair.minimum_time_s == pytest.approx(32.0, abs=0.11)
    assert flown(read_run(run_folder)).positions == "own GNSS positions"


def test_positions_come_from_decisions_where_there_are_no_others(
    tmp_path: Path, made: SimpleNamespace
) -> None:
    other = made.eastbound(20.0)
    made.write_events(tmp_path, "a", made.steps(made.northbound, other, positions=False))
    made.write_events(tmp_path, "b", made.steps(other, made.northbound))
    pair = closest(flown(read_run(tmp_path)))
    assert pair.minimum_m == pytest.approx(20.0 / math.sqrt(2.0), abs=0.02)


def test_without_any_position_there_are_no_paths(tmp_path: Path, made: SimpleNamespace) -> None:
    made.write_events(tmp_path, "a", [])
    with pytest.raises(ConfigError, match="no aircraft recorded a position"):
        flown(read_run(tmp_path))


def test_different_clocks_are_aligned_by_utc(tmp_path: Path, made: SimpleNamespace) -> None:
    other = made.eastbound(20.0)
    made.write_events(tmp_path, "a", made.steps(made.northbound, other, 1000.0))
    late = [step for step in made.steps(other, made.northbound, 55.5) if step.now_s >= 60.0]
    made.write_events(tmp_path, "b", late)
    ways = flown(read_run(tmp_path))
    assert ways.clock == "UTC of the autopilots"
    assert ways.paths[0].time_s[0] == pytest.approx(0.0)
    assert ways.paths[1].time_s[0] == pytest.approx(4.5)
    assert closest(ways).minimum_m == pytest.approx(20.0 / math.sqrt(2.0), abs=0.02)
    assert closest(ways).minimum_time_s == pytest.approx(32.0, abs=0.11)


def test_without_utc_a_common_clock_is_assumed_and_reported(tmp_path: Path, made: SimpleNamespace) -> None:
    other = made.eastbound(20.0)
    made.write_events(tmp_path, "a", made.steps(made.northbound, other))
    made.write_events(tmp_path, "b", made.steps(other, made.northbound, utc=False))
    line = time_line(read_run(tmp_path))
    assert line.offsets_s == {"a": 0.0, "b": 0.0}
    assert line.words == "one clock, assumed to be common because b recorded no UTC"


@pytest.mark.parametrize(
    ("other_start_s", "zero_at_s", "words"),
    [
        (4.0, 4.0, "one clock shared by all aircraft; 0 is the start of the timed paths"),
        (5.0, 0.0, "one clock shared by all aircraft"),
    ],
)
def test_time_zero_is_the_common_start_of_the_paths(
    tmp_path: Path, made: SimpleNamespace, other_start_s: float, zero_at_s: float, words: str
) -> None:
    other = made.eastbound(20.0)
    start = made.utc_s + 4.0
    made.write_events(tmp_path, "a", made.steps(made.northbound, other), start_utc_s=start)
    made.write_events(
        tmp_path, "b", made.steps(other, made.northbound), start_utc_s=made.utc_s + other_start_s
    )
    ways = flown(read_run(tmp_path))
    assert ways.clock == words
    assert closest(ways).minimum_time_s == pytest.approx(32.0 - zero_at_s, abs=0.01)


def test_positions_inside_a_gap_are_unknown(tmp_path: Path, made: SimpleNamespace) -> None:
    """The closest approach lies in the gap. It must not be interpolated over the gap."""
    other = made.eastbound(20.0)
    kept = [s for s in made.steps(made.northbound, other) if not 25.05 < s.now_s < 38.95]
    made.write_events(tmp_path, "a", kept)
    made.write_events(tmp_path, "b", made.steps(other, made.northbound))
    pair = closest(flown(read_run(tmp_path)))
    inside = (pair.time_s > 25.05) & (pair.time_s < 38.95)
    assert np.isnan(pair.distance_m[inside]).all()
    assert not np.isnan(pair.distance_m[pair.time_s < 25.0]).any()
    assert pair.minimum_m is not None
    assert pair.minimum_m > 30.0


@pytest.mark.parametrize("silent_s", [1.0, 700.0, 5000.0, 1.7e9])
def test_a_silence_of_years_is_one_step(silent_s: float) -> None:
    """The clock of a computer without a battery may jump from 1970 to today in flight."""
    time = np.concatenate([np.arange(0.0, 50.0, 0.5), 50.0 + silent_s + np.arange(0.0, 50.0, 0.5)])
    north = np.linspace(-200.0, 200.0, len(time))
    still = np.zeros(len(time))
    one = flown_module.Path("one", time, np.column_stack([north, still, still]), 5.0)
    # The other stands 7 m beside its way, at a place that it passes after the silence.
    other = flown_module.Path("other", time, np.column_stack([still + 100.0, still + 7.0, still]), 5.0)
    parts = list(flown_module._relative(one, other))
    assert len(parts) <= 5
    (pair,) = separations((one, other))
    assert pair.minimum_m == pytest.approx(7.0, abs=1e-6)
    assert pair.minimum_time_s == pytest.approx(np.interp(100.0, north, time), abs=1e-3)
    assert (np.diff(pair.time_s) > 0.0).all()
    if silent_s > flown_module.MAX_GAP_S:
        inside = (pair.time_s > 49.5) & (pair.time_s < 50.0 + silent_s)
        assert inside.any(), "the line is broken there"
        assert np.isnan(pair.distance_m[inside]).all()


def test_aircraft_never_in_the_air_together_have_no_separation(tmp_path: Path, made: SimpleNamespace) -> None:
    found = made.steps(made.northbound, made.eastbound(0.0))
    made.write_events(tmp_path, "a", [s for s in found if s.now_s < 20.0])
    made.write_events(tmp_path, "b", [s for s in found if s.now_s > 40.0])
    run = read_run(tmp_path)
    assert closest(flown(run)).minimum_m is None
    figures = describe(run)
    assert figures["separations"][0]["kept"] is None
    assert "never known at the same time" in text(figures)


def test_radii_of_both_make_the_required_separation(tmp_path: Path, made: SimpleNamespace) -> None:
    other = made.eastbound(20.0)
    made.write_events(tmp_path, "a", made.steps(made.northbound, other), radius_m=8.0)
    made.write_events(tmp_path, "b", made.steps(other, made.northbound), radius_m=7.0)
    figures = describe(read_run(tmp_path))["separations"][0]
    assert (figures["required_m"], figures["kept"]) == (15.0, False)


def test_frames_convert(made: SimpleNamespace) -> None:
    points = np.array([[100.0, -50.0, -30.0], [0.0, 0.0, 0.0]])
    here = made.home.to_geodetic(0.0, 0.0, 0.0)
    there = made.home.to_geodetic(20.0, -30.0, 10.0)
    moved = from_frame(points, there, here)
    assert moved == pytest.approx(points + np.array([20.0, -30.0, 10.0]), abs=0.01)
    assert from_frame(points, here, here) is points


def test_figures_of_a_run(run_folder: Path) -> None:
    figures = describe(read_run(run_folder))
    one = figures["aircraft"][0]
    assert (one["steps"], one["duration_s"], one["broadcasts"], one["heard"]) == (601, 60.0, 61, 61)
    assert (one["decisions"], one["infeasible"], one["authority"]) == (301, 0, "flying")
    assert one["conflicts"] > 0
    assert "closest 14.14 m at 32.00 s (10 m kept)" in text(figures)
