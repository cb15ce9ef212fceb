"""Heights that no aircraft can have flown."""

import numpy as np
import pytest

from ground_tools.inspect.read import heights


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
