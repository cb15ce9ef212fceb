"""Foreign transmissions: their share, the surviving packets, and independence of the queries."""

import math

import numpy as np
import pytest

from sitl_mocks.channel.packets.background import Background
from sitl_mocks.channel.packets.timing import BLE4, BLE5, WIFI
from sitl_mocks.channel.parameters import BackgroundLoad, ChannelParameters

LOAD = BackgroundLoad(ble4=0.3, wifi=0.6, burst_ms=4.0)
PARAMETERS = ChannelParameters(background=LOAD)


def survive(mode: int, length: float, seed: int = 1) -> tuple[float, float]:
    """Share of packets that meet no burst at any of 40 receivers, and its standard error over these."""
    begin = np.arange(3000) * 411.0
    background = Background(PARAMETERS, 40, 0.0, np.random.default_rng(seed))
    met = background.overlaps(np.full(3000, mode), begin, begin + length)
    assert met is not None
    shares = 1.0 - met.mean(axis=0)
    return float(shares.mean()), float(shares.std(ddof=1) / math.sqrt(40))


@pytest.mark.parametrize(("mode", "share"), [(BLE4, 0.3), (WIFI, 0.6)])
def test_the_band_is_busy_for_the_given_share_of_time(mode: int, share: float) -> None:
    idle, error = survive(mode, 1e-6)
    assert error < 0.003
    assert abs(1.0 - idle - share) < 4 * error


@pytest.mark.parametrize(("mode", "share"), [(BLE4, 0.3), (WIFI, 0.6)])
def test_a_packet_survives_when_it_begins_and_ends_in_an_idle_time(mode: int, share: float) -> None:
    packet_ms = 2.0
    idle_ms = 4.0 * (1.0 - share) / share
    survived, error = survive(mode, packet_ms / 0.125)
    assert error < 0.003
    assert abs(survived - (1.0 - share) * math.exp(-packet_ms / idle_ms)) < 4 * error


def test_it_is_stationary_from_its_beginning() -> None:
    """Among very many receivers the share is busy already at the first moment."""
    background = Background(PARAMETERS, 4000, 0.0, np.random.default_rng(2))
    met = background.overlaps(np.array([WIFI]), np.array([0.0]), np.array([1e-6]))
    assert met is not None
    assert abs(met.mean() - 0.6) < 4 * math.sqrt(0.6 * 0.4 / 4000)


def test_a_mode_without_load_meets_nothing_and_a_band_without_any_is_none() -> None:
    assert survive(BLE5, 100.0) == (1.0, 0.0)
    clear = Background(ChannelParameters(), 3, 0.0, np.random.default_rng(1))
    assert clear.overlaps(np.array([0]), np.zeros(1), np.ones(1)) is None


def test_receivers_and_modes_are_independent() -> None:
    begin = np.arange(4000) * 300.0
    background = Background(PARAMETERS, 2, 0.0, np.random.default_rng(3))
    wifi = background.overlaps(np.full(4000, WIFI), begin, begin + 1.0)
    ble4 = background.overlaps(np.full(4000, BLE4), begin, begin + 1.0)
    assert wifi is not None
    assert ble4 is not None
    together = np.corrcoef(np.stack([wifi[:, 0], wifi[:, 1], ble4[:, 0]]).astype(float))
    assert np.abs(together[np.triu_indices(3, 1)]).max() < 4 / math.sqrt(4000)


def test_asking_piece_by_piece_and_forgetting_gives_the_same_bursts() -> None:
    begin = np.arange(20_000) * 37.0
    mode = np.arange(20_000) % 3
    whole = Background(PARAMETERS, 3, -50.0, np.random.default_rng(5)).overlaps(mode, begin, begin + 9.0)
    background = Background(PARAMETERS, 3, -50.0, np.random.default_rng(5))
    pieces = []
    for low in range(0, 20_000, 170):
        part = slice(low, low + 170)
        background.forget(begin[low])
        pieces.append(background.overlaps(mode[part], begin[part], begin[part] + 9.0))
    assert whole is not None
    assert 0.2 < whole.mean() < 0.6
    assert np.array_equal(whole, np.concatenate([p for p in pieces if p is not None]))
