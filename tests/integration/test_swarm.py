"""The real-time swarm: every part a process of its own."""

from __future__ import annotations

import json
import signal


def test_a_small_swarm_flies_and_ends_cleanly(start, tmp_path):
    swarm = start(
        "sitl_mocks.cli", "swarm", "--aircraft", "2", "--duration", "10", "--runs", tmp_path / "runs",
        "--policy", "rule", "--region", "config/regions/us.toml",
    )  # fmt: skip
    assert swarm.process.wait(150) in (0, 1)
    (folder,) = (tmp_path / "runs").iterdir()
    report = json.loads((folder / "summary.json").read_text())
    assert report["ended_badly"] == []
    assert len(report["setpoint_gaps"]) == 2
    assert all(gap["setpoints"] > 100 for gap in report["setpoint_gaps"].values())
    assert len(report["air"]) == 2
    assert all(row["sent"] > 5 for row in report["air"])
    assert report["min_separation_m"] is not None
    assert report["policy"] == "rule"
    for choices in report["transports"].values():
        assert choices["seconds"]["ble4 10 + wifi 10"] > 5.0


def test_ctrl_c_leaves_complete_files(start, tmp_path):
    swarm = start("sitl_mocks.cli", "swarm", "--aircraft", "2", "--runs", tmp_path / "runs")
    swarm.wait_for("5 processes; starts in 5 s")
    assert swarm.end(signal.SIGINT) == 1
    (folder,) = (tmp_path / "runs").iterdir()
    report = json.loads((folder / "summary.json").read_text())
    assert report["interrupted"]
    assert report["ended_badly"] == []
    assert len(list(folder.glob("*-DMUCA*/summary.json"))) == 2
