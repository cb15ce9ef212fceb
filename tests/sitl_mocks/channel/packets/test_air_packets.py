"""Frames as packets on the air: outcomes at any time of asking, collisions and real radios."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import numpy as np
import pytest

from sitl_mocks.channel.air import Outcome, Transmission
from sitl_mocks.channel.link_budget import path_loss_db
from sitl_mocks.channel.packets.air_packets import MAX_BACKLOG_S, PacketChannel, _events
from sitl_mocks.channel.packets.reception import Coverage, Scanners, arrivals, decide
from sitl_mocks.channel.packets.schedule import packets_of
from sitl_mocks.channel.packets.timing import REAL, Durations
from sitl_mocks.channel.parameters import (
    BackgroundLoad,
    Ble5Parameters,
    ChannelParameters,
    PropagationParameters,
    WifiParameters,
)

PAPER = ChannelParameters()
BEACON_S = 0.000632
NAMES = ("a", "b", "c", "d", "e")


def traffic(
    seed: int, seconds: float = 4.0, tick_s: float = 0.05, jitter_s: float = 0.0
) -> list[Transmission]:
    """Five aircraft that move, each sending on all transports at ticks or up to `jitter_s` after them."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.0, 900.0, (5, 3))
    frames: list[tuple[float, str, str, dict[str, float | None]]] = []
    for tick in range(80):
        distance = np.linalg.norm(places[:, None] - places, axis=2)
        for sender, name in enumerate(NAMES):
            away = {other: float(distance[sender, r]) for r, other in enumerate(NAMES) if r != sender}
            for transport in ("ble4", "ble4", "ble5", "wifi", "nan"):
                if rng.random() < 0.4:
                    sent_s = tick * 0.05 + float(rng.uniform(0.0, jitter_s))
                    frames.append((sent_s, name, transport, {**away}))
        places += rng.uniform(-40.0, 40.0, (5, 3))
    frames.sort(key=lambda frame: frame[0])
    return [Transmission(number, *frame) for number, frame in enumerate(frames)]


def settled(
    channel: PacketChannel, sent: Iterable[Transmission], settle_s: Iterable[float], seed: int = 9
) -> list[Outcome]:
    """All outcomes, with the air settled at these times and at the end."""
    rng, told = np.random.default_rng(seed), []
    times = sorted(settle_s)
    for transmission in sent:
        while times and times[0] <= transmission.sent_s:
            told += channel.settle(times.pop(0), rng)
        channel.transmit(transmission, rng)
    for time_s in [*times, 1e4]:
        told += channel.settle(time_s, rng)
    assert channel.next_s() is None
    return told


@pytest.mark.parametrize("spread_s", [0.0, 0.05])
def test_an_outcome_never_depends_on_when_the_air_is_settled(spread_s: float) -> None:
    parameters = ChannelParameters(
        background=BackgroundLoad(ble4=0.2, ble5=0.1, wifi=0.2),
        propagation=PropagationParameters(shadowing_sigma_db=2.0),
        ble5=Ble5Parameters(auxiliary_uncertainty_ms=1.0),
    )
    sent = traffic(1, jitter_s=0.05 - spread_s)
    ends = settled(PacketChannel(parameters, spread_s), sent, [])
    assert sum(o.arrival_s is not None for o in ends) > 200
    assert {(o.number, o.receiver) for o in ends} == {(t.number, r) for t in sent for r in t.distance_m}
    assert len(ends) == len({(o.number, o.receiver) for o in ends})
    ticks = np.arange(0.0, 5.0, 0.05)
    odd = np.random.default_rng(5).uniform(0.0, 5.0, 400)
    for times in (ticks, odd, np.concatenate([ticks, odd])):
        assert settled(PacketChannel(parameters, spread_s), sent, times.tolist()) == ends


def test_fates_are_those_of_the_whole_air_judged_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Judged one by one with its neighbours, or all together: nobody moves here, so that one matrix holds."""
    places = np.random.default_rng(2).uniform(0.0, 700.0, (5, 3))
    distance = np.linalg.norm(places[:, None] - places, axis=2)
    sent = [
        Transmission(
            t.number, t.sent_s, t.sender, t.transport,
            {r: float(distance[NAMES.index(t.sender), NAMES.index(r)]) for r in t.distance_m},
        )
        for t in traffic(3)
    ]  # fmt: skip
    channel, rng = PacketChannel(PAPER, 0.05), np.random.default_rng(9)
    for transmission in sent:
        channel.transmit(transmission, rng)
    laid = {}
    lay = channel._lay
    monkeypatch.setattr(channel, "_lay", lambda event: laid.setdefault(event.number, event) and lay(event))
    laid |= {event.number: event for event in channel._around}
    told = {(o.number, o.receiver): o.arrival_s for o in channel.settle(1e4, rng)}
    # Beacons that had to wait until their sender's next one were never sent.
    assert 0.98 * len(sent) < len(laid) <= len(sent)
    sent = [transmission for transmission in sent if transmission.number in laid]
    events, radios = [laid[t.number] for t in sent], [channel._radio(name, 0.0, rng) for name in NAMES]
    durations = Durations.of(PAPER, slotted=False)
    packets = packets_of(_events(events, {name: k for k, name in enumerate(NAMES)}, durations), durations)
    whole = decide(
        packets,
        Coverage.of(path_loss_db(distance, PAPER.propagation), PAPER),
        Scanners(np.stack([r.phase for r in radios], axis=1), np.array([r.clock for r in radios])),
        durations,
        REAL,
    )
    expected = arrivals(packets, whole.received, len(events)) * durations.slot_s
    heard = 0
    for transmission, row in zip(sent, expected, strict=True):
        for receiver in transmission.distance_m:
            arrival_s = told[transmission.number, receiver]
            wanted = row[NAMES.index(receiver)]
            assert (arrival_s is None) == bool(np.isnan(wanted))
            assert arrival_s is None or arrival_s == pytest.approx(wanted)
            heard += arrival_s is not None
    # The case is a busy one: alone, a fifth of all would be heard and more.
    assert 0.02 < heard / len(told) < 0.15


@pytest.mark.parametrize(
    ("transport", "share", "least_s", "most_s"),
    [
        ("ble4", 3 * (2.0 - 0.376) / 24.0, 0.000376, 0.005 + 0.001378),
        ("ble5", 3 * (2.0 - 1.152) / 24.0, 0.008328, 0.005 + 0.008328),
        ("wifi", (6.0 - 0.632) / 21.0, BEACON_S, BEACON_S),
        ("nan", (6.0 - 0.632) / 21.0, BEACON_S, BEACON_S),
    ],
)
def test_a_frame_alone_is_heard_as_often_as_windows_are_open(
    transport: str, share: float, least_s: float, most_s: float
) -> None:
    """It arrives at the end of its packet, after Bluetooth's random delay of up to 5 ms."""
    times = np.cumsum(np.random.default_rng(1).uniform(0.05, 0.15, 60))
    receivers = dict.fromkeys((f"r{k}" for k in range(150)), 1.0)
    sent = [Transmission(k, float(t), "s", transport, receivers) for k, t in enumerate(times)]
    told = settled(PacketChannel(PAPER), sent, [])
    delays = [o.arrival_s - sent[o.number].sent_s for o in told if o.arrival_s is not None]
    # Receivers scan independently; frames of random times sample each one's cycle.
    assert len(delays) / len(told) == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / len(told)))
    assert least_s - 1e-9 <= min(delays)
    assert max(delays) <= most_s + 1e-9


def beacons(
    transports: tuple[str, str], away_m: float, frames: int = 200, between_m: float = 1e6
) -> list[Transmission]:
    """Two aircraft send at the same instants; 20 others are near the first and `away_m` from the second."""
    near: dict[str, float | None] = dict.fromkeys((f"r{k}" for k in range(20)), 1.0)
    far: dict[str, float | None] = dict.fromkeys(near, away_m)
    return [
        Transmission(
            2 * k + n, k * 0.1037, name, transport, away | {("b" if name == "a" else "a"): between_m}
        )
        for k in range(frames)
        for n, (name, transport, away) in enumerate((("a", transports[0], near), ("b", transports[1], far)))
    ]


def heard_of(sent: list[Transmission], channel: PacketChannel, seed: int = 9) -> dict[tuple[str, str], int]:
    heard: dict[tuple[str, str], int] = {}
    for outcome in settled(channel, sent, [], seed):
        if outcome.arrival_s is not None:
            pair = (sent[outcome.number].sender, outcome.receiver)
            heard[pair] = heard.get(pair, 0) + 1
    return heard


@pytest.mark.parametrize("transports", [("wifi", "wifi"), ("wifi", "nan"), ("nan", "nan")])
def test_what_overlaps_on_one_channel_is_lost(transports: tuple[str, str]) -> None:
    """The two senders do not hear each other."""
    assert heard_of(beacons(transports, 1.0), PacketChannel(PAPER)) == {}
    # Radios that send at their own times within the tick meet no more.
    spread = heard_of(beacons(transports, 1.0), PacketChannel(PAPER, 0.05))
    assert sum(spread.values()) > 1000


@pytest.mark.parametrize("transports", [("wifi", "wifi"), ("wifi", "nan")])
@pytest.mark.parametrize("between_m", [1.0, 2000.0])
def test_who_hears_the_other_waits_for_its_end(transports: tuple[str, str], between_m: float) -> None:
    """This holds wherever beacons are heard. Bluetooth does not wait."""
    sent = beacons(transports, 1.0, between_m=between_m)
    told = settled(PacketChannel(PAPER), sent, [])
    delays = {"a": [], "b": []}  # type: dict[str, list[float]]
    for outcome in told:
        if outcome.arrival_s is not None:
            delays[sent[outcome.number].sender].append(outcome.arrival_s - sent[outcome.number].sent_s)
    # A quarter of 200 frames at 21 receivers each; the first one begins at once.
    assert min(len(each) for each in delays.values()) > 800
    assert delays["a"] == pytest.approx([BEACON_S] * len(delays["a"]))
    difs_s, slot_s = 50e-6, 20e-6
    slots = (np.array(delays["b"]) - 2 * BEACON_S - difs_s) / slot_s
    assert slots == pytest.approx(np.round(slots), abs=1e-4)
    assert 0 <= round(slots.min()) < 5
    assert 26 < round(slots.max()) <= 31


def test_an_interferer_that_does_not_reach_does_no_harm() -> None:
    heard = heard_of(beacons(("wifi", "wifi"), 1e6), PacketChannel(PAPER))
    assert sum(count for (sender, _), count in heard.items() if sender == "a") > 700
    assert all(sender == "a" for sender, _ in heard)


def test_who_sends_does_not_hear() -> None:
    """Beacons on different channels: the others hear both, the two do not hear each other."""
    parameters = ChannelParameters(wifi_channels="random")
    for seed in range(20):
        heard = heard_of(beacons(("wifi", "wifi"), 1.0, between_m=1.0), PacketChannel(parameters), seed)
        if ("a", "b") not in heard:  # the two drew different channels, so that neither waits
            break
    assert {sender for sender, _ in heard} == {"a", "b"}
    assert ("a", "b") not in heard
    assert ("b", "a") not in heard


def test_an_interferer_counts_with_where_it_was_when_it_sent() -> None:
    """It comes near later, and its next frame says so before the air is settled."""
    sent = beacons(("wifi", "wifi"), 1e6, 1)
    alone = heard_of(sent[:1], PacketChannel(PAPER))
    near: dict[str, float | None] = dict.fromkeys(sent[0].distance_m, 1.0)
    then = heard_of([*sent, Transmission(2, 0.1, "b", "wifi", near)], PacketChannel(PAPER))
    assert len(alone) > 2
    assert {pair for pair in then if pair[0] == "a"} == {pair for pair in alone if pair != ("a", "b")}


def test_one_radio_sends_one_event_after_the_other() -> None:
    receivers: dict[str, float | None] = dict.fromkeys((f"r{k}" for k in range(300)), 1.0)
    sent = [Transmission(k, 0.0, "s", "ble4" if k < 3 else "ble5", receivers) for k in range(4)]
    arrival_s = [[], [], [], []]  # type: list[list[float]]
    for outcome in settled(PacketChannel(ChannelParameters()), sent, []):
        if outcome.arrival_s is not None:
            arrival_s[outcome.number].append(outcome.arrival_s)
    assert all(len(times) > 10 for times in arrival_s)
    for before, after in itertools.pairwise(arrival_s):
        assert max(before) < min(after)


def test_a_radio_that_falls_behind_drops_what_is_out_of_date() -> None:
    channel, rng = PacketChannel(PAPER), np.random.default_rng(1)
    for number in range(3000):
        channel.transmit(Transmission(number, 5.0, "s", "wifi", {"b": 1.0}), rng)
    dropped = [o.number for o in channel.settle(5.0, rng)]
    assert dropped == list(range(3000 - len(dropped), 3000))
    turn_s = BEACON_S + 50e-6 + 31 * 20e-6  # with the longest wait for its own last frame
    assert 3000 - len(dropped) == math.floor(MAX_BACKLOG_S / turn_s) + 1
    rest = channel.settle(5.0 + MAX_BACKLOG_S + 2 * turn_s, rng)
    assert len(rest) + len(dropped) == 3000
    # After the rush it sends at once again.
    channel.transmit(Transmission(3000, 9.0, "s", "wifi", {"b": 1.0}), rng)
    assert channel.next_s() == pytest.approx(9.0 + BEACON_S, abs=0.0002)
    assert channel.settle(9.0001, rng) == []
    assert channel.next_s() == pytest.approx(9.0 + BEACON_S, abs=0.0002)


def test_who_goes_by_the_times_it_names_hears_every_outcome() -> None:
    """Beacons of stations that hear each other, some sent faster than they can go out."""
    near: dict[str, float | None] = dict.fromkeys("abc", 1.0)
    sent = [
        Transmission(k, k * 0.0003, "abc"[k % 3], "wifi", {n: 1.0 for n in near if n != "abc"[k % 3]})
        for k in range(60)
    ]
    channel, rng, told = PacketChannel(PAPER), np.random.default_rng(9), []
    for transmission in sent:
        channel.transmit(transmission, rng)
    for _ in range(10 * len(sent)):
        if (time_s := channel.next_s()) is None:
            break
        told += channel.settle(time_s, rng)
    assert sorted((o.number, o.receiver) for o in told) == sorted(
        (t.number, receiver) for t in sent for receiver in t.distance_m
    )


@pytest.mark.parametrize(("beacon", "later", "heard"), [(1.0, 1e6, False), (1e6, 1.0, True)])
def test_each_frame_of_an_interferer_disturbs_from_where_it_was_sent(beacon, later, heard) -> None:
    """Whenever the air is settled: Bluetooth is laid at once, a beacon once it may begin."""
    sent = [
        Transmission(0, 0.0, "b", "wifi", {f"r{k}": beacon for k in range(40)}),
        Transmission(1, 0.0, "a", "wifi", {f"r{k}": 1.0 for k in range(40)}),
        Transmission(2, 0.0001, "b", "ble5", {f"r{k}": later for k in range(40)}),
    ]
    prompt = ChannelParameters(ble5=Ble5Parameters(random_delay_ms=0.0))
    once = settled(PacketChannel(prompt), sent, [])
    assert settled(PacketChannel(prompt), sent, [0.0001]) == once
    assert any(o.number == 1 and o.arrival_s is not None for o in once) == heard


def waits(sender: str, transport: str, seconds: float, seed: int) -> list[float]:
    """Time from hand-over to the start of each event that an aircraft received."""
    receivers: dict[str, float | None] = dict.fromkeys((f"r{k}" for k in range(40)), 1.0)
    ticks = range(0, round(seconds / 0.05), 2)
    sent = [Transmission(k, tick * 0.05, sender, transport, receivers) for k, tick in enumerate(ticks)]
    told = settled(PacketChannel(PAPER, 0.05), sent, [], seed)
    arrived = {o.number: o.arrival_s for o in told if o.arrival_s is not None}
    length_s = {"wifi": BEACON_S, "ble5": 0.008328}[transport]
    return [arrival_s - sent[number].sent_s - length_s for number, arrival_s in sorted(arrived.items())]


def test_a_radios_own_time_drifts_with_its_clock() -> None:
    """The drift is up to 20 ppm, within the tick, and differs between aircraft."""
    first = set()
    for seed in range(5):
        of_one = waits("a", "wifi", 40.0, seed)
        steps = np.diff(of_one)
        steps = steps[np.abs(steps) < 0.025]  # at the end of the tick it begins anew
        assert len(steps) > 300
        assert np.all(np.abs(steps) <= 20e-6 * 2.0 + 1e-9)
        assert np.all(steps >= 0.0) or np.all(steps <= 0.0)
        assert -1e-9 <= min(of_one) <= max(of_one) < 0.05
        first.add(round(of_one[0], 6))
    assert len(first) == 5


def test_bluetooths_random_delays_add_up() -> None:
    of_one = np.array(waits("a", "ble5", 100.0, 1))
    assert -1e-9 <= of_one.min() < 0.002
    assert 0.048 < of_one.max() < 0.05
    # Uniform over the tick in the long run.
    assert of_one.mean() == pytest.approx(0.025, abs=0.003)


@pytest.mark.parametrize(("transport", "least"), [("ble5", 0.05), ("ble4", 0.1)])
def test_two_aircraft_that_send_together_do_not_do_so_for_ever(transport: str, least: float) -> None:
    channel, rng = PacketChannel(PAPER, 0.05), np.random.default_rng(1)
    for name in "ab":
        channel._radio(name, 0.0, rng).offset_s = [0.02, 0.02, 0.02]
    pairs = [("a", "b"), ("b", "a")] * 600
    sent = [Transmission(k, k // 2 * 0.1, a, transport, {b: 1.0}) for k, (a, b) in enumerate(pairs)]
    told = settled(channel, sent, [])
    for receiver in "ab":
        assert np.mean([o.arrival_s is not None for o in told if o.receiver == receiver]) > least


def test_foreign_transmissions_take_their_share() -> None:
    """A packet in a window survives if the medium is idle at its start and for its length."""
    busy = ChannelParameters(background=BackgroundLoad(wifi=0.5, burst_ms=2.0))
    times = np.cumsum(np.random.default_rng(1).uniform(0.05, 0.15, 60))
    receivers: dict[str, float | None] = dict.fromkeys((f"r{k}" for k in range(150)), 1.0)
    sent = [Transmission(k, float(t), "s", "wifi", receivers) for k, t in enumerate(times)]
    told = settled(PacketChannel(busy), sent, times.tolist())
    expected = (6.0 - 0.632) / 21.0 * 0.5 * math.exp(-0.632 / 2.0)
    share = sum(o.arrival_s is not None for o in told) / len(told)
    assert share == pytest.approx(expected, abs=4 * math.sqrt(expected / len(told)))


@pytest.mark.parametrize("seed", [0, 2, 3])
def test_foreign_transmissions_still_to_be_met_are_not_forgotten(seed: int) -> None:
    """All that is open may lie in the future: a radio has its own time to send."""
    busy = ChannelParameters(
        background=BackgroundLoad(wifi=0.3, burst_ms=0.05), wifi=WifiParameters(beacon_ms=0.2)
    )
    near: dict[str, float | None] = dict.fromkeys((f"r{k}" for k in range(6)), 1.0)
    sent = [
        Transmission(4 * k + n, 1.0 + k * 0.05, name, "ble5" if name == "d" else "wifi", near)
        for k in range(40)
        for n, name in enumerate("abcd")
    ]
    often = np.arange(1.0, 4.0, 0.0005).tolist()
    ends = settled(PacketChannel(busy, 0.05), sent, [], seed)
    assert settled(PacketChannel(busy, 0.05), sent, often, seed) == ends
    assert any(outcome.arrival_s is not None for outcome in ends)


def test_what_is_over_is_forgotten() -> None:
    channel, rng = PacketChannel(PAPER), np.random.default_rng(1)
    for number in range(200):
        channel.settle(number * 0.05, rng)
        channel.transmit(Transmission(number, number * 0.05, "s", "ble5", {"b": 1.0}), rng)
    assert len(channel._around) <= 2


def test_time_does_not_go_back() -> None:
    channel, rng = PacketChannel(PAPER), np.random.default_rng(1)
    channel.settle(2.0, rng)
    with pytest.raises(ValueError, match=r"sent at 1.9 s, but everything is already decided until 2.0 s"):
        channel.transmit(Transmission(0, 1.9, "s", "wifi", {"b": 1.0}), rng)
