"""The oracle file passes, a changed copy fails with the place, and another file is refused in one line."""

from __future__ import annotations

import argparse
import gzip
import json
from pathlib import Path
from typing import Any

import pytest

from ground_tools import orca_check

ORACLE = Path(__file__).parents[1] / "data" / "orca_cases.json.gz"


def check(*arguments: object) -> int:
    parser = argparse.ArgumentParser()
    orca_check.add_arguments(parser)
    return orca_check.run(parser.parse_args(["check", *map(str, arguments)]))


@pytest.fixture(scope="module")
def oracle() -> dict[str, Any]:
    return json.loads(gzip.decompress(ORACLE.read_bytes()))


def damaged(oracle: dict[str, Any], path: Path, case_id: str, **changes: object) -> Path:
    cases = [{**case, **changes} if case["id"] == case_id else case for case in oracle["cases"]]
    path.write_text(json.dumps({"cases": cases}))
    return path


def first(oracle: dict[str, Any], **wanted: object) -> str:
    return next(c["id"] for c in oracle["cases"] if all(c[key] == value for key, value in wanted.items()))


def test_every_case_agrees(capsys: pytest.CaptureFixture[str]) -> None:
    assert check(ORACLE) == 0
    out = capsys.readouterr().out
    assert "320 of 320 cases agree" in out
    assert "head_on_exact_axis" in out


def test_json_says_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    assert check(ORACLE, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["cases"] == 320
    assert result["differing"] == {}
    assert sum(c["cases"] for c in result["categories"].values()) == 320


def test_a_changed_velocity_is_found(
    oracle: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case_id = first(oracle, feasible=True, conditioning="well", category="dense")
    velocity = next(c for c in oracle["cases"] if c["id"] == case_id)["new_velocity_float64"]
    changed = [velocity[0] + 2e-5, *velocity[1:]]
    path = damaged(oracle, tmp_path / "c.json", case_id, new_velocity_float64=changed)
    assert check(path) == 1
    out = capsys.readouterr().out
    assert f"{case_id}: velocity" in out
    assert "319 of 320 cases agree" in out


@pytest.mark.parametrize("change", [2e-5, -2e-5])
def test_a_changed_violation_is_found(oracle: dict[str, Any], tmp_path: Path, change: float) -> None:
    case_id = first(oracle, feasible=False, conditioning="well")
    violation = next(c for c in oracle["cases"] if c["id"] == case_id)["max_violation"]
    assert check(damaged(oracle, tmp_path / "c.json", case_id, max_violation=violation + change)) == 1


@pytest.mark.parametrize("conditioning", ["well", "ill", "float32_nan"])
def test_a_changed_feasibility_is_found(oracle: dict[str, Any], tmp_path: Path, conditioning: str) -> None:
    case_id = first(oracle, feasible=True, conditioning=conditioning)
    assert check(damaged(oracle, tmp_path / "c.json", case_id, feasible=False)) == 1


def test_an_answer_that_flies_on_head_on_is_found(oracle: dict[str, Any]) -> None:
    raw = next(c for c in oracle["cases"] if c["conditioning"] == "degenerate")
    case = orca_check.msgspec.convert(raw, orca_check.Case)
    flying_on = orca_check.Answer(case.agent.velocity, True, 0.0)
    assert orca_check.compare(case, flying_on) is not None
    not_a_number = orca_check.Answer((float("nan"), 0.0, 0.0), True, 0.0)
    assert "finite" in str(orca_check.compare(case, not_a_number))
    assert orca_check.compare(case, orca_check.solve(case)) is None


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[]",
        b'{"cases": []}',
        b'{"cases": [{"id": 1}]}',
        b"\x1f\x8bnot gzip at all",
        b"\xff\xfe",
        gzip.compress(b'{"cases": []}', mtime=0)[:-9],
    ],
)
def test_another_file_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes
) -> None:
    path = tmp_path / "cases.json"
    path.write_bytes(content)
    assert check(path) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert str(path) in error


def test_missing_file_and_missing_answer(
    oracle: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert check(tmp_path / "nowhere.json") == 2
    path = damaged(oracle, tmp_path / "c.json", "pub-0000", new_velocity_float64=None)
    assert check(path) == 2
    assert "pub-0000" in capsys.readouterr().err
