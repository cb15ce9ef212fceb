"""When aircraft send, under the paper's advertiser and under the standards'."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sitl_mocks.channel.packets.reception import FIRST_PRIMARY
from sitl_mocks.channel.packets.schedule import Events, draw_schedule, packets_of
from sitl_mocks.channel.packets.timing import (
    BLE4,
    BLE5,
    PAPER,
    REAL,
    WIFI,
    Assumptions,
    Durations,
    coprime_interval,
)
from sitl_mocks.channel.parameters import Ble5Parameters, BleParameters, ChannelParameters

PARAMETERS = ChannelParameters()
EXACT = replace(REAL, random_delay=False, clock_ppm=0.0)


def schedule(
    assumptions: Assumptions,
    mode: int,
    rate: int,
    periods: float = 3.0,
    clock: float = 1.0,
    parameters: ChannelParameters = PARAMETERS,
) -> Events:
    """Events of one aircraft whose first GNSS sample is at 100 slots."""
    durations = Durations.of(parameters, assumptions.slotted)
    rates = np.zeros((1, 3), int)
    rates[0, mode] = rate
    events, _ = draw_schedule(
        parameters, durations, assumptions, rates, np.array([1]), np.array([clock]), np.array([100.0]),
        100.0 + periods * 8000.0, np.random.default_rng(4),
    )  # fmt: skip
    return events


def test_durations_are_whole_slots_rounded_down_or_exact() -> None:
    whole, exact = Durations.of(PARAMETERS, True), Durations.of(PARAMETERS, False)
    assert whole.length.tolist() == [[3, 3, 3, 0], [9, 9, 9, 26], [5, 0, 0, 0]]
    assert whole.offset.tolist() == [[0, 4, 8, 0], [0, 10, 20, 40], [0, 0, 0, 0]]
    assert whole.dwell.tolist() == [64, 64, 56]
    assert whole.window.tolist() == [16, 16, 48]
    assert exact.length[BLE4, 0] == pytest.approx(3.008)
    assert exact.length[BLE5, 3] == pytest.approx(26.624)
    assert exact.length[WIFI, 0] == pytest.approx(5.056)


def test_intervals_are_coprime_to_the_scan_cycle() -> None:
    """The published procedure's values for psi = 1 to 10."""
    ble = [7999, 4001, 2665, 1999, 1601, 1333, 1141, 1001, 887, 799]
    wifi = [7999, 4001, 2665, 1999, 1601, 1333, 1139, 997, 887, 799]
    for mode, expected in ((BLE4, ble), (BLE5, ble), (WIFI, wifi)):
        assert [coprime_interval(r, mode, PARAMETERS) for r in range(1, 11)] == expected


def test_the_papers_advertiser_restarts_at_each_sample_and_sends_up_to_the_next_inclusive() -> None:
    events = schedule(PAPER, WIFI, 3)
    cycle = [0, 2665, 5330, 7995]
    assert events.begin.tolist() == [100 + 8000 * k + b for k in range(3) for b in cycle]
    assert events.sample.tolist() == [0] * 4 + [1] * 4 + [2] * 4
    # An interval that divides the period: the last beacon goes out with the next sample.
    even = ChannelParameters(gnss_period_ms=5 * 803 * 0.125)
    assert coprime_interval(5, WIFI, even) == 803
    events = schedule(PAPER, WIFI, 5, periods=4016 / 8000, parameters=even)
    assert (events.begin - 100).tolist() == [0, 803, 1606, 2409, 3212, 4015, 4015]
    assert events.sample.tolist() == [0, 0, 0, 0, 0, 0, 1]


def test_the_last_ble4_event_of_a_cycle_ends_with_the_last_pdu_that_begins_in_it() -> None:
    """psi 3: the event at 7995 has PDUs at 7995, 7999 and 8003, the last of which is too late."""
    events = schedule(PAPER, BLE4, 3, periods=1.0)
    assert events.parts.tolist() == [3, 3, 3, 2]
    sent = packets_of(events, Durations.of(PARAMETERS, True))
    assert (sent.begin[-2:] - 100).tolist() == [7995, 7999]
    assert schedule(PAPER, BLE4, 1, periods=1.0).parts.tolist() == [3, 1]


def test_ble5_sends_psi_auxiliary_packets_in_a_cycle() -> None:
    events = schedule(PAPER, BLE5, 3, periods=1.0)
    assert (events.begin - 100).tolist() == [0, 2665, 5330]
    assert events.parts.tolist() == [4, 4, 4]


def test_auxiliary_packets_hop_uniformly_over_37_channels() -> None:
    events = schedule(PAPER, BLE5, 10, periods=3700.0)
    counts = np.bincount(events.channel, minlength=FIRST_PRIMARY)
    assert len(counts) == 37
    # Chi-squared with 36 degrees of freedom: mean 36, standard deviation sqrt(72).
    assert ((counts - 1000.0) ** 2 / 1000.0).sum() < 36 + 5 * math.sqrt(72)


def test_auxiliary_packets_keep_within_their_uncertainty() -> None:
    parameters = ChannelParameters(ble5=Ble5Parameters(auxiliary_uncertainty_ms=1.0))
    for assumptions, mean in ((PAPER, 4.0), (EXACT, 4.0)):
        delay = schedule(assumptions, BLE5, 10, 200.0, parameters=parameters).auxiliary_delay
        assert delay.min() >= 0.0
        assert delay.max() <= 8.0
        assert delay.mean() == pytest.approx(mean, abs=5 * 2.6 / math.sqrt(len(delay)))
        assert np.array_equal(delay, np.floor(delay)) is assumptions.slotted


def test_the_standards_advertiser_runs_on_and_carries_the_latest_sample() -> None:
    events = schedule(EXACT, WIFI, 3, periods=30.0)
    assert np.allclose(np.diff(events.begin), 8000 / 3)
    assert 100.0 <= events.begin[0] < 100.0 + 8000 / 3
    age = events.begin - (100.0 + 8000.0 * events.sample)
    assert age.min() >= 0.0
    assert age.max() < 8000.0


@pytest.mark.parametrize("assumptions", [REAL, replace(REAL, slotted=True, carrier_sense=False)])
def test_random_delay_spreads_bluetooth_intervals_about_their_mean(assumptions: Assumptions) -> None:
    intervals = np.diff(schedule(assumptions, BLE4, 8, periods=1000.0).begin)
    assert intervals.min() >= 1000.0 - 20.0
    assert intervals.max() <= 1000.0 + 20.0
    assert intervals.std() == pytest.approx(40.0 / math.sqrt(12), rel=0.05)
    assert intervals.mean() == pytest.approx(1000.0, abs=5 * 11.5 / math.sqrt(len(intervals)))


def test_wifi_has_no_random_delay() -> None:
    assert np.allclose(np.diff(schedule(REAL, WIFI, 8, periods=100.0).begin), 1000.0)


def test_the_papers_advertiser_shifts_each_event_by_its_own_random_delay() -> None:
    events = schedule(replace(PAPER, random_delay=True), BLE5, 5, periods=500.0)
    shift = (events.begin - 100.0 - 8000.0 * events.sample).reshape(500, 5) - 1601.0 * np.arange(5)
    assert shift.min() == 0.0
    assert shift.max() == 40.0
    assert shift.mean() == pytest.approx(20.0, abs=5 * 11.9 / math.sqrt(2500))


def test_an_event_does_not_begin_before_the_last_one_of_its_radio_ended() -> None:
    """Where the random delay is longer than the interval, it is cut."""
    tight = ChannelParameters(ble4=BleParameters(random_delay_ms=30.0, max_rate=100), gnss_period_ms=1000.0)
    intervals = np.diff(schedule(REAL, BLE4, 100, periods=20.0, parameters=tight).begin)
    assert intervals.min() == pytest.approx(Durations.of(tight, False).span[BLE4])
    assert intervals.max() > 190.0


def test_a_fast_clock_stretches_the_intervals_and_not_the_gnss_samples() -> None:
    assert np.allclose(np.diff(schedule(EXACT, WIFI, 4, clock=1.001).begin), 2002.0)
    events = schedule(PAPER, WIFI, 5, clock=1.001)
    assert np.allclose(events.begin[::5], 100.0 + 8000.0 * np.arange(3))
    assert np.allclose(np.diff(events.begin[:5]), 1601.0 * 1.001)


def test_scan_rows_are_one_per_mode_or_one_per_cycle() -> None:
    durations, rates = Durations.of(PARAMETERS, True), np.array([[1, 0, 2], [0, 3, 0]])
    for phases, expected in (("free", [0, 1, 2]), ("redrawn", [0, 0, 1, 1, 2, 2])):
        events, row_mode = draw_schedule(
            PARAMETERS, durations, replace(PAPER, phases=phases), rates, np.zeros(2, int), np.ones(2),
            np.zeros(2), 16_000.0, np.random.default_rng(0),
        )  # fmt: skip
        assert row_mode.tolist() == expected
        assert np.array_equal(row_mode[events.scan_row], events.mode)
        assert np.all(np.diff(events.begin) >= 0.0)
        if phases == "redrawn":
            cycles = {
                (t, m, s) for t, m, s in zip(events.transmitter, events.mode, events.sample, strict=True)
            }
            assert len(cycles) == len(set(events.scan_row.tolist())) == 6
