"""Which packets are received, by cases small enough to be checked by hand, and against a plain loop."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from companion.errors import ConfigError
from sitl_mocks.channel.packets.reception import (
    CHANNELS_OVERLAP,
    FIRST_PRIMARY,
    FIRST_WIFI,
    Coverage,
    Packets,
    Scanners,
    arrivals,
    decide,
)
from sitl_mocks.channel.packets.schedule import Events, packets_of
from sitl_mocks.channel.packets.timing import BLE4, BLE5, PAPER, REAL, WIFI, Assumptions, Durations
from sitl_mocks.channel.parameters import ChannelParameters

PARAMETERS = ChannelParameters()
DURATIONS = Durations.of(PARAMETERS, slotted=True)
# BLE 4: PDUs of 3 slots, 1 apart; windows of 16 at 0, 64, 128 of 192. Wi-Fi: 5; windows of 48 at 0, 56, 112.
# BLE 5: pointers of 9; auxiliary packet of 26 at 40.

NEAR_DB, FAR_DB = 60.0, 200.0
HALF_DUPLEX = replace(PAPER, half_duplex=True)


@dataclass
class Sent:
    """One packet, alone in its event."""

    transmitter: int
    begin: float
    channel: int = FIRST_PRIMARY
    mode: int = BLE4
    length: float | None = None


def packets(*sent: Sent, event: list[int] | None = None) -> Packets:
    part = [3 if s.mode == BLE5 and s.channel < FIRST_PRIMARY else 0 for s in sent]
    length = [s.length or DURATIONS.length[s.mode, p] for s, p in zip(sent, part, strict=True)]
    begin = np.array([s.begin for s in sent], float)
    mode = np.array([s.mode for s in sent])
    return Packets(
        event=np.arange(len(sent)) if event is None else np.array(event),
        transmitter=np.array([s.transmitter for s in sent]),
        place=np.array([s.transmitter for s in sent]),
        mode=mode,
        channel=np.array([s.channel for s in sent]),
        begin=begin,
        end=begin + np.array(length),
        scan_row=mode,
    )


def coverage(path_loss_db: list[list[float]] | None = None, nodes: int = 4) -> Coverage:
    loss = np.full((nodes, nodes), NEAR_DB) if path_loss_db is None else np.array(path_loss_db)
    return Coverage.of(loss, PARAMETERS)


def received(
    *sent: Sent,
    assumptions: Assumptions = PAPER,
    phase: float = 0.0,
    path_loss_db: list[list[float]] | None = None,
    event: list[int] | None = None,
) -> list[list[bool]]:
    air = coverage(path_loss_db)
    nodes = len(air.path_loss_db)
    scanners = Scanners(np.full((3, nodes), phase), np.ones(nodes))
    got: list[list[bool]] = decide(
        packets(*sent, event=event), air, scanners, DURATIONS, assumptions
    ).received.tolist()
    return got


ALL_BUT_0 = [False, True, True, True]
NOBODY = [False] * 4
ONLY_1 = [False, True, False, False]
"""Aircraft 1 sends the interferer, which disturbs nobody's reception but the others'."""


def test_a_packet_alone_is_heard_by_all_but_its_sender() -> None:
    assert received(Sent(0, 0.0)) == [ALL_BUT_0]


@pytest.mark.parametrize(
    ("mode", "channel", "opens", "last"),
    [
        (BLE4, 37, 0, 13),
        (BLE4, 38, 64, 77),
        (BLE4, 39, 128, 141),
        (BLE5, 38, 64, 71),
        (WIFI, 40, 0, 43),
        (WIFI, 41, 56, 99),
        (WIFI, 42, 112, 155),
    ],
)
@pytest.mark.parametrize("cycles", [0, 5])
@pytest.mark.parametrize("phase", [0.0, 11.0])
def test_a_packet_must_begin_and_end_in_the_window(
    mode: int, channel: int, opens: int, last: int, cycles: int, phase: float
) -> None:
    base = cycles * (168 if mode == WIFI else 192) + phase
    begins = [opens - 1, opens, last, last + 1]
    heard = [received(Sent(0, base + b, channel, mode), phase=phase)[0][1] for b in begins]
    if mode != BLE5:
        assert heard == [False, True, True, False]
    # A pointer alone is received as any packet, but carries no message.
    else:
        assert heard == [False, True, True, False]
        lone = packets(Sent(0, base + opens, channel, mode))
        got = np.array([ALL_BUT_0])
        assert np.isnan(arrivals(lone, got, 1)).all()


@pytest.mark.parametrize(
    ("second_begins", "both_lost"), [(2.0, True), (4.0, True), (5.0, False), (-1.0, False), (0.0, True)]
)
def test_packets_that_share_a_slot_destroy_each_other_and_adjacent_ones_do_not(
    second_begins: float, both_lost: bool
) -> None:
    one, two = received(Sent(0, 2.0), Sent(1, second_begins))
    assert one[2] is not both_lost
    # One that begins before the window is not heard anyway.
    assert two[2] is (not both_lost and second_begins >= 0.0)


def test_a_shorter_packet_within_a_longer_one_and_one_behind_it() -> None:
    """The third overlaps the first only, although the second lies between them in order."""
    got = received(Sent(0, 0.0, length=12.0), Sent(1, 1.0), Sent(2, 8.0))
    assert [row[3] for row in got] == [False, False, False]
    got = received(Sent(0, 0.0, length=5.0), Sent(1, 1.0), Sent(2, 8.0))
    assert [row[3] for row in got] == [False, False, True]


def test_packets_on_other_primary_channels_do_not_disturb() -> None:
    assert received(Sent(0, 0.0), Sent(1, 0.0, 38), Sent(2, 0.0, 39))[0] == ALL_BUT_0


def test_pointers_disturb_pdus_on_the_same_channel() -> None:
    assert received(Sent(0, 5.0), Sent(1, 0.0, 37, BLE5))[0] == ONLY_1


def test_channels_overlap_as_frequencies_do() -> None:
    ble, wifi = CHANNELS_OVERLAP[:FIRST_WIFI], CHANNELS_OVERLAP[FIRST_WIFI:, FIRST_WIFI:]
    assert np.array_equal(ble[:, :FIRST_WIFI], np.eye(40, dtype=bool))
    assert np.array_equal(wifi, np.eye(3, dtype=bool))
    assert [np.nonzero(ble[:, FIRST_WIFI + c])[0].tolist() for c in range(3)] == [
        list(range(9)),  # 2404 to 2420 MHz around 2412
        list(range(11, 21)),  # 2428 to 2446 around 2437
        list(range(24, 33)),  # 2454 to 2470 around 2462
    ]


@pytest.mark.parametrize(("channel", "survives"), [(0, False), (8, False), (9, True), (36, True)])
def test_wifi_and_auxiliary_packets_disturb_each_other_where_they_overlap(
    channel: int, survives: bool
) -> None:
    pointer, auxiliary = Sent(0, 0.0, 37, BLE5), Sent(0, 200.0, channel, BLE5)
    beacon = Sent(1, 170.0, FIRST_WIFI, WIFI, length=31.0)  # within the window at 168
    got = received(pointer, auxiliary, beacon, event=[0, 0, 1])
    assert got[1][2] is survives
    assert got[2][2] is survives


def test_an_auxiliary_packet_needs_a_pointer_of_its_own_event() -> None:
    auxiliary = Sent(0, 40.0, 5, BLE5)
    in_window, outside = Sent(0, 0.0, 37, BLE5), Sent(0, 30.0, 37, BLE5)
    assert received(in_window, auxiliary, event=[0, 0])[1] == ALL_BUT_0
    assert received(outside, auxiliary, event=[0, 0])[1] == NOBODY
    assert received(in_window, auxiliary, event=[0, 1])[1] == NOBODY
    # The pointer is destroyed, the auxiliary packet is not.
    assert received(in_window, auxiliary, Sent(1, 4.0), event=[0, 0, 1])[1] == ONLY_1
    # Any one of three pointers will do.
    second = Sent(0, 64.0, 38, BLE5)
    assert received(outside, second, auxiliary, event=[0, 0, 0])[2] == ALL_BUT_0


def test_an_auxiliary_packet_is_followed_wherever_the_scan_is_and_must_not_collide() -> None:
    pointer = Sent(0, 0.0, 37, BLE5)
    other = Sent(1, 60.0, 5, BLE5)
    assert received(pointer, Sent(0, 40.0, 5, BLE5), other, event=[0, 0, 1])[1] == ONLY_1
    assert received(pointer, Sent(0, 40.0, 6, BLE5), other, event=[0, 0, 1])[1] == ALL_BUT_0


def test_what_an_aircraft_sends_does_not_destroy_its_other_packets() -> None:
    got = received(Sent(0, 0.0), Sent(0, 0.0, 37, BLE5))
    assert got == [ALL_BUT_0, ALL_BUT_0]


def test_nothing_is_heard_or_disturbed_out_of_reach() -> None:
    x, n, f = math.inf, NEAR_DB, FAR_DB
    # 0 and 1 reach 2, only 0 reaches 3.
    loss = [[x, n, n, n], [n, x, n, f], [n, n, x, n], [n, n, n, x]]
    got = received(Sent(0, 0.0), Sent(1, 0.0), path_loss_db=loss)
    # What 1 sends reaches 0 and 2; at 2 the two meet, and so do they at none that hears only one of them.
    assert got == [[False, True, False, True], [True, False, False, False]]


def test_each_mode_has_its_own_reach() -> None:
    # 18 dBm: 103 dB reach -85 dBm, 115 dB -97 dBm, 123 dB -105 dBm.
    for mode, channel, limit_db in [(BLE4, 37, 103.0), (BLE5, 37, 115.0), (WIFI, 40, 123.0)]:
        for loss_db, heard in [(limit_db, True), (limit_db + 0.01, False)]:
            assert (
                received(Sent(0, 0.0, channel, mode), path_loss_db=[[math.nan, loss_db], [loss_db, 0.0]])[0][
                    1
                ]
                is heard
            )


def test_an_interferer_disturbs_where_its_own_mode_reaches() -> None:
    """At 110 dB pointers are heard and PDUs are not: only the pointer disturbs."""
    x, n, d = math.inf, NEAR_DB, 110.0
    loss = [[x, n, n], [n, x, d], [n, n, x]]
    by_pdu = received(Sent(0, 0.0, 37, BLE5), Sent(1, 0.0), path_loss_db=loss)
    by_pointer = received(Sent(0, 0.0), Sent(1, 0.0, 37, BLE5), path_loss_db=loss)
    assert by_pdu[0][2] is True
    assert by_pointer[0][2] is False


@pytest.mark.parametrize(
    ("capture_db", "first", "second"),
    [(None, False, False), (10.0, True, False), (10.1, False, False), (0.0, True, False)],
)
def test_the_stronger_packet_survives_by_the_capture_margin(
    capture_db: float | None, first: bool, second: bool
) -> None:
    x = math.inf
    loss = [[x, 60.0, 60.0], [70.0, x, 70.0], [60.0, 60.0, x]]
    got = received(
        Sent(0, 0.0), Sent(1, 0.0), path_loss_db=loss, assumptions=replace(PAPER, capture_db=capture_db)
    )
    assert (got[0][2], got[1][2]) == (first, second)


def test_capture_needs_the_margin_over_every_interferer() -> None:
    loss = [[math.inf] * 4, [70.0] * 4, [63.0] * 4, [60.0] * 4]
    loss[0] = [60.0] * 4
    capture = replace(PAPER, capture_db=6.0)
    assert received(Sent(0, 0.0), Sent(1, 2.0), path_loss_db=loss, assumptions=capture)[0][3] is True
    three = received(Sent(0, 0.0), Sent(1, 2.0), Sent(2, 2.0), path_loss_db=loss, assumptions=capture)
    assert three[0][3] is False


@pytest.mark.parametrize(
    ("own", "hears"),
    [
        (Sent(1, 1.0, 39), False),  # any Bluetooth channel
        (Sent(1, 0.0, 5, BLE5), False),
        (Sent(1, 6.0, 39), True),  # adjacent in time
        (Sent(1, 0.0, FIRST_WIFI, WIFI), True),  # another radio
    ],
)
def test_half_duplex_who_sends_bluetooth_hears_no_bluetooth(own: Sent, hears: bool) -> None:
    wanted = Sent(0, 3.0)
    assert received(wanted, own, assumptions=HALF_DUPLEX)[0] == [False, hears, True, True]
    assert received(wanted, own)[0] == ALL_BUT_0


def test_half_duplex_who_sends_wifi_hears_no_wifi() -> None:
    wanted, own = Sent(0, 0.0, FIRST_WIFI, WIFI), Sent(1, 4.0, FIRST_WIFI + 2, WIFI)
    assert received(wanted, own, assumptions=HALF_DUPLEX)[0] == [False, False, True, True]


def test_lost_and_unhearable_are_told_apart() -> None:
    air, scanners = coverage(), Scanners(np.zeros((3, 4)), np.ones(4))
    sent = packets(Sent(0, 0.0), Sent(1, 2.0), Sent(2, 14.0))
    outcome = decide(sent, air, scanners, DURATIONS, HALF_DUPLEX)
    assert outcome.hearable.tolist() == [[False, False, True, True], [False, False, True, True], NOBODY]
    assert not outcome.received.any()


def test_a_message_arrives_with_its_first_pdu_or_with_its_auxiliary_packet() -> None:
    events = Events(
        transmitter=np.array([0, 1, 2]),
        mode=np.array([BLE4, BLE5, WIFI]),
        begin=np.array([1000.0, 2000.0, 3000.0]),
        sample=np.zeros(3, int),
        parts=np.array([3, 4, 1]),
        channel=np.array([FIRST_PRIMARY, 7, FIRST_WIFI]),
        auxiliary_delay=np.array([0.0, 2.0, 0.0]),
        scan_row=np.arange(3),
    )
    sent = packets_of(events, DURATIONS)
    assert sent.begin.tolist() == [1000, 1004, 1008, 2000, 2010, 2020, 2042, 3000]
    assert sent.end.tolist() == [1003, 1007, 1011, 2009, 2019, 2029, 2068, 3005]
    assert sent.channel.tolist() == [37, 38, 39, 37, 38, 39, 7, FIRST_WIFI]
    got = np.zeros((8, 2), bool)
    got[[1, 2, 3, 6, 7], 0] = True
    got[3, 1] = True
    times = arrivals(sent, got, 3)
    assert times[:, 0].tolist() == [1007, 2068, 3005]
    assert np.isnan(times[:, 1]).all()


def test_a_fast_clock_reaches_the_window_early() -> None:
    scanners = Scanners(np.zeros((3, 2)), np.array([1.0, 1.0 + 1e-3]))
    air = coverage([[math.inf, 60.0], [60.0, math.inf]])
    # On the fast clock a second of 8000 slots takes 8008: window 42 at 8064 opens at 8072.06.
    heard = [
        decide(packets(Sent(0, b)), air, scanners, DURATIONS, PAPER).received[0, 1] for b in (8070, 8080)
    ]
    assert heard == [False, True]


def test_no_packets_give_no_verdicts() -> None:
    none = packets(Sent(0, 0.0))
    none = Packets(*(getattr(none, name)[:0] for name in Packets.__slots__))
    outcome = decide(none, coverage(), Scanners(np.zeros((3, 4)), np.ones(4)), DURATIONS, REAL)
    assert outcome.received.shape == (0, 4)
    assert arrivals(none, outcome.received, 0).shape == (0, 4)


@pytest.mark.parametrize(
    "assumptions", [PAPER, REAL, replace(REAL, capture_db=3.0), replace(PAPER, capture_db=0.0)]
)
def test_many_packets_are_judged_as_by_a_plain_loop(assumptions: Assumptions) -> None:
    rng = np.random.default_rng(11)
    nodes, events = 6, 300
    durations = Durations.of(PARAMETERS, assumptions.slotted)
    mode = rng.integers(0, 3, events)
    drawn = Events(
        transmitter=rng.integers(0, nodes, events),
        mode=mode,
        begin=durations.phase(6000.0, events, rng),
        sample=np.zeros(events, int),
        parts=durations.parts[mode],
        channel=np.where(mode == WIFI, FIRST_WIFI + rng.integers(0, 3, events), rng.integers(0, 37, events)),
        auxiliary_delay=np.zeros(events),
        scan_row=mode,
    )
    loss = rng.uniform(80.0, 125.0, (nodes, nodes))
    air = Coverage.of(loss, PARAMETERS)
    scanners = Scanners(durations.phase(160.0, 3 * nodes, rng).reshape(3, nodes), np.ones(nodes))
    sent = packets_of(drawn, durations)
    got = decide(sent, air, scanners, durations, assumptions).received
    expected = plain_verdicts(sent, loss, scanners, assumptions)
    assert 100 < expected.sum() < 2000
    assert np.array_equal(got, expected)


def plain_verdicts(sent: Packets, loss: np.ndarray, scanners: Scanners, a: Assumptions) -> np.ndarray:
    """A second implementation of the rules, for one packet and one receiver at a time."""
    count, nodes = len(sent.begin), len(loss)
    limits = [103.0, 115.0, 123.0]
    mhz = [*range(2404, 2425, 2), *range(2428, 2479, 2), 2402, 2426, 2480, 2412, 2437, 2462]
    dwell = [64.0, 64.0, 56.0]
    window = [16.0, 16.0, 48.0]
    tx, mode, channel = sent.transmitter, sent.mode, sent.channel
    good = np.zeros((count, nodes), bool)
    for p in sorted(range(count), key=lambda p: bool(mode[p] == BLE5 and channel[p] < 37)):
        for r in range(nodes):
            if r == tx[p] or loss[tx[p], r] > limits[mode[p]]:
                continue
            fine = True
            for q in range(count):
                if sent.begin[q] >= sent.end[p] or sent.begin[p] >= sent.end[q]:
                    continue
                wifi_p, wifi_q = mode[p] == WIFI, mode[q] == WIFI
                if a.half_duplex and tx[q] == r and wifi_p == wifi_q:
                    fine = False
                near = 10 if wifi_p != wifi_q else 1
                if tx[q] in (tx[p], r) or abs(mhz[channel[p]] - mhz[channel[q]]) >= near:
                    continue
                if loss[tx[q], r] > limits[mode[q]]:
                    continue
                if a.capture_db is None or loss[tx[q], r] - loss[tx[p], r] < a.capture_db:
                    fine = False
            if mode[p] == BLE5 and channel[p] < 37:
                pointers = (sent.event == sent.event[p]) & (channel >= 37)
                good[p, r] = fine and good[pointers, r].any()
                continue
            turn = channel[p] - (40 if mode[p] == WIFI else 37)
            m = mode[p]
            into = (sent.begin[p] - scanners.phase[m, r]) % (3 * dwell[m]) - turn * dwell[m]
            good[p, r] = fine and into >= 0.0 and into + sent.end[p] - sent.begin[p] <= window[m]
    return good


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"advertiser": "both"}, "advertiser"),
        ({"phases": "none"}, "phases"),
        ({"capture_db": -1.0}, "capture_db"),
        ({"capture_db": math.nan}, "capture_db"),
        ({"clock_ppm": -1.0}, "clock_ppm"),
    ],
)
def test_assumptions_that_are_none_are_refused(change: dict[str, object], key: str) -> None:
    with pytest.raises(ConfigError, match=key):
        replace(PAPER, **change)  # type: ignore[arg-type]
