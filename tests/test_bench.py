"""The benches run: their figures are for a person, but a bench that broke says nothing."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import import_module
from types import SimpleNamespace

import pytest

from bench import (
    __main__,
    bench_aboard,
    bench_atmc,
    bench_avoidance,
    bench_channel,
    bench_core,
    bench_display,
    bench_flood,
    bench_gate,
    bench_lockstep,
    bench_remote_id,
)
from bench.measuring import figures
from bench.measuring.memory import memory_mb

_SHORT_AVOIDANCE = {
    "COUNTS": (20,),
    "DECIDE_SCENES": 1,
    "ROUNDS": 1,
    "DECISIONS": 2,
    "REFERENCE_US": {},  # it compiles a loop of its own
    "REFERENCE_STEP_MS": {50: 1.0},
    "STEPS": 2,
    "FLIGHTS": {5: 1},
    "FLIGHT_ROUNDS": 1,
}


@pytest.mark.parametrize(
    ("module", "shorter", "words"),
    [
        (bench_avoidance, _SHORT_AVOIDANCE, "target: campaign, 5 aircraft: at least 45,000"),
        (bench_core, {"SECONDS": 10, "FLIGHTS": 2}, "target: deciding step, median: at most 0.2"),
        (
            bench_flood,
            {"FLOOD_S": 1, "FLIGHTS": 1, "FLOODS": bench_flood.FLOODS[:2]},
            "target: honest frames heard in a flood: at least 95 %",
        ),
        (bench_gate, {"STEPS": 300}, "octagonal fence"),
        (bench_lockstep, {"SECONDS": 2.0, "RUNS": 2}, "target: 5 aircraft: at least 60 times real time"),
        (bench_remote_id, {"NUMBER": 200}, "Location: encode"),
        (bench_channel, {"FLEETS": (10, 30)}, "only neighbours in range"),
    ],
)
def test_a_bench_prints_its_table(monkeypatch, capsys, module, shorter, words):
    for name, value in shorter.items():
        monkeypatch.setattr(module, name, value)
    module.main()
    assert words in capsys.readouterr().out


def test_every_learner_is_measured(monkeypatch, capsys):
    """With a buffer that is filled first, and without."""
    for name in ("_STEPS", "_EPISODES", "_TURNS"):
        monkeypatch.setattr(bench_atmc, name, 1)
    bench_atmc._learners()
    bench_atmc._aboard()
    shown = capsys.readouterr().out
    for name in bench_atmc._LEARNERS:
        assert re.search(rf"{name} .*\d", shown), shown


@pytest.mark.parametrize("name", __main__.NAMES)
def test_every_bench_has_a_main(name):
    assert callable(import_module(f"bench.bench_{name}").main)


@pytest.mark.parametrize(
    ("measured", "bounds", "verdict"),
    [
        (24.9, {"most": 25.0}, "met"),
        (25.1, {"most": 25.0}, "NOT MET"),
        (61.0, {"least": 60.0}, "met"),
        (59.0, {"least": 60.0}, "NOT MET"),
    ],
)
def test_a_target_is_shown_beside_the_figure(capsys, measured, bounds, verdict):
    figures.target("a figure", measured, "us", **bounds)
    shown = capsys.readouterr().out
    assert shown.endswith(f": {verdict}\n")
    assert f"{measured:g}" in shown


@pytest.mark.parametrize(("most", "code"), [(1.0, 0), (0.9, 1)])
def test_a_missed_target_is_an_exit_code(monkeypatch, most, code):
    bench = SimpleNamespace(main=lambda: figures.target("a figure", 1.0, "MB", most=most), __doc__="A bench.")
    monkeypatch.setattr(figures.Missed, "count", 0)
    monkeypatch.setattr(__main__, "import_module", lambda name: bench)
    monkeypatch.setattr(__main__, "reference_s", lambda: 0.05)
    monkeypatch.setattr(sys, "argv", ["bench", "links"])
    assert __main__.main() == code


def test_the_peak_of_a_process_is_its_own():
    """A process that a large one starts has not been as large."""
    block = bytearray(200_000_000)
    code = "from bench.measuring.memory import memory_mb; print(memory_mb('VmHWM'))"
    child = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert float(child.stdout) < 100.0 < memory_mb("VmHWM")
    assert len(block) == 200_000_000


def test_the_real_process_is_measured(monkeypatch, capsys, tmp_path):
    """One short flight, and none beside busy processes, which would disturb other tests."""
    monkeypatch.setattr(bench_aboard, "SECONDS", 0.2)
    monkeypatch.setattr(bench_aboard, "SETTLE_S", 0.1)
    bench_aboard.line("as it is here", bench_aboard.fly(tmp_path))
    flown = capsys.readouterr().out
    assert flown.startswith("as it is here")
    assert 50 < float(flown.split()[5]) < 1000, "MB of this process's memory"


def test_a_real_display_beside_a_real_flight_takes_little_of_a_core(monkeypatch, tmp_path):
    """The display takes 0.2 % of a core with 50 aircraft. The clients are in the place of a browser.

    What it adds to the flight is less than the scatter of the flight's own time; `python -m bench display`
    measures that, in minutes.
    """
    for name, value in {"ROUNDS": 1, "SECONDS": 2.0, "SETTLE_S": 1.5}.items():
        monkeypatch.setattr(bench_display, name, value)
    ways = {bench_display.ONE: bench_display.clients, bench_display.STOPPED: bench_display.stopped}
    monkeypatch.setattr(bench_display, "WAYS", ways)
    shares = bench_display.measured(tmp_path)
    assert set(shares.flight) == {bench_display.NONE, *ways} == set(shares.late)
    assert set(shares.display) == set(ways)
    assert all(0.0 < share < 400.0 for (share,) in shares.flight.values()), "it flies at 20 Hz meanwhile"
    assert all(share < bench_display.MOST_CORE for (share,) in shares.display.values()), shares.display
