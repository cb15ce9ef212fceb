"""Carrier sense: waiting times in hand-worked cases, against a tick-by-tick model, and in whole runs."""

import math
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

import numpy as np
import pytest

from companion.errors import ConfigError
from sitl_mocks.channel.packets import schedule as packet_schedule
from sitl_mocks.channel.packets.access import (
    BACKOFF_SLOT_MS,
    DIFS_MS,
    MAX_BACKOFF,
    Beacon,
    WifiAccess,
    defer,
)
from sitl_mocks.channel.packets.metrics import loss
from sitl_mocks.channel.packets.reception import FIRST_WIFI, Coverage, Scanners, decide
from sitl_mocks.channel.packets.schedule import Events, packets_of, sense_carrier
from sitl_mocks.channel.packets.simulation import Result, simulate
from sitl_mocks.channel.packets.timing import PAPER, REAL, WIFI, Durations
from sitl_mocks.channel.parameters import ChannelParameters, WifiParameters

LENGTH, DIFS, SLOT = 30, 5, 2
"""Whole numbers, as are all times below. What matters is only DIFS + slots < length."""
ALL = frozenset(range(5))
NOBODY: AbstractSet[int] = frozenset()


@dataclass
class Want:
    """A beacon that a station wants to send, heard by these (never by itself)."""

    station: int
    at: int
    backoff: int = 0
    heard_by: AbstractSet[int] = ALL
    channel: int = 0
    length: int = LENGTH


def beacon(number: int, want: Want) -> Beacon:
    others = want.heard_by - {want.station}
    return Beacon(
        number, want.station, want.channel, float(want.at), float(want.length), others, want.backoff
    )


def begins(*wants: Want) -> list[float | None]:
    """Start of each beacon; None for those that were replaced."""
    access = WifiAccess(float(DIFS), float(SLOT))
    for number, want in enumerate(wants):
        access.want(beacon(number, want))
    decided = dict(access.advance(math.inf))
    assert len(decided) == len(wants)
    return [decided[number] for number in range(len(wants))]


def test_of_two_that_want_the_same_instant_one_waits_for_the_other() -> None:
    # 100 + 30 + 5 + 3 * 2.
    assert begins(Want(0, 100, 9), Want(1, 100, 3)) == [100, 141]


@pytest.mark.parametrize(
    ("at", "expected"),
    [(101, 141), (129, 141), (130, 141), (134, 141), (135, 135), (136, 136)],
)
def test_only_a_medium_idle_for_a_difs_is_free_at_once(at: int, expected: float) -> None:
    assert begins(Want(0, 100), Want(1, at, 3)) == [100, expected]


def test_stations_that_do_not_hear_each_other_do_not_wait() -> None:
    assert begins(Want(0, 100, 1, {2}), Want(1, 110, 1, {2})) == [100, 110]
    # It is enough that one of the two hears the other.
    assert begins(Want(0, 100, 1, {1}), Want(1, 110, 1, NOBODY)) == [100, 137]
    assert begins(Want(0, 100, 1, NOBODY), Want(1, 110, 1, {0})) == [100, 110]


def test_in_a_chain_the_one_in_the_middle_waits_for_both_ends() -> None:
    # 0 and 2 are hidden from each other. 2 begins in 1's wait, 1 goes on when that has ended, at 150.
    assert begins(Want(0, 100, 0, {1}), Want(1, 110, 4, {0, 2}), Want(2, 120, 0, {1})) == [100, 163, 120]


def test_a_countdown_stands_while_the_medium_is_busy() -> None:
    # Both count from 135. 1 is over at 141 and lasts until 171; 2 has 7 slots left and counts on from 176.
    assert begins(Want(0, 100), Want(1, 101, 3), Want(2, 102, 10)) == [100, 141, 190]
    # 3 begins at 152, in the middle of the 9th slot, heard by 2 alone: 8 are counted, 4 are left, from 187.
    assert begins(Want(0, 100), Want(2, 102, 12), Want(3, 152, 0, {2})) == [100, 195, 152]


def test_nobody_counts_in_a_difs() -> None:
    # 1 may go on from 135. 2, which it alone hears, begins at 133 and ends at 163.
    assert begins(Want(0, 100, 0, {1}), Want(1, 101, 2), Want(2, 133, 0, {1})) == [100, 172, 133]


def test_countdowns_that_end_together_collide() -> None:
    assert begins(Want(0, 100), Want(1, 101, 3), Want(2, 120, 3)) == [100, 141, 141]
    # Also when one has counted longer: 2 has 4 left after 1, as many as 3 draws.
    assert begins(Want(0, 100), Want(1, 101, 3), Want(2, 102, 7), Want(3, 150, 4)) == [100, 141, 184, 184]


def test_other_channels_do_not_wait() -> None:
    assert begins(Want(0, 100, channel=0), Want(1, 110, channel=1), Want(2, 120, 1)) == [100, 110, 137]
    # Nor does a countdown stop for them.
    assert begins(Want(0, 100), Want(1, 110, 10), Want(2, 145, channel=1)) == [100, 155, 145]


def test_of_two_beacons_heard_the_one_that_ends_last_counts() -> None:
    # 0 is heard until 200; 2, hidden from it, from 150 to 160.
    long, short = Want(0, 100, 0, {1}, length=100), Want(2, 150, 0, {1}, length=10)
    assert begins(long, Want(1, 120, 1), short) == [100, 207, 150]
    assert begins(long, short, Want(1, 155, 1)) == [100, 150, 207]


def test_a_beacon_that_has_ended_counts_for_a_difs_whatever_else_began() -> None:
    # 2 begins at 132, heard by nobody.
    assert begins(Want(0, 100, 0, {1}), Want(2, 132, 0, NOBODY), Want(1, 133, 1)) == [100, 132, 137]


def test_a_station_waits_for_its_own_beacon() -> None:
    assert begins(Want(0, 100, 0, NOBODY), Want(0, 120, 2, NOBODY)) == [100, 139]


def test_a_newer_beacon_takes_the_place_of_one_that_waits() -> None:
    # The countdown of 20 slots from 135 goes on.
    assert begins(Want(0, 100), Want(1, 110, 20), Want(1, 150, 5)) == [100, None, 175]


def ticking(wants: list[Want], until: int) -> dict[int, float | None]:
    """The same, computed by checking every station at every tick; all are on one channel."""
    sent: list[tuple[int, Want]] = []
    waiting: dict[int, int] = {}
    left: dict[int, int] = {}
    idle = dict.fromkeys(range(5), 1000)
    decided: dict[int, float | None] = {}
    for now in range(until):

        def busy(station: int, now: int = now) -> bool:
            heard = [begin for begin, w in sent if station in w.heard_by or station == w.station]
            return any(begin <= now < begin + LENGTH for begin in heard)

        counted = {s: max(0, idle[s] - DIFS) // SLOT for s in waiting}
        for station in [s for s in waiting if idle[s] >= DIFS and counted[s] == left[s]]:
            number = waiting.pop(station)
            decided[number] = now
            sent.append((now, wants[number]))
        for number, want in enumerate(wants):
            if want.at != now:
                continue
            station = want.station
            if station in waiting:
                decided[waiting[station]] = None
                waiting[station] = number
            elif idle[station] >= DIFS and not busy(station):
                decided[number] = now
                sent.append((now, want))
            else:
                waiting[station], left[station], counted[station] = number, want.backoff, 0
        for station in range(5):
            if not busy(station):
                idle[station] += 1
                continue
            if station in waiting:
                left[station] -= counted[station]
            idle[station] = 0
    return decided


def random_wants(rng: np.random.Generator, count: int, until: int) -> list[Want]:
    hears = rng.random((5, 5)) < 0.7
    at = np.sort(rng.integers(0, until, count)).tolist()
    station = rng.integers(0, 5, count).tolist()
    backoff = rng.integers(0, 12, count).tolist()
    return [
        Want(s, t, b, {r for r in range(5) if hears[s, r] and r != s})
        for s, t, b in zip(station, at, backoff, strict=True)
    ]


@pytest.mark.parametrize("seed", range(40))
def test_it_agrees_with_a_clock_that_ticks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wants = random_wants(rng, count=30, until=int(rng.integers(200, 2000)))
    expected = ticking(wants, 4000)
    assert len(expected) == 30
    assert begins(*wants) == [expected[number] for number in range(30)]


def test_these_cases_hold_all_that_can_happen() -> None:
    """The random cases above include beacons sent at once, deferred, replaced and sent simultaneously."""
    at_once = put_off = replaced = together = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        wants = random_wants(rng, count=30, until=int(rng.integers(200, 2000)))
        times = begins(*wants)
        sent = [(t, w) for t, w in zip(times, wants, strict=True) if t is not None]
        replaced += len(wants) - len(sent)
        at_once += sum(t == w.at for t, w in sent)
        put_off += sum(t > w.at for t, w in sent)
        together += len(sent) - len({t for t, _ in sent})
    assert min(at_once, put_off, replaced, together) > 10


@pytest.mark.parametrize("step", [1, 17, 400])
def test_deciding_as_time_goes_on_gives_the_same(step: int) -> None:
    wants = random_wants(np.random.default_rng(7), 40, 1500)
    access, decided = WifiAccess(float(DIFS), float(SLOT)), {}
    for now in range(0, 4000, step):
        for number, want in enumerate(wants):
            if now <= want.at < now + step:
                access.want(beacon(number, want))
        for number, time in access.advance(float(now + step)):
            assert time is None or now <= time < now + step
            decided[number] = time
    assert [decided[number] for number in range(40)] == begins(*wants)


def test_the_next_time_at_which_something_may_happen() -> None:
    access = WifiAccess(float(DIFS), float(SLOT))
    assert access.next_time() is None
    access.want(beacon(0, Want(0, 100)))
    access.want(beacon(1, Want(1, 110, 3)))
    assert access.next_time() == 100
    assert access.advance(100.0) == []
    assert access.advance(110.5) == [(0, 100)]
    assert access.next_time() == 141
    assert access.advance(142.0) == [(1, 141)]
    assert access.next_time() is None


def test_the_past_is_settled() -> None:
    access = WifiAccess(float(DIFS), float(SLOT))
    access.advance(50.0)
    access.want(beacon(0, Want(0, 50)))
    with pytest.raises(ValueError, match="beacon 1"):
        access.want(beacon(1, Want(1, 49)))


PARAMETERS = ChannelParameters()
EXACT = Durations.of(PARAMETERS, slotted=False)
BEACON = float(EXACT.length[WIFI, 0])
DIFS_SLOTS, BACKOFF_SLOTS = DIFS_MS / PARAMETERS.slot_ms, BACKOFF_SLOT_MS / PARAMETERS.slot_ms
EVERYBODY = ~np.eye(2, dtype=bool)


def test_backoffs_are_uniform_whole_numbers_of_slots() -> None:
    wanted = np.repeat(np.arange(16_000) * 1000.0, 2)
    station = np.tile([0, 1], 16_000)
    begin = defer(
        wanted,
        station,
        np.zeros(32_000, int),
        BEACON,
        EVERYBODY,
        PARAMETERS.slot_ms,
        np.random.default_rng(3),
    )
    assert np.array_equal(begin[::2], wanted[::2])
    drawn = (begin - wanted)[1::2]
    backoff = (drawn - BEACON - DIFS_SLOTS) / BACKOFF_SLOTS
    assert np.allclose(backoff, np.round(backoff), atol=1e-4)
    counts = np.bincount(np.round(backoff).astype(int))
    assert len(counts) == MAX_BACKOFF + 1 == 32
    # Chi-squared with 31 degrees of freedom: mean 31, standard deviation sqrt(62).
    assert ((counts - 500.0) ** 2 / 500.0).sum() < 31 + 5 * math.sqrt(62)


def beacons_at_once(channel: list[int]) -> Events:
    nodes = len(channel)
    return Events(
        transmitter=np.arange(nodes),
        mode=np.full(nodes, WIFI),
        begin=np.zeros(nodes),
        sample=np.arange(nodes) + 7,
        parts=np.ones(nodes, int),
        channel=np.array(channel),
        auxiliary_delay=np.zeros(nodes),
        scan_row=np.full(nodes, WIFI),
    )


def heard_by_the_last(loss_db: np.ndarray, events: Events) -> list[bool]:
    """Whether each event is received by the last aircraft, which listens at the right time."""
    nodes = len(loss_db)
    scanners = Scanners(np.zeros((3, nodes)), np.ones(nodes))
    packets = packets_of(events, EXACT)
    received = decide(packets, Coverage.of(loss_db, PARAMETERS), scanners, EXACT, REAL).received
    return [bool(heard) for heard in received[:, -1]]


def test_two_that_want_the_same_instant_are_both_received_unless_hidden() -> None:
    for between_db, kept in ((60.0, True), (200.0, False)):
        loss_db = np.full((3, 3), 60.0)
        loss_db[0, 1] = loss_db[1, 0] = between_db
        wanted = beacons_at_once([FIRST_WIFI] * 2)
        hears = Coverage.of(loss_db, PARAMETERS).reach[WIFI]
        sent = sense_carrier(wanted, EXACT, hears, np.random.default_rng(1))
        assert heard_by_the_last(loss_db, wanted) == [False, False]
        assert heard_by_the_last(loss_db, sent) == [kept, kept]


def test_a_beacon_that_waits_keeps_its_sample_and_all_else() -> None:
    wanted = beacons_at_once([FIRST_WIFI] * 6)
    # Two that are no beacons stay, on whatever channel.
    wanted = replace(wanted, mode=np.array([WIFI, WIFI, 0, WIFI, 1, WIFI]))
    sent = sense_carrier(wanted, EXACT, ~np.eye(6, dtype=bool), np.random.default_rng(2))
    assert np.all(np.diff(sent.begin) >= 0.0)
    assert sent.transmitter[sent.begin == 0.0].tolist() == [0, 2, 4]
    assert sorted(sent.transmitter.tolist()) == list(range(6))
    assert sent.transmitter.tolist() != list(range(6))
    assert np.array_equal(sent.sample, sent.transmitter + 7)
    assert np.array_equal(sent.mode, wanted.mode[sent.transmitter])


def test_beacons_on_three_channels_all_begin_at_once() -> None:
    wanted = beacons_at_once([FIRST_WIFI, FIRST_WIFI + 1, FIRST_WIFI + 2])
    sent = sense_carrier(wanted, EXACT, ~np.eye(3, dtype=bool), np.random.default_rng(1))
    assert sent.begin.tolist() == [0.0] * 3


def run(
    nodes: int,
    seconds: float,
    seed: int,
    *,
    carrier_sense: bool = True,
    receivers: int = 0,
    path_loss_db: np.ndarray | None = None,
    parameters: ChannelParameters = PARAMETERS,
) -> Result:
    """Aircraft with Wi-Fi at 10, and others that only listen; all near each other unless told."""
    every = nodes + receivers
    return simulate(
        parameters,
        replace(REAL, carrier_sense=carrier_sense),
        np.full((every, every), 60.0) if path_loss_db is None else path_loss_db,
        np.array([[0, 0, 10]] * nodes + [[0, 0, 0]] * receivers),
        np.zeros(every, int),
        seconds,
        np.random.default_rng(seed),
    )


def test_in_a_crowd_beacons_begin_together_or_a_difs_apart() -> None:
    together = beacons = 0
    for seed in range(8):
        result = run(40, 20.0, seed)
        apart = np.diff(result.start_s) / EXACT.slot_s
        same = apart < 1e-6
        assert np.all(apart[~same] > BEACON + DIFS_SLOTS - 1e-6)
        together += int(same.sum())
        beacons += len(apart) + 1
        # All that are wanted are sent: 10 a second from each aircraft's first sample on, within one interval.
        wanted = np.floor(10.0 * (20.0 - result.first_sample_s))
        assert np.all(np.abs(np.bincount(result.transmitter) - wanted) <= 1)
    # A quarter of the time is busy, and of two that wait one in 32 draws what the other does.
    assert 0.0002 < together / beacons < 0.01


def test_without_carrier_sense_ten_lose_what_overlaps_and_with_it_next_to_nothing() -> None:
    lost, hearable = np.zeros(2), np.zeros(2)
    for seed in range(200):
        for sensing in (0, 1):
            result = run(10, 2.0, seed, carrier_sense=bool(sensing))
            lost[sensing] += result.lost.sum()
            hearable[sensing] += result.hearable.sum()
    without, with_it = lost / hearable
    # Two beacon lengths in a tenth of a second, eight others that the receiver is not. Of 200 times 45 pairs
    # 114 overlap for a whole run: a tenth more or less is one standard deviation.
    assert without == pytest.approx(1.0 - (1.0 - 2 * 0.632 / 100.0) ** 8, rel=0.3)
    assert with_it < 0.003


def test_two_hidden_from_each_other_still_collide_at_a_third() -> None:
    parameters = ChannelParameters(wifi=WifiParameters(beacon_ms=5.9, scan_ms=30.0))
    hidden_db = np.full((3, 3), 60.0)
    hidden_db[0, 1] = hidden_db[1, 0] = 200.0
    seeds = 200
    for loss_db, expected in ((hidden_db, 2 * 5.9 / 100.0), (np.full((3, 3), 60.0), 0.0)):
        lost = [
            loss(run(2, 2.0, seed, receivers=1, path_loss_db=loss_db, parameters=parameters))[:2, 2, WIFI]
            for seed in range(seeds)
        ]
        # Phases hardly move in two seconds: each run is one case.
        error = math.sqrt(expected * (1.0 - expected) / seeds)
        assert abs(np.mean(lost) - expected) <= 4 * error


def test_a_medium_with_too_much_to_carry_stays_full_and_drops_what_is_out_of_date() -> None:
    """25 aircraft with 10 beacons of 5.9 ms each: 1.475 s of beacons in a second."""
    parameters = ChannelParameters(wifi=WifiParameters(beacon_ms=5.9))
    result = run(25, 60.0, 1, parameters=parameters)
    begin = np.unique(np.round(result.start_s, 9))
    busy = 0.0059 * np.sum((begin >= 1.0) & (begin < 60.0)) / 59.0
    assert 0.95 < busy < 1.0
    assert np.all(np.diff(begin) > 0.0059)
    # Nobody is shut out, and nobody sends what a newer beacon has replaced: 0.1 s is the interval.
    sent = np.bincount(result.transmitter)
    assert sent.min() > 0.5 * sent.mean()
    age = result.start_s - result.sample_s
    assert age.min() >= 0.0
    assert age.max() < 1.0 + 0.1


def test_a_seed_decides_who_waits_how_long_and_nothing_else_changes_with_it() -> None:
    first, again, other = (run(30, 10.0, seed) for seed in (5, 5, 6))
    assert np.array_equal(first.start_s, again.start_s)
    assert np.array_equal(first.heard_s, again.heard_s)
    assert not np.array_equal(first.start_s[:100], other.start_s[:100])
    # Schedules and phases are those without carrier sense: what need not wait begins when it would have.
    without = run(30, 10.0, 5, carrier_sense=False)
    assert np.array_equal(first.first_sample_s, without.first_sample_s)
    assert 0.5 < np.isin(first.start_s, without.start_s).mean() < 0.95


def test_the_papers_assumptions_sense_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise AssertionError("waited")

    monkeypatch.setattr(packet_schedule, "defer", fail)
    loss_db, rates, channel = np.full((3, 3), 60.0), np.tile([0, 0, 10], (3, 1)), np.zeros(3, int)
    simulate(PARAMETERS, PAPER, loss_db, rates, channel, 2.0, np.random.default_rng(1))
    with pytest.raises(AssertionError, match="waited"):
        simulate(PARAMETERS, REAL, loss_db, rates, channel, 2.0, np.random.default_rng(1))


def test_whole_slots_are_too_coarse_to_sense_the_carrier() -> None:
    with pytest.raises(ConfigError, match="carrier_sense"):
        replace(PAPER, carrier_sense=True)
