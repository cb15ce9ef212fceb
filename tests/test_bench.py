"""The benches run: their figures are for a person, but a bench that broke says nothing."""

from __future__ import annotations

import pytest

from bench import bench_channel, bench_heart, bench_lockstep, bench_remote_id


@pytest.mark.parametrize(
    ("module", "shorter", "words"),
    [
        (bench_heart, ("SECONDS", 10), "that decides, 20 neighbours"),
        (bench_lockstep, ("SECONDS", 2.0), "times real time"),
        (bench_remote_id, ("NUMBER", 200), "Location encoded"),
        (bench_channel, ("FLEETS", (10, 30)), "neighbours in range only"),
    ],
)
def test_a_bench_prints_its_table(monkeypatch, capsys, module, shorter, words):
    monkeypatch.setattr(module, *shorter)
    module.main()
    assert words in capsys.readouterr().out
