"""The placement of encounters: window, beginning, headings and weights."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ground_tools.campaign.encounters import pairing
from ground_tools.campaign.encounters.model import LAYER
from ground_tools.campaign.encounters.sampling import FOOT_M
from ground_tools.campaign.encounters.volumes import WELL_CLEAR, Volume, first_inside
from tests.support.encounter_models import ROTORCRAFT, model_of

STEP_S = 0.5
AT = round(pairing.CONFLICT_S / STEP_S)


def own_at(encounter, rows):
    """Position of our own aircraft on its path, at every row."""
    times = np.linspace(0.0, pairing.DURATION_S, rows)
    return np.column_stack([np.interp(times, encounter.own_times_s, c) for c in encounter.own_points.T])


def drawn(model, own_mps, count, window=WELL_CLEAR):
    rng = np.random.default_rng(1)
    return [pairing.draw(rng, model, own_mps, window, STEP_S) for _ in range(count)]


@pytest.mark.parametrize("own_mps", [0.0, 10.0])
@pytest.mark.parametrize("name", ["tiny", ROTORCRAFT])
@pytest.mark.parametrize("window", [WELL_CLEAR, Volume(1200.0, 130.0)])
def test_the_window_and_the_beginning(name, own_mps, window):
    model = model_of(name)
    for encounter in drawn(model, own_mps, 40, window):
        track, own = encounter.position, own_at(encounter, len(encounter.position))
        assert len(track) == pairing.DURATION_S / STEP_S + 1
        np.testing.assert_allclose(own[AT], [0.0, 0.0, own[0, 2]], atol=1e-6)
        assert encounter.own_times_s.tolist() == [-60.0, 300.0]
        assert np.linalg.norm(np.diff(encounter.own_points, axis=0)) / 360.0 == pytest.approx(own_mps)
        low, high = pairing.OWN_HEIGHT_M
        assert low <= -own[0, 2] <= high
        assert own[0, 2] == own[-1, 2]
        relative = track[AT] - own[AT]
        assert np.hypot(*relative[:2]) <= window.aside_m
        assert abs(relative[2]) <= window.height_m
        velocity = encounter.velocity[AT, :2] - (own[-1, :2] - own[0, :2]) / pairing.DURATION_S
        across = relative[:2] @ velocity / np.linalg.norm(velocity)
        assert across == pytest.approx(0.0, abs=1e-6)  # perpendicular to the relative motion
        assert np.hypot(*(track[0] - own[0])[:2]) >= pairing.APART_M
        layers = np.array(model.bounds(LAYER)) * FOOT_M
        assert (-track[:, 2] >= layers[0] - 1e-6).all()
        assert layers[0] <= -track[0, 2] <= layers[1]
        steps = np.diff(track, axis=0)[:, :2] / STEP_S
        middle = 0.5 * (encounter.velocity[1:] + encounter.velocity[:-1])[:, :2]
        np.testing.assert_allclose(steps, middle, atol=1e-9)


def test_an_encounter_loses_well_clear_without_avoidance():
    for encounter in drawn(model_of("tiny"), 10.0, 40):
        relative = encounter.position - own_at(encounter, len(encounter.position))
        assert first_inside(relative, STEP_S, WELL_CLEAR) is not None


def test_sides_are_uniform():
    aside = []
    for encounter in drawn(model_of("tiny"), 0.0, 400):
        n, e = encounter.velocity[AT, :2] / np.linalg.norm(encounter.velocity[AT, :2])
        place = encounter.position[AT]
        aside.append((n * place[1] - e * place[0]) / WELL_CLEAR.aside_m)
    seen, _ = np.histogram(aside, bins=8, range=(-1.0, 1.0))
    assert seen.sum() == 400
    assert ((seen - 50.0) ** 2 / 50.0).sum() < 26.0  # chi-square, 7 degrees of freedom, level 0.0005


def test_headings_follow_the_relative_speed_and_the_weight_is_its_mean():
    """At 30 m/s against 15 m/s, head-on encounters are three times as frequent as those from behind. The
    weight is compared with the mean over all headings from another integration."""
    rng = np.random.default_rng(2)
    own, velocity = np.array([15.0, 0.0, 0.0]), np.array([0.0, 30.0, -2.0])
    found = [pairing._heading(rng, velocity, own) for _ in range(4000)]
    weight = found[0][1]
    fine = (np.arange(100_000) + 0.5) * 2.0 * math.pi / 100_000
    speeds = np.sqrt(30.0**2 + 15.0**2 - 2.0 * 30.0 * 15.0 * np.cos(fine) + 2.0**2)
    assert all(w == weight for _, w in found)
    assert weight == pytest.approx(speeds.mean(), rel=1e-9)
    seen, _ = np.histogram([h for h, _ in found], bins=10, range=(0.0, 2.0 * math.pi))
    wanted = speeds.reshape(10, -1).sum(axis=1) / speeds.sum() * 4000
    assert ((seen - wanted) ** 2 / wanted).sum() < 29.7  # 9 degrees of freedom, level 0.0005
    assert ((seen - 400.0) ** 2 / 400.0).sum() > 29.7  # uniform headings would fail


def test_weights_make_up_for_headings_drawn_in_proportion_to_the_relative_speed():
    """The weighted share of any event equals that of uniform headings weighted by their relative speed."""
    rng = np.random.default_rng(3)
    own = np.array([15.0, 0.0, 0.0])
    levels = np.where(rng.random(6_000) < 0.5, 5.0, 40.0)  # slow and fast aircraft
    drawn_ = [pairing._heading(rng, np.array([v, 0.0, 0.0]), own) for v in levels]
    headings, weights = np.array(drawn_).T
    fast_from_ahead = (levels > 20.0) & (np.cos(headings) < 0.0)
    share = weights[fast_from_ahead].sum() / weights.sum()
    uniform = (np.arange(100_000) + 0.5) * 2.0 * math.pi / 100_000
    slow, fast = (np.hypot(v * np.cos(uniform) - 15.0, v * np.sin(uniform)) for v in (5.0, 40.0))
    other = fast[np.cos(uniform) < 0.0].sum() / (slow.sum() + fast.sum())
    assert share == pytest.approx(other, abs=0.015)
    assert abs(fast_from_ahead.mean() - other) > 0.05  # fails without weights


def test_a_model_that_never_flies_at_our_height_is_refused(monkeypatch):
    monkeypatch.setattr(pairing, "_MOST_TRIES", 20)
    monkeypatch.setattr(pairing, "OWN_HEIGHT_M", (9000.0, 9000.0))
    with pytest.raises(ValueError, match="hardly ever flies at the height of our own aircraft"):
        drawn(model_of("tiny"), 0.0, 1)
