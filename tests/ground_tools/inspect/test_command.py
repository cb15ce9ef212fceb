"""`ground-tools inspect` and `ground-tools picture`: files written, figures printed, wrong input refused."""

import argparse
import json
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from companion.errors import ConfigError
from ground_tools.inspect.read.flown import flown, separations
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.report import picture
from tests.ground_tools.inspect.flights import inspect


def draw(*arguments: object) -> int:
    parser = argparse.ArgumentParser()
    picture.add_arguments(parser)
    return picture.run(parser.parse_args([str(a) for a in arguments]))


def pixels(path: Path) -> np.ndarray:
    from matplotlib.image import imread

    return np.asarray(imread(path))


def test_a_recording_is_written_into_the_run_and_named(
    run_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rerun")
    assert inspect(run_folder) == 0
    assert (run_folder / "inspect.rrd").stat().st_size > 10_000
    out = capsys.readouterr().out
    assert "closest 14.14 m" in out
    assert f"rerun {run_folder / 'inspect.rrd'}" in out


def test_save_sets_the_path_of_the_recording(run_folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    assert inspect(run_folder, "--save", tmp_path / "x.rrd") == 0
    assert (tmp_path / "x.rrd").exists()
    assert not (run_folder / "inspect.rrd").exists()


def test_summary_writes_no_recording(run_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert inspect(run_folder, "--summary") == 0
    assert "DMUCA001 - DMUCA002: closest 14.14 m at 32.00 s (10 m kept)" in capsys.readouterr().out
    assert not (run_folder / "inspect.rrd").exists()


def test_summary_shows_the_simulated_radio_channel(
    run_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ages = {"information_age_mean_s": 0.5, "information_age_max_s": 2.25}
    row = {"sender": "DMUCA001", "receiver": "DMUCA002", "sent": 500, "delivered": 130, **ages, "lost": 370}
    mute = {"sender": "DMUCA002", "receiver": "DMUCA001", "sent": 9, "delivered": 0, **dict.fromkeys(ages)}
    (run_folder / "summary.json").write_text(json.dumps({"air": [row, mute]}))
    assert inspect(run_folder, "--summary") == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "DMUCA001 DMUCA002 500 130 0.50 2.25" in out
    assert "DMUCA002 DMUCA001 9 0 - -" in out


@pytest.mark.parametrize("air", [3, [3], [{}], [{"sender": 1}], "x", None])
def test_unreadable_channel_figures_are_only_a_problem(
    run_folder: Path, capsys: pytest.CaptureFixture[str], air: object
) -> None:
    (run_folder / "summary.json").write_text(json.dumps({"air": air}))
    assert inspect(run_folder, "--json") == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["air"] == []
    assert "summary.json: air: the format is not that of a run" in figures["problems"]


def test_json_is_one_object_a_line(run_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert inspect(run_folder, run_folder / "unavoided", "--json") == 0
    avoided, unavoided = map(json.loads, capsys.readouterr().out.splitlines())
    assert (avoided["separations"][0]["kept"], unavoided["separations"][0]["kept"]) == (True, False)


@pytest.mark.parametrize("extra", [["--summary"], ["--json"], ["second"]])
def test_save_needs_exactly_one_recording(run_folder: Path, extra: list[str]) -> None:
    with pytest.raises(ConfigError, match="--save"):
        inspect(run_folder, *extra, "--save", "x.rrd")


def test_missing_rerun_is_one_line_of_advice(run_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ConfigError, match=r"in the checkout: pip install -e '\.\[inspect\]'"):
        inspect(run_folder)
    assert inspect(run_folder, "--summary") == 0


def test_the_picture_shows_both_runs(run_folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    assert draw(run_folder, "--out", tmp_path / "both.png") == 0
    both = pixels(tmp_path / "both.png")
    assert both.shape[1] > both.shape[0] > 600
    moved = Path(shutil.move(run_folder / "unavoided", tmp_path / "other"))
    draw(run_folder, "--out", tmp_path / "one.png")
    draw(run_folder, "--unavoided", moved, "--out", tmp_path / "given.png")
    assert (pixels(tmp_path / "given.png") == both).all()
    one = pixels(tmp_path / "one.png")
    assert one.shape != both.shape or (one != both).any()


def test_the_title_shows_the_closest_distances(run_folder: Path) -> None:
    """Closest 20 / sqrt(2) m with avoidance, 2 / sqrt(2) m without."""
    (run_folder / "summary.json").write_text(json.dumps({"delay_s": [0.5, 2]}))
    run = read_run(run_folder)
    avoided = flown(run)
    pairs = separations(avoided.paths)
    before = separations(flown(read_run(run_folder / "unavoided")).paths)
    words = picture.lateness(run)
    assert picture.title(avoided, pairs, before, words) == (
        "2 aircraft, Remote ID delayed by 0.5 to 2 s: closest 14.1 m with avoidance, 1.4 m without"
    )
    assert picture.title(avoided, pairs, [], "") == "2 aircraft: closest 14.1 m with avoidance"


@pytest.mark.parametrize("summary", [{}, {"delay_s": 3}, {"delay_s": ["a", "b"]}, {"delay_s": [1.0]}])
def test_a_run_without_a_configured_delay(run_folder: Path, summary: object) -> None:
    (run_folder / "summary.json").write_text(json.dumps(summary))
    assert picture.lateness(read_run(run_folder)) == ""


def test_the_picture_names_the_kind_of_positions(
    run_folder: Path, tmp_path: Path, made: SimpleNamespace, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    made.write_truth(run_folder, "DMUCA001", made.northbound)
    made.write_truth(run_folder, "DMUCA002", made.eastbound(20.0))
    draw(run_folder, "--out", tmp_path / "p.png")
    assert "distances from true positions and own GNSS positions" in capsys.readouterr().out


def test_one_aircraft_makes_no_picture(run_folder: Path, tmp_path: Path) -> None:
    (run_folder / "DMUCA002.events").unlink()
    with pytest.raises(ConfigError, match="no two aircraft"):
        draw(run_folder, "--out", tmp_path / "p.png")


@pytest.mark.parametrize("name", ["no/such/folder.png", "picture.unknown"])
def test_an_unwritable_picture_is_reported(run_folder: Path, tmp_path: Path, name: str) -> None:
    pytest.importorskip("matplotlib")
    with pytest.raises(ConfigError, match="cannot be written"):
        draw(run_folder, "--out", tmp_path / name)


def test_missing_matplotlib_is_one_line_of_advice(
    run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ConfigError, match=r"in the checkout: pip install -e '\.\[inspect\]'"):
        draw(run_folder, "--out", tmp_path / "p.png")
