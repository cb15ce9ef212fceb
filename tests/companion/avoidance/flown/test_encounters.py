"""Whole encounters, flown by the law in a small deterministic simulation.

Vehicles answer a velocity command with a first-order lag (0.5 s) and 2.5 m/s^2. Every aircraft sends its
state once a second; each receiver gets it after its own uniformly drawn delay. Positions carry correlated
GNSS noise (1.5 m per axis, 30 s), sent velocities 0.3 m/s, and messages are quantised as Remote ID does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from companion.avoidance.law import Law, Neighbour, Situation
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from sitl_mocks.encounters.scenario import CROSSING_S, encounter

STEP_S = 0.1
LAG_S = 0.5
ACCELERATION_MPS2 = 2.5
SEPARATION_M = 10.0
NOISE_MEMORY_S = 30.0


@dataclass(frozen=True)
class Flown:
    """Result of an encounter."""

    separation_m: float
    """Least true distance of any pair."""
    deviation_m: float
    """Largest true distance of any aircraft from its timed point."""
    back_m: float
    """Largest true distance from the timed point at the end."""


def fly(
    laws: list[Law],
    delay_s: tuple[float, float],
    seed: int,
    *,
    sigma_m: float = 1.5,
    sigma_mps: float = 0.3,
    period_s: float = 0.2,
    window_s: tuple[float, float] = (0.0, 500.0),
) -> Flown:
    """Fly an encounter; it begins on the paths at the window's first time."""
    rng = np.random.default_rng([seed, 7])
    count, start = len(laws), window_s[0]
    position = np.array([law.trajectory.position(start) for law in laws])
    velocity = np.array([law.trajectory.velocity(start) for law in laws])
    command = velocity.copy()
    noise = rng.normal(0.0, sigma_m, (count, 3))
    phase = rng.integers(0, round(1.0 / STEP_S), count)
    keep = math.exp(-STEP_S / NOISE_MEMORY_S)
    pending: list[list[tuple[float, int, Neighbour]]] = [[] for _ in laws]
    heard: list[dict[int, tuple[float, Neighbour]]] = [{} for _ in laws]
    separation, deviation, away = math.inf, 0.0, 0.0
    every = round(period_s / STEP_S)
    for tick in range(round((window_s[1] - start) / STEP_S) + 1):
        now = start + tick * STEP_S
        measured = position + noise
        for i in range(count):
            if (tick + phase[i]) % round(1.0 / STEP_S) == 0:
                sent = _quantised(i, measured[i], velocity[i] + rng.normal(0.0, sigma_mps, 3), sigma_m)
                for j in range(count):
                    if j != i:
                        pending[j].append((now + rng.uniform(*delay_s), tick, sent))
        if tick % every == 0:
            for i, law in enumerate(laws):
                known = _receive(pending, heard, i, now, start)
                own = (tuple(measured[i].tolist()), tuple(velocity[i].tolist()))
                result = law.decide(Situation(now, now, own[0], own[1], sigma_m, known))
                command[i] = result.chosen_ned_mps
        answer = (command - velocity) / LAG_S
        size = np.linalg.norm(answer, axis=1, keepdims=True)
        answer *= np.minimum(1.0, ACCELERATION_MPS2 / np.maximum(size, 1e-12))
        step = (velocity + 0.5 * STEP_S * answer) * STEP_S
        separation = min(separation, _least_distance(position, step))
        position, velocity = position + step, velocity + STEP_S * answer
        noise = keep * noise + math.sqrt(1.0 - keep * keep) * rng.normal(0.0, sigma_m, (count, 3))
        gaps = [
            math.dist(law.trajectory.position(now + STEP_S), p) for law, p in zip(laws, position, strict=True)
        ]
        away = max(gaps)
        deviation = max(deviation, away)
    return Flown(separation, deviation, away)


def _quantised(i: int, p: np.ndarray, v: np.ndarray, sigma_m: float) -> Neighbour:
    """Remote ID's steps: 0.25 m/s, 1 degree, 0.5 m/s vertical, 1e-7 degree, 0.5 m."""
    speed = round(math.hypot(v[0], v[1]) / 0.25) * 0.25
    course = math.radians(round(math.degrees(math.atan2(v[1], v[0]))))
    return Neighbour(
        f"uas-{i}",
        (round(p[0] / 0.0111) * 0.0111, round(p[1] / 0.0111) * 0.0111, round(p[2] / 0.5) * 0.5),
        (speed * math.cos(course), speed * math.sin(course), round(v[2] / 0.5) * 0.5),
        0.0,
        sigma_m,
    )


def _receive(
    pending: list[list[tuple[float, int, Neighbour]]],
    heard: list[dict[int, tuple[float, Neighbour]]],
    i: int,
    now: float,
    start: float,
) -> list[Neighbour]:
    """Deliver what has arrived; the newest of every sender, aged to now."""
    arrived = [m for m in pending[i] if m[0] <= now]
    pending[i] = [m for m in pending[i] if m[0] > now]
    for _, tick, message in arrived:
        sampled = start + tick * STEP_S
        sender = int(message.track_id.removeprefix("uas-"))
        if sender not in heard[i] or heard[i][sender][0] < sampled:
            heard[i][sender] = (sampled, message)
    return [
        Neighbour(m.track_id, m.position_ned_m, m.velocity_ned_mps, now - sampled, m.sigma_m)
        for sampled, m in heard[i].values()
    ]


def _least_distance(position: np.ndarray, step: np.ndarray) -> float:
    """Least distance of any pair while all move along their straight step."""
    a, b = np.triu_indices(len(position), 1)
    p, d = position[a] - position[b], step[a] - step[b]
    d2 = np.einsum("ij,ij->i", d, d)
    share = np.clip(-np.einsum("ij,ij->i", p, d) / np.maximum(d2, 1e-12), 0.0, 1.0)
    return float(np.linalg.norm(p + share[:, None] * d, axis=1).min())


def laws_for(kind: str, aircraft: int, seed: int, avoidance: AvoidanceConfig) -> list[Law]:
    """One law for each aircraft of an encounter."""
    paths = encounter(kind, aircraft, seed)  # type: ignore[arg-type]
    return [Law(avoidance, LimitsConfig(), Trajectory.from_rows(rows)) for rows in paths]


WINDOW = (CROSSING_S - 70.0, CROSSING_S + 60.0)


@pytest.mark.parametrize("delay_s", [(0.0, 1.0), (2.0, 3.0)])
@pytest.mark.parametrize("seed", range(3))
def test_every_pair_stays_apart(delay_s: tuple[float, float], seed: int) -> None:
    flown = fly(laws_for("S2", 5, seed, AvoidanceConfig()), delay_s, seed, window_s=WINDOW)
    assert flown.separation_m > SEPARATION_M
    assert flown.back_m < 15.0


@pytest.mark.parametrize("seed", range(3))
def test_the_same_paths_conflict_when_nobody_avoids(seed: int) -> None:
    flown = fly(laws_for("S2", 5, seed, AvoidanceConfig(law="none")), (0.0, 1.0), seed, window_s=WINDOW)
    assert flown.separation_m < SEPARATION_M


def test_symmetric_circle_does_not_dance() -> None:
    flown = fly(laws_for("S3", 5, 1, AvoidanceConfig()), (1.0, 2.0), 1, window_s=WINDOW)
    assert flown.separation_m > SEPARATION_M
    assert flown.deviation_m < 60.0
