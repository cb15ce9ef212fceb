"""The comparison of both channel models: correctness of the rows, and their output."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ground_tools.channel import compare
from ground_tools.channel.compare import Effort, row_of
from ground_tools.channel.comparison import VARIANTS, Case, Row
from ground_tools.cli import main
from sitl_mocks.channel.parameters import ChannelParameters

PAPER = ChannelParameters()
EFFORT = Effort(seconds=60.0, environments=4, seed=3)


def link(variant, mode, rate):
    return row_of(PAPER, EFFORT, Case("link", variant, mode, rate, 201))


@pytest.mark.parametrize(("mode", "rate"), [("ble4", 9), ("ble5", 10), ("wifi", 10), ("wifi", 8)])
def test_under_the_same_assumptions_both_models_agree(mode, rate):
    row = link("as the equations", mode, rate)
    # The larger of 2 % and 1.5 times the simulation's 95 % interval.
    assert row.ratio == pytest.approx(1.0, abs=max(0.02, 1.5 * (row.packets_high / row.packets - 1.0)))
    assert row.packets_high / row.packets - 1.0 < 0.02
    assert row.never_heard == 0.0
    assert row.waiting == 0.0


def test_locked_phases_leave_pairs_that_never_hear():
    row = link("phases run on", "ble4", 5)
    assert row.never_heard > 0.5
    assert link("phases run on, clocks drift", "ble4", 5).never_heard < row.never_heard
    assert link("real radios", "ble4", 5).never_heard == 0.0


def test_losses_of_independent_senders_agree():
    """With random delays, collisions are nearly independent, as the products of the equations assume."""
    row = row_of(PAPER, EFFORT, Case("collision", "real radios", "ble4", 9, 30, 100.0))
    assert row.equations == pytest.approx(1.0 - (1.0 - 2 * 0.376 * 9 / 1000) ** 28)
    assert row.ratio == pytest.approx(1.0, abs=0.15)
    stronger = row_of(PAPER, EFFORT, Case("collision", "real radios, capture 6 dB", "ble4", 9, 30, 100.0))
    assert stronger.packets < row.packets


@pytest.mark.parametrize("variant", VARIANTS["collision"])
def test_every_variant_loses_about_as_many_packets_as_the_equations_say(variant):
    """Uses few simulations; with many, the command takes minutes."""
    effort = Effort(seconds=10.0, environments=1, seed=1)
    row = row_of(PAPER, effort, Case("collision", variant, "ble4", 9, 5, 100.0))
    assert row.packets == pytest.approx(row.equations, abs=0.01)
    assert row.packets > 0.01


def test_both_models_see_the_same_positions():
    rows = [
        row_of(PAPER, EFFORT, Case("fleet", variant, "ble4", 9, 10, 3000.0)) for variant in VARIANTS["fleet"]
    ]
    assert rows[0].equations == rows[1].equations
    assert rows[0].packets != rows[1].packets


def test_random_phases_are_nearer_to_real_bluetooth():
    row = link("real radios", "ble5", 10)
    assert abs(row.ratio_random - 1.0) < 0.15 < abs(row.ratio - 1.0)


def test_the_command_prints_rows_and_draws(monkeypatch, capsys, tmp_path):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(compare, "SIDES_M", (3000.0,))
    monkeypatch.setattr(compare, "FLEETS", (5,))
    monkeypatch.setattr(compare, "RECEIVERS", 3)
    # Colliding packets take most of the time. Other variants are simulated above.
    collisions = {name: VARIANTS["collision"][name] for name in ("as the equations", "real radios")}
    monkeypatch.setitem(VARIANTS, "collision", collisions)
    out = str(tmp_path / "new")
    assert (
        main(["channel", "compare", "--seconds", "10", "--environments", "10", "--out", out, "--json"]) == 0
    )
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {row["study"] for row in rows} == {"link", "collision", "fleet"}
    assert len(rows) == 30 * len(VARIANTS["link"]) + 3 * len(VARIANTS["collision"]) + 3 * len(
        VARIANTS["fleet"]
    )
    assert (tmp_path / "new" / "compare.png").stat().st_size > 10_000
    kept = [json.loads(line) for line in (tmp_path / "new" / "compare.jsonl").read_text().splitlines()]
    assert kept == rows
    assert all(
        v is None or not isinstance(v, float) or math.isfinite(v) for row in rows for v in row.values()
    )


def test_tables_in_a_pipe_hold_whole_numbers(monkeypatch, capsys):
    names = Case("fleet", "real radios, capture 6 dB", "wifi", 10, 100, 10_000.0)
    row = Row(names, "system_delay_ms", 19_001.0, 18_002.0, 19_503.0, 19_000.0, 20_000.0, 0.015, 0.001)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(compare, "compare", lambda *_: [row])
    assert main(["channel", "compare"]) == 0
    out = capsys.readouterr().out
    assert "…" not in out
    for cell in ("real radios, capture 6 dB", "19001 ms", "18002 ms", "19503 ± 500 ms", "1.5 %", "0.10 %"):
        assert f" {cell} " in out


def test_tables_explain_their_columns_and_hold_no_nan(monkeypatch, capsys):
    nobody = Row(
        Case("fleet", "as the equations", "ble4", 9, 10, 10_000.0),
        "system_delay_ms",
        *(0.0, 0.0, 0.0, 0.0, 0.0),
        *(math.nan, math.nan),
    )
    monkeypatch.setattr(compare, "compare", lambda *_: [nobody])
    assert main(["channel", "compare"]) == 0
    out = capsys.readouterr().out
    assert "nan" not in out
    assert out.count(" - ") == 4
    for column in ("random phases", "never heard", "waiting"):
        assert f"\n{column}: " in out


def test_errors_are_reported_before_the_simulation(monkeypatch, capsys, tmp_path):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(compare, "compare", lambda *_: pytest.fail("simulated"))
    (tmp_path / "file").write_text("")
    slow = tmp_path / "slow.toml"
    slow.write_text("[ble5]\nmax_rate = 7\n")
    taken = tmp_path / "taken"
    (taken / "compare.png").mkdir(parents=True)
    for words, what in (
        (
            ["--parameters", str(slow)],
            f"--parameters: {slow}: ble5.max_rate: 7 is too low; allowed in this comparison: 10",
        ),
        (["--out", str(tmp_path / "file")], f"--out: {tmp_path / 'file'}: the folder cannot be created"),
        (["--out", str(taken)], "compare.png: cannot be written: it is a folder"),
    ):
        assert main(["channel", "compare", *words]) == 2
        assert what in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main(["channel", "compare", "--out", str(tmp_path / "new")]) == 2
    assert ".[inspect]" in capsys.readouterr().err


@pytest.mark.parametrize("begun", ["first worker", "all workers"])
def test_ctrl_c_ends_it_with_all_its_workers(begun):
    """The simulations would take days. A terminal sends the signal to the whole process group."""

    def ready(pid):
        if begun == "first worker":
            return bool(children_of(pid))
        return workers_ready(pid) >= (os.cpu_count() or 1)

    words = ["channel", "compare", "--seconds", "86400", "--environments", "10000"]
    code = "import sys; from ground_tools.cli import main; sys.exit(main())"
    with subprocess.Popen(
        [sys.executable, "-c", code, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    ) as process:
        try:
            while process.poll() is None and not ready(process.pid):
                time.sleep(0.001)  # the pool starts within milliseconds
            os.killpg(process.pid, signal.SIGINT)
            out, err = process.communicate(timeout=60)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
    assert (process.returncode, out, err) == (130, b"", b"")


def children_of(pid):
    return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()


def workers_ready(pid):
    """Number of child processes with the default handler for SIGINT."""
    status = [Path(f"/proc/{child}/status").read_text().split() for child in children_of(pid)]
    caught = [int(words[words.index("SigCgt:") + 1], 16) for words in status]
    return sum(not signals >> (signal.SIGINT - 1) & 1 for signals in caught)


@pytest.mark.parametrize(
    ("option", "value", "allowed"),
    [
        ("--seconds", "5", "10 to 86400"),
        ("--environments", "9", "10 to 10000"),
        ("--seed", "-1", "0 to 4294967295"),
    ],
)
def test_wrong_options_are_named(capsys, option, value, allowed):
    assert main(["channel", "compare", option, value]) == 2
    error = capsys.readouterr().err
    assert option in error
    assert allowed in error
