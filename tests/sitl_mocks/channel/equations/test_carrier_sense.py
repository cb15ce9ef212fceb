"""The equations of Wi-Fi carrier sense against hand-worked cases, limits and the packet simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import pytest

from companion.errors import ConfigError
from sitl_mocks.channel.equations import carrier_sense
from sitl_mocks.channel.equations.analytic import Analytic, Fleet, fixed_mode
from sitl_mocks.channel.equations.collision import Survival, shares_of, survival
from sitl_mocks.channel.equations.delay import mean_delay_s
from sitl_mocks.channel.link_budget import Links, all_links, draw_positions, near_links, reached
from sitl_mocks.channel.packets import metrics as packet_metrics
from sitl_mocks.channel.packets.simulation import simulate
from sitl_mocks.channel.packets.timing import REAL
from sitl_mocks.channel.parameters import ChannelParameters, load

CONFIG = Path(__file__).parents[4] / "config" / "channel"
NEAR, FAR = 80.0, 140.0
WIFI = 2


def listening(name: str, access: Literal["independent", "carrier_sense"] = "carrier_sense"):
    """A shipped parameter set with this access."""
    p = load(CONFIG / f"{name}.toml")
    return msgspec.structs.replace(p, wifi=msgspec.structs.replace(p.wifi, access=access))


PAPER, STANDARD = listening("paper"), listening("standard")


def alive(links: Links, fleet: Fleet, p: ChannelParameters) -> Survival:
    carried = reached(links, p) & (fleet.rates > 0)[links.transmitter]
    return survival(links, carried, fleet.rates, fleet.wifi_channel, p)


def dense(losses_db: list[list[float]], rates: list[int]) -> tuple[Links, Fleet]:
    """Links of a matrix of path losses; all on Wi-Fi and one channel."""
    n = len(losses_db)
    j, i = np.nonzero(~np.eye(n, dtype=bool))
    table = np.zeros((n, 3), np.intp)
    table[:, WIFI] = rates
    return Links(n, j, i, np.asarray(losses_db, float)[j, i]), Fleet(table, np.ones(n, np.intp))


def scattered(seed: int = 1, environments: int = 4, aircraft: int = 12) -> tuple[Links, Fleet]:
    """Several environments with hidden stations, all modes, rates and Wi-Fi channels."""
    rng = np.random.default_rng(seed)
    nodes = environments * aircraft
    links = all_links(draw_positions(environments, aircraft, 4000.0, rng), STANDARD.propagation)
    return links, Fleet(rng.integers(0, 11, (nodes, 3)), rng.integers(0, 3, nodes))


def one_by_one(links: Links, fleet: Fleet, p: ChannelParameters) -> np.ndarray:
    """Wi-Fi's survival, station by station as the module's description says."""
    n, psi, channel = links.nodes, fleet.rates[:, WIFI], fleet.wifi_channel
    carried = reached(links, p) & (fleet.rates > 0)[links.transmitter]
    wifi, ble5 = np.zeros((2, n, n), bool)
    wifi[links.transmitter, links.receiver], ble5[links.transmitter, links.receiver] = carried[:, [2, 1]].T
    share, aux = shares_of(p).wifi_by_wifi, shares_of(p).wifi_by_ble5
    load = carrier_sense.load_of(psi.astype(float), p)
    found = np.ones(len(carried))
    for at in np.flatnonzero(carried[:, WIFI]):
        j, i = links.transmitter[at], links.receiver[at]
        others = [k for k in range(n) if k not in (j, i) and wifi[k, i] and channel[k] == channel[j]]
        u = np.array(sum(load[k] for k in range(n) if wifi[k, j] and channel[k] == channel[j]))
        met = sum(load[k] for k in others if wifi[k, j]) * carrier_sense.crowding(u)
        hidden = np.prod([1.0 - share * psi[k] for k in others if not wifi[k, j]])
        pointers = [1.0 - aux * fleet.rates[k, 1] for k in range(n) if k != j and ble5[k, i]]
        found[at] = np.exp(-met) * hidden * np.prod(pointers)
    return found


# ---------------------------------------------------------------- the form


def test_alone_a_station_loses_nothing():
    links, fleet = dense([[0, NEAR], [NEAR, 0]], [10, 10])
    assert alive(links, fleet, STANDARD).wifi.tolist() == [1.0, 1.0]


def test_it_is_the_form_that_the_module_describes():
    links, fleet = scattered()
    expected = one_by_one(links, fleet, STANDARD)
    assert expected.min() < 0.95
    assert alive(links, fleet, STANDARD).wifi == pytest.approx(expected, rel=1e-12)


def test_hidden_stations_alone_are_the_paper_s_product():
    """No station senses another: 1, 2 and 3 reach only 0, and 0 does not send."""
    loss = [[0, NEAR, NEAR, NEAR], [NEAR, 0, FAR, FAR], [NEAR, FAR, 0, FAR], [NEAR, FAR, FAR, 0]]
    links, fleet = dense(loss, [0, 10, 7, 3])
    same = alive(links, fleet, listening("standard", "independent")).wifi
    assert same.min() < 0.95
    assert alive(links, fleet, STANDARD).wifi == pytest.approx(same, rel=1e-14)


def test_the_paper_s_access_is_the_default_and_free_of_all_this(monkeypatch):
    links, fleet = scattered()
    monkeypatch.setattr(carrier_sense, "_over_common", None)
    Analytic(listening("standard", "independent")).evaluate(links, fleet)
    assert ChannelParameters().wifi.access == "independent"


def test_more_load_is_never_better_and_never_out_of_bounds():
    load_ = np.linspace(0.0, 12.0, 1201)
    met = load_ * carrier_sense.crowding(load_)
    assert met[0] == 0.0
    assert (np.diff(met) > 0.0).all()
    late_s = carrier_sense.delay_s(10, np.exp(-met), load_, STANDARD)
    assert (np.diff(late_s) > 0.0).all()
    for rate in (1, 3, 5, 8):
        late_s = carrier_sense.delay_s(rate, np.exp(-met), load_, STANDARD)
        assert (late_s > 0.0).all()
        assert np.isfinite(late_s).all()


def test_where_nothing_survives_nothing_ever_arrives():
    for load_ in (0.0, 2.0):
        assert np.isinf(carrier_sense.delay_s(10, np.zeros(1), np.full(1, load_), STANDARD)).all()


def test_far_below_saturation_and_far_above_it_is_what_the_description_says():
    low, high = np.array([0.05]), np.array([1000.0])
    assert low * carrier_sense.crowding(low) == pytest.approx(
        carrier_sense.MEETING * low**2 / (1 - low), rel=0.01
    )
    slope = 1000.0 * (
        carrier_sense.crowding(high) * high - carrier_sense.crowding(high - 1e-3) * (high - 1e-3)
    )
    assert slope == pytest.approx(1.0 / carrier_sense.CROWDING, rel=0.05)


@pytest.mark.parametrize("p", [PAPER, STANDARD])
def test_everything_at_once_is_a_probability(p):
    links, fleet = scattered()
    for part in ("ble4", "pointer", "auxiliary", "wifi"):
        values = getattr(alive(links, fleet, p), part)
        assert ((values > 0.0) & (values <= 1.0)).all()
    result = Analytic(p).evaluate(links, fleet)
    assert np.isfinite(result.delay_s[result.carried]).all()


def test_other_numbers_for_the_same_aircraft_change_nothing():
    links, fleet = scattered(environments=1, aircraft=30)
    new = np.random.default_rng(4).permutation(links.nodes)
    renamed = Links(links.nodes, new[links.transmitter], new[links.receiver], links.path_loss_db)
    rates, channels = np.empty_like(fleet.rates), np.empty_like(fleet.wifi_channel)
    rates[new], channels[new] = fleet.rates, fleet.wifi_channel
    one = Analytic(STANDARD).evaluate(links, fleet)
    two = Analytic(STANDARD).evaluate(renamed, Fleet(rates, channels))
    assert two.delay_s == pytest.approx(one.delay_s, rel=1e-12, nan_ok=True)


@pytest.mark.parametrize("dense_nodes", [1024, 2])
def test_environments_side_by_side_do_not_mix(monkeypatch, dense_nodes):
    """The result is also the same for full and sparse matrices."""
    links, fleet = scattered()
    whole = Analytic(STANDARD).evaluate(links, fleet)
    monkeypatch.setattr(carrier_sense, "_DENSE_NODES", dense_nodes)
    for environment in range(4):
        at = links.transmitter // 12 == environment
        some = Links(12, links.transmitter[at] % 12, links.receiver[at] % 12, links.path_loss_db[at])
        nodes = slice(12 * environment, 12 * environment + 12)
        own = Fleet(fleet.rates[nodes], fleet.wifi_channel[nodes])
        alone = Analytic(STANDARD).evaluate(some, own)
        assert alone.delay_s == pytest.approx(whole.delay_s[at], rel=1e-12, nan_ok=True)


def test_many_matrices_are_made_piece_by_piece(monkeypatch):
    links, fleet = scattered()
    whole = alive(links, fleet, STANDARD).wifi
    monkeypatch.setattr(carrier_sense, "_DENSE_CELLS", 300)
    assert np.array_equal(alive(links, fleet, STANDARD).wifi, whole)


def test_neighbours_by_range_give_the_same_as_all_links():
    at = draw_positions(1, 80, 6000.0, np.random.default_rng(7))[0]
    some, every = near_links(at, STANDARD), all_links(at, STANDARD.propagation)
    fleets = fixed_mode(80, "wifi", 10, STANDARD)
    one, two = (Analytic(STANDARD).evaluate(links, fleets) for links in (some, every))
    assert one.uav_delay_s() == pytest.approx(two.uav_delay_s(), rel=1e-12)


def test_an_auxiliary_packet_can_flee_wi_fi_only_so_far():
    """However many beacons: 28 of 37 channels are under no Wi-Fi channel of theirs."""
    links, fleet = dense(np.full((60, 60), NEAR).tolist(), [10] * 60)
    fleet.rates[:2, 1], fleet.rates[:2, WIFI] = (5, 0), (0, 0)
    at = (links.transmitter == 0) & (links.receiver == 1)
    assert alive(links, fleet, STANDARD).auxiliary[at] == pytest.approx([28 / 37], abs=0.002)


# ---------------------------------------------------------------- the running interval


def test_one_link_by_trying_phases_and_samples():
    """A million beacons, at a survival of 0.6, drawn one by one."""
    p, rate, survives = STANDARD, 7, 0.6
    rng = np.random.default_rng(2)
    runs, beacons, cycle = 20_000, 150, 21.0
    interval = 1000.0 / rate
    first = rng.uniform(0.0, interval, runs)[:, None]
    begin = first + interval * np.arange(beacons)
    met = np.mod(begin + rng.uniform(0.0, cycle, runs)[:, None], cycle) <= p.wifi.scan_ms - p.wifi.beacon_ms
    met &= rng.random(met.shape) < survives
    assert met.any(axis=1).all()
    late_s = (begin[np.arange(runs), met.argmax(axis=1)] + p.wifi.beacon_ms) / 1000.0
    told = mean_delay_s(carrier_sense.running_terms(rate, p), np.array([survives]), np.ones(1))[0]
    assert told == pytest.approx(late_s.mean(), abs=4.0 * late_s.std() / runs**0.5 + 0.002 * told)


def test_a_rate_that_is_not_allowed_is_refused():
    with pytest.raises(ConfigError, match="rate 11"):
        carrier_sense.running_terms(11, PAPER)


# ---------------------------------------------------------------- beside the packets


def packets(p: ChannelParameters, aircraft: int, rate: int, side_m: float, runs: int, seconds: float):
    """Loss and mean delay of both models, averaged over links that received anything."""
    rng = np.random.default_rng([aircraft, rate])
    rows = []
    for _ in range(runs):
        links = all_links(draw_positions(1, aircraft, side_m, rng), p.propagation)
        fleet = fixed_mode(aircraft, "wifi", rate, p)
        matrix = np.full((aircraft, aircraft), np.nan)
        matrix[links.transmitter, links.receiver] = links.path_loss_db
        result = simulate(p, REAL, matrix, fleet.rates, fleet.wifi_channel, seconds, rng)
        told = Analytic(p).evaluate(links, fleet)
        mean_s = packet_metrics.sample_delay_s(result, seconds / 4).mean_s[..., WIFI]
        mean_s = mean_s[links.transmitter, links.receiver]
        heard = told.carried[:, WIFI] & np.isfinite(mean_s)
        lost = result.lost[..., WIFI].sum() / result.hearable[..., WIFI].sum()
        rows.append(
            (lost, np.nanmean(told.loss[:, WIFI]), mean_s[heard].mean(), told.delay_s[heard, WIFI].mean())
        )
    return np.mean(rows, axis=0)


@pytest.mark.parametrize(
    ("name", "aircraft", "rate", "loss_within", "delay_within"),
    [
        ("paper", 30, 10, 0.003, 0.06),
        ("standard", 40, 10, 0.02, 0.12),
        ("standard", 75, 10, 0.03, 0.08),
        ("standard", 100, 10, 0.03, 0.12),
    ],
)
def test_crowds_lose_and_wait_as_the_packets_say(name, aircraft, rate, loss_within, delay_within):
    """From a fifth of the air to one and a half times of it, where the paper's product is off by factors."""
    p = listening(name)
    lost, told_lost, late_s, told_s = packets(p, aircraft, rate, 100.0, runs=4, seconds=8.0)
    assert told_lost == pytest.approx(lost, abs=loss_within)
    assert told_s == pytest.approx(late_s, rel=delay_within)


def test_hidden_stations_lose_as_the_packets_say():
    lost, told, *_ = packets(STANDARD, 30, 10, 5000.0, runs=8, seconds=6.0)
    assert told == pytest.approx(lost, rel=0.35)
