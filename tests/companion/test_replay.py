"""Replay: the same input gives the same commands; recorded flights of real vehicles go through the core."""

from __future__ import annotations

import gzip
import io
import json
from pathlib import Path

import msgspec
import pytest
from pymavlink import mavutil

from companion import event_record, replay
from companion.autopilot.tlog import read_tlog
from companion.commands import cli
from companion.core import Companion
from companion.errors import PeerDataError
from companion.events import AuthorityChanged, VelocitySetpoint
from companion.gate.gate import Gate
from companion.remote_id.messages import Location
from companion.runtime.record.recorder import write_manifest
from sitl_mocks.encounters import lockstep, scenario_file

DATA = Path(__file__).parents[1] / "data"
LOGS = Path(__file__).parents[3] / "shared" / "data" / "mavlink"
SIMULATOR = ("ardupilot_sitl_guided", "ardupilot_sitl_odid_adsb", "px4_sih_offboard")
ALL = (*SIMULATOR, "ardusub_multi_component", "dronekit_flight_replay", "uavlogviewer_vtol")


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    """A recorded lock-step run of a head-on encounter."""
    return recorded(tmp_path_factory.mktemp("run"))


def recorded(folder):
    path = ((0.0, -40.0, 0.0, -60.0), (20.0, 40.0, 0.0, -60.0))
    back = ((0.0, 40.0, 0.0, -60.0), (20.0, -40.0, 0.0, -60.0))
    scenario = scenario_file.Scenario(
        path=(scenario_file.PathSettings(points=path), scenario_file.PathSettings(points=back))
    )
    files = {}

    def recorder(name, config):
        header = event_record.Header(aircraft=name, software="test", config=config)
        files[name] = bytearray(event_record.MAGIC + event_record.encode(header))
        return lambda step: files[name].extend(event_record.encode(step))

    lockstep.fly(scenario, 1, record=recorder)
    for name, data in files.items():
        (folder / f"{name}.events").write_bytes(bytes(data))
    return folder


def test_a_run_replays_bit_for_bit(run_folder):
    for file in run_folder.glob("*.events"):
        with file.open("rb") as stream:
            result = replay.replay_record(event_record.read(stream, file.name), file.name, 0.0)
        assert result.steps > 400
        assert result.commands > 400
        assert result.differences == result.inexact == 0


def test_the_gate_judges_a_replay_too(run_folder, monkeypatch, capsys):
    """Of an honest record it refuses nothing; of one by a law that is too fast it says so."""

    def refused():
        with file.open("rb") as stream:
            return replay.replay_record(event_record.read(stream, file.name), file.name, 0.0).refused

    file = min(run_folder.glob("*.events"))
    assert refused() == {}
    step = Companion.step

    def too_fast(self, now_s, events):
        fast = VelocitySetpoint(velocity_ned_mps=(50.0, 0.0, 0.0))
        return [fast if isinstance(c, VelocitySetpoint) else c for c in step(self, now_s, events)]

    monkeypatch.setattr(Companion, "step", too_fast)
    assert refused()["speed"] > 100
    assert cli.main(["replay", str(file)]) == 1
    assert "commands that the gate would now refuse, by rule: " in capsys.readouterr().out


def refuses_all(self, data, now_s):
    self.counts["speed"] += 1
    return b""


@pytest.mark.parametrize(
    "change",
    [{"release": refuses_all}, {"current": lambda *_: False}],
    ids=["refuses all", "never knows the mode"],
)
def test_a_gate_that_refuses_what_it_did_not_refuse_then_is_found(run_folder, monkeypatch, capsys, change):
    file = min(run_folder.glob("*.events"))
    assert cli.main(["replay", str(file)]) == 0
    for name, instead in change.items():
        monkeypatch.setattr(Gate, name, instead)
    assert cli.main(["replay", str(file)]) == 1
    told = capsys.readouterr().out
    assert " 0 steps differ" in told
    assert "commands that the gate refuses now and did not refuse then, by rule: " in told


def test_refusals_that_the_record_shows_must_come_again(tmp_path, monkeypatch, capsys):
    step = Companion.step

    def too_fast_at_times(self, now_s, events):
        fast = VelocitySetpoint(velocity_ned_mps=(50.0, 0.0, 0.0))
        commands = step(self, now_s, events)
        if now_s % 10.0 > 1.0:
            return commands
        return [fast if isinstance(c, VelocitySetpoint) else c for c in commands]

    monkeypatch.setattr(Companion, "step", too_fast_at_times)
    folder = recorded(tmp_path)
    assert cli.main(["replay", str(folder), "--json"]) == 0
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert all(line["refused"]["speed"] > 0 for line in told)
    assert all(line["refused_anew"] == line["passed_anew"] == {} for line in told)
    monkeypatch.setattr("companion.gate.bounds.Bounds.check", lambda *_: None)
    assert cli.main(["replay", str(folder)]) == 1
    told = capsys.readouterr().out
    assert " 0 steps differ" in told
    assert "refusals in the record that the gate does not repeat now, by rule: speed " in told


def test_replay_of_a_folder_by_command(run_folder, capsys):
    assert cli.main(["replay", str(run_folder), "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["aircraft"] for line in lines] == ["DMUCA001", "DMUCA002"]


def test_what_was_not_compared_is_told(run_folder, tmp_path, capsys):
    data = min(run_folder.glob("*.events")).read_bytes()
    file = tmp_path / "x.events"
    file.write_bytes(data[:-5])
    assert cli.main(["replay", str(file), "--json"]) == 0
    told = capsys.readouterr()
    left = json.loads(told.out)["unread_bytes"]
    assert f"x.events: the file is cut off; its last {left} bytes are not a whole record" in told.err
    assert 5 < left < 3000
    file.write_bytes(data[: len(event_record.MAGIC)])
    assert cli.main(["replay", str(file)]) == 1
    assert "x.events: holds no step, so nothing was compared" in capsys.readouterr().err


@pytest.mark.parametrize(("change", "code"), [(1e-4, 1), (1e-7, 1), (1e-12, 0)])
def test_a_changed_command_is_found(run_folder, tmp_path, capsys, change, code):
    """1e-12 passes because the folder has no manifest that proves the same software."""
    source = next(iter(sorted(run_folder.glob("*.events"))))
    items = list(event_record.read(io.BytesIO(source.read_bytes()), "x"))
    at = next(
        k
        for k, item in enumerate(items)
        if isinstance(item, event_record.Step) and any(isinstance(c, VelocitySetpoint) for c in item.commands)
    )
    step = items[at]
    commands = tuple(
        VelocitySetpoint(
            velocity_ned_mps=(
                c.velocity_ned_mps[0] + change,
                c.velocity_ned_mps[1],
                c.velocity_ned_mps[2],
            )
        )
        if isinstance(c, VelocitySetpoint)
        else c
        for c in step.commands
    )
    items[at] = msgspec.structs.replace(step, commands=commands)
    changed = tmp_path / "x.events"
    changed.write_bytes(event_record.MAGIC + b"".join(event_record.encode(item) for item in items))
    assert cli.main(["replay", str(changed)]) == code
    assert ("step" in capsys.readouterr().err) == (code == 1)


def test_other_words_are_told_from_other_actions(run_folder, tmp_path, capsys):
    """A text and a velocity that the record has otherwise: two steps differ, one only in its text."""
    source = min(run_folder.glob("*.events"))
    items = list(event_record.read(io.BytesIO(source.read_bytes()), "x"))

    def change(kind, **fields):
        at, command = next(
            (k, c)
            for k, item in enumerate(items)
            if isinstance(item, event_record.Step)
            for c in item.commands
            if isinstance(c, kind) and not (kind is VelocitySetpoint and k < 200)
        )
        commands = tuple(
            msgspec.structs.replace(c, **fields) if c is command else c for c in items[at].commands
        )
        items[at] = msgspec.structs.replace(items[at], commands=commands)

    change(AuthorityChanged, reason="in other words")
    change(VelocitySetpoint, velocity_ned_mps=(9.0, 9.0, 9.0))
    changed = tmp_path / "x.events"
    changed.write_bytes(event_record.MAGIC + b"".join(event_record.encode(item) for item in items))
    assert cli.main(["replay", str(changed)]) == 1
    assert "2 steps differ (to within 1e-09 (other machine or versions)), 1 of them only in texts" in (
        capsys.readouterr().out
    )


@pytest.mark.parametrize(("key", "value"), [("machine", "another"), ("dmuca", "0.0.1")])
def test_a_run_of_another_machine_or_version_is_not_compared_bit_for_bit(
    run_folder, tmp_path, capsys, key, value
):
    source = next(iter(sorted(run_folder.glob("*.events"))))
    (tmp_path / source.name).write_bytes(source.read_bytes())
    write_manifest(tmp_path, "test")
    assert cli.main(["replay", str(tmp_path)]) == 0
    assert "(bit for bit)" in capsys.readouterr().out
    manifest = tmp_path / "manifest.json"
    manifest.write_text(json.dumps({**json.loads(manifest.read_text()), key: value}))
    assert cli.main(["replay", str(tmp_path)]) == 0
    assert "(to within 1e-09 (other machine or versions))" in capsys.readouterr().out


def fly_log(stream, name):
    result, locations = replay.replay_tlog(read_tlog(stream, name))
    return result, list(locations)


def check_locations(locations):
    """Every Location decodes back within half a quantum."""
    positions = 0
    for sent in locations:
        heard = replay.on_air(sent)
        for field, half in (
            ("lat_deg", 0.5e-7),
            ("lon_deg", 0.5e-7),
            ("alt_geodetic_m", 0.25),
            ("height_m", 0.25),
            ("speed_mps", 0.125 if (sent.speed_mps or 0) <= 63.75 else 0.375),
            ("vertical_speed_mps", 0.25),
            ("timestamp_s", 0.05),
        ):
            a, b = getattr(sent, field), getattr(heard, field)
            assert (a is None) == (b is None), field
            if a is not None:
                assert abs(a - b) <= half + 1e-9, (field, a, b)
        if sent.direction_deg is not None:
            assert abs((sent.direction_deg - heard.direction_deg + 180.0) % 360.0 - 180.0) <= 0.5 + 1e-9
        positions += sent.lat_deg is not None
    return positions


@pytest.mark.parametrize("name", SIMULATOR)
def test_recordings_of_real_firmware(name):
    with gzip.open(DATA / f"{name}.tlog.gz") as stream:
        result, locations = fly_log(stream, name)
    assert result.gnss_states > 100
    assert check_locations(locations) > 50
    assert result.first == pytest.approx((47.397, 8.545, 400.0), abs=3.0)


@pytest.mark.parametrize("name", ALL)
def test_whole_logs_against_an_independent_reader(name):
    path = LOGS / f"{name}.tlog"
    if not path.exists():
        pytest.skip(f"{path.name}: the folder with recorded logs is not beside this checkout")
    with path.open("rb") as stream:
        result, locations = fly_log(stream, name)
    reader = mavutil.mavlink_connection(str(path))
    states, vehicle = [], False
    while (message := reader.recv_match(type=["HEARTBEAT", "GLOBAL_POSITION_INT"])) is not None:
        if message.get_srcComponent() != 1:
            continue
        # Positions before the vehicle's first heartbeat are nobody's yet.
        vehicle = vehicle or message.get_type() == "HEARTBEAT"
        if vehicle and message.get_type() == "GLOBAL_POSITION_INT" and (message.lat or message.lon):
            states.append((message.lat / 1e7, message.lon / 1e7, message.alt / 1e3))
    assert result.gnss_states == len(states)
    assert result.first == pytest.approx(states[0], abs=1e-9)
    assert result.last == pytest.approx(states[-1], abs=1e-9)
    # Positions that a laggy link brings more than a second late do not go on the air.
    assert check_locations(locations) > 20
    assert all(isinstance(location, Location) for location in locations)


def test_a_torn_log_is_counted_not_fatal():
    with gzip.open(DATA / "px4_sih_offboard.tlog.gz") as stream:
        data = stream.read()
    whole, _ = fly_log(io.BytesIO(data), "whole")
    torn, _ = fly_log(io.BytesIO(data[:-7]), "torn")
    assert whole.frames - 1 <= torn.frames <= whole.frames


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("x.tlog", b"hello, I am not a telemetry log at all", "not a telemetry log"),
        ("x.tlog", b"", "is empty"),
        ("x.events", b"hello", "not an event record"),
    ],
)
def test_a_file_of_another_kind_is_one_line(tmp_path, capsys, name, content, words):
    file = tmp_path / name
    file.write_bytes(content)
    assert cli.main(["replay", str(file)]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_a_folder_without_records_is_one_line(tmp_path, capsys):
    assert cli.main(["replay", str(tmp_path)]) == 2
    assert "no .events file" in capsys.readouterr().err


def test_a_record_without_header_is_refused():
    step = event_record.Step(now_s=0.0, events=(), commands=())
    with pytest.raises(PeerDataError, match="not a header"):
        replay.replay_record([step], "x", 0.0)
