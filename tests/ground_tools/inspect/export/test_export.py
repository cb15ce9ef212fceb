"""`ground-tools export`: tables, KML, and scenarios that fly an incident again."""

import argparse
import csv
import dataclasses
import json
import math
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
import tomli_w
from mcap.reader import make_reader
from mcap.records import Message
from rosbags.highlevel import AnyReader

from companion.config import AvoidanceConfig, Config, IdentityConfig
from companion.errors import ConfigError
from companion.geometry import LocalFrame
from companion.toml_reader import without_none
from ground_tools.inspect.explain import manoeuvres
from ground_tools.inspect.export import export, incident
from ground_tools.inspect.export.kml import GX, KML
from ground_tools.inspect.read.flown import flown
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.report.summary import describe
from sitl_mocks.air.air_settings import AirSettings
from sitl_mocks.encounters import demo, scenario_file
from sitl_mocks.encounters.lockstep import fly
from sitl_mocks.encounters.scenario_file import PathSettings, Scenario, VehicleSettings
from sitl_mocks.encounters.verdict import pairs_of
from tests.ground_tools.inspect.flights import decision, guarded, step, track, write
from tests.ground_tools.inspect.read.test_read_tlog import with_utc
from tests.ground_tools.inspect.test_inputs import write_tlog
from tests.support.place import HOME

SEED = 3


def mcap_messages(path: Path) -> list[Message]:
    with path.open("rb") as stream:
        return [message for _, _, message in make_reader(stream).iter_messages()]


def run_export(*arguments: object) -> int:
    parser = argparse.ArgumentParser()
    export.add_arguments(parser)
    return export.run(parser.parse_args([str(a) for a in arguments]))


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def least_m(file: Path, seed: int = 1, law: str | None = None) -> float:
    """Least separation (m) in a flight of a scenario file."""
    return min(pair.min_separation_m for pair in pairs_of(fly(scenario_file.load(file), seed, law=law)))


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a demo: a crossing with noise, wind and delay, flown with and without avoidance."""
    scenario = Scenario(
        aircraft=2,
        path=(
            PathSettings(points=((0.0, -66.0, 0.0, -60.0), (44.0, 66.0, 0.0, -60.0))),
            PathSettings(points=((0.0, 3.0, -66.0, -62.0), (44.0, 3.0, 66.0, -62.0))),
        ),
        vehicle=VehicleSettings(wind_ned_mps=(1.0, -2.0, 0.0)),
        air=AirSettings(delay_s=(0.5, 1.0)),
        avoidance=AvoidanceConfig(conflict_radius_m=6.0),
    )
    folder = tmp_path_factory.mktemp("simulated")
    (folder / "unavoided").mkdir()
    (folder / "config.toml").write_text(tomli_w.dumps(without_none(msgspec.to_builtins(scenario))))
    (folder / "manifest.json").write_text(json.dumps({"seed": SEED}))
    summary = {}
    for avoided, where in ((True, folder), (False, folder / "unavoided")):
        outcome = demo._fly_one(scenario, SEED, 0, avoided=avoided, folder=where)
        summary[where.name] = outcome.min_separation_m
    assert summary[folder.name] > 12.0 > summary["unavoided"]
    (folder / "least.json").write_text(json.dumps(list(summary.values())))
    return folder


@pytest.mark.parametrize("which", [0, 1])
def test_an_incident_flown_again_comes_as_close(simulated: Path, tmp_path: Path, which: int) -> None:
    """This holds with and without avoidance. The seed makes no difference, because nothing is random."""
    folder = (simulated, simulated / "unavoided")[which]
    was_m = json.loads((simulated / "least.json").read_text())[which]
    file = tmp_path / "incident.toml"
    assert run_export(folder, "--scenario", file) == 0
    assert least_m(file) == pytest.approx(was_m, abs=0.5)
    assert scenario_file.load(file).avoidance.conflict_radius_m == 6.0
    assert scenario_file.load(file).air.delay_s == (0.5, 1.0)


@pytest.mark.parametrize("which", [0, 1])
def test_planned_paths_with_the_same_seed_are_the_same_run(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], which: int
) -> None:
    folder = (simulated, simulated / "unavoided")[which]
    was_m = json.loads((simulated / "least.json").read_text())[which]
    file = tmp_path / "planned.toml"
    assert run_export(folder, "--scenario", file, "--planned") == 0
    assert f"--seed {SEED}" in capsys.readouterr().out
    assert least_m(file, SEED) == pytest.approx(was_m, abs=0.05)


@pytest.mark.parametrize(("which", "least"), [(".", 14.14), ("unavoided", 1.41)])
def test_without_true_positions_own_positions_are_exported(
    run_folder: Path, tmp_path: Path, which: str, least: float
) -> None:
    """The records contain only positions, as two telemetry logs would."""
    file = tmp_path / "incident.toml"
    run_export(run_folder / which, "--scenario", file)
    assert least_m(file) == pytest.approx(least, abs=0.5)
    scenario = scenario_file.load(file)
    assert scenario.avoidance.law == "none"
    assert max(point[3] for path in scenario.path for point in path.points) <= -incident.LOWEST_M


def test_five_that_meet_come_as_close_again(tmp_path: Path) -> None:
    """As in S2, all pass one point. The closest of ten pairs is compared."""
    around = [(math.cos(2.0 * math.pi * k / 5), math.sin(2.0 * math.pi * k / 5)) for k in range(5)]
    scenario = Scenario(
        aircraft=5,
        path=tuple(
            PathSettings(points=((0.0, -60.0 * n, -60.0 * e, -60.0), (30.0, 60.0 * n, 60.0 * e, -60.0)))
            for n, e in around
        ),
        air=AirSettings(delay_s=(0.0, 1.0)),
    )
    folder = tmp_path / "five"
    folder.mkdir()
    was_m = demo._fly_one(scenario, SEED, 0, avoided=True, folder=folder).min_separation_m
    file = tmp_path / "incident.toml"
    assert run_export(folder, "--scenario", file) == 0
    assert len(scenario_file.load(file).path) == 5
    assert least_m(file) == pytest.approx(was_m, abs=0.5)


def test_two_telemetry_logs_come_as_close_again(tmp_path: Path, made: SimpleNamespace) -> None:
    """The clock of one station is wrong by 30 s; the vehicles' UTC is used."""
    one = write_tlog(tmp_path / "one.tlog", made, made.northbound)
    two = write_tlog(tmp_path / "two.tlog", made, made.eastbound(6.0), late_s=30.0)
    file = tmp_path / "incident.toml"
    assert run_export(one, two, "--scenario", file) == 0
    assert least_m(file) == pytest.approx(6.0 / 2**0.5, abs=0.5)


def test_delays_are_estimated_if_they_are_not_configured(simulated: Path, tmp_path: Path) -> None:
    """The time stamp of a Location has a resolution of 0.1 s, and a tick is 0.05 s."""
    for path in simulated.glob("DMUCA*"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    run = read_run(tmp_path)
    low, high = incident.flown_again(run, flown(run)).scenario.air.interval_s
    assert (low, high) == (pytest.approx(0.55, abs=0.15), pytest.approx(1.0, abs=0.15))


def test_runs_that_cannot_be_flown_again_are_reported(run_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="its record has no timed path; leave out --planned"):
        run_export(run_folder, "--scenario", tmp_path / "x.toml", "--planned")
    run = read_run(run_folder)
    fast = dataclasses.replace(flown(run))
    for path in fast.paths:
        path.position_ned_m[:, :2] *= 20.0
    with pytest.raises(ConfigError, match=r"flown 100\.0 m/s .*allowed: limits\.max_speed_mps up to 50"):
        incident.flown_again(run, fast)
    (run_folder / "DMUCA002.events").unlink()
    with pytest.raises(ConfigError, match="a scenario needs a pair"):
        run_export(run_folder, "--scenario", tmp_path / "x.toml")


def test_tables_contain_flown_and_received_positions(run_folder: Path, tmp_path: Path) -> None:
    assert run_export(run_folder / "unavoided", "--csv", tmp_path / "t") == 0
    table = rows(tmp_path / "t" / "tracks.csv")
    assert len(table) == 2 * (601 + 61)
    flown_rows = [r for r in table if (r["name"], r["source"]) == ("DMUCA001", "flown")]
    at_ten = flown_rows[100]
    assert (at_ten["time_utc"], float(at_ten["time_s"])) == ("2026-01-01T00:00:00.000Z", pytest.approx(10.0))
    # 5 m/s northbound, through the home's latitude at 30 s.
    assert float(at_ten["lat_deg"]) == pytest.approx(HOME.lat_deg - 100.0 / 111_190, abs=1e-6)
    assert float(at_ten["alt_msl_m"]) == pytest.approx(450.0, abs=0.01)
    (heard,) = {(r["name"], r["by"]) for r in table if r["source"] == "heard" and r["by"] == "DMUCA001"}
    assert heard == ("c2:00:00:00:00:02", "DMUCA001")
    (near,) = rows(tmp_path / "t" / "encounters.csv")
    assert (near["first"], near["second"], near["kept"]) == ("DMUCA001", "DMUCA002", "False")
    assert float(near["separation_m"]) == pytest.approx(2.0 / 2**0.5, abs=0.02)
    # Closer than 10 m for as long as sqrt(10^2 - 2^2/2) m at the relative 5 sqrt(2) m/s, on either side.
    assert float(near["end_s"]) - float(near["start_s"]) == pytest.approx(2 * 98**0.5 / 50**0.5, abs=0.11)


def test_parquet_holds_the_same(run_folder: Path, tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    run_export(run_folder, "--csv", tmp_path, "--parquet", tmp_path)
    for name in ("tracks", "encounters"):
        columns = pq.read_table(tmp_path / f"{name}.parquet").to_pydict()
        table = rows(tmp_path / f"{name}.csv")
        assert list(columns) == list(table[0])
        last = {key: values[-1] for key, values in columns.items()}
        assert (
            last["time_utc"].isoformat(timespec="milliseconds").replace("+00:00", "Z")
            == table[-1]["time_utc"]
        )
        assert last["time_s"] == pytest.approx(float(table[-1]["time_s"]))
        assert [len(values) for values in columns.values()] == [len(table)] * len(columns)
    assert columns["kept"] == [True]


def test_manoeuvres_hold_what_the_summary_tells(tmp_path: Path) -> None:
    """A guarded mission meets another one; its clock differs from the run's time line."""
    for config, steps in guarded():
        write(tmp_path, config, steps)
    run = read_run(tmp_path)
    (told,) = describe(run)["aircraft"][0]["manoeuvres"]
    assert run_export(tmp_path, "--csv", tmp_path, "--parquet", tmp_path) == 0
    (row,) = rows(tmp_path / "manoeuvres.csv")
    assert (row["name"], row["track"], row["guarded"]) == ("ONE", "TWO", "True")
    for column, key in (("time_s", "start_s"), *((key, key) for key in ("end_s", "regained_s"))):
        assert (row[column] == "") == (told[key] is None)
        assert row[column] == "" or float(row[column]) == pytest.approx(told[key])
    for key in ("time_to_closest_s", "closest_m"):
        assert float(row[key]) == pytest.approx(told[key])
    assert float(row["nearest_s"]) == pytest.approx(told["nearest"]["time_s"])
    (found,) = manoeuvres.find(run.aircraft[0])
    for what, velocity in (
        ("wanted", found.decision.wanted_ned_mps),
        ("most_chosen", found.strongest.chosen_ned_mps),
    ):
        axes = [float(row[f"{what}_{axis}_mps"]) for axis in ("north", "east", "down")]
        assert axes == pytest.approx(list(velocity))
    active = [space for space in told["half_spaces"] if space["active"]]
    assert [space["cause"] for space in json.loads(row["half_spaces"])] == [s["cause"] for s in active]
    assert json.loads(row["tracks"]) == ["TWO"]
    assert [row[key] for key in ("why", "done", "came")] == [told[key] for key in ("why", "done", "came")]
    others = rows(tmp_path / "alternatives.csv")
    assert [one["alternative"] for one in others] == [one["name"] for one in told["alternatives"]]
    assert {one["time_s"] for one in others} == {row["time_s"]}
    assert [float(one["closest_m"]) for one in others] == pytest.approx(
        [one["closest_m"] for one in told["alternatives"]]
    )
    pq = pytest.importorskip("pyarrow.parquet")
    (same,) = pq.read_table(tmp_path / "manoeuvres.parquet").to_pylist()
    assert list(same) == list(row)
    assert (same["guarded"], same["feasible"], same["done"]) == (True, True, row["done"])
    assert same["closest_m"] == pytest.approx(told["closest_m"])
    assert pq.read_table(tmp_path / "alternatives.parquet").num_rows == len(others)


def test_what_excludes_an_alternative_is_exported(tmp_path: Path) -> None:
    head_on = track(position_ned_m=(100.0, 0.0, -50.0))
    steps = [step(k / 5, decision(head_on, chosen=(4.0, 3.0, 0.0))) for k in range(20)]
    write(tmp_path, Config(identity=IdentityConfig(uas_id="ONE")), steps)
    (told,) = describe(read_run(tmp_path))["aircraft"][0]["manoeuvres"]
    run_export(tmp_path, "--csv", tmp_path)
    by = [json.loads(one["excluded_by"]) for one in rows(tmp_path / "alternatives.csv")]
    assert by == [dict(map(tuple, one["excluded_by"])) for one in told["alternatives"]]
    assert {"TWO"} in [set(one) for one in by]
    (space,) = json.loads(rows(tmp_path / "manoeuvres.csv")[0]["half_spaces"])
    assert space == {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in next(s for s in told["half_spaces"] if s["active"]).items()
        if key in ("cause", "normal_ned", "least_mps")
    }


def test_kml_is_what_google_earth_reads(run_folder: Path, tmp_path: Path) -> None:
    """Elements in the order of the schema's sequences; longitude first."""
    run_export(run_folder, "--kml", tmp_path / "run.kml")
    root = ET.parse(tmp_path / "run.kml").getroot()
    k, gx = f"{{{KML}}}", f"{{{GX}}}"
    assert root.tag == f"{k}kml"
    tracks = root.findall(f"{k}Document/{k}Folder/{k}Placemark/{gx}Track")
    assert len(tracks) == 2
    for one in tracks:
        tags = [child.tag for child in one]
        count = len(one.findall(f"{k}when"))
        assert tags == [f"{k}altitudeMode", *[f"{k}when"] * count, *[f"{gx}coord"] * count]
        assert one.findtext(f"{k}altitudeMode") == "absolute"
        assert count == 301
    lon, lat, alt = map(float, (tracks[0].findtext(f"{gx}coord") or "").split())
    assert (lon, lat, alt) == (
        pytest.approx(HOME.lon_deg),
        pytest.approx(47.39565, abs=1e-5),
        pytest.approx(450, abs=0.1),
    )
    (folder,) = [f for f in root.iter(f"{k}Folder") if f.findtext(f"{k}name") == "Closest approaches"]
    mark = folder.find(f"{k}Placemark")
    assert mark is not None
    assert [c.tag.removeprefix(k) for c in mark] == ["name", "description", "TimeStamp", "MultiGeometry"]
    assert mark.findtext(f"{k}name") == "DMUCA001 - DMUCA002: 14.1 m"
    assert mark.findtext(f"{k}TimeStamp/{k}when") == "2026-01-01T00:00:22.000Z"
    lon, lat, alt = map(float, (mark.findtext(f".//{k}Point/{k}coordinates") or "").split(","))
    assert 8.5 < lon < 8.6
    assert 47.3 < lat < 47.5


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), "there is nothing to write"),
        (("--planned",), "there is nothing"),
        (("--kml", "x", "--planned"), "allowed only with --scenario"),
    ],
)
def test_options_that_do_not_go_together(run_folder: Path, options: tuple[str, ...], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        run_export(run_folder, *options)


def test_the_place_of_a_closest_approach_is_between_both_at_the_antimeridian(
    tmp_path: Path, made: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "run"
    monkeypatch.setattr(sys.modules[made.write_events.__module__], "HOME", LocalFrame(10.0, 180.0, 5.0))
    flown = made.steps.__wrapped__
    made.write_events(run, "ONE", flown(made.northbound, made.eastbound(10.0)))
    made.write_events(run, "TWO", flown(made.eastbound(10.0), made.northbound))
    run_export(run, "--kml", tmp_path / "run.kml")
    (lon, _, _) = (
        ET.parse(tmp_path / "run.kml").getroot().findtext(f".//{{{KML}}}Point/{{{KML}}}coordinates") or ""
    ).split(",")
    assert abs(float(lon)) == pytest.approx(180.0, abs=0.01)


def test_a_run_without_utc_has_no_kml(tmp_path: Path, made: SimpleNamespace) -> None:
    other = made.eastbound(20.0)
    made.write_events(tmp_path, "a", made.steps(made.northbound, other, utc=False))
    with pytest.raises(ConfigError, match="KML needs UTC"):
        run_export(tmp_path, "--kml", tmp_path / "x.kml")
    run_export(tmp_path, "--csv", tmp_path)
    assert {row["time_utc"] for row in rows(tmp_path / "tracks.csv")} == {""}


def test_a_form_that_cannot_be_written_leaves_the_others(
    tmp_path: Path, made: SimpleNamespace, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without UTC there is no KML, and without a second aircraft no scenario; one exit code tells of both."""
    run = tmp_path / "run"
    run.mkdir()
    made.write_events(run, "a", made.steps(made.northbound, made.eastbound(20.0), utc=False))
    kml = ("--kml", tmp_path / "x.kml")
    scenario = ("--scenario", tmp_path / "x.toml")
    others = ("--csv", tmp_path, "--mcap", tmp_path / "x.mcap", "--rosbag", tmp_path / "bag")
    assert run_export(run, *kml, *scenario, *others) == 2
    printed = capsys.readouterr()
    skipped = printed.err.splitlines()
    assert [line.split(":")[0] for line in skipped] == ["skipped", "skipped"]
    assert "KML needs UTC" in skipped[0]
    assert "a scenario needs a pair" in skipped[1]
    assert rows(tmp_path / "tracks.csv")
    assert mcap_messages(tmp_path / "x.mcap")
    with AnyReader([tmp_path / "bag"]) as reader:
        assert reader.message_count
    for path in ("tracks.csv", "x.mcap", "bag"):
        assert f"wrote {tmp_path / path}: " in printed.out
    assert not (tmp_path / "x.kml").exists()
    assert not (tmp_path / "x.toml").exists()
    with pytest.raises(ConfigError, match="none of the files can be written"):
        run_export(run, *kml, *scenario)


@pytest.mark.parametrize("option", ["--csv", "--kml", "--scenario"])
def test_unwritable_files_are_reported(run_folder: Path, tmp_path: Path, option: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be"):
        run_export(run_folder, option, tmp_path / "file" / "inside")


@pytest.mark.parametrize(("jump_s", "told"), [(0.0, False), (3600.0, True)])
def test_a_clock_that_was_set_is_told_by_every_export(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], jump_s: float, told: bool
) -> None:
    words = "was set by about 3600 s"
    log = with_utc(tmp_path / "pi.tlog", {1: 0.0, 2: 0.0}, jump_s).folder
    for option, name in (("--csv", "csv"), ("--kml", "a.kml"), ("--mcap", "a.mcap"), ("--rosbag", "bag")):
        assert run_export(log, option, tmp_path / name) == 0
        assert capsys.readouterr().out.count(words) == (2 if told else 0)  # one line for each vehicle
    about = ET.parse(tmp_path / "a.kml").getroot().findtext(f"{{{KML}}}Document/{{{KML}}}description") or ""
    assert (words in about) is told
    assert (words.encode() in b"".join(m.data for m in mcap_messages(tmp_path / "a.mcap"))) is told
    with AnyReader([tmp_path / "bag"]) as reader:
        assert any(words.encode() in raw for _, _, raw in reader.messages()) is told
