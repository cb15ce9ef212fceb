"""Fixed modes: comparison with known numbers, and independence of a row from the other rows."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ground_tools.channel import fixed_modes
from ground_tools.channel.fixed_modes import Row, Settings, evaluate, mean_and_error, ratio_and_error
from sitl_mocks.channel.equations.delay import single_link_s
from sitl_mocks.channel.parameters import ChannelParameters

PAPER = ChannelParameters()
SIDES_M = (100.0, 500.0, 1000.0, 3000.0, 5000.0, 10000.0)
BEST = {"ble4": (9,), "ble5": (10,), "wifi": (10,)}
REFERENCE_SAMPLES = 800
"""Assumed number of environments behind each of `REFERENCE_MS`, whose Monte Carlo error is not known."""
REFERENCE_MS = {
    ("ble4", "shared", 0.0): (3131, 2974, 2252, 487, 191, 47),
    ("ble4", "shared", math.sqrt(6)): (3131, 2989, 2351, 551, 231, 57),
    ("ble5", "shared", 0.0): (5728, 5728, 5640, 3719, 2319, 818),
    ("wifi", "shared", 0.0): (1900, 1900, 1900, 1827, 1625, 1089),
    ("wifi", "random", 0.0): (1624, 1624, 1625, 1601, 1512, 1069),
}
"""An independent computation of the same readings of the paper."""


def settings(**changes) -> Settings:
    usual = {
        "parameters": PAPER,
        "sides_m": (500.0,),
        "rates": BEST,
        "sigmas_db": (0.0,),
        "uavs": 10,
        "samples": 40,
        "seed": 1,
    }
    return Settings(**(usual | changes))


def rows_of(**changes) -> dict[tuple, Row]:
    rows = [row for side in evaluate(settings(**changes)) for row in side]
    return {(r.mode, r.wifi_channels, r.rate, r.side_m, r.sigma_db): r for r in rows}


@pytest.fixture(scope="module")
def reference():
    return rows_of(sides_m=SIDES_M, sigmas_db=(0.0, math.sqrt(6)), samples=2000, seed=3)


@pytest.mark.parametrize("case", REFERENCE_MS, ids=str)
def test_known_delays(reference, case):
    mode, reading, sigma_db = case
    for side_m, known_ms in zip(SIDES_M, REFERENCE_MS[case], strict=True):
        row = reference[mode, reading, BEST[mode][0], side_m, sigma_db]
        combined_ms = row.system_delay_se_ms * math.sqrt(1 + row.samples / REFERENCE_SAMPLES)
        assert abs(row.system_delay_ms - known_ms) <= max(0.01 * known_ms, 3 * combined_ms), row


def test_ten_aircraft_alone_in_range_of_each_other_have_known_delays_without_error(reference):
    """At 100 m all aircraft hear each other, so there is no Monte Carlo error."""
    row = reference["ble4", "shared", 9, 100.0, 0.0]
    assert row.system_delay_se_ms == pytest.approx(0.0, abs=1e-6)
    spared = (1 - 2 * 0.376e-3 * 9) ** 8
    assert row.loss == pytest.approx(1 - spared)
    assert row.loss_se == pytest.approx(0.0, abs=1e-9)


def test_two_aircraft_meet_no_interference():
    row = rows_of(uavs=2, sides_m=(100.0,))["ble5", "shared", 10, 100.0, 0.0]
    assert row.system_delay_ms == pytest.approx(2 * 1000 * single_link_s("ble5", 10, PAPER))
    assert row.loss == 0.0


def test_a_row_does_not_depend_on_the_other_rows():
    many = rows_of(
        sides_m=(100.0, 700.0, 3000.0),
        rates={"ble4": (1, 9), "ble5": (2, 10), "wifi": (3, 10)},
        sigmas_db=(0.0, 3.0),
    )
    for mode, rate in (("ble4", 9), ("ble5", 10), ("wifi", 10)):
        for sigma_db in (0.0, 3.0):
            alone = rows_of(sides_m=(3000.0,), rates={mode: (rate,)}, sigmas_db=(sigma_db,))
            assert alone
            for key, row in alone.items():
                assert row == many[key]


@pytest.mark.parametrize("reading", ["shared", "random"])
def test_a_row_of_a_later_batch_does_not_depend_on_the_other_rows(monkeypatch, reading):
    """The table has both ways to assign Wi-Fi channels, independent of the parameters."""
    monkeypatch.setattr(fixed_modes, "_LINKS_AT_ONCE", 7 * 90)
    asked = {"parameters": msgspec.structs.replace(PAPER, wifi_channels=reading), "sides_m": (2000.0,)}
    alone = rows_of(**asked, rates={"wifi": (10,)})
    assert alone == {key: row for key, row in rows_of(**asked).items() if key[0] == "wifi"}
    assert alone == rows_of(sides_m=(2000.0,), rates={"wifi": (10,)})


def test_a_row_does_not_depend_on_the_batches(monkeypatch):
    asked = {"sides_m": (2000.0,), "sigmas_db": (3.0,), "samples": 30}
    whole = rows_of(**asked)
    monkeypatch.setattr(fixed_modes, "_LINKS_AT_ONCE", 7 * 90)
    assert fixed_modes.batches_of(settings(**asked)) == (7, 7, 7, 7, 2)
    split = rows_of(**asked)
    assert split.keys() == whole.keys()
    for key, row in split.items():
        assert row.system_delay_ms == pytest.approx(whole[key].system_delay_ms, rel=1e-12)
        assert row.loss == pytest.approx(whole[key].loss, rel=1e-12)


def test_seeds_differ_and_repeat():
    first, again, other = (rows_of(seed=seed, sides_m=(3000.0,)) for seed in (1, 1, 2))
    assert first == again
    key = ("ble4", "shared", 9, 3000.0, 0.0)
    assert first[key].system_delay_ms != other[key].system_delay_ms


def test_sides_have_separate_draws():
    rows = rows_of(sides_m=(3000.0, 3000.5))
    near, far = (rows["ble4", "shared", 9, side, 0.0].system_delay_ms for side in (3000.0, 3000.5))
    assert abs(near - far) > 1.0


def test_the_given_error_is_the_spread_between_seeds():
    found = [
        rows_of(seed=seed, sides_m=(3000.0,), rates={"ble4": (9,)})["ble4", "shared", 9, 3000.0, 0.0]
        for seed in range(40)
    ]
    spread_ms = np.std([row.system_delay_ms for row in found], ddof=1)
    assert np.mean([row.system_delay_se_ms for row in found]) == pytest.approx(spread_ms, rel=0.35)
    spread = np.std([row.loss for row in found], ddof=1)
    assert np.mean([row.loss_se for row in found]) == pytest.approx(spread, rel=0.35)


def test_both_readings_for_wifi_and_one_for_ble():
    readings = [(row.mode, row.wifi_channels) for row in rows_of().values()]
    assert readings == [("ble4", "shared"), ("ble5", "shared"), ("wifi", "shared"), ("wifi", "random")]


def test_random_channels_spare_packets():
    rows = rows_of(sides_m=(100.0,), samples=200)
    shared, spread = (rows["wifi", reading, 10, 100.0, 0.0] for reading in ("shared", "random"))
    assert spread.system_delay_ms < shared.system_delay_ms
    # Each of the eight others is on the same channel one time in three.
    assert spread.loss == pytest.approx(1 - (1 - 2 * 0.632e-2 / 3) ** 8, abs=4 * spread.loss_se)


def test_nobody_in_range():
    row = rows_of(sides_m=(900_000.0,))["ble4", "shared", 9, 900_000.0, 0.0]
    assert (row.system_delay_ms, row.system_delay_se_ms) == (0.0, 0.0)
    assert (row.loss, row.loss_se) == (None, None)


def test_background_load_of_the_parameters_counts():
    background = msgspec.structs.replace(PAPER.background, wifi=0.5)
    loaded = msgspec.structs.replace(PAPER, background=background)
    key = ("wifi", "shared", 10, 500.0, 0.0)
    assert rows_of(parameters=loaded)[key].loss > rows_of()[key].loss + 0.3


def test_progress_counts_batches(monkeypatch):
    monkeypatch.setattr(fixed_modes, "_LINKS_AT_ONCE", 20 * 90)
    asked, calls = settings(sides_m=(100.0, 200.0), sigmas_db=(0.0, 1.0)), []
    list(evaluate(asked, lambda: calls.append(1)))
    assert len(calls) == 2 * 2 * len(fixed_modes.batches_of(asked)) == 8


def test_errors_of_means_and_ratios():
    values = np.array([1.0, 2.0, 3.0, 6.0])
    assert mean_and_error(values) == pytest.approx((3.0, np.std(values, ddof=1) / 2))
    assert mean_and_error(np.array([1.0, math.inf])) == (None, None)
    # With equal counts the ratio is a mean.
    assert ratio_and_error(values, np.ones(4)) == pytest.approx(mean_and_error(values))
    # If the parts are in a fixed proportion to the counts, the error is 0.
    ratio, error = ratio_and_error(np.array([1.0, 2.0, 5.0]), np.array([2.0, 4.0, 10.0]))
    assert (ratio, error) == pytest.approx((0.5, 0.0))
    assert ratio_and_error(np.zeros(3), np.zeros(3)) == (None, None)
