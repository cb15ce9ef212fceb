"""Heights that no aircraft can have flown."""

from pathlib import Path

import numpy as np
import pytest

from ground_tools.inspect.read import heights
from ground_tools.inspect.report.summary import describe
from tests.ground_tools.inspect.report.test_drawings import at, run_of


def test_long_flights_are_judged_as_in_one_piece(monkeypatch: pytest.MonkeyPatch):
    rng = np.random.default_rng(1)
    count = 3000
    time_s = np.cumsum(rng.uniform(0.01, 0.3, count))
    height_m = np.cumsum(rng.normal(0.0, 0.2, count))
    wrong = np.concatenate([rng.integers(0, count, 40), np.arange(254, 258)])
    height_m[wrong] += 100.0
    height_m[511] = np.nan
    whole = heights.spikes(time_s, height_m)
    assert whole[254:258].all()
    monkeypatch.setattr(heights, "BLOCK", 256)
    assert (heights.spikes(time_s, height_m) == whole).all()
    assert whole.sum() == len(set(wrong.tolist()) - {511})


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("gap_s", [0.0, 8.0])
def test_a_steady_climb_has_no_spikes_at_the_ends_of_a_log_and_at_gaps(down: bool, gap_s: float):
    time_s = np.arange(16.0) + np.where(np.arange(16) >= 8, gap_s, 0.0)
    height_m = 20.0 * (time_s[::-1] if down else time_s)
    assert not heights.spikes(time_s, height_m).any()


@pytest.mark.parametrize("wrong", [[0], [14], [13, 14], [7], [0, 7, 14]])
def test_spikes_within_a_climb_are_found_also_at_its_ends(wrong: list[int]):
    time_s = np.arange(15.0)
    height_m = 20.0 * time_s
    height_m[wrong] += 500.0
    assert np.flatnonzero(heights.spikes(time_s, height_m)).tolist() == wrong


def test_a_last_sample_that_jumps_is_a_spike_also_among_few():
    assert heights.spikes(np.arange(3.0), np.array([0.0, 0.0, 100.0])).tolist() == [False, False, True]


def test_the_top_of_a_climb_that_ends_the_log_is_the_greatest_height(tmp_path: Path):
    run = run_of(tmp_path, [at(float(t), 20.0 * t) for t in range(15)])
    assert describe(run)["aircraft"][0]["flight"]["max_height_m"] == pytest.approx(280.0)
