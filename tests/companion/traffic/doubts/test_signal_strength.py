"""What signal strength says of positions: honest senders, senders beside their positions, invented ones."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.avoidance import kernels
from companion.traffic.signal_strength import FARTHEST_M, MISMATCH, SignalWitness, Suspicion

ABEAM_M = 8.0
SPEED_MPS = 6.0
"""Closing speed; the sender passes us `ABEAM_M` aside at time 0."""


def passes(
    rng: np.random.Generator,
    offset_m: float = 0.0,
    rate: float = 5.0,
    until_s: float = 0.0,
    message_db: float = 6.0,
    source: tuple[float, float] | None = None,
    wander_db: float = 0.0,
    bearing: float | None = None,
) -> SignalWitness:
    """A sender that comes past, from 40 s before.

    Args:
        offset_m: distance of its reported position from the true one.
        bearing: direction of that, random by default.
        source: true place of the transmitter, if it is not on the sender that it reports.
        wander_db: standard deviation of a shadowing that changes within some 20 m.
    """
    witness = SignalWitness()
    angle = rng.uniform(0.0, 2.0 * math.pi) if bearing is None else bearing
    link_db = -40.0 + rng.normal(0.0, 4.0) + rng.normal(0.0, 6.0)
    wander = rng.normal(0.0, wander_db)
    keep = math.exp(-SPEED_MPS / rate / 20.0)
    for time_s in np.arange(-40.0, until_s, 1.0 / rate):
        true = (SPEED_MPS * time_s, ABEAM_M) if source is None else source
        wander = keep * wander + math.sqrt(1.0 - keep**2) * rng.normal(0.0, wander_db)
        rssi = link_db + wander - 20.0 * math.log10(math.hypot(*true)) + rng.normal(0.0, message_db)
        told = (
            SPEED_MPS * time_s + offset_m * math.cos(angle),
            ABEAM_M + offset_m * math.sin(angle),
            0.0,
        )
        witness.add("wifi/a", float(round(rssi)), told, float(time_s))
    return witness


def share(number: int, seed: int, says, **of) -> float:
    rng = np.random.default_rng(seed)
    return sum(bool(says(passes(rng, **of).suspicion)) for _ in range(number)) / number


def is_beside(found: Suspicion) -> bool:
    return found.beside > kernels.BESIDE


def test_at_most_one_honest_encounter_in_a_hundred_is_suspected() -> None:
    """Ville's inequality bounds it by 1 %; 400 encounters, so 4 are expected at most, and 11 allow for chance
    (the binomial distribution gives more with a probability of 0.3 %)."""
    assert share(400, 11, lambda found: found.log_ratio > MISMATCH, until_s=5.0) <= 11 / 400


def test_honest_senders_are_not_avoided_elsewhere() -> None:
    assert share(200, 12, is_beside, until_s=-4.0) <= 0.02


@pytest.mark.parametrize(
    ("rate", "until_s", "least"),
    [(5.0, -5.0, 0.18), (5.0, -2.0, 0.7), (10.0, -5.0, 0.28), (10.0, -2.0, 0.85)],
)
def test_a_sender_50_m_beside_its_position_is_found_before_it_passes(
    rate: float, until_s: float, least: float
) -> None:
    """More messages find more."""
    assert share(150, 13, is_beside, offset_m=50.0, rate=rate, until_s=until_s) >= least


def test_shadowing_that_wanders_a_little_is_not_suspected() -> None:
    """2 dB, as the filter assumes; 1 % of the encounters at most, and 5 of 150 allow for chance."""
    assert share(150, 19, lambda found: found.log_ratio > MISMATCH, until_s=5.0, wander_db=2.0) <= 5 / 150


def test_its_true_place_is_found() -> None:
    rng = np.random.default_rng(14)
    errors = []
    for _ in range(100):
        found = passes(rng, offset_m=50.0, until_s=-4.0, bearing=0.7).suspicion
        north, east = found.north_m + 50.0 * math.cos(0.7), found.east_m + 50.0 * math.sin(0.7)
        errors.append(math.hypot(north, east))
    assert np.median(errors) <= 15.0


def test_invented_aircraft_of_one_transmitter_contradict_its_power() -> None:
    """It stands 300 m away and tells of an aircraft that comes past."""
    found = share(60, 15, lambda found: found.log_ratio > MISMATCH, source=(0.0, 300.0), until_s=-4.0)
    assert found >= 0.95


def test_a_sender_of_unknown_power_is_not_judged_by_it() -> None:
    """Constant 40 dB more or less change nothing, exactly."""
    quiet, loud = SignalWitness(), SignalWitness()
    rng = np.random.default_rng(16)
    for k in range(100):
        place = (100.0 - k, 5.0, 0.0)
        rssi = -60.0 - 20.0 * math.log10(math.hypot(*place)) + rng.normal(0.0, 6.0)
        quiet.add("wifi/a", rssi, place, 0.2 * k)
        loud.add("wifi/a", rssi + 40.0, place, 0.2 * k)
    assert loud.suspicion == pytest.approx(quiet.suspicion, abs=1e-6)


def test_two_transports_have_a_power_each() -> None:
    """A second address 30 dB weaker is no evidence."""
    rng = np.random.default_rng(17)
    witness = SignalWitness()
    for k in range(200):
        place = (100.0 - k, 20.0, 0.0)
        rssi = -40.0 - 20.0 * math.log10(math.hypot(*place)) + rng.normal(0.0, 6.0)
        witness.add(f"{'wifi' if k % 2 else 'ble4'}/a", rssi - 30.0 * (k % 2), place, 0.1 * k)
    assert witness.suspicion.log_ratio < MISMATCH
    assert not is_beside(witness.suspicion)


@pytest.mark.parametrize("rssi", [math.nan, math.inf, -math.inf])
def test_what_is_no_power_is_ignored(rssi: float) -> None:
    witness = SignalWitness()
    witness.add("wifi/a", -50.0, (50.0, 0.0, 0.0), 0.0)
    for k in range(50):
        assert not witness.add("wifi/a", rssi, (50.0 - k, 0.0, 0.0), 1.0 + k)
    assert witness.suspicion.log_ratio == pytest.approx(0.0, abs=1e-9)


def test_hostile_numbers_leave_finite_results() -> None:
    rng = np.random.default_rng(18)
    witness = SignalWitness()
    for k in range(3000):
        place = tuple(rng.uniform(-1.0, 1.0, 3) * 10.0 ** rng.uniform(-3.0, 5.0))
        witness.add(f"wifi/{k % 9}", float(rng.choice([-1e9, 1e9, -128.0, 127.0, 0.0])), place, 0.1 * k)
        found = witness.suspicion
        assert all(map(math.isfinite, found))
        assert math.hypot(found.north_m, found.east_m) <= 100.0


def test_messages_from_afar_and_too_many_messages_are_not_used() -> None:
    far, flood = SignalWitness(), SignalWitness()
    for k in range(100):
        far.add("wifi/a", -60.0 - k, (FARTHEST_M + 1.0, 0.0, 0.0), float(k))
        flood.add("wifi/a", -60.0 - k, (30.0, 0.0, 0.0), 0.0008 * k)
    assert far.suspicion.log_ratio == flood.suspicion.log_ratio == pytest.approx(0.0, abs=1e-9)
