"""The channel equations frame by frame: if frames are sent as the equations assume, the same values
result."""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np
import pytest

from sitl_mocks.channel.air import Outcome, Transmission
from sitl_mocks.channel.equations.air_analytic import AnalyticChannel
from sitl_mocks.channel.equations.collision import survival
from sitl_mocks.channel.equations.delay import single_link_s
from sitl_mocks.channel.equations.reception import event_period, heard_packets, scan_of
from sitl_mocks.channel.link_budget import all_links, ranges_m, reached
from sitl_mocks.channel.parameters import (
    MODES,
    BackgroundLoad,
    Ble5Parameters,
    BleParameters,
    ChannelParameters,
    Slots,
    WifiParameters,
)

PAPER = ChannelParameters()
SLOT_S = 0.000125


class Air:
    """One channel and its outcomes, by transmission."""

    def __init__(self, parameters: ChannelParameters = PAPER, seed: int = 1) -> None:
        self.channel = AnalyticChannel(parameters)
        self.rng = np.random.default_rng(seed)
        self.sent = 0

    def send(
        self, sent_s: float, sender: str, transport: str, distance_m: dict[str, float | None]
    ) -> list[Outcome]:
        """Send one frame; returns its outcomes."""
        self.channel.transmit(Transmission(self.sent, sent_s, sender, transport, distance_m), self.rng)
        self.sent += 1
        return self.channel.settle(sent_s, self.rng)


def zero_within(samples: np.ndarray, sigmas: float = 4.0) -> bool:
    """Whether the mean of independent samples is 0 within its own standard error."""
    return bool(abs(samples.mean()) <= sigmas * samples.std() / math.sqrt(len(samples)))


@pytest.mark.parametrize(
    ("mode", "rate"), [("ble4", 9), ("ble4", 5), ("ble5", 10), ("ble5", 3), ("wifi", 10), ("wifi", 5)]
)
def test_frames_at_the_equations_times_give_the_equations_delay(mode: str, rate: int) -> None:
    """A renewal equation: the delay of the first frame received in a GNSS period; if none, one period more
    and so on."""
    air = Air(seed=rate)
    receivers: dict[str, float | None] = {f"r{k}": 1.0 for k in range(250)}
    interval = event_period(mode, rate, PAPER)
    # The matching sets reach to the end of the GNSS period; of BLE 5 there are psi auxiliary packets.
    events = rate if mode == "ble5" else Slots(PAPER).gnss_period // interval + 1
    expected_s = single_link_s(mode, rate, PAPER)
    samples = []
    for period in range(20):
        start_s = period * 1.0
        first: dict[str, float] = {}
        for event in range(events):
            for outcome in air.send(start_s + event * interval * SLOT_S, "s", mode, receivers):
                if outcome.arrival_s is not None:
                    first.setdefault(outcome.receiver, outcome.arrival_s - start_s)
        samples += [first.get(r, 1.0) - expected_s * (r in first) for r in receivers]
    assert zero_within(np.array(samples))


@pytest.mark.parametrize(
    ("parameters", "kinds"),
    [
        (ChannelParameters(ble4=BleParameters(packet_ms=1.0)), (0, 1, 2)),
        (ChannelParameters(wifi=WifiParameters(beacon_ms=2.5), wifi_channels="random"), (0, 1, 2)),
        (ChannelParameters(ble5=Ble5Parameters(auxiliary_ms=60.0)), (1,)),
    ],
)
def test_what_collides_is_what_the_eight_products_say(
    parameters: ChannelParameters, kinds: tuple[int, ...]
) -> None:
    """Each mode's share of frames heard against the products for whole fleets.

    Packets are long in turn, so that leaving out any of the products fails in one of the cases.
    """
    aircraft, rate = 24, 10
    names = [f"u{k:02d}" for k in range(aircraft)]
    modes = [kinds[k % len(kinds)] for k in range(aircraft)]
    side = np.random.default_rng(3).uniform(0.0, 200.0, (aircraft, 3))
    links = all_links(side, parameters.propagation)
    distance = np.linalg.norm(side[:, None] - side, axis=2)
    air = Air(parameters)
    heard: dict[tuple[int, int], list[float]] = defaultdict(list)
    for event in range(12 * rate):
        now_s = event / rate
        counts: dict[tuple[int, int], float] = {}
        for sender, name in enumerate(names):
            away = {names[r]: float(distance[sender, r]) for r in range(aircraft) if r != sender}
            for outcome in air.send(now_s, name, MODES[modes[sender]], away):
                counts[sender, names.index(outcome.receiver)] = float(outcome.arrival_s is not None)
        if event >= rate:  # by then everybody has sent for a whole period
            for pair, count in counts.items():
                heard[pair].append(count)
    rates = np.zeros((aircraft, 3), np.intp)
    rates[np.arange(aircraft), modes] = rate
    wifi_channel = np.array(
        [air.channel._links.wifi_channel(name, "wifi", air.rng) for name in names], np.intp
    )
    carried = reached(links, parameters) & (rates > 0)[links.transmitter]
    alive = survival(links, carried, rates, wifi_channel, parameters)
    differences: dict[int, list[float]] = defaultdict(list)
    for link, (sender, receiver) in enumerate(zip(links.transmitter, links.receiver, strict=True)):
        mode = modes[sender]
        if not carried[link, mode]:
            assert not any(heard[sender, receiver])
            continue
        first = (alive.ble4, alive.pointer, alive.wifi)[mode][link]
        last = alive.auxiliary[link] if mode == 1 else 1.0
        cycle = scan_of(MODES[mode], parameters).cycle
        channel = int(wifi_channel[sender])
        hits = [len(heard_packets(MODES[mode], p, parameters, wifi_channel=channel)) for p in range(cycle)]
        expected = float(np.mean([1.0 - (1.0 - first) ** n for n in hits])) * last
        # Frames of one pair and period share a phase: periods are the independent samples.
        periods = np.array(heard[sender, receiver]).reshape(-1, rate).mean(axis=1)
        differences[mode] += (periods - expected).tolist()
    assert all(zero_within(np.array(differences[mode])) for mode in kinds)


def test_the_share_heard_without_collisions_differs_from_that_with_them() -> None:
    """The tolerance above is narrower than the effect."""
    crowd, alone = Air(), Air()
    everyone: dict[str, float | None] = {f"r{k}": 1.0 for k in range(300)}
    heard = {"crowd": 0, "alone": 0}
    for event in range(100):
        for name in ("a", "b", "c", "d", "e"):
            told = crowd.send(event * 0.1, name, "ble5", {**everyone})
            heard["crowd"] += sum(o.arrival_s is not None for o in told) if name == "a" else 0
        heard["alone"] += sum(o.arrival_s is not None for o in alone.send(event * 0.1, "a", "ble5", everyone))
    # Four interferers at 10 a second: pointers survive with 0.9775^4, auxiliary packets with 0.9982^4.
    assert heard["crowd"] / heard["alone"] == pytest.approx(0.906, abs=0.04)


def test_others_count_with_what_they_sent_in_the_last_gnss_period() -> None:
    """100 beacons of 5 ms in a second leave no free air. A second after the last one the air is idle
    again."""
    parameters = ChannelParameters(wifi=WifiParameters(beacon_ms=5.0, scan_ms=100.0, switch_ms=0.0))
    air = Air(parameters)
    receivers: dict[str, float | None] = {f"r{k}": 1.0 for k in range(300)}
    for frame in range(100):
        air.send(frame * 0.01, "flood", "wifi", receivers)

    def share(now_s: float) -> float:
        told = air.send(now_s, "a", "wifi", receivers)
        return sum(o.arrival_s is not None for o in told) / len(told)

    quiet = (800 - 40 + 1) / 2400
    assert share(1.0) == 0.0
    assert share(1.5) == pytest.approx(quiet * 0.5, abs=4 * math.sqrt(0.16 * 0.84 / 300))
    assert share(2.1) == pytest.approx(quiet, abs=4 * math.sqrt(quiet * (1 - quiet) / 300))


def test_frames_of_one_moment_disturb_each_other_alike_in_any_order() -> None:
    """Whoever sends first in a tick must not be better off: rates are those before the tick."""
    shares = {}
    for order in (("a", "b"), ("b", "a")):
        air = Air(ChannelParameters(wifi=WifiParameters(beacon_ms=5.0)), seed=4)
        receivers: dict[str, float | None] = {f"r{k}": 1.0 for k in range(200)}
        for tick in range(100):
            for name in order:
                told = air.send(tick * 0.02, name, "wifi", receivers)
                if name == "a" and tick >= 50:
                    shares[order] = shares.get(order, 0) + sum(o.arrival_s is not None for o in told)
    # 50 interfering beacons of 5 ms a second leave half.
    first, last = shares.values()
    assert first / last == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize(
    ("transport", "slots"), [("ble4", {3, 7, 11}), ("ble5", {40 + 26}), ("wifi", {5}), ("nan", {5})]
)
def test_delay_is_that_of_the_packet_that_brought_it(transport: str, slots: set[int]) -> None:
    air = Air()
    told = air.send(7.0, "a", transport, {f"r{k}": 1.0 for k in range(400)})
    delays = {round((o.arrival_s - 7.0) / SLOT_S, 3) for o in told if o.arrival_s is not None}
    assert delays == slots


@pytest.mark.parametrize("transport", ["ble4", "ble5", "wifi", "nan"])
def test_reach_is_the_link_budgets(transport: str) -> None:
    air = Air()
    range_m = float(ranges_m(PAPER)[MODES.index("wifi" if transport == "nan" else transport)])
    heard = {"in": 0, "out": 0, "unknown": 0}
    for frame in range(300):
        places = {"in": range_m - 1.0, "out": range_m + 1.0, "unknown": None}
        for outcome in air.send(frame * 0.37, "a", transport, places):
            heard[outcome.receiver] += outcome.arrival_s is not None
    assert heard["out"] == 0
    assert min(heard["in"], heard["unknown"]) > 10


@pytest.mark.parametrize(("flood_m", "share"), [(1.0, 0.0), (1e6, (800 - 40 + 1) / 2400)])
def test_only_interferers_that_reach_the_receiver_count(flood_m: float, share: float) -> None:
    air = Air(ChannelParameters(wifi=WifiParameters(beacon_ms=5.0, scan_ms=100.0, switch_ms=0.0)))
    names = [f"r{k}" for k in range(300)]
    for frame in range(100):
        air.send(frame * 0.01, "flood", "wifi", dict.fromkeys(names, flood_m))
    told = air.send(1.0, "a", "wifi", dict.fromkeys(names, 1.0))
    heard = sum(o.arrival_s is not None for o in told)
    assert heard / 300 == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / 300))


def test_foreign_transmissions_take_their_share() -> None:
    busy = ChannelParameters(background=BackgroundLoad(wifi=0.5, burst_ms=2.0))
    receivers: dict[str, float | None] = {f"r{k}": 1.0 for k in range(300)}
    air = Air(busy)
    heard = [o.arrival_s is not None for k in range(40) for o in air.send(k * 1.0, "a", "wifi", receivers)]
    # Idle at the beginning, and for 5 slots of 0.125 ms more at 1/2 a millisecond.
    expected = 44 / 168 * 0.5 * math.exp(-0.625 / 2.0)
    assert np.mean(heard) == pytest.approx(expected, abs=4 * math.sqrt(expected / len(heard)))


def test_a_mode_that_no_model_knows_is_refused() -> None:
    with pytest.raises(ValueError):
        Air().send(0.0, "a", "lora", {"b": 1.0})
