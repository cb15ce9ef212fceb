"""`ground-tools city`: whole runs are reproducible bit for bit, complete, stored and continued."""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.errors import ConfigError
from ground_tools.city import cells
from ground_tools.city.cells import City, Row
from ground_tools.city.command import add_arguments, city_of, kept, summary
from ground_tools.city.measure import T_BEGUN, T_ENDED
from ground_tools.city.traffic.demand import Demand
from ground_tools.cli import main

SMALL = City(
    demand=Demand(pattern="inspections", per_km2=12.0, north_m=1000.0, east_m=1000.0),
    duration_s=30.0,
    settle_s=5.0,
)
ARGUMENTS = ["city", "--pattern", "inspections", "--density", "12", "--size", "1", "1", "--minutes", "0.4"]


@pytest.mark.parametrize("transports", ["rule", "policy"])
def test_two_runs_of_one_seed_agree_bit_for_bit(transports: str) -> None:
    city = msgspec.structs.replace(SMALL, transports=transports)
    (first, one), (second, other) = (cells.fly(city, 2) for _ in range(2))
    assert first == second
    assert np.array_equal(one.state.tally.flights, other.state.tally.flights, equal_nan=True)
    assert np.array_equal(one.state.craft.position, other.state.craft.position)
    assert first.age_s is not None
    assert first.age_s > 0.3
    assert first.wifi > 0.0


@pytest.mark.parametrize(("hours", "rate"), [((0.5, 0.25), 8.0), ((0.0, 0.0), None)])
def test_rates_an_hour_are_of_all_runs_together(hours: tuple[float, ...], rate: float | None) -> None:
    zero = dict.fromkeys(Row.__struct_fields__, 0)
    rows = [Row(**zero | {"flight_h": part, "losses": 3}) for part in hours]
    assert summary(rows)["losses_per_flight_h"] == rate


def test_every_flight_is_accounted_for() -> None:
    short = msgspec.structs.replace(SMALL.demand, pattern="doorsteps")
    city = msgspec.structs.replace(SMALL, demand=short, duration_s=90.0, knows="perfect")
    row, result = cells.fly(city, 1)
    assert row.flights == row.arrived + row.in_the_air + row.waiting + row.not_due
    assert row.arrived > 0
    assert row.in_the_air > 0
    tally = result.state.tally.flights
    assert np.isfinite(tally[:, T_BEGUN]).sum() == row.arrived + row.in_the_air
    assert (tally[:, T_ENDED] > tally[:, T_BEGUN]).sum() == row.arrived


def test_nobody_avoids_and_separation_is_lost() -> None:
    crowd = msgspec.structs.replace(SMALL.demand, pattern="event", per_km2=60.0, heights="free")
    lost, _ = cells.fly(msgspec.structs.replace(SMALL, demand=crowd, law="none", knows="perfect"), 3)
    avoided, _ = cells.fly(msgspec.structs.replace(SMALL, demand=crowd, knows="perfect"), 3)
    assert lost.losses > 0
    assert avoided.losses < lost.losses
    assert avoided.conflict > 0.0 == lost.conflict


def test_the_command_keeps_and_continues_its_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    options = [
        *ARGUMENTS,
        "--settle",
        "5",
        "--knows",
        "perfect",
        "--out",
        str(tmp_path),
        "--jobs",
        "1",
        "--json",
    ]
    assert main([*options, "--seeds", "1-1"]) == 0
    assert json.loads(capsys.readouterr().out)["flown"] == 1
    assert main([*options, "--seeds", "1-2"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["runs"], found["flown"]) == (2, 1)
    (runs,) = [p for p in tmp_path.glob("*.parquet") if p.with_name(p.name + ".made.json").exists()]
    table = pq.read_table(runs)
    assert table["seed"].to_pylist() == [1, 2]
    assert msgspec.json.decode(table.schema.metadata[b"city"])["knows"] == "perfect"
    flights = pq.read_table(next(iter(tmp_path.glob("*-1-flights.parquet"))))
    assert flights.num_rows == table["flights"][0].as_py()
    assert len(list(tmp_path.glob("*-losses.parquet"))) == 2


def test_runs_of_another_file_of_flights_are_not_continued(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file keeps its name, so its content tells."""
    pytest.importorskip("pyarrow")
    flights, lines = tmp_path / "meeting.scn", []
    for name, lat, heading in (("A", 48.0, 0), ("B", 48.01, 180)):
        lines.append(f"0:00:00.00>CRE {name},M600,{lat},16,{heading},200,20")
        lines.append(f"0:00:00.00>DEST {name},{48.01 if heading == 0 else 48.0},16")
    flights.write_text("\n".join(lines))
    options = ["city", "--flights", str(flights), "--minutes", "0.4", "--settle", "5", "--knows", "perfect",
               "--out", str(tmp_path / "out"), "--jobs", "1", "--json"]  # fmt: skip
    assert main([*options, "--seeds", "1-1"]) == 0
    assert main([*options, "--seeds", "1-1"]) == 0
    flights.write_text("\n".join(lines).replace(",200,20", ",300,20"))
    assert main([*options, "--seeds", "1-2"]) == 2
    assert "was made with other settings (data: " in capsys.readouterr().err


def test_runs_depend_on_the_channel_and_the_policy(tmp_path: Path) -> None:
    (tmp_path / f"{SMALL.name}.jsonl").touch()
    with pytest.raises(ConfigError, match="cannot be read"):
        kept(tmp_path, SMALL)
    (tmp_path / f"{SMALL.name}.jsonl").write_text("{}\n")
    with pytest.raises(ConfigError, match=r"standard\.toml.*atmc\.safetensors"):
        kept(tmp_path, SMALL)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--density", "190", "--size", "20", "20"], "76,000 aircraft in the air; allowed: up to 20,000"),
        (["--density", "0"], "--density: 0 is out of range; allowed: above 0, up to 200"),
        (["--density", "nan"], "--density: nan is out of range"),
        (["--size", "1", "0.5"], "--size: 0.5 is out of range; allowed: 1 to 20"),
        (["--size", "nan", "1"], "--size: nan is out of range"),
        (["--speed", "4"], "--speed: 4 is out of range; allowed: 5 to 30"),
        (["--from", "nan"], "--from: nan is out of range; allowed: any finite number"),
        (["--minutes", "-3"], "--minutes: -3 is out of range; allowed: 1/6 to 1440"),
        (["--settle", "600"], "--settle: 600 is out of range; allowed: at least 0, below the run's length"),
        (["--settle", "nan"], "--settle: nan is out of range"),
        (["--separation", "0"], "--separation: 0 is out of range; allowed: above 0, up to 100"),
        (["--load", "1"], "--load: 1 is out of range; allowed: at least 0, below 1"),
        (["--loss", "1.5"], "--loss: 1.5 is out of range; allowed: 0 to 1"),
        (["--reach", "inf"], "--reach: inf is out of range; allowed: any finite number above 0"),
        (["--delay", "3", "1"], "--delay: 3 1; allowed: two rising numbers from 0 to 15"),
    ],
)
def test_wrong_options_are_refused(options: list[str], words: str) -> None:
    """Each message names the option, its value and what is allowed, in the option's own unit."""
    with pytest.raises(ConfigError, match=re.escape(words)):
        cells_of(options)


def test_the_least_and_the_greatest_values_are_allowed() -> None:
    """What the options allow is what `City` and `Demand` allow."""
    for options in (
        ["--size", "1", "20", "--speed", "5", "--settle", "0", "--loss", "0", "--load", "0"],
        ["--density", "200", "--size", "1", "1", "--speed", "30", "--separation", "100", "--loss", "1"],
        ["--minutes", str(1 / 6), "--settle", "0"],
        ["--minutes", "1440", "--from", "-5"],
    ):
        city = cells_of(options)
        assert city == msgspec.convert(msgspec.to_builtins(city), City)


def cells_of(options: list[str]) -> City:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return city_of(parser.parse_args(options))
