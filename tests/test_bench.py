"""The benches run: their figures are for a person, but a bench that broke says nothing."""

from __future__ import annotations

import pytest

from bench import bench_aboard, bench_channel, bench_core, bench_gate, bench_lockstep, bench_remote_id


@pytest.mark.parametrize(
    ("module", "shorter", "words"),
    [
        (bench_core, ("SECONDS", 10), "with a decision, 20 neighbours"),
        (bench_gate, ("STEPS", 300), "octagonal fence"),
        (bench_lockstep, ("SECONDS", 2.0), "times real time"),
        (bench_remote_id, ("NUMBER", 200), "Location: encode"),
        (bench_channel, ("FLEETS", (10, 30)), "only neighbours in range"),
    ],
)
def test_a_bench_prints_its_table(monkeypatch, capsys, module, shorter, words):
    monkeypatch.setattr(module, *shorter)
    module.main()
    assert words in capsys.readouterr().out


def test_the_real_process_is_measured(monkeypatch, capsys, tmp_path):
    """One short flight, and none beside busy processes, which would disturb other tests."""
    monkeypatch.setattr(bench_aboard, "SECONDS", 0.2)
    monkeypatch.setattr(bench_aboard, "SETTLE_S", 0.1)
    bench_aboard.line("as it is here", bench_aboard.fly(tmp_path))
    flown = capsys.readouterr().out
    assert flown.startswith("as it is here")
    assert 50 < float(flown.split()[5]) < 1000, "MB of this process's memory"
