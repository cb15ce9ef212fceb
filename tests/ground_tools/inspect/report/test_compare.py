"""Comparison of two runs, aligned at take-off: configuration, pairs and figures."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from companion.config import AvoidanceConfig, Config, IdentityConfig, RemoteIdConfig
from companion.errors import ConfigError
from companion.event_record import Step
from companion.events import Broadcast, Firmware, FlightMode, Heartbeat, Landed, LandedState
from companion.remote_id.messages import Location
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.report.compare import compare, text
from tests.ground_tools.inspect.flights import inspect, step, write


def value(figures, what):
    return next(row["values"] for row in figures["figures"] if row["what"].startswith(what))


def test_differences_are_listed_side_by_side(run_folder: Path) -> None:
    figures = compare([read_run(run_folder), read_run(run_folder / "unavoided")])
    assert figures["runs"] == [run_folder.name, "unavoided"]
    (pair,) = figures["pairs"]
    assert pair["pair"] == ["DMUCA001", "DMUCA002"]
    assert pair["minimum_m"] == pytest.approx([14.142, 1.414], abs=1e-3)
    assert pair["kept"] == [True, False]
    assert value(figures, "least separation") == pair["minimum_m"]
    assert value(figures, "pairs that lost") == [0, 1]
    assert value(figures, "broadcasts sent") == [122, 122]
    assert figures["config"] == []
    words = " ".join(text(figures).split())
    assert "pairs that lost separation 0 1 +1" in words
    assert "14.14 m at 32.0 s LOST 1.41 m at 30.2 s" in words


def test_configuration_that_differs_is_named_by_key(tmp_path: Path) -> None:
    def config(law, name="ONE"):
        return Config(identity=IdentityConfig(uas_id=name), avoidance=AvoidanceConfig(law=law))

    for folder, laws in (("a", ("dmuca", "dmuca")), ("b", ("dmuca", "paper"))):
        for name, law in zip(("ONE", "TWO"), laws, strict=True):
            write(tmp_path / folder, config(law, name), [step(1.0), step(2.0)])
    figures = compare([read_run(tmp_path / "a"), read_run(tmp_path / "b")])
    assert figures["config"] == [
        {"key": "avoidance.law", "values": ["dmuca", {"ONE": "dmuca", "TWO": "paper"}]}
    ]


def test_the_operators_secret_is_not_printed(tmp_path: Path) -> None:
    for folder, secret in (("a", "FIN87astrdge12k8-xyz"), ("b", None)):
        remote_id = RemoteIdConfig(operator_id=secret)
        config = Config(identity=IdentityConfig(uas_id="ONE"), remote_id=remote_id)
        write(tmp_path / folder, config, [step(1.0), step(2.0)])
    told = json.dumps(compare([read_run(tmp_path / "a"), read_run(tmp_path / "b")]))
    assert "FIN87astrdge12k8" in told
    assert "xyz" not in told


def test_times_count_from_the_first_take_off(tmp_path: Path, made: SimpleNamespace) -> None:
    """In the second run, the companion ran 100 s longer before the same flight."""
    beat = Heartbeat(
        system_id=1, firmware=Firmware.PX4, vehicle_type=2, custom_mode=0, mode=FlightMode.HOLD, armed=True
    )
    for folder, wait_s in (("a", 0.0), ("b", 100.0)):
        for name, me in (("ONE", made.northbound), ("TWO", made.eastbound(2.0))):
            steps = made.steps(me, made.northbound, wait_s, utc=False)
            ground = (beat, LandedState(landed=Landed.ON_GROUND))
            early = Step(now_s=wait_s, events=ground, commands=())
            up = Step(now_s=wait_s + 10.5, events=(LandedState(landed=Landed.IN_AIR),), commands=())
            config = Config(identity=IdentityConfig(uas_id=name))
            write(tmp_path / folder, config, [early, *steps[1:106], up, *steps[106:]])
    figures = compare([read_run(tmp_path / "a"), read_run(tmp_path / "b")])
    assert figures["zero"] == "the first take-off"
    assert figures["pairs"][0]["time_s"] == pytest.approx([30.2 - 10.5, 30.2 - 10.5], abs=0.01)


def test_a_run_without_positions_is_compared_by_its_other_figures(
    run_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = tmp_path / "bare"
    config = Config(identity=IdentityConfig(uas_id="DMUCA001"), avoidance=AvoidanceConfig(law="paper"))
    sent = Broadcast(transport="wifi", messages=(Location(),))
    write(bare, config, [Step(now_s=5.0 + k, events=(), commands=(sent,)) for k in range(4)])
    figures = compare([read_run(run_folder), read_run(bare)])
    assert figures["positions"] == ["own GNSS positions", None]
    assert value(figures, "least separation") == [pytest.approx(14.142, abs=1e-3), None]
    assert value(figures, "broadcasts sent") == [122, 4]
    assert {row["key"]: row["values"][1] for row in figures["config"]}["avoidance.law"] == "paper"
    told = [row["text"] for row in figures["problems"] if row["run"] == "bare"]
    assert "separations, distances and speeds are not compared, because there are no positions" in told
    assert "bare" in figures["zero"]
    pytest.importorskip("rerun")
    assert inspect("--compare", run_folder, bare, "--save", tmp_path / "c.rrd") == 0
    assert "are not compared, because there are no positions" in capsys.readouterr().out
    assert (tmp_path / "c.rrd").stat().st_size > 10_000
    assert inspect("--compare", bare, bare, "--save", tmp_path / "bare.rrd") == 0


def test_a_pair_that_is_not_in_every_run_is_left_open(run_folder: Path) -> None:
    (run_folder / "unavoided" / "DMUCA002.events").unlink()
    figures = compare([read_run(run_folder), read_run(run_folder / "unavoided")])
    assert figures["pairs"][0]["minimum_m"] == [pytest.approx(14.142, abs=1e-3), None]
    assert value(figures, "least separation")[1] is None
    assert "14.14 m at 32.0 s" in text(figures)


def test_runs_with_the_same_name_get_distinct_names(run_folder: Path) -> None:
    run = read_run(run_folder)
    name = run_folder.name
    assert compare([run, run, run])["runs"] == [name, f"{name} (2)", f"{name} (3)"]


def test_the_command_prints_or_gives_json(run_folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert inspect("--compare", run_folder, run_folder / "unavoided") == 0
    assert "LOST 1.41 m" in capsys.readouterr().out
    assert inspect("--compare", "--json", run_folder, run_folder / "unavoided") == 0
    assert json.loads(capsys.readouterr().out)["pairs"]
    assert not (run_folder / "inspect.rrd").exists()


@pytest.mark.parametrize("extra", [["--save", "x.rrd"], ["--report", "x.html"], []])
def test_contradicting_options_are_refused(run_folder: Path, extra: list[str]) -> None:
    with pytest.raises(ConfigError, match="--compare"):
        inspect("--compare", run_folder, *extra)
