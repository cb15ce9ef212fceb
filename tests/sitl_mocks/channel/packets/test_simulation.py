"""Whole runs: the published single-link delays, loss by collision, and what must hold for every run."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest

from companion.errors import ConfigError
from sitl_mocks.channel.packets import reception as packet_reception
from sitl_mocks.channel.packets import simulation as module
from sitl_mocks.channel.packets.metrics import loss, never_heard, sample_delay_s
from sitl_mocks.channel.packets.simulation import Result, simulate
from sitl_mocks.channel.packets.timing import BLE4, BLE5, PAPER, REAL, WIFI, Assumptions
from sitl_mocks.channel.parameters import BackgroundLoad, Ble5Parameters, BleParameters, ChannelParameters

PARAMETERS = ChannelParameters()
LOADED = ChannelParameters(background=BackgroundLoad(ble4=0.2, ble5=0.1, wifi=0.3))
NEAR_DB, FAR_DB = 60.0, 200.0


def run(
    rates: list[list[int]],
    duration_s: float,
    assumptions: Assumptions,
    *,
    receivers: int = 0,
    path_loss_db: np.ndarray | None = None,
    parameters: ChannelParameters = PARAMETERS,
    seed: int = 1,
) -> Result:
    """Aircraft at these rates, all near each other, and others that only listen."""
    nodes = len(rates) + receivers
    loss_db = np.full((nodes, nodes), NEAR_DB) if path_loss_db is None else path_loss_db
    every = np.array(rates + [[0, 0, 0]] * receivers)
    return simulate(
        parameters,
        assumptions,
        loss_db,
        every,
        np.zeros(nodes, int),
        duration_s,
        np.random.default_rng(seed),
    )


def only(mode: int, rate: int) -> list[int]:
    return [rate if m == mode else 0 for m in range(3)]


@pytest.mark.parametrize(
    ("mode", "rate", "published_ms"),
    [
        (BLE4, 1, 3192.0),
        (BLE4, 5, 1812.0),
        (BLE4, 6, 374.0),
        (BLE4, 9, 289.0),
        (BLE5, 2, 3258.0),
        (BLE5, 10, 383.0),
        (WIFI, 1, 1410.0),
        (WIFI, 7, 233.0),
        (WIFI, 10, 149.0),
    ],
)
def test_a_single_link_has_the_delay_of_the_equations(mode: int, rate: int, published_ms: float) -> None:
    # Slow links give fewer independent delays in the same time.
    result = run([only(mode, rate)], 1500.0 if rate > 2 else 4000.0, PAPER, receivers=400)
    delay = sample_delay_s(result)
    assert delay.open_samples.sum() == 0
    mean_ms, error_ms = 1000.0 * delay.pooled_s[mode], 1000.0 * delay.pooled_error_s[mode]
    assert 3 * error_ms < 0.015 * published_ms
    assert abs(mean_ms - published_ms) < 0.02 * published_ms
    assert never_heard(result) == 0.0
    assert not result.lost.any()


CONTINUOUS = replace(REAL, half_duplex=False)
WANDERING = ChannelParameters(
    ble4=BleParameters(random_delay_ms=50.0), ble5=Ble5Parameters(random_delay_ms=50.0)
)
"""With the usual 5 ms, schedules that once collide do so for minutes: long runs hold few separate cases."""
A4, A5, AUX, BEACON = 0.376, 1.152, 3.328, 0.632


@pytest.mark.parametrize(
    ("victim", "interferer", "overlap_ms"),
    [
        (BLE4, BLE4, 2 * A4),
        (BLE4, BLE5, A4 + A5),
        (WIFI, BLE5, 9 / 37 * (BEACON + AUX)),
        (BLE4, WIFI, 0.0),
        (WIFI, BLE4, 0.0),
    ],
)
def test_one_interferer_destroys_the_share_of_time_in_which_it_overlaps(
    victim: int, interferer: int, overlap_ms: float
) -> None:
    """Random delays let the two schedules meet at every phase."""
    result = run(
        [only(victim, 10), only(interferer, 10)], 2000.0, CONTINUOUS, receivers=30, parameters=WANDERING
    )
    expected = overlap_ms * 10 / 1000.0
    sent = np.sum(result.transmitter == 0) * (3 if victim == BLE4 else 1)
    measured = loss(result)[0, 2:, victim].mean()
    # What one collision destroys is missed by many receivers: it counts once.
    assert abs(measured - expected) <= 4 * math.sqrt(expected / sent)
    assert sent == pytest.approx(20_000 * (3 if victim == BLE4 else 1), rel=0.01)
    # The interferer's own packets do not disturb what it hears.
    assert result.lost[0, 1, victim] == 0
    assert result.hearable[0, 1, victim] > 0


def test_half_duplex_takes_packets_from_who_sends() -> None:
    """PDUs of two aircraft, each hearing the other: deaf to what overlaps any of its own three."""
    both = [only(BLE4, 10), only(BLE4, 10)]
    full, half = (
        run(both, 4000.0, replace(REAL, half_duplex=h), receivers=1, parameters=WANDERING).hearable[
            0, :, BLE4
        ]
        for h in (False, True)
    )
    # From A_P before the first own PDU to the end of the third: the gaps are shorter than a PDU.
    expected = (2 * (A4 + 0.125) + 2 * A4) * 10 / 1000.0
    assert half[2] == full[2]
    assert 1.0 - half[1] / full[1] == pytest.approx(expected, abs=4 * math.sqrt(expected / full[1]))


def test_nothing_is_heard_beyond_range_or_by_a_mode_that_is_off() -> None:
    x = math.nan
    # 110 dB: pointers and beacons reach, PDUs do not. 200 dB: nothing does.
    loss_db = np.array([[x, 110.0, FAR_DB], [110.0, x, NEAR_DB], [FAR_DB, NEAR_DB, x]])
    result = run([[9, 10, 0], [9, 0, 10], [0, 10, 10]], 60.0, REAL, path_loss_db=loss_db)
    pairs = np.zeros((3, 3, 3), int)
    event = result.heard_event
    np.add.at(pairs, (result.transmitter[event], result.heard_by, result.mode[event]), 1)
    assert np.array_equal(pairs > 0, result.carried)
    assert result.carried[0].tolist() == [[False] * 3, [False, True, False], [False] * 3]
    assert result.carried[1].tolist() == [[False, False, True], [False] * 3, [True, False, True]]
    assert result.carried[2].tolist() == [[False] * 3, [False, True, True], [False] * 3]


@pytest.mark.parametrize(
    "assumptions",
    [PAPER, REAL, replace(PAPER, slotted=False), replace(REAL, slotted=True, carrier_sense=False)],
)
def test_a_message_arrives_within_its_event(assumptions: Assumptions) -> None:
    result = run([[9, 10, 10]] * 4, 20.0, assumptions)
    after = result.heard_s - result.start_s[result.heard_event]
    mode = result.mode[result.heard_event]
    first = (
        [0.375e-3, 8.25e-3, 0.625e-3] if assumptions.slotted else [A4 * 1e-3, (5 + AUX) * 1e-3, BEACON * 1e-3]
    )
    last = [f + e for f, e in zip(first, [2 * 0.501e-3, 0.0, 0.0], strict=True)]
    for m in range(3):
        assert np.min(after[mode == m]) == pytest.approx(first[m], abs=1e-9)
        assert np.max(after[mode == m]) <= last[m] + 1e-9
    assert np.all(np.diff(result.start_s) >= 0.0)
    assert np.all(result.sample_s <= result.start_s + 1e-9)
    assert np.all(result.start_s < 20.0)


def test_arrivals_by_event_and_receiver_are_those_heard() -> None:
    result = run([[9, 0, 10]] * 3, 5.0, REAL)
    table = result.arrival_s()
    assert table.shape == (len(result.transmitter), 3)
    assert np.sum(~np.isnan(table)) == len(result.heard_s) > 50
    assert np.array_equal(table[result.heard_event, result.heard_by], result.heard_s)
    assert np.isnan(table[np.arange(len(table)), result.transmitter]).all()


def same(one: Result, other: Result) -> bool:
    return all(np.array_equal(getattr(one, f.name), getattr(other, f.name)) for f in fields(Result))


@pytest.mark.parametrize("assumptions", [PAPER, REAL])
def test_a_seed_decides_everything(assumptions: Assumptions) -> None:
    first, again, other = (
        run([[9, 10, 10]] * 4, 20.0, assumptions, parameters=LOADED, seed=s) for s in (3, 3, 4)
    )
    assert same(first, again)
    assert not same(first, other)


@pytest.mark.parametrize("assumptions", [PAPER, REAL])
def test_how_a_run_is_divided_does_not_change_it(
    assumptions: Assumptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = run([[9, 10, 10]] * 5, 20.0, assumptions, parameters=LOADED)
    monkeypatch.setattr(module, "_CELLS", 5 * 23)
    monkeypatch.setattr(module, "_FEWEST", 1)
    monkeypatch.setattr(packet_reception, "_PAIR_CELLS", 5 * 3)
    assert same(whole, run([[9, 10, 10]] * 5, 20.0, assumptions, parameters=LOADED))
    assert whole.lost.sum() > 500


def test_the_background_takes_its_share_of_the_packets() -> None:
    """Wi-Fi, 30 % busy in bursts of 2 ms: a beacon must begin in an idle time and end before that does."""
    result = run([only(WIFI, 10)], 1000.0, CONTINUOUS, receivers=20, parameters=LOADED)
    expected = 1.0 - 0.7 * math.exp(-0.632 / (2.0 * 0.7 / 0.3))
    heard = result.hearable[0, 1:, WIFI].sum()
    assert heard > 50_000
    assert result.lost[0, 1:, WIFI].sum() / heard == pytest.approx(
        expected, abs=4 * math.sqrt(expected * (1 - expected) / heard)
    )


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"rates": np.array([[11, 0, 0], [0, 0, 0]])}, "ble4: rate 11"),
        ({"rates": np.array([[0, -1, 0], [0, 0, 0]])}, "ble5: rate -1"),
        ({"rates": np.zeros((2, 3), int)}, "rates"),
        ({"wifi_channel": np.array([0, 3])}, "wifi_channel"),
        ({"duration_s": math.nan}, "duration_s"),
        ({"duration_s": 0.0}, "duration_s"),
    ],
)
def test_runs_that_cannot_be_are_refused(change: dict[str, object], key: str) -> None:
    arguments: dict[str, object] = {
        "path_loss_db": np.zeros((2, 2)),
        "rates": np.ones((2, 3), int),
        "wifi_channel": np.zeros(2, int),
        "duration_s": 1.0,
    }
    with pytest.raises(ConfigError, match=key):
        simulate(PARAMETERS, PAPER, rng=np.random.default_rng(0), **(arguments | change))  # type: ignore[arg-type]


def test_arrays_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match="shapes"):
        simulate(
            PARAMETERS, PAPER, np.zeros((2, 2)), np.ones((3, 3), int), np.zeros(2, int), 1.0,
            np.random.default_rng(0),
        )  # fmt: skip
