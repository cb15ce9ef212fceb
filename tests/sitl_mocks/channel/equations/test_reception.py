"""The matching sets against a slot-by-slot enumeration, for everything that the paper's table allows."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import ConfigError
from sitl_mocks.channel.equations.reception import (
    coincidences,
    coprime_period,
    event_period,
    heard_packets,
    matching_packets,
    scan_of,
)
from sitl_mocks.channel.parameters import (
    MODES,
    Ble5Parameters,
    BleParameters,
    ChannelParameters,
    WifiParameters,
)

PAPER = ChannelParameters()


def enumerated(mode, rate, parameters, channel):
    """Walk through one GNSS period slot by slot, all phases at once; rows of (phase, slot, channel) of every
    packet heard, sorted. Knows no theorem."""
    unit = parameters.slot_ms
    if mode == "wifi":
        p = parameters.wifi
        stay, pause, packet = int(p.scan_ms / unit), int(p.switch_ms / unit), int(p.beacon_ms / unit)
        cycle, starts, window, offsets = 3 * (stay + pause), [k * (stay + pause) for k in range(3)], stay, [0]
    else:
        p = parameters.ble4 if mode == "ble4" else parameters.ble5
        dwell, packet = int(p.scan_interval_ms / unit), int(p.packet_ms / unit)
        window, step = int(p.scan_window_ms / unit), packet + int(p.gap_ms / unit)
        cycle, starts, offsets = 3 * dwell, [0, dwell, 2 * dwell], [0, step, 2 * step]
    horizon = int(parameters.gnss_period_ms / unit)
    period = next(
        p
        for away in range(10_000)
        for p in (horizon // rate - away, horizon // rate + away)
        if math.gcd(p, cycle) == 1
    )
    phases = np.arange(cycle)
    found = []
    for slot in range(horizon + 1):
        for k, offset in enumerate(offsets):
            where = channel if mode == "wifi" else k
            begun = slot - offset
            if begun < 0 or begun % period:
                continue
            # Every slot of the packet must lie in the receiver's window on this channel.
            during = (phases[:, None] + slot + np.arange(packet)) % cycle
            listening = (during >= starts[where]) & (during < starts[where] + window)
            found += [(phase, slot, where) for phase in np.flatnonzero(listening.all(axis=1)).tolist()]
    return sorted(found)


def rows(matches):
    return sorted(zip(matches.phase.tolist(), matches.slot.tolist(), matches.channel.tolist(), strict=True))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("rate", range(1, 11))
def test_sets_equal_the_enumeration(mode, rate):
    for channel in range(3) if mode == "wifi" else [0]:
        matches = matching_packets(mode, rate, PAPER, wifi_channel=channel)
        assert rows(matches) == enumerated(mode, rate, PAPER, channel)


@st.composite
def other_parameters(draw):
    """Windows, packets and gaps of other sizes, on a coarse slot so that the enumeration is quick."""
    window = draw(st.integers(2, 40))
    ble = {
        "packet_ms": float(draw(st.integers(1, window))),
        "gap_ms": float(draw(st.integers(0, 5))),
        "scan_window_ms": float(window),
        "scan_interval_ms": float(draw(st.integers(window, window + 40))),
        "max_rate": 4,
    }
    stay = draw(st.integers(1, 40))
    wifi = WifiParameters(
        beacon_ms=float(draw(st.integers(1, stay))),
        scan_ms=float(stay),
        switch_ms=float(draw(st.integers(0, 9))),
        max_rate=4,
    )
    return ChannelParameters(
        slot_ms=1.0,
        gnss_period_ms=1500.0,
        ble4=BleParameters(**ble),
        ble5=Ble5Parameters(
            **ble, auxiliary_offset_ms=3 * ble["packet_ms"] + 2 * ble["gap_ms"], auxiliary_ms=4.0
        ),
        wifi=wifi,
    )


@settings(max_examples=60, deadline=None)
@given(other_parameters(), st.sampled_from(MODES), st.integers(1, 4), st.integers(0, 2))
def test_sets_equal_the_enumeration_for_other_parameters(parameters, mode, rate, channel):
    matches = matching_packets(mode, rate, parameters, wifi_channel=channel)
    assert rows(matches) == enumerated(mode, rate, parameters, channel)


@pytest.mark.parametrize("mode", MODES)
def test_a_single_event_is_heard_as_the_sets_say(mode):
    matches = matching_packets(mode, 1, PAPER, wifi_channel=2)
    scan = scan_of(mode, PAPER)
    for phase in range(scan.cycle):
        first = (matches.phase == phase) & (matches.slot <= scan.packet_offsets[-1])
        offsets = [scan.packet_offsets[i] for i in heard_packets(mode, phase, PAPER, wifi_channel=2)]
        assert offsets == sorted(matches.slot[first].tolist())


def theorem(t1, t2, period_1, period_2):
    """Delta_o of the paper's equation (CRT), term by term."""
    by_1, by_2 = pow(period_2, -1, period_1), pow(period_1, -1, period_2)
    return (t1 * period_2 * by_1 + t2 * period_1 * by_2) % (period_1 * period_2)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("rate", [1, 5, 9, 10])
def test_sets_equal_the_paper_s_theorem(mode, rate):
    scan, period = scan_of(mode, PAPER), event_period(mode, rate, PAPER)
    channel, both = 1, period * scan.cycle
    found = []
    for phase in range(scan.cycle):
        for index, offset in enumerate(scan.packet_offsets):
            where = channel if mode == "wifi" else index
            for i in range(scan.window_starts[where], scan.window_starts[where] + scan.slack + 1):
                first = theorem(phase + offset, i, period, scan.cycle)
                slots = range((first - phase) % both, 8000 + 1, both)
                found += [(phase, slot, where) for slot in slots]
    assert rows(matching_packets(mode, rate, PAPER, wifi_channel=channel)) == sorted(found)


def test_no_packet_comes_before_its_event():
    """T_GNSS / psi of 3 slots, coprime to the cycle of 60 only at 1: shorter than the event itself."""
    ble = {"packet_ms": 1.0, "gap_ms": 0.0, "scan_interval_ms": 20.0, "max_rate": 25}
    p = ChannelParameters(
        slot_ms=1.0,
        gnss_period_ms=95.0,
        ble4=BleParameters(**ble),
        ble5=Ble5Parameters(**ble | {"max_rate": 1}, auxiliary_offset_ms=3.0),
        wifi=WifiParameters(beacon_ms=1.0, max_rate=1),
    )
    assert event_period("ble4", 25, p) == 1
    assert rows(matching_packets("ble4", 25, p)) == enumerated("ble4", 25, p, 0)


def test_scans_of_real_phones_take_no_more_memory_than_packets():
    """4.096 s on each channel, always listening: phases by window slots would be 26 GB."""
    p = ChannelParameters(ble4=BleParameters(scan_interval_ms=4096.0, scan_window_ms=4096.0))
    matches = matching_packets("ble4", 9, p)
    assert scan_of("ble4", p).cycle == 98_304
    # One channel is listened to at any time: most phases hear one packet of each event, and ten events, 887
    # slots apart, begin within 8,000.
    assert np.median(np.bincount(matches.phase, minlength=98_304)) == 10


def test_periods_of_the_paper():
    ble = [7999, 4001, 2665, 1999, 1601, 1333, 1141, 1001, 887, 799]
    wifi = [7999, 4001, 2665, 1999, 1601, 1333, 1139, 997, 887, 799]
    for mode, expected in (("ble4", ble), ("ble5", ble), ("wifi", wifi)):
        assert [event_period(mode, rate, PAPER) for rate in range(1, 11)] == expected


@given(st.integers(1, 10**5), st.integers(1, 1000))
def test_the_nearest_coprime_period(period, cycle):
    near = coprime_period(period, cycle)
    assert math.gcd(near, cycle) == 1
    away = abs(near - period)
    closer = [p for p in range(max(1, period - away), period + away + 1) if math.gcd(p, cycle) == 1]
    assert near == min(closer, key=lambda p: (abs(p - period), p))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("rate", [0, -1, 11])
def test_rates_outside_the_limits_are_refused(mode, rate):
    with pytest.raises(ConfigError, match=f"{mode}: rate {rate} is out of range; allowed: 1 to 10"):
        matching_packets(mode, rate, PAPER)


def test_periods_below_one_slot_are_refused():
    with pytest.raises(ValueError, match="period 0, cycle 3: expected at least 1 slot"):
        coprime_period(0, 3)


@pytest.mark.parametrize(
    ("period", "words"),
    [
        (8000, "period 8000, scan cycle 192 slots: both are multiples of 64; they must be coprime"),
        (801, "period 801, scan cycle 192 slots: both are multiples of 3"),
        (0, "period 0, scan cycle 192 slots: expected at least 1"),
    ],
)
def test_periods_that_share_a_factor_with_the_scan_are_refused(period, words):
    with pytest.raises(ValueError, match=words):
        coincidences(scan_of("ble4", PAPER), period, 8000)
