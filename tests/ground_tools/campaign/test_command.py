"""`ground-tools campaign run`: output, stored results and refused input."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time

import msgspec
import pytest

from companion.errors import ConfigError
from ground_tools import cli
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import fences, tables
from ground_tools.campaign.cells import Cell, Row, fly
from ground_tools.campaign.generators import NAMES
from ground_tools.campaign.runs import summary
from ground_tools.common import table_file

S2 = ["campaign", "run", "--generator", "S2", "--delay", "1", "2", "--processes", "1"]


def row(seed, separation_m, deviation_m=10.0, recovery_s=8.0, lost=(), alerts=()):
    return Row(
        seed,
        separation_m,
        1.0,
        0,
        1,
        deviation_m,
        5.0,
        1.0,
        0.0,
        1.01,
        4.0,
        0.0,
        recovery_s,
        None,
        0.0,
        lost,
        alerts,
    )


def test_s2_keeps_separation_although_the_paths_do_not(capsys):
    assert cli.main([*S2, "--seeds", "1-12", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["runs"], found["losses_of_separation"], found["collisions"]) == (12, 0, 0)
    assert found["unavoided_losses_of_separation"] == 12
    assert found["risk_ratio"] == 0.0
    assert found["min_separation_m"] > campaign.SEPARATION_M
    assert 5.0 < found["median_max_deviation_m"] < 40.0
    assert found["flight_s"] == 2 * 12 * 500.0
    assert found["wall_s"] > 0.0


def test_numbers_of_a_cell():
    rows = [row(1, 1.5, 30.0), row(2, 9.9, 20.0), row(3, 10.0), row(4, 12.0)]
    found = summary(rows, [row(1, 1.0), row(2, 2.0), row(3, 5.0), row(4, 30.0)])
    assert (found["runs"], found["collisions"], found["losses_of_separation"]) == (4, 1, 2)
    assert (found["unavoided_collisions"], found["unavoided_losses_of_separation"]) == (1, 3)
    assert found["risk_ratio"] == pytest.approx((2 / 4) / (3 / 4))
    low, high = found["risk_ratio_interval"]
    assert low < found["risk_ratio"] < high
    assert (found["min_separation_m"], found["worst_seed"]) == (1.5, 1)
    assert found["median_max_deviation_m"] == 15.0
    assert summary([row(1, 20.0)], [row(1, 20.0)])["risk_ratio"] is None


def test_severity_duration_and_false_alerts():
    rows = [
        row(1, 4.0, alerts=(0, 2)),
        row(2, 9.0, recovery_s=None, alerts=(1,)),
        row(3, 20.0, recovery_s=2.0),
    ]
    unavoided = [row(1, 4.0, lost=(0, 1)), row(2, 4.0, lost=(1,)), row(3, 4.0, lost=(0,))]
    found = summary(rows, unavoided)
    assert (found["mean_severity"], found["max_severity"]) == pytest.approx(((0.6 + 0.1) / 2, 0.6))
    assert (found["median_recovery_s"], found["not_recovered"]) == (8.0, 1)
    # Only pair 2 of seed 1 would have kept its separation.
    assert (found["alerts"], found["false_alerts"], found["false_alert_share"]) == (3, 1, 1 / 3)
    never = summary([row(1, 20.0, recovery_s=None)], unavoided[:1])
    assert (never["mean_severity"], never["max_severity"]) == (None, None)
    assert (never["median_recovery_s"], never["false_alert_share"]) == (None, None)
    json.dumps(found, allow_nan=False)


def test_stored_flights_are_not_flown_again(tmp_path, capsys, monkeypatch):
    out = ["--out", str(tmp_path / "kept"), "--json"]
    assert cli.main([*S2, "--seeds", "1-3", *out]) == 0
    first = json.loads(capsys.readouterr().out)
    flown = []
    monkeypatch.setattr(
        "ground_tools.campaign.runs.in_parallel", lambda f, items, *_: flown.extend(items) or []
    )
    assert cli.main([*S2, "--seeds", "1-3", *out]) == 0
    again = json.loads(capsys.readouterr().out)
    assert flown == []
    assert again["flight_s"] == 0.0
    for key in ("wall_s", "flight_s"):
        del first[key], again[key]
    assert first == again


def test_a_torn_line_is_flown_again_and_other_software_is_refused(tmp_path, capsys):
    out = [*S2, "--seeds", "1-3", "--json", "--out", str(tmp_path)]
    assert cli.main(out) == 0
    first = json.loads(capsys.readouterr().out)
    (path,) = tmp_path.glob("S2-5-dmuca-*.jsonl")
    whole = path.read_text()
    path.write_text(whole[:-20])
    assert cli.main(out) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["flight_s"] == 500.0
    assert again["min_separation_m"] == first["min_separation_m"]
    path.write_text(whole.replace('"software": "', '"software": "0'))
    assert cli.main(out) == 2
    assert "made with other settings (software: 0" in capsys.readouterr().err


def test_cells_that_differ_have_files_that_differ(tmp_path):
    cell = Cell(generator="S2", aircraft=5)
    others = [
        Cell(generator="S2", aircraft=5, law="paper"),
        Cell(generator="S2", aircraft=5, delay_s=(1.0, 2.0)),
        Cell(generator="S2", aircraft=5, loss=0.8),
        Cell(generator="S2", aircraft=5, intruders=0.2),
        Cell(generator="S2", aircraft=5, speed_mps=20.0),
    ]
    assert len({c.name for c in [cell, *others]}) == 6
    assert len({campaign.baseline(c).name for c in [cell, *others]}) == 2  # the speed


def test_blind_intruders_do_not_avoid():
    """If all aircraft are blind intruders, the flights equal those without avoidance."""
    cell = Cell(generator="crossing", aircraft=2, intruders=1.0)
    seen = campaign.fly(cell, range(1, 4))
    unavoided = campaign.fly(Cell(generator="crossing", aircraft=2, law="none", intruders=1.0), range(1, 4))
    assert [r.separation_m for r in seen] == [r.separation_m for r in unavoided]
    half = campaign.fly(Cell(generator="crossing", aircraft=2, intruders=0.5), range(1, 4))
    assert min(r.separation_m for r in half) > max(r.separation_m for r in seen)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--seeds", "5"], "--seeds: 5 is not allowed; allowed: a rising range"),
        (["--seeds", "9-1"], "--seeds: 9-1 is not allowed; allowed: a rising range"),
        (["--aircraft", "1"], "--aircraft: 1 is out of range; allowed: 2 to 200"),
        (["--delay", "2", "1"], "--delay: 2 1 is not allowed; allowed: two rising numbers from 0 to 60"),
        (["--delay", "nan", "1"], "--delay: nan 1 is not allowed; allowed: two rising"),
        (["--loss", "1.5"], "--loss: 1.5 is out of range; allowed: 0 to 1"),
        (["--intruders", "-1"], "--intruders: -1 is out of range; allowed: 0 to 1"),
        (["--speed", "nan"], "--speed: nan is out of range; allowed: 1 to 50"),
        (["--rate", "21"], "--rate: 21 is out of range; allowed: 1 to 20"),
        (["--signal", "--worst", "1"], "--worst cannot be combined with --signal"),
        (
            ["--signal", "--intruder", "twin", "--intruders", "0.2"],
            "--signal cannot be combined with --intruder",
        ),
        (["--processes", "0"], "--processes: 0 is out of range; allowed: 1 to 1024"),
        (["--out", "/dev/null/here"], "/dev/null/here"),
        (["--aircraft", "60", "--generator", "circle"], "seed 1: generator circle: it cannot place 60"),
    ],
)
def test_what_is_wrong_is_named(options, words, capsys):
    assert cli.main([*S2, *options]) == 2
    assert words in capsys.readouterr().err


def test_ctrl_c_keeps_what_was_flown(tmp_path):
    command = [sys.executable, "-m", "ground_tools.cli", *S2, "--seeds", "1-200000", "--out", str(tmp_path)]
    command += ["--processes", "2"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    end = time.monotonic() + 300.0
    while time.monotonic() < end and not any(p.stat().st_size > 2000 for p in tmp_path.glob("*.jsonl")):
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)
    _, words = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Interrupted" in words
    (path,) = tmp_path.glob("S2-5-dmuca-*.jsonl")
    assert len(path.read_text().splitlines()) > 1


# ---------------------------------------------------------------- fences


def test_attacks_on_fences_are_shown_as_a_table_and_as_json(capsys):
    words = ["campaign", "fences", "--seeds", "1-4", "--processes", "1"]
    for options in ([], ["--outside"]):
        assert cli.main([*words, *options, "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert cli.main([*words, *options]) == 0
        printed = capsys.readouterr().out
        assert found["runs"] == 4
        assert printed == (fences.markdown_outside(found) if options else fences.markdown(found))


def test_crossed_fences_by_hand():
    crossing = fences.Row(
        seed=7,
        others="ghosts",
        shape="in circle",
        crossed_m=2.25,
        error_m=0.25,
        further_m=2.25,
        back_s=3.14,
        could_stop=True,
        avoidable=True,
    )
    swerve = msgspec.structs.replace(crossing, seed=8, crossed_m=4.25, could_stop=False)
    lost = msgspec.structs.replace(crossing, seed=9, others="none", could_stop=False, avoidable=False)
    rows = [crossing, swerve, lost, msgspec.structs.replace(lost, seed=10, crossed_m=0.0)]
    printed = fences.markdown(fences.summary(rows)).splitlines()
    assert printed[2] == "| none | 2 | 0 | 0.00 | 0 | 0.00 | 1 | - |"
    assert printed[3] == "| honest | 0 | 0 | 0.00 | 0 | 0.00 | 0 | - |"
    assert printed[5] == "| ghosts | 2 | 1 | 2.00 | 1 | 4.00 | 0 | 8 |"
    never = msgspec.structs.replace(crossing, seed=11, further_m=4.0, back_s=math.inf)
    printed = fences.markdown_outside(fences.summary_outside([crossing, never])).splitlines()
    assert printed[2] == "| 2 | 3.12 | 3.98 | 4.00 | 3.1 | 1 | 11 |"
    printed = fences.markdown_outside(fences.summary_outside([never])).splitlines()
    assert printed[2] == "| 1 | 4.00 | 4.00 | 4.00 | - | 1 | 11 |"


# ---------------------------------------------------------------- tables


def test_a_table_has_a_line_for_each_cell(tmp_path, capsys):
    file = tmp_path / "fast.json"
    words = ["campaign", "table", "fast", "--seeds", "1-2", "--processes", "1", "--file", str(file)]
    assert cli.main(words) == 0
    printed = capsys.readouterr().out
    kept = table_file.read(file, tables.Kept)
    reserved = [line.cell for line in kept.lines if line.cell.reserve]
    assert [cell.generator for cell in reserved] == list(NAMES)
    assert {cell.speed_mps for cell in reserved} == {20.0}
    assert [line.cell.generator for line in kept.lines[len(reserved) :]] == [n for n in NAMES if n != "lift"]
    assert (kept.seeds, kept.software) == ((1, 2), campaign.software())
    assert printed == tables.markdown(kept.lines)
    assert all(line.found["min_separation_m"] > 10.0 for line in kept.lines)


def test_columns_of_what_differs():
    rows = [row(1, 9.0), row(2, 12.5)]
    cells = [Cell(generator="S1", aircraft=5, intruders=0.2), Cell(generator="S1", aircraft=5, law="paper")]
    lines = [tables.Line(cell=cell, found=summary(rows, rows)) for cell in cells]
    head, _, first, second = tables.markdown(lines).splitlines()
    assert head.startswith("| law | intruders | runs | below 10 m |")
    assert "| least separation (m) | mean severity | deviation (m) |" in head
    assert first == (
        "| dmuca | 20% blind | 2 | 1 | 0 | 1, 0 | 1.0000 (0.1891 to 1.8109) | 9.00 | 0.10 | 10 | 8 | 0, 0 |"
    )
    assert second.startswith("| paper | none | 2 |")
    apart = [row(1, 11.0)]
    kept = tables.Line(cell=cells[0], found=summary(apart, apart))
    assert "severity" not in tables.markdown([kept])


def test_a_damaged_table_is_reported(tmp_path):
    file = tmp_path / "table.json"
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        table_file.read(file, tables.Kept)
    file.write_text('{"software": "x", "seeds": [1, 2], "lines": [{}]}')
    with pytest.raises(ConfigError, match=r"not a table of a campaign: .*lines"):
        table_file.read(file, tables.Kept)


def test_crewed_traffic_fences_and_lateness_have_figures():
    crewed = Cell(generator="random", aircraft=4, delay_s=(1.0, 2.0), intruders=0.25, intruder="crewed")
    ours, alone = fly(crewed, range(1, 5)), fly(campaign.baseline(crewed), range(1, 5))
    found = summary(ours, alone)
    assert (found["crewed_losses"], found["unavoided_crewed_losses"]) == (0, 4)
    assert found["min_crewed_separations"] > 1.0
    line = tables.Line(cell=crewed, found=found)
    assert "| 0, 4 |" in tables.markdown([line])
    beside = Cell(generator="head-on", aircraft=4, delay_s=(1.0, 2.0), world="fence")
    found = summary(fly(beside, range(1, 5)), fly(campaign.baseline(beside), range(1, 5)))
    assert found["max_beyond_fence_m"] == 0.0
    assert found["min_crewed_separations"] is None
    full = Cell(generator="overtaking", aircraft=4, delay_s=(1.0, 2.0), reserve=False)
    rows = fly(full, range(1, 5))
    assert all(row.lost_s > 0.0 and row.back_m < 15.0 for row in rows)


def test_a_fence_needs_paths_along_one_line():
    with pytest.raises(ConfigError, match="head-on or overtaking"):
        fly(Cell(generator="circle", aircraft=4, world="fence"), [1])


@pytest.mark.parametrize("world", ["blackout", "mute"])
def test_an_aircraft_without_gnss_falls_behind_its_path(world):
    """An aircraft is away from its timed point for longer than in calm conditions, and by more than 15 m."""
    dark = Cell(generator="random", aircraft=4, delay_s=(1.0, 2.0), world=world)
    rows = fly(dark, range(1, 9))
    calm = fly(msgspec.structs.replace(dark, world="calm"), range(1, 9))
    assert all(a.away_s > b.away_s for a, b in zip(rows, calm, strict=True))
    assert all(row.deviation_m > 15.0 for row in rows)


def test_an_aircraft_that_reports_the_loss_of_its_position_is_kept_clear_of():
    """The seeds are those of 300 with the least separations from an aircraft that falls silent instead."""
    told = Cell(generator="crossing", aircraft=5, delay_s=(1.0, 2.0), world="blackout")
    mute = msgspec.structs.replace(told, world="mute")
    told_m, mute_m = ([row.separation_m for row in fly(cell, [84, 95, 107, 154])] for cell in (told, mute))
    assert min(mute_m) < 8.0
    assert min(told_m) > 9.0
    assert sum(told_m) > sum(mute_m) + 4.0


@pytest.mark.parametrize(
    "words", [["table", "twenty"], ["peers", "table", "encounters"], ["scenarios", "lanes-20"]]
)
def test_a_file_that_cannot_be_written_is_refused_before_the_flights(words, tmp_path, monkeypatch, capsys):
    def fly(*_: object) -> None:
        raise AssertionError("it flies")

    for name in ("ground_tools.campaign.cells.fly", "ground_tools.campaign.cells.look"):
        monkeypatch.setattr(name, fly)
    file = str(tmp_path / "nowhere" / "table.json")
    assert cli.main(["campaign", *words, "--processes", "1", "--file", file]) == 2
    assert f"--file: {file}: cannot be written: No such file or directory" in capsys.readouterr().err


def test_the_check_of_a_file_leaves_it_as_it_is(tmp_path):
    file = tmp_path / "table.json"
    table_file.check_writable(file)
    assert not file.exists()
    file.write_text("kept")
    table_file.check_writable(file)
    assert file.read_text() == "kept"
