"""The drawn encounters have the documented geometry."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from sitl_mocks.encounters.scenario import HALF_AIRSPACE_M, HEIGHT_M, encounter


@pytest.mark.parametrize("kind", ["S1", "S2", "S3"])
@pytest.mark.parametrize("aircraft", [2, 5, 10])
def test_paths(kind: str, aircraft: int) -> None:
    for seed in range(20):
        paths = encounter(kind, aircraft, seed)  # type: ignore[arg-type]
        assert len(paths) == aircraft
        for rows in paths:
            assert rows[:, 0].tolist() == [0.0, 250.0, 500.0]
            assert np.abs(rows[:, 1:3]).max() <= HALF_AIRSPACE_M
            height = -rows[:, 3]
            assert height.min() > 44.0
            assert height.max() < 156.0
            legs = np.diff(rows[:, 1:], axis=0) / 250.0
            np.testing.assert_allclose(legs[0], legs[1], atol=1e-12)  # straight, at one speed
            assert 1.3 < np.linalg.norm(legs[0]) < 3.0
            radius = {"S1": 30.0, "S2": 8.0, "S3": 1e-9}[kind]
            assert np.linalg.norm(rows[1, 1:] + [0, 0, HEIGHT_M]) <= radius
        for a, b in itertools.combinations(paths, 2):
            assert np.linalg.norm(a[0, 1:] - b[0, 1:]) > 60.0
            assert np.linalg.norm(a[2, 1:] - b[2, 1:]) > 60.0


def test_same_seed_same_paths_other_seed_others() -> None:
    a, b, c = encounter("S2", 5, 4), encounter("S2", 5, 4), encounter("S2", 5, 5)
    assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
    assert not np.array_equal(a[0], c[0])


def test_s2_conflicts_when_nobody_avoids() -> None:
    near = 0
    for seed in range(40):
        paths = encounter("S2", 5, seed)
        t = np.linspace(200, 300, 2001)
        flown = np.array([[np.interp(t, r[:, 0], r[:, k]) for k in (1, 2, 3)] for r in paths])
        least = min(np.linalg.norm(a - b, axis=0).min() for a, b in itertools.combinations(flown, 2))
        near += least < 10.0
    assert near >= 38


def test_wrong_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="S4"):
        encounter("S4", 5, 0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="2 or more"):
        encounter("S1", 1, 0)
    # Sixty never fit on the circle, in however many draws.
    monkeypatch.setattr("sitl_mocks.encounters.scenario._MOST_DRAWS", 100)
    with pytest.raises(ValueError, match="cannot be placed"):
        encounter("S3", 60, 0)
