"""Whole encounters in virtual time, over real bytes."""

from __future__ import annotations

import itertools
import json

import msgspec
import numpy as np
import pytest

from companion.autopilot.tlog import read_tlog
from companion.events import AuthorityChanged
from sitl_mocks import cli
from sitl_mocks.air.air_settings import AirSettings
from sitl_mocks.encounters import lockstep, scenario_file
from sitl_mocks.encounters.lockstep import Flown, Run
from sitl_mocks.encounters.scenario_file import PathSettings, Scenario
from sitl_mocks.encounters.swarm import window
from sitl_mocks.encounters.verdict import deviations_of, on_path_limit_m, pairs_of

HEAD_ON = Scenario(
    path=(
        PathSettings(points=((0.0, -54.0, 0.0, -60.0), (36.0, 54.0, 0.0, -60.0))),
        PathSettings(points=((0.0, 54.0, 0.0, -60.0), (36.0, -54.0, 0.0, -60.0))),
    )
)


def middle_of(kind, seed, seconds):
    """The middle part of a drawn encounter, which contains the conflict, as a scenario."""
    whole = msgspec.structs.replace(scenario_file.DEFAULT, geometry=kind)
    paths = tuple(
        PathSettings(points=tuple(map(tuple, window(p, seconds).tolist())))
        for p in lockstep.paths_of(whole, seed)
    )
    return msgspec.structs.replace(scenario_file.DEFAULT, geometry=None, path=paths)


def with_delay(scenario, low, high, **air):
    return msgspec.structs.replace(
        scenario, air=msgspec.structs.replace(scenario.air, delay_s=(low, high), **air)
    )


def least(run):
    return min(p.min_separation_m for p in pairs_of(run))


def least_as_planned(paths):
    """Least separation of aircraft that are exactly on their paths."""
    at = np.linspace(paths[0][0, 0], paths[0][-1, 0], 2000)
    places = [np.array([np.interp(at, p[:, 0], p[:, c]) for c in (1, 2, 3)]) for p in paths]
    return min(np.linalg.norm(a - b, axis=0).min() for a, b in itertools.combinations(places, 2))


@pytest.mark.parametrize(
    ("kind", "seed", "seconds", "delay"), [("S2", 3, 80.0, (0.0, 1.0)), ("S3", 5, 95.0, (2.0, 3.0))]
)
def test_five_aircraft_keep_apart_and_return(kind, seed, seconds, delay):
    scenario = with_delay(middle_of(kind, seed, seconds), *delay)
    paths = lockstep.paths_of(scenario, seed)
    assert least_as_planned(paths) < 10.0
    run = lockstep.fly(scenario, seed)
    assert least(run) > 10.0
    for deviation in deviations_of(run, paths, on_path_limit_m(scenario)):
        assert deviation.final_m < on_path_limit_m(scenario)
        assert deviation.largest_m > 3.0


def test_what_the_air_does_not_carry_nobody_knows():
    """With all messages lost the aircraft collide, because no state is exchanged in another way."""
    lost = with_delay(HEAD_ON, 0.0, 0.0, loss=1.0)
    assert least(lockstep.fly(lost, 1)) < 6.0
    assert least(lockstep.fly(with_delay(HEAD_ON, 0.0, 0.0), 1)) > 10.0


@pytest.mark.parametrize(
    ("transport", "firmware"), [("wifi", "ardupilot"), ("ble4", "px4"), ("ble5", "ardupilot"), ("nan", "px4")]
)
def test_every_transport_and_firmware_avoids_head_on(transport, firmware):
    scenario = with_delay(HEAD_ON, 0.0, 1.0, transports=(transport,))
    vehicle = msgspec.structs.replace(scenario.vehicle, firmware=firmware)
    assert least(lockstep.fly(msgspec.structs.replace(scenario, vehicle=vehicle), 1)) > 10.0


def test_the_same_seed_gives_the_same_run_and_another_seed_another():
    scenario = msgspec.structs.replace(HEAD_ON, duration_s=20.0)
    a, b, c = (lockstep.fly(scenario, seed) for seed in (1, 1, 2))
    for first, second, third in zip(a.aircraft, b.aircraft, c.aircraft, strict=True):
        np.testing.assert_array_equal(first.position_ned_m, second.position_ned_m)
        assert np.abs(first.position_ned_m - third.position_ned_m).max() > 0.1


@pytest.mark.parametrize(
    ("model", "transport", "rate"),
    [("analytic", "wifi", 5), ("packets", "wifi", 5), ("packets", "ble4", 9), ("analytic", "ble5", 10)],
)
def test_delays_come_out_of_the_channel(model, transport, rate):
    """No interval is given; the pair keeps apart by what the channel lets through, and is as old as that."""
    air = AirSettings(model=model, transports=(transport,), rate=rate)
    scenario = msgspec.structs.replace(HEAD_ON, air=air)
    run = lockstep.fly(scenario, 1)
    assert least(run) > 10.0
    assert set(run.air) == {("DMUCA001", "DMUCA002"), ("DMUCA002", "DMUCA001")}
    for pair in run.air.values():
        # At most a quarter of a single event's packets fall into a window.
        assert 0.03 < pair.delivered / pair.sent < 0.32
        # Frames that are lost make the age longer than the time between two of them.
        assert 1.5 / rate < pair.information_age_mean_s < 4.0
        assert pair.age_max_s < 0.2
        # Counted from the first position heard to the last tick.
        assert pair.first_heard_s + pair.observed_s == pytest.approx(run.time_s[-1] - run.time_s[0])
    if transport == "wifi":  # once for each model
        assert lockstep.fly(scenario, 1).air == run.air


def test_wind_and_the_papers_law_fly():
    wind = msgspec.structs.replace(HEAD_ON.vehicle, wind_ned_mps=(3.0, 4.0, 0.0))
    scenario = msgspec.structs.replace(HEAD_ON, vehicle=wind)
    assert least(lockstep.fly(scenario, 1)) > 10.0
    states = set()

    def record(name, config):
        return lambda step: states.update(c.state for c in step.commands if isinstance(c, AuthorityChanged))

    run = lockstep.fly(scenario, 1, law="paper", record=record)
    assert "avoiding" in states
    assert least(run) > least(lockstep.fly(scenario, 1, law="none"))


# ---------------------------------------------------------------- the verdict


def run_of(*tracks):
    time_s = np.arange(len(tracks[0])) * 0.05
    return Run([Flown(f"A{n}", np.asarray(t, float)) for n, t in enumerate(tracks)], {}, time_s, {})


def test_separation_between_ticks():
    """Two aircraft that pass each other between two samples."""
    a = [(x, 0.0, 0.0) for x in (-3.0, -1.0, 1.0, 3.0)]
    b = [(-x, 0.5, 0.0) for x in (-3.0, -1.0, 1.0, 3.0)]
    (pair,) = pairs_of(run_of(a, b))
    assert pair.min_separation_m == pytest.approx(0.5)


def test_deviation_and_return():
    path = np.array([[0.0, 0.0, 0.0, 0.0], [1.0, 10.0, 0.0, 0.0]])
    away = [0.0, 2.0, 8.0, 4.0] + [1.0] * 17
    track = [(10.0 * 0.05 * k, away[k], 0.0) for k in range(21)]
    (deviation,) = deviations_of(run_of(track), [path], 3.0)
    assert deviation.largest_m == pytest.approx(8.0)
    assert deviation.final_m == pytest.approx(1.0)
    assert deviation.back_s == pytest.approx(0.1)


# ---------------------------------------------------------------- the command


def demo(*arguments):
    return cli.main(["demo", *map(str, arguments)])


def write(folder, text):
    path = folder / "s.toml"
    path.write_text(text)
    return path


SHORT = """duration_s = 12.0
[[path]]
points = [[0.0, -25.0, {east}, -60.0], [12.0, 25.0, {east}, -60.0]]
[[path]]
points = [[0.0, 25.0, 0.0, -60.0], [12.0, -25.0, 0.0, -60.0]]
"""


def test_seeds_as_json_lines_and_exit_code(tmp_path, capsys):
    apart = write(tmp_path, SHORT.format(east=60.0))
    assert demo("--scenario", apart, "--seeds", "1-2", "--json") == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["seed"] for line in lines] == [1, 2]
    assert set(lines[0]) == {
        "seed",
        "delay_s",
        "aircraft",
        "min_separation_m",
        "unavoided_min_separation_m",
        "max_deviation_m",
        "final_deviation_m",
        "ok",
    }


@pytest.mark.usefixtures("one_worker")
def test_an_encounter_that_fails_has_another_exit_code(tmp_path, capsys):
    together = write(tmp_path, SHORT.format(east=0.0))
    assert demo("--scenario", together, "--seeds", "1-1", "--law", "none", "--json") == 1
    assert json.loads(capsys.readouterr().out)["ok"] is False


@pytest.mark.usefixtures("one_worker")
def test_a_channel_model_flies_by_the_command_and_says_so(tmp_path, capsys):
    scenario = write(tmp_path, SHORT.format(east=60.0))
    parameters = tmp_path / "p.toml"
    parameters.write_text('wifi_channels = "random"\n')
    words = ["--channel", "packets", "--parameters", parameters, "--runs", tmp_path / "runs", "--json"]
    assert demo("--scenario", scenario, *words) == 0
    line = json.loads(capsys.readouterr().out)
    assert line["channel"] == "packets"
    assert "delay_s" not in line
    (folder,) = (tmp_path / "runs").iterdir()
    flown = scenario_file.load(folder / "config.toml")
    assert (flown.air.model, flown.channel.wifi_channels) == ("packets", "random")
    assert len(json.loads((folder / "summary.json").read_text())["air"]) == 2


@pytest.mark.usefixtures("one_worker")
def test_a_run_folder_is_whole(tmp_path, capsys):
    scenario = write(tmp_path, SHORT.format(east=60.0))
    assert demo("--scenario", scenario, "--runs", tmp_path / "runs") == 0
    (folder,) = (tmp_path / "runs").iterdir()
    names = {path.name for path in folder.iterdir()}
    assert {"config.toml", "manifest.json", "summary.json", "DMUCA001.events", "unavoided"} <= names
    with (folder / "DMUCA001.tlog").open("rb") as stream:
        frames = list(read_tlog(stream, "tlog"))
    assert {(frame[5], frame[6]) for _, frame in frames} == {(1, 1), (1, 191)}
    # From the start to the end of the run; the guess before the vehicle tells UTC is good to a tick.
    times = [utc_s for utc_s, _ in frames]
    assert all(b - a > -0.1 for a, b in itertools.pairwise(times))
    assert times[0] == pytest.approx(lockstep.UTC_AT_START_S, abs=0.1)
    assert times[-1] - times[0] == pytest.approx(15.0, abs=0.2)
    assert scenario_file.load(folder / "config.toml").duration_s == 12.0
    summary = json.loads((folder / "summary.json").read_text())
    assert [(row["sender"], row["receiver"]) for row in summary["air"]] == [
        ("DMUCA001", "DMUCA002"),
        ("DMUCA002", "DMUCA001"),
    ]
    for row in summary["air"]:
        assert row["transports"] == {"wifi": {"sent": row["sent"], "delivered": row["delivered"]}}
        assert row["first_heard_s"] < 3.0
        # Once a second, 0 to 1 s on the way.
        assert 0.4 < row["information_age_mean_s"] < row["information_age_max_s"] < 3.0
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["seed"] == 1
    assert "numba" in manifest["versions"]
    out = capsys.readouterr().out
    assert "ground-tools inspect" in out
    from companion.commands import cli as companion_cli

    assert companion_cli.main(["replay", str(folder)]) == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["--channel", "packets", "--delay", "0", "1"],
            "--delay: allowed only with --channel interval",
        ),
        (["--delay", "2", "1"], "--delay: 2 1 is out of range; allowed: 0 <= LOW <= HIGH <= 60"),
        (["--seed", "-1"], "--seed: -1 is out of range; allowed: 0 or more"),
        (["--aircraft", "1"], "--aircraft: 1 is out of range; allowed: 2 to 100"),
        (["--seeds", "5-1"], "--seeds: '5-1' is not a range of seeds; allowed: A-B"),
        (["--scenario", "/nowhere.toml"], "/nowhere.toml: cannot be read"),
        (["--scenario", "headon"], "come with the software: atmc, head_on, "),
    ],
)
def test_wrong_options_are_one_line_and_exit_code_2(capsys, arguments, words):
    assert demo(*arguments) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "give either geometry or path"),
        ('geometry = "S9"\n', "geometry: 'S9': allowed: 'S1', 'S2', 'S3'"),
        (
            'geometry = "S2"\n[air]\nlos = 1\n',
            "air.los: unknown key; did you mean loss? allowed here: model, parameters, delay_s, loss",
        ),
        (
            "[[path]]\npoints = [[0.0, 0.0, 0.0, -9.0], [0.0, 1.0, 0.0, -9.0]]\n"
            "[[path]]\npoints = [[0.0, 0.0, 0.0, -9.0], [9.0, 1.0, 0.0, -9.0]]\n",
            "path[0].points: time 0 s is not after 0 s",
        ),
        ("[[path]]\npoints = [[0.0, 0.0, 0.0, -9.0], [9.0, 1.0, 0.0, -9.0]]\n", "there is only one path"),
    ],
)
def test_a_wrong_scenario_is_one_line_and_exit_code_2(tmp_path, capsys, text, words):
    assert demo("--scenario", write(tmp_path, text)) == 2
    assert words in capsys.readouterr().err


def test_the_scenarios_in_the_project_load():
    from pathlib import Path

    files = sorted((Path(__file__).parents[3] / "config" / "scenarios").glob("*.toml"))
    assert files
    for file in files:
        scenario_file.load(file)
    assert scenario_file.load(next(f for f in files if f.name == "s2.toml")) == scenario_file.DEFAULT
