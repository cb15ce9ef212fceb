"""A campaign on a Ray cluster: the same rows, and messages about lost workers, errors and interruptions."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from companion.errors import ConfigError
from ground_tools import cli
from ground_tools.campaign import runs
from ground_tools.campaign.encounters import command as encounters
from ground_tools.city.cells import City, Row, fly
from ground_tools.city.traffic.demand import Demand
from ground_tools.common.cluster import on_ray
from tests.support.encounter_models import TINY

RUN = ["campaign", "run", "--generator", "crossing", "--aircraft", "3", "--seeds", "1-100"]


def state() -> str:
    return "the same"


def other_state() -> str:
    return f"process {os.getpid()}"


def square(number: int) -> int:
    if number < 0:
        raise ConfigError(f"number {number} is wrong")
    return number * number


def killed_once(marker: str) -> str:
    if not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return marker


def killed(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.fixture(scope="module")
def address():
    """Address of a cluster of two nodes on this machine, one CPU each."""
    pytest.importorskip("ray", reason="ray is not installed (the extra `cluster`)")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        from ray.cluster_utils import Cluster

        # Ray gives a node 30 s to start, which takes longer on a busy machine. It gets ten times as long.
        patient = SimpleNamespace(time=time.time, sleep=time.sleep, monotonic=lambda: 0.1 * time.monotonic())
        patch.setattr("ray._private.node.time", patient)
        node = {"num_cpus": 1, "object_store_memory": 80_000_000}
        cluster = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
        try:
            cluster.add_node(**node)
            yield cluster.address
        finally:
            cluster.shutdown()


def test_rows_are_those_of_this_machine_and_go_on(address, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(runs, "_AIRCRAFT_AT_ONCE", 120)
    for folder, options in (("here", ["--processes", "1"]), ("there", ["--ray", address])):
        assert cli.main([*RUN, "--json", "--out", str(tmp_path / folder), *options]) == 0
    here, there = map(json.loads, capsys.readouterr().out.splitlines())
    assert {**here, "wall_s": 0.0} == {**there, "wall_s": 0.0}
    assert there["flight_s"] > 0.0
    for path in (tmp_path / "here").iterdir():
        lines = (tmp_path / "there" / path.name).read_text().splitlines()
        assert sorted(lines) == sorted(path.read_text().splitlines())
        # Half of them are flown again and are the same.
        (tmp_path / "there" / path.name).write_text("\n".join(lines[:51]) + "\n")
    assert cli.main([*RUN, "--json", "--out", str(tmp_path / "there"), "--ray", address]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["flight_s"] == there["flight_s"] / 2.0
    assert {**again, "wall_s": 0.0, "flight_s": 0.0} == {**there, "wall_s": 0.0, "flight_s": 0.0}


def test_encounters_with_crewed_aircraft_are_those_of_this_machine(address, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(encounters, "_AT_ONCE", 10)
    command = ["campaign", "encounters", "--model", str(TINY), "--seeds", "1-24", "--json"]
    for folder, options in (("here", ["--processes", "1"]), ("there", ["--ray", address])):
        assert cli.main([*command, "--out", str(tmp_path / folder), *options]) == 0
    here, there = map(json.loads, capsys.readouterr().out.splitlines())
    assert here["flown"] == there["flown"] == 24
    assert {**here, "wall_s": 0.0} == {**there, "wall_s": 0.0}
    (kept,) = (tmp_path / "there").glob("tiny-hover-geometric-*.jsonl")
    assert len(kept.read_text().splitlines()) == 25


CITY = ["city", "--density", "20", "--size", "1", "1", "--minutes", "0.5", "--settle", "5", "--seeds", "1-3"]


def test_cities_are_those_of_this_machine(address, tmp_path, capsys):
    for folder, options in (("here", ["--jobs", "1"]), ("there", ["--ray", address])):
        assert cli.main([*CITY, "--json", "--out", str(tmp_path / folder), *options]) == 0
    here, there = map(json.loads, capsys.readouterr().out.splitlines())
    assert here["flown"] == there["flown"] == 3
    assert here["flight_h"] > 0.1
    assert {**here, "wall_s": 0.0} == {**there, "wall_s": 0.0}
    (kept,) = (tmp_path / "here").glob("*.jsonl")
    lines = (tmp_path / "there" / kept.name).read_text().splitlines()
    assert sorted(lines) == sorted(kept.read_text().splitlines())
    tables = {path.name for path in (tmp_path / "here").glob("*.parquet")}
    assert len(tables) == 7
    assert tables == {path.name for path in (tmp_path / "there").glob("*.parquet")}


def city_killed_once(marker: str) -> Row:
    """Fly a city in a worker that is killed the first time."""
    return fly(City(demand=Demand(north_m=1000.0, east_m=1000.0), duration_s=10.0), len(killed_once(marker)))[
        0
    ]


def test_a_city_whose_worker_was_killed_is_the_same(address, tmp_path):
    words, marker = io.StringIO(), str(tmp_path / "marker")
    ((_, row),) = on_ray(city_killed_once, [marker], address, state, Console(file=words))
    assert "A worker was lost" in words.getvalue()
    assert row == city_killed_once(marker)


def test_a_lost_worker_is_reported_and_its_work_repeated(address, tmp_path):
    words = io.StringIO()
    marker = str(tmp_path / "marker")
    assert list(on_ray(killed_once, [marker], address, state, Console(file=words))) == [(marker, marker)]
    assert "A worker was lost (WorkerCrashedError). Its flights are repeated." in words.getvalue()
    with pytest.raises(ConfigError, match="3 workers were lost at the same work"):
        list(on_ray(killed, [1], address, state, Console(file=words)))


def test_an_error_in_a_worker_ends_the_run_with_its_own_message(address):
    assert list(on_ray(square, [], address, state, Console())) == []
    with pytest.raises(ConfigError, match=r"^number -1 is wrong$"):
        list(on_ray(square, [1, -1], address, state, Console()))
    with pytest.raises(ConfigError, match=r"--ray: node [\d.]+ has other software \(process \d+\) than"):
        list(on_ray(square, [1], address, other_state, Console()))


def test_ctrl_c_keeps_what_was_flown_on_the_cluster(address, tmp_path):
    command = [sys.executable, "-m", "ground_tools.cli", *RUN[:-1], "1-200000", "--ray", address,
               "--out", str(tmp_path)]  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    end = time.monotonic() + 240.0
    while time.monotonic() < end and not any(p.stat().st_size > 2000 for p in tmp_path.glob("*.jsonl")):
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)
    _, words = process.communicate(timeout=60)
    assert process.returncode == 130, words
    assert "Interrupted" in words
    assert any(len(path.read_text().splitlines()) > 1 for path in tmp_path.glob("crossing-3-*.jsonl"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--ray", "cluster"], "--ray: cluster is not allowed; allowed: HOST:PORT or ray://HOST:PORT"),
        (["--ray", "10.0.0.5:70000"], "--ray: 10.0.0.5:70000 is not allowed; allowed: HOST:PORT"),
        (["--ray", "10.0.0.5:6379", "--processes", "2"], "--processes cannot be combined with --ray"),
    ],
)
def test_a_wrong_address_is_reported(options, words, capsys):
    assert cli.main([*RUN, *options]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("command", [CITY, ["paper", "city"], ["paper", "city-separation"]])
def test_cities_take_one_of_jobs_and_a_cluster(command, tmp_path, capsys):
    options = ["--ray", "10.0.0.5:6379", "--jobs", "2", "--out", str(tmp_path)]
    assert cli.main([*command, *options]) == 2
    assert "--jobs cannot be combined with --ray" in capsys.readouterr().err


def test_an_address_without_an_answer_is_reported(capsys):
    pytest.importorskip("ray", reason="ray is not installed (the extra `cluster`)")
    assert cli.main([*RUN, "--ray", "ray://127.0.0.1:1"]) == 2
    assert "--ray: ray://127.0.0.1:1 does not answer: Connection refused" in capsys.readouterr().err


def test_without_ray_the_message_says_how_to_install_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert cli.main([*RUN, "--ray", "127.0.0.1:1"]) == 2
    assert "pip install -e '.[cluster]'" in capsys.readouterr().err
