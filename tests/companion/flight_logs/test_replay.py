"""Onboard logs through the core: their vehicles fly again, and nothing is compared."""

import json
from pathlib import Path

import pytest

from companion.commands import cli
from companion.events import RemoteIdModule
from companion.flight_logs import About, px4
from companion.replay import replay_steps
from tests.support import onboard_logs as logs


@pytest.mark.parametrize(("make", "vehicle"), [
    (logs.copter, "ardupilot, system 7, MAV_TYPE 13"),
    (logs.px4, "px4, system 9, MAV_TYPE 2"),
])  # fmt: skip
def test_a_vehicle_flies_again_and_sends_its_positions(tmp_path: Path, capsys, make, vehicle: str):
    path = make(tmp_path / "flight.log")
    assert cli.main(["replay", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["vehicle"] == vehicle
    assert (found["gnss_states"], found["gnss_fixes"]) == (200, 100)
    assert found["duration_s"] == pytest.approx(logs.SECONDS, abs=0.3)
    assert found["first"] == pytest.approx([*logs.PLACE, logs.ALT_M])
    assert found["last"] == pytest.approx([logs.latitude(19.9), logs.PLACE[1], logs.ALT_M])
    # Once a second, with a position as soon as the estimator and the receiver have one.
    assert 15 <= found["locations_with_position"] <= found["broadcasts"] <= 60
    assert cli.main(["replay", str(path)]) == 0
    assert "no companion's record, so no commands are compared" in capsys.readouterr().out


def test_the_vehicles_own_remote_id_module_does_not_silence_the_replay(tmp_path: Path):
    path = logs.px4(tmp_path / "x.ulg")
    with path.open("rb") as stream:
        steps = list(px4.read_steps(stream, "x.ulg", About()))
    assert any(isinstance(event, RemoteIdModule) for step in steps for event in step.events)
    result, locations = replay_steps(steps)
    assert len([one for one in locations if one.lat_deg is not None]) == result.locations_with_position > 0


def test_what_only_begins_like_a_log_is_one_line(tmp_path: Path, capsys):
    path = tmp_path / "x.bin"
    path.write_bytes(b"\xa3\x95\x80\x80")
    assert cli.main(["replay", str(path)]) == 2
    error = capsys.readouterr().err
    assert "no DataFlash log" in error
    assert error.count("\n") == 1
