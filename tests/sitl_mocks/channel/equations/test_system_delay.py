"""The system delay of the analytic channel model."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from companion.errors import ConfigError
from sitl_mocks.channel.equations.analytic import Analytic, Fleet, fixed_mode, system_delay_s
from sitl_mocks.channel.link_budget import all_links
from sitl_mocks.channel.parameters import MODES, ChannelParameters
from tests.sitl_mocks.channel.equations.test_analytic import FAR, NEAR, one_environment

PAPER = ChannelParameters()
MODEL = Analytic(PAPER)


# ---------------------------------------------------------------- the system delay


def test_system_delay_by_hand():
    """Three aircraft: 0 reaches 1 and 2, 1 and 2 reach only 0; a fourth reaches nobody and counts 0."""
    loss = np.array([[0, NEAR, NEAR, FAR], [NEAR, 0, FAR, FAR], [NEAR, FAR, 0, FAR], [FAR, FAR, FAR, 0]])
    links, fleet = one_environment(loss, [[9, 0, 0]] * 4)
    e = MODEL.evaluate(links, fleet)
    each = {(s, r): d for s, r, d in zip(links.transmitter, links.receiver, e.delay_s[:, 0], strict=True)}
    expected = [(each[0, 1] + each[0, 2]) / 2, each[1, 0], each[2, 0], 0.0]
    assert e.uav_delay_s() == pytest.approx(expected)
    assert system_delay_s(e, 1) == pytest.approx([sum(expected)])


def test_p0_refuses_two_modes():
    links, fleet = one_environment(np.full((2, 2), NEAR), [[1, 1, 0], [1, 0, 0]])
    with pytest.raises(ValueError, match="P0 needs exactly one mode"):
        MODEL.evaluate(links, fleet).uav_delay_s()


@pytest.mark.parametrize(("mode", "bad"), [("ble4", 11), ("ble5", -1), ("wifi", 12)])
def test_rates_outside_the_limits_are_refused(mode, bad):
    links, fleet = one_environment(np.full((2, 2), NEAR), np.zeros((2, 3), int))
    fleet.rates[0, MODES.index(mode)] = bad
    with pytest.raises(ConfigError, match=rf"{mode}: rates .* are out of range; allowed: 0 to 10"):
        MODEL.evaluate(links, fleet)


def test_busy_shares_outside_the_limits_are_refused():
    links, fleet = one_environment(np.full((2, 2), NEAR), np.ones((2, 3), int))
    for bad in (1.0, -0.1, np.nan):
        with pytest.raises(ConfigError, match="busy: a share is out of range; allowed: 0 to less than 1"):
            MODEL.evaluate(links, fleet, np.full((2, 3), bad))


def test_rates_of_another_fleet_are_refused():
    links, _ = one_environment(np.full((2, 2), NEAR), np.ones((2, 3), int))
    with pytest.raises(ValueError, match="rates have shape"):
        MODEL.evaluate(links, Fleet(np.ones((3, 3), np.intp), np.zeros(3, np.intp)))


@pytest.mark.parametrize("bad", [3, 6, -1])
def test_wifi_channels_are_indices(bad):
    """Channel number 6 used as an index would read the entry of another receiver."""
    links, fleet = one_environment(np.full((4, 4), NEAR), [[0, 0, 10]] * 4, [0, 1, 2, bad])
    with pytest.raises(ValueError, match=r"wifi_channel is .*; expected indices 0 to 2 into \(1, 6, 11\)"):
        MODEL.evaluate(links, fleet)


def test_arrays_of_another_kind_are_refused():
    links, fleet = one_environment(np.full((2, 2), NEAR), [[0, 0, 10]] * 2)
    for dtype in (float, bool):
        with pytest.raises(ValueError, match=f"rates are {dtype.__name__}.*expected integers"):
            MODEL.evaluate(links, Fleet(fleet.rates.astype(dtype), fleet.wifi_channel))
    with pytest.raises(ValueError, match=r"wifi_channel has shape \(3,\); expected \(2,\)"):
        MODEL.evaluate(links, Fleet(fleet.rates, np.ones(3, np.intp)))
    with pytest.raises(ValueError, match=r"busy has shape \(3, 3\); expected \(2, 3\)"):
        MODEL.evaluate(links, fleet, np.zeros((3, 3)))
    small = MODEL.evaluate(links, Fleet(fleet.rates.astype(np.uint8), fleet.wifi_channel))
    assert np.array_equal(small.delay_s, MODEL.evaluate(links, fleet).delay_s, equal_nan=True)


def test_nobody_and_one_alone():
    for n in (0, 1):
        links = all_links(np.zeros((2, n, 3)), PAPER.propagation)
        e = MODEL.evaluate(links, Fleet(np.ones((2 * n, 3), np.intp), np.zeros(2 * n, np.intp)))
        assert system_delay_s(e, 2).tolist() == [0.0, 0.0]


def test_random_channels_need_a_generator():
    random = msgspec.structs.replace(PAPER, wifi_channels="random")
    with pytest.raises(ValueError, match="random Wi-Fi channels need a random generator"):
        fixed_mode(3, "wifi", 1, random)
    drawn = fixed_mode(3000, "wifi", 1, random, np.random.default_rng(1)).wifi_channel
    assert np.bincount(drawn) == pytest.approx([1000, 1000, 1000], abs=110)
