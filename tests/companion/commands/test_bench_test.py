"""The first-flight checklist: end to end against the mock, in virtual time, and what each stage refuses."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from companion import __version__
from companion import config as configuration
from companion.commands import bench_test, run_evidence
from companion.commands.cli import main
from companion.commands.preflight import Preflight
from companion.event_record import MAGIC, Header, Step, encode
from companion.events import Firmware, RadioState, VehicleText
from companion.runtime.record.disk import MANIFEST, RUN
from companion.runtime.record.recorder import write_manifest
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from tests.companion.commands.conftest import Vehicle
from tests.companion.core.conftest import intruder
from tests.sitl_mocks.with_companion.guarding import mission
from tests.sitl_mocks.with_companion.pair import Pair

HEIGHT_M = 12.0
SUMMARY = {"records_dropped": 0, "recorder_error": None, "link_losses": 0}
"""What the flight loop adds to its record; there is none in virtual time."""
CONFIRM = {stage: [f"--confirm={name}" for name in names] for stage, names in bench_test.STATEMENTS.items()}


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("BENCH_S", "IN_AIR_S", "WATCHED_S", "TOGETHER_S"):
        monkeypatch.setattr(run_evidence, name, 8.0)


def config_file(folder: Path, use: str, *, link: str = "udpin:127.0.0.1:14999", more: str = "") -> Path:
    path = folder / f"{use}.toml"
    radio = "" if use == "watch" else '[[radio]]\nbackend = "ether"\naddress = "127.0.0.1:14640"\n'
    path.write_text(
        f'[identity]\nuas_id = "FIRST1"\n[vehicle]\nlink = "{link}"\nsystem_id = 1\n'
        f'[flight]\nuse = "{use}"\ntake_in_flight = true\n[record]\nfolder = "{folder}"\n{radio}{more}'
    )
    return path


class Flown(Pair):
    """A flight on a mission 12 m above home, recorded as `companion run` does."""

    def __init__(self, path: Path, *, airborne: bool = True) -> None:
        points = [(0.0, 0.0, HEIGHT_M), (400.0, 0.0, HEIGHT_M)]
        options: dict[str, Any] = {"mission": mission(*points, first=0), "mission_speed_mps": 5.0}
        if airborne:
            options |= {"start_mode": VehicleMode.MISSION, "start_position_ned_m": (0.0, 0.0, -HEIGHT_M)}
        else:
            options |= {"airborne": False, "start_position_ned_m": (0.0, 0.0, 0.0)}
        super().__init__(Firmware.PX4, configuration.load(path), **options)
        self.onboard.hear(RadioState(can_send=("wifi",)))

    def landed(self) -> Flown:
        self.vehicle.pilot_selects(VehicleMode.LAND)
        for _ in range(60):
            self.run(1.0)
            if not self.vehicle.armed:
                return self
        raise AssertionError("it has not landed")

    def recorded(self, folder: Path, **summary: Any) -> Path:
        folder.mkdir()
        header = Header(aircraft="FIRST1", software=__version__, config=self.config)
        parts = [MAGIC, *(encode(record) for record in (header, *self.steps))]
        (folder / "first.events").write_bytes(b"".join(parts))
        (folder / "summary.json").write_text(json.dumps(SUMMARY | summary))
        write_manifest(folder, RUN, dry_run=False, code_sha256=bench_test.code_sha256())
        return folder


def passer(flown: Flown, east_m: float) -> Any:
    """Somebody who comes the other way at 5 m/s, `east_m` aside."""
    return lambda now_s: intruder(flown, 150.0 - 5.0 * now_s, 5.0, east_m=east_m)


def judged(stage: str, path: Path, run: Path, *more: str) -> int:
    evidence = path.parent / "evidence.json"
    options = ["--config", str(path), "--run", str(run), "--evidence", str(evidence)]
    return main(["bench-test", stage, *options, *more])


def failed(folder: Path) -> list[str]:
    """What has not passed at the last attempt."""
    last = bench_test.read_evidence(folder / "evidence.json").attempts[-1]
    return [check.what for check in last.checks if not check.passed]


@pytest.fixture
def ready(monkeypatch: pytest.MonkeyPatch) -> None:
    """`companion check` has nothing to say."""
    monkeypatch.setattr("companion.commands.check.findings", lambda config: Preflight())


def passed_before(folder: Path, stage: bench_test.Stage, **over: Any) -> None:
    """Write evidence in which everything before a stage has passed."""
    attempts = [
        bench_test.Attempt(
            **{
                "stage": earlier, "passed": True, "utc": "", "software": __version__, "aircraft": "FIRST1",
                "code_sha256": bench_test.code_sha256(), "config": "", "config_sha256": "", "run": None,
                "stated": (), "checks": (),
            } | over
        )
        for earlier in bench_test.STAGES[: bench_test.STAGES.index(stage)]
    ]  # fmt: skip
    bench_test.write_evidence(folder / "evidence.json", bench_test.Evidence(attempts=tuple(attempts)))


def test_from_the_bench_to_two_aircraft(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    vehicle = Vehicle()
    try:
        bench = config_file(tmp_path, "watch", link=f"tcp:127.0.0.1:{vehicle.port}")
        run = Flown(bench, airborne=False).run(12.0).recorded(tmp_path / "on_the_bench")
        assert judged("bench", bench, run, *CONFIRM["bench"]) == 0, capsys.readouterr().out
    finally:
        vehicle.end()
    watch = bench
    run = Flown(watch).run(12.0).landed().recorded(tmp_path / "watched")
    assert judged("watch", watch, run, *CONFIRM["watch"]) == 0, capsys.readouterr().out
    guard = config_file(tmp_path, "guard", more="[limits]\nceiling_height_m = 60.0\n")
    run = Flown(guard).run(16.0).landed().recorded(tmp_path / "guarded")
    assert judged("guard", guard, run, *CONFIRM["guard"]) == 0, capsys.readouterr().out
    flown = Flown(guard)
    flown.heard = passer(flown, 50.0)
    run = flown.run(20.0).landed().recorded(tmp_path / "passed")
    assert judged("pair", guard, run, *CONFIRM["pair"]) == 0, capsys.readouterr().out

    evidence = json.loads((tmp_path / "evidence.json").read_text())
    assert [a["stage"] for a in evidence["attempts"]] == ["bench", "watch", "guard", "pair"]
    last = evidence["attempts"][-1]
    assert last["software"] == __version__
    assert last["config_sha256"] == hashlib.sha256(guard.read_bytes()).hexdigest()
    assert bench_test.MEANING["offset-50m"] in last["stated"]
    nearest = next(c for c in last["checks"] if c["what"] == "least distance to another aircraft")
    assert 45.0 <= float(nearest["measured"].split()[0]) <= 60.0
    assert any(c["what"] == "check, vehicle" for c in evidence["attempts"][0]["checks"])
    capsys.readouterr()
    assert main(["bench-test", "--evidence", str(tmp_path / "evidence.json")]) == 0
    assert capsys.readouterr().out.count(" passed ") == 4


def test_no_stage_before_the_one_before_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = config_file(tmp_path, "guard")
    assert judged("guard", path, tmp_path, *CONFIRM["guard"]) == 1
    assert 'comes after "bench", which has not been tried' in capsys.readouterr().err
    for over, why in (
        ({"passed": False}, "did not pass"),
        ({"software": "0.0.9"}, "passed with software 0.0.9"),
        # A checkout that was updated has the same version.
        ({"code_sha256": "0" * 64}, f"passed with other code of version {__version__}"),
        ({"aircraft": "OTHER"}, "was passed by OTHER"),
    ):
        passed_before(tmp_path, "guard", **over)
        assert judged("guard", path, tmp_path, *CONFIRM["guard"]) == 1
        assert why in capsys.readouterr().err
    attempts = bench_test.read_evidence(tmp_path / "evidence.json").attempts
    assert attempts[-1].refused is not None
    assert not attempts[-1].checks


def test_a_refused_stage_does_not_count_as_passed(tmp_path: Path) -> None:
    path = config_file(tmp_path, "watch")
    assert judged("bench", path, tmp_path) == 1  # without the operator's word
    assert judged("watch", path, tmp_path, *CONFIRM["watch"]) == 1
    assert not any(a.passed for a in bench_test.read_evidence(tmp_path / "evidence.json").attempts)


@pytest.mark.usefixtures("ready")
def test_what_each_stage_does_not_pass(tmp_path: Path) -> None:
    watch = config_file(tmp_path, "watch")
    flown = Flown(watch).run(12.0)
    in_the_air = flown.recorded(tmp_path / "in_the_air")
    assert judged("bench", watch, in_the_air, *CONFIRM["bench"]) == 1
    assert failed(tmp_path) == ["arming"]
    passed_before(tmp_path, "watch")
    assert judged("watch", watch, in_the_air, *CONFIRM["watch"]) == 1
    assert failed(tmp_path) == ["end of the record"]
    lost = flown.landed().recorded(tmp_path / "lost", link_losses=2, recorder_error="disk full")
    assert judged("watch", watch, lost, *CONFIRM["watch"]) == 1
    assert failed(tmp_path) == ["record", "link losses"]
    passed_before(tmp_path, "guard")
    assert judged("guard", watch, lost, *CONFIRM["guard"]) == 1
    assert {"flight.use", "time guarding the mission", "limits.ceiling_height_m"} < set(failed(tmp_path))


@pytest.mark.usefixtures("ready")
@pytest.mark.parametrize(
    ("text", "measured"),
    [
        ("SIM Hit ground at 0.5 m/s", 'simulated: it said "SIM Hit ground at 0.5 m/s"'),
        ("SIMPLE mode on", "not known whether it is simulated"),
    ],
)
def test_the_evidence_tells_of_a_simulated_vehicle(tmp_path: Path, text: str, measured: str) -> None:
    watch = config_file(tmp_path, "watch")
    flown = Flown(watch, airborne=False).run(1.0)
    said = VehicleText(severity=6, text=text)
    flown.steps.append(Step(now_s=flown.steps[-1].now_s + 0.05, events=(said,), commands=()))
    judged("bench", watch, flown.recorded(tmp_path / "run"), *CONFIRM["bench"])
    last = bench_test.read_evidence(tmp_path / "evidence.json").attempts[-1]
    assert [check.measured for check in last.checks if check.what == "vehicle"] == [measured]


def test_a_pair_that_never_met_or_came_too_near(tmp_path: Path) -> None:
    guard = config_file(tmp_path, "guard", more="[limits]\nceiling_height_m = 60.0\n")
    alone = Flown(guard).run(16.0).landed().recorded(tmp_path / "alone")
    passed_before(tmp_path, "pair")
    assert judged("pair", guard, alone, *CONFIRM["pair"]) == 1
    assert failed(tmp_path) == ["another aircraft heard in the air", "least distance to another aircraft"]
    low = config_file(tmp_path, "guard", more="[limits]\nceiling_height_m = 20.0\n")
    passed_before(tmp_path, "guard")
    assert judged("guard", low, alone, *CONFIRM["guard"]) == 1
    assert failed(tmp_path) == ["configuration of the run", "limits.ceiling_height_m"]


def test_a_run_of_the_service_is_judged_by_a_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = config_file(tmp_path, "watch")
    path.write_text(path.read_text().replace(f'folder = "{tmp_path}"', 'folder = "runs"'))
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    run = Flown(path).run(12.0).landed().recorded(tmp_path / "run")
    monkeypatch.delenv("STATE_DIRECTORY")
    passed_before(tmp_path, "watch")
    assert judged("watch", path, run, *CONFIRM["watch"]) == 0, failed(tmp_path)


@pytest.mark.parametrize(
    ("facts", "what"),
    [
        ({"dry_run": True}, "kind of run"),
        ({"dry_run": None}, "kind of run"),  # recorded before the manifest told
        ({"what": "sitl-mocks demo"}, "kind of run"),
        ({"code_sha256": "0" * 64}, "code of the run"),
    ],
)
def test_a_run_that_is_no_flight_of_this_code(tmp_path: Path, facts: dict[str, Any], what: str) -> None:
    path = config_file(tmp_path, "watch")
    run = Flown(path).run(12.0).landed().recorded(tmp_path / "run")
    manifest = json.loads((run / MANIFEST).read_text())
    (run / MANIFEST).write_text(json.dumps(manifest | facts))
    passed_before(tmp_path, "watch")
    assert judged("watch", path, run, *CONFIRM["watch"]) == 1
    assert failed(tmp_path) == [what]


def test_one_flight_is_no_evidence_of_two_stages(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    guard = config_file(tmp_path, "guard", more="[limits]\nceiling_height_m = 60.0\n")
    flown = Flown(guard)
    flown.heard = passer(flown, 50.0)
    run = flown.run(20.0).landed().recorded(tmp_path / "both")
    passed_before(tmp_path, "guard")
    assert judged("guard", guard, run, *CONFIRM["guard"]) == 0
    assert judged("pair", guard, run, *CONFIRM["pair"]) == 1
    assert 'this run passed the stage "guard" already' in capsys.readouterr().err


def test_broken_input_names_the_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = config_file(tmp_path, "watch")
    assert main(["bench-test", "bench"]) == 2
    assert "--config and --run are required" in capsys.readouterr().err
    assert judged("bench", path, tmp_path, *CONFIRM["bench"], "--evidence", str(path)) == 2
    assert "--evidence" in capsys.readouterr().err


@pytest.mark.usefixtures("ready")
def test_a_run_that_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = config_file(tmp_path, "watch")
    assert judged("bench", path, tmp_path, *CONFIRM["bench"]) == 2
    assert "holds 0 event records" in capsys.readouterr().err
    (tmp_path / "a.events").write_bytes(MAGIC)
    assert judged("bench", path, tmp_path, *CONFIRM["bench"]) == 2
    assert "the run must have ended" in capsys.readouterr().err
    (tmp_path / "summary.json").write_text("[]")
    assert judged("bench", path, tmp_path, *CONFIRM["bench"]) == 2
    assert "manifest.json" in capsys.readouterr().err
    (tmp_path / MANIFEST).write_text("[]")
    assert judged("bench", path, tmp_path, *CONFIRM["bench"]) == 2
    assert "holds no record" in capsys.readouterr().err


def test_a_record_that_is_cut_off_is_no_evidence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = config_file(tmp_path, "watch")
    run = Flown(path).run(12.0).landed().recorded(tmp_path / "run")
    record = run / "first.events"
    record.write_bytes(record.read_bytes()[:-3])
    passed_before(tmp_path, "watch")
    assert judged("watch", path, run, *CONFIRM["watch"]) == 2
    assert "first.events: the file is cut off; its last " in capsys.readouterr().err


def test_the_evidence_file_is_read_again_as_it_was_written(tmp_path: Path) -> None:
    passed_before(tmp_path, "pair")
    path = tmp_path / "evidence.json"
    evidence = bench_test.read_evidence(path)
    assert msgspec.json.decode(path.read_bytes(), type=bench_test.Evidence) == evidence
    assert [a.stage for a in evidence.attempts] == ["bench", "watch", "guard"]
