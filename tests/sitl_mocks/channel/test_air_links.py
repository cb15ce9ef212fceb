"""Random draws for names and pairs stay constant."""

from __future__ import annotations

import numpy as np
import pytest

from sitl_mocks.air.server import MAX_CLIENTS
from sitl_mocks.channel.air_links import AirLinks, Kept
from sitl_mocks.channel.parameters import ChannelParameters, PropagationParameters

PROPAGATION = PropagationParameters(shadowing_sigma_db=6.0)


def test_shadowing_is_one_number_for_a_pair_in_both_directions_and_for_ever() -> None:
    links, rng = AirLinks(ChannelParameters(propagation=PROPAGATION)), np.random.default_rng(1)
    there = links.path_loss_db("a", {"b": 100.0, "c": 100.0}, rng)
    back = links.path_loss_db("b", {"a": 100.0}, rng)
    assert there["b"] == back["a"]
    assert there["b"] != there["c"]
    assert links.path_loss_db("a", {"b": 1000.0}, rng)["b"] == pytest.approx(there["b"] + 21.0)


def test_shadowing_spreads_as_its_parameter_says() -> None:
    links, rng = AirLinks(ChannelParameters(propagation=PROPAGATION)), np.random.default_rng(2)
    loss = np.array(list(links.path_loss_db("a", {f"r{k}": 1.0 for k in range(2000)}, rng).values()))
    assert loss.mean() == pytest.approx(52.55, abs=4 * 6.0 / 2000**0.5)
    assert loss.std() == pytest.approx(6.0, rel=4 / 4000**0.5)


def test_an_unknown_distance_is_near() -> None:
    links, rng = AirLinks(ChannelParameters()), np.random.default_rng(1)
    assert links.path_loss_db("a", {"b": None, "c": 1.0}, rng) == {"b": 52.55, "c": 52.55}
    assert links.path_loss_db("a", {}, rng) == {}


def test_wifi_channels_are_shared_or_drawn_once_for_each_sender() -> None:
    rng = np.random.default_rng(1)
    shared = AirLinks(ChannelParameters())
    assert {shared.wifi_channel(f"a{k}", "wifi", rng) for k in range(30)} == {1}
    drawn = AirLinks(ChannelParameters(wifi_channels="random"))
    first = [drawn.wifi_channel(f"a{k}", "wifi", rng) for k in range(300)]
    assert first == [drawn.wifi_channel(f"a{k}", "wifi", rng) for k in range(300)]
    assert np.bincount(first) == pytest.approx([100, 100, 100], abs=4 * 8.2)
    # Wi-Fi NAN has its channel by its own standard.
    assert {drawn.wifi_channel(f"a{k}", "nan", rng) for k in range(30)} == {1}


def test_shadowing_stays_among_as_many_aircraft_as_the_air_process_takes() -> None:
    links, rng = AirLinks(ChannelParameters(propagation=PROPAGATION)), np.random.default_rng(1)
    names = [f"a{k}" for k in range(MAX_CLIENTS)]

    def all_pairs() -> list[dict[str, float]]:
        return [links.path_loss_db(a, dict.fromkeys(set(names) - {a}, 100.0), rng) for a in names]

    assert all_pairs() == all_pairs()


def test_what_is_kept_is_bounded() -> None:
    kept: Kept[int, int] = Kept(3)
    for key in range(5):
        kept.get(key, lambda key=key: key)  # type: ignore[misc]
    assert [kept.get(key, lambda: -1) for key in (4, 3, 2)] == [4, 3, 2]
    assert kept.get(0, lambda: -1) == -1
