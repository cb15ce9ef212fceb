"""The real-time swarm: every part a process of its own."""

from __future__ import annotations

import json
import signal
import subprocess

from tests.integration.conftest import PATIENCE_S, StalledError, again_after_a_stall, stalled
from tests.support.waiting import until


@again_after_a_stall
def test_a_small_swarm_flies_and_ends_cleanly(start, tmp_path):
    swarm = start(
        "sitl_mocks.cli", "swarm", "--aircraft", "2", "--duration", "10", "--runs", tmp_path / "runs",
        "--policy", "rule", "--region", "config/regions/us.toml",
    )  # fmt: skip
    assert swarm.process.wait(PATIENCE_S) in (0, 1)
    (folder,) = (tmp_path / "runs").iterdir()
    report = json.loads((folder / "summary.json").read_text())
    assert report["ended_badly"] == []
    assert len(report["setpoint_gaps"]) == 2
    enough = all(gap["setpoints"] > 100 for gap in report["setpoint_gaps"].values())
    vehicles = "".join(log.read_text() for log in folder.glob("vehicle-*.log"))
    if not enough and any(stalled(log.read_text(), vehicles) for log in folder.glob("DMUCA*.log")):
        raise StalledError
    assert enough
    assert len(report["air"]) == 2
    assert all(row["sent"] > 5 for row in report["air"])
    assert report["min_separation_m"] is not None
    assert report["policy"] == "rule"
    for choices in report["transports"].values():
        assert choices["seconds"]["ble4 10 + wifi 10"] > 5.0


def test_ctrl_c_leaves_complete_files(start, tmp_path):
    swarm = start("sitl_mocks.cli", "swarm", "--aircraft", "2", "--runs", tmp_path / "runs")
    # A program that is interrupted while it still loads leaves no files.
    until(
        lambda: len(list((tmp_path / "runs").glob("*/*Z-DMUCA*/*.events"))) == 2,
        "both run folders",
        PATIENCE_S,
    )
    assert swarm.end(signal.SIGINT) == 1
    (folder,) = (tmp_path / "runs").iterdir()
    report = json.loads((folder / "summary.json").read_text())
    assert report["interrupted"]
    assert report["ended_badly"] == []
    assert len(list(folder.glob("*-DMUCA*/summary.json"))) == 2


def test_a_swarm_that_is_killed_leaves_no_process(start, tmp_path):
    """One that was left kept a serial line from the next run."""
    swarm = start("sitl_mocks.cli", "swarm", "--aircraft", "2", "--runs", tmp_path / "runs")

    def running():
        found = subprocess.run(["pgrep", "-fc", f"companion.commands.*{tmp_path}"], stdout=subprocess.PIPE)
        return int(found.stdout)

    until(lambda: running() == 2, "both companions", PATIENCE_S)
    swarm.process.kill()
    until(lambda: running() == 0, "the end of both companions", PATIENCE_S)


def test_a_swarm_in_which_companions_stop_and_pilots_take_over_breaks_no_rule(start, tmp_path):
    swarm = start(
        "sitl_mocks.cli", "swarm", "--aircraft", "2", "--duration", "14", "--faults", "--seed", "452",
        "--runs", tmp_path / "runs",
    )  # fmt: skip
    code = swarm.process.wait(PATIENCE_S)
    (folder,) = (tmp_path / "runs").iterdir()
    report = json.loads((folder / "summary.json").read_text())
    assert report["ended_badly"] == []
    found = report["faults"].values()
    assert [one["breaches"] for one in found] == [[], []]
    assert all(one["setpoints"] > 0 for one in found)
    # On a slow machine a companion flies its vehicle late, and less of its schedule is reached.
    assert {row["kind"] for one in found for row in one["done"]} >= {"stall", "mode"}
    assert sum(one["choices_while_held"] for one in found) > 0
    assert report["ok"] == all(one["unknown"] is None for one in found)
    assert code == (0 if report["ok"] else 1)
    for name, one in report["faults"].items():
        assert f"{name}, link {one['link']}: injected faults" in swarm.output
        assert (folder / "wire" / f"{name}.tlog").stat().st_size > 0
