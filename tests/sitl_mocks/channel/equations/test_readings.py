"""The equations to the letter: pointers by intervals, and the same scan phase in every GNSS period."""

import numpy as np
import pytest

from companion.errors import ConfigError
from sitl_mocks.channel.equations.delay import link_delay_s, single_link_s
from sitl_mocks.channel.equations.reception import event_period, matching_packets, scan_of
from sitl_mocks.channel.parameters import Ble5Parameters, BleParameters, ChannelParameters, Slots

PAPER = ChannelParameters()
SAME = ChannelParameters(phases="same")
BY_INTERVAL = ChannelParameters(ble5=Ble5Parameters(pointers="interval"))


def sum_of_the_paper(mode, rate, p, survives):
    """Equation of the transmission delay of BLE 4 and Wi-Fi, term by term, over 400 periods."""
    matches, scan, slots = matching_packets(mode, rate, p), scan_of(mode, p), Slots(p)
    total = 0.0
    for t0 in range(scan.cycle):
        delta = matches.slot[matches.phase == t0]
        for k in range(400):
            for n, slot in enumerate(delta, 1):
                fails = (1.0 - survives) ** (n - 1 + len(delta) * k)
                delay_s = slots.seconds(slot + scan.duration) + k * p.gnss_period_ms / 1000.0
                total += fails * survives * delay_s
    return total / scan.cycle


@pytest.mark.parametrize(("mode", "rate"), [("ble4", 1), ("ble4", 5), ("wifi", 1)])
def test_the_same_phase_is_the_sum_of_the_paper(mode, rate):
    """Phases without a match are empty sums. With ours the first periods of all phases are the same."""
    for survives in (1.0, 0.8):
        p = np.array([survives])
        found = link_delay_s(mode, rate, SAME, p, np.ones(1))[0]
        assert found == pytest.approx(sum_of_the_paper(mode, rate, SAME, survives), rel=1e-9)
        assert found < link_delay_s(mode, rate, PAPER, p, np.ones(1))[0]


def test_where_every_phase_receives_the_phases_do_not_matter_without_losses():
    for mode, rate in (("ble4", 9), ("wifi", 10)):
        assert single_link_s(mode, rate, SAME) == pytest.approx(single_link_s(mode, rate, PAPER), rel=1e-12)


def test_pointers_by_interval():
    """I_xi, counted pointer by pointer, in the phases in which only one pointer falls into a window."""
    rate = 10
    matches, scan, slots = matching_packets("ble5", rate, PAPER), scan_of("ble5", PAPER), Slots(PAPER)
    interval = slots.gnss_period // rate
    assert event_period("ble5", rate, PAPER) != interval
    behind = sum(slots.of(ms) for ms in (5.0, 0.0, 3.328))
    total, missed = 0.0, 0
    for t0 in range(scan.cycle):
        xi = sorted(x for x in {int(s) // interval for s in matches.slot[matches.phase == t0]} if x < rate)
        if xi:
            total += slots.seconds(xi[0] * interval + behind)
        missed += not xi
    heard = scan.cycle - missed
    expected = (total + missed * 1.0) / heard
    assert single_link_s("ble5", rate, BY_INTERVAL) == pytest.approx(expected, rel=1e-9)
    assert single_link_s("ble5", rate, BY_INTERVAL) < single_link_s("ble5", rate, PAPER)


def test_events_of_random_phases_have_no_same_phase():
    random = ChannelParameters(phases="same", ble4=BleParameters(schedule="random"))
    redrawn = ChannelParameters(ble4=BleParameters(schedule="random"))
    assert single_link_s("ble4", 3, random) == single_link_s("ble4", 3, redrawn)


def test_a_rate_that_is_not_allowed():
    with pytest.raises(ConfigError, match="ble4: rate 11"):
        single_link_s("ble4", 11, SAME)
