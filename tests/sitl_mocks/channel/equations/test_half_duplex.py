"""Loss because a Bluetooth radio does not receive while it sends: by enumeration and packet by packet."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from sitl_mocks.channel.equations.analytic import Analytic, Fleet
from sitl_mocks.channel.equations.half_duplex import deaf_shares_of, log_hearing
from sitl_mocks.channel.equations.reception import meeting_chances
from sitl_mocks.channel.link_budget import Links
from sitl_mocks.channel.packets.simulation import simulate
from sitl_mocks.channel.packets.timing import BLE4, BLE5, REAL
from sitl_mocks.channel.parameters import ChannelParameters, load

CONFIG = Path(__file__).parents[4] / "config/channel"
STANDARD = load(CONFIG / "standard.toml")


def test_the_paper_s_radios_hear_while_they_send():
    assert not ChannelParameters().bluetooth_half_duplex
    assert not load(CONFIG / "paper.toml").bluetooth_half_duplex
    assert STANDARD.bluetooth_half_duplex


def spans_of(kind, pointer=0):
    ble = STANDARD.ble4 if kind == "ble4" else STANDARD.ble5
    step = ble.packet_ms + ble.gap_ms
    primary = [(k * step, k * step + ble.packet_ms) for k in range(3)]
    begin = STANDARD.ble5.auxiliary_offset_ms
    auxiliary = (begin, begin + STANDARD.ble5.auxiliary_ms)
    return {
        "ble4": primary,
        "ble5": [*primary, auxiliary],
        "pdu": [(0.0, STANDARD.ble4.packet_ms)],
        "pointer": [primary[pointer]],
        "both": [primary[pointer], auxiliary],
    }[kind]


@pytest.mark.parametrize("own", ["ble4", "ble5"])
@pytest.mark.parametrize("victim", ["pdu", "pointer", "both"])
def test_the_shares_are_found_by_trying(victim, own):
    offsets = np.arange(-40.0, 40.0, 0.004) + 0.002
    counts = []
    for pointer in range(3) if victim == "both" else [0]:
        victims = spans_of(victim, pointer)
        hit = np.zeros(len(offsets), bool)
        for begin, end in victims:
            for low, high in spans_of(own):
                hit |= (offsets + low < end) & (offsets + high > begin)
        counts.append(hit.sum() * 0.004)
    shares = deaf_shares_of(STANDARD)
    told = {"pdu": shares.ble4, "pointer": shares.pointer, "both": shares.both}[victim][own == "ble5"]
    assert told * STANDARD.gnss_period_ms == pytest.approx(np.mean(counts), abs=0.02)


def test_a_radio_that_sends_nothing_hears_everything():
    for log in log_hearing(STANDARD, np.array([[0, 0, 10]])):
        assert log.tolist() == [0.0]


def test_a_radio_that_always_sends_hears_nothing_and_stays_a_number():
    for log in log_hearing(STANDARD, np.array([[0, 1000, 0]]))[:2]:
        assert -100.0 < log[0] < -20.0


def share_heard(result, mode):
    """Share of a mode's messages that are received, averaged over the receivers."""
    receivers = len(result.first_sample_s) - 1
    return (result.mode[result.heard_event] == mode).sum() / (result.mode == mode).sum() / receivers


@pytest.mark.parametrize("rates", [(10, 2, 0), (10, 10, 0), (10, 5, 0)])
def test_the_share_that_is_heard_is_that_of_the_packets(rates):
    aircraft = 10
    loss = np.full((aircraft, aircraft), 60.0)
    rates = np.tile(rates, (aircraft, 1))
    channel = np.zeros(aircraft, int)

    def packets(assumptions):
        # Several short runs: what one draws of phases and clocks lasts for the whole of it.
        runs = [
            simulate(STANDARD, assumptions, loss, rates, channel, 60.0, np.random.default_rng(seed))
            for seed in range(8)
        ]
        return np.mean([[share_heard(run, mode) for mode in (BLE4, BLE5)] for run in runs], 0)

    sender, receiver = np.nonzero(~np.eye(aircraft, dtype=bool))
    links = Links(aircraft, sender, receiver, loss[sender, receiver])
    found = Analytic(STANDARD).evaluate(links, Fleet(rates, channel))
    chances = np.array([meeting_chances(name, STANDARD)[0][0] for name in ("ble4", "ble5")])
    told = chances * (1.0 - found.loss[:, :2].mean(0))
    assert packets(REAL) == pytest.approx(told, rel=0.05)
    # The loss is caused by deafness while sending, not by collisions.
    if rates[0, BLE5] > 2:
        assert (packets(replace(REAL, half_duplex=False)) > 1.07 * told).all()


def test_without_it_the_equations_are_what_they_were():
    aircraft = 5
    loss = np.full((aircraft, aircraft), 60.0)
    sender, receiver = np.nonzero(~np.eye(aircraft, dtype=bool))
    links = Links(aircraft, sender, receiver, loss[sender, receiver])
    fleet = Fleet(np.tile([5, 5, 0], (aircraft, 1)), np.zeros(aircraft, int))
    hearing = msgspec.structs.replace(STANDARD, bluetooth_half_duplex=False)
    with_it, without = (Analytic(p).evaluate(links, fleet) for p in (STANDARD, hearing))
    kept = [np.exp(log[0]) for log in log_hearing(STANDARD, fleet.rates[:1])]
    for mode, factor in ((BLE4, kept[0]), (BLE5, kept[1] * kept[2])):
        assert 1.0 - with_it.loss[:, mode] == pytest.approx((1.0 - without.loss[:, mode]) * factor)
