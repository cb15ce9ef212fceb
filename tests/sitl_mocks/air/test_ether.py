"""The simulated air: who receives which frame, when and over which distance, and the statistics."""

import math

import numpy as np
import pytest

from companion.radio.frames_io import FrameSender, radio_address
from companion.remote_id.messages import Location, SelfId, Status
from sitl_mocks.air.ether import REST, Delivery, Ether
from sitl_mocks.air.pair_statistics import PairStats
from sitl_mocks.channel.air import Channel, Outcome, Transmission
from sitl_mocks.channel.simple import SimpleChannel


class DistanceProbe:
    """A perfect channel that records the distances of its links."""

    def __init__(self) -> None:
        self.asked: list[float | None] = []
        self.delay_s = 0.0
        self._outcomes: list[Outcome] = []

    def transmit(self, transmission: Transmission, rng: np.random.Generator) -> None:
        for receiver, distance_m in transmission.distance_m.items():
            self.asked.append(distance_m)
            arrival_s = transmission.sent_s + self.delay_s
            self._outcomes.append(Outcome(transmission.number, receiver, arrival_s))

    def settle(self, now_s: float, rng: np.random.Generator) -> list[Outcome]:
        told, self._outcomes = self._outcomes, []
        return told

    def next_s(self) -> float | None:
        return None


class LateChannel:
    """A channel that decides after one second whether a frame is received."""

    def __init__(self, lost: tuple[int, ...] = ()) -> None:
        self.lost = lost
        self.open: list[Transmission] = []

    def transmit(self, transmission: Transmission, rng: np.random.Generator) -> None:
        self.open.append(transmission)

    def settle(self, now_s: float, rng: np.random.Generator) -> list[Outcome]:
        told = [t for t in self.open if t.sent_s + 1.0 <= now_s]
        self.open = self.open[len(told) :]
        return [
            Outcome(t.number, receiver, None if t.number in self.lost else t.sent_s + 0.5)
            for t in told
            for receiver in t.distance_m
        ]

    def next_s(self) -> float | None:
        return self.open[0].sent_s + 1.0 if self.open else None


def make(channel: Channel | None = None, seed: int = 1, **options: int) -> Ether:
    ether = Ether(channel or SimpleChannel(), np.random.default_rng(seed), **options)
    for name in ("a", "b", "c"):
        ether.join(name)
    return ether


def test_everyone_but_the_sender_hears_a_frame_as_it_was_sent() -> None:
    ether = make()
    ether.transmit(5.0, "b", "ble5", b"\x01\x02", address="c2:00:00:00:00:01")
    assert ether.due(5.0) == [
        Delivery("a", "b", "ble5", b"\x01\x02", 5.0, "c2:00:00:00:00:01"),
        Delivery("c", "b", "ble5", b"\x01\x02", 5.0, "c2:00:00:00:00:01"),
    ]
    assert ether.due(100.0) == []


def test_a_frame_arrives_after_its_delay_and_not_before() -> None:
    ether = make(SimpleChannel(delay_s=(0.5, 0.5)))
    ether.transmit(10.0, "a", "wifi", b"x")
    assert ether.next_due_s() == 10.5
    assert ether.due(10.49) == []
    assert [d.receiver for d in ether.due(10.5)] == ["b", "c"]
    assert ether.next_due_s() is None


def test_frames_come_in_order_of_arrival_not_of_sending() -> None:
    ether = make(SimpleChannel(delay_s=(0.0, 1.0)), seed=2)
    for i in range(50):
        ether.transmit(i * 0.01, "a", "wifi", bytes([i]))
    seen: list[float] = []
    order: list[int] = []
    for now in np.arange(0.0, 2.0, 0.001):
        for delivery in ether.due(float(now)):
            seen.append(now - delivery.sent_s)
            order.append(delivery.frame[0])
    assert len(order) == 100
    assert order != sorted(order)
    assert 0.0 <= min(seen) < max(seen) <= 1.0011


def test_one_seed_and_order_of_calls_give_one_air() -> None:
    def flown(seed: int) -> list[Delivery]:
        ether = make(SimpleChannel(delay_s=(0.1, 2.0), loss=0.3), seed=seed)
        out = []
        for i in range(100):
            ether.transmit(i * 0.1, "abc"[i % 3], "ble4", bytes([i]))
            out += ether.due(i * 0.1)
        return out

    assert flown(4) == flown(4)
    assert flown(4) != flown(5)


def test_what_became_of_every_frame_is_counted_by_pair() -> None:
    ether = make(SimpleChannel(delay_s=(0.2, 0.6), loss=0.4))
    heard = 0
    for i in range(300):
        ether.transmit(i * 1.0, "a", "wifi", b"x", (0.0, 0.0, 0.0))
        heard += sum(d.receiver == "b" for d in ether.due(i + 0.9))
    pair = ether.stats["a", "b"]
    assert (pair.sent, pair.delivered) == (300, heard)
    assert pair.sent == pair.delivered + pair.lost
    assert 60 < pair.lost < 180
    # Ages are those of the hand-over, which here always comes 0.9 s after sending.
    assert (pair.age_min_s, pair.age_max_s) == pytest.approx((0.9, 0.9))
    assert pair.age_mean_s == pytest.approx(0.9)
    assert pair.unknown_distance == 300
    assert ("b", "a") not in ether.stats


def test_a_pair_that_heard_nothing_has_no_ages() -> None:
    assert PairStats(sent=3, lost=3).to_dict()["age_min_s"] is None
    assert PairStats(sent=3, lost=3).age_mean_s is None


def test_distance_is_slant_and_of_the_told_positions() -> None:
    channel = DistanceProbe()
    ether = make(channel)
    ether.place("b", (30.0, 0.0, -10.0))
    ether.transmit(0.0, "a", "wifi", b"x", (0.0, 40.0, -10.0))
    ether.place("b", (0.0, 40.0, -60.0))
    ether.transmit(0.1, "a", "wifi", b"x")
    assert channel.asked == [50.0, None, 50.0, None]


def test_range_holds_between_placed_aircraft() -> None:
    ether = make(SimpleChannel(range_m=100.0))
    ether.place("b", (99.0, 0.0, 0.0))
    ether.place("c", (101.0, 0.0, 0.0))
    ether.transmit(0.0, "a", "wifi", b"x", (0.0, 0.0, 0.0))
    assert [d.receiver for d in ether.due(0.0)] == ["b"]
    assert ether.stats["a", "c"].lost == 1


@pytest.mark.parametrize("transport", ["ble4", "ble5", "wifi", "nan"])
def test_where_nobody_tells_the_frames_tell(transport: str) -> None:
    """A hundredth of a degree of latitude at the equator is 1105.7 m (WGS84)."""
    channel = DistanceProbe()
    ether = make(channel)
    for name, lat, alt in (("a", 0.0, 100.0), ("b", 0.01, 500.0), ("a", 0.005, 100.0)):
        location = Location(status=Status.AIRBORNE, lat_deg=lat, lon_deg=8.5, alt_geodetic_m=alt)
        for frame in FrameSender(radio_address(name)).frames(transport, (location,)):
            ether.transmit(0.0, name, transport, frame, address=radio_address(name))
    to_a, from_a = channel.asked[2], channel.asked[4]
    assert channel.asked[:2] == [None, None]
    assert to_a == pytest.approx(math.hypot(1105.7, 400.0), abs=0.5)
    assert from_a == pytest.approx(math.hypot(552.9, 400.0), abs=0.5)


def test_a_carried_position_without_altitude_gives_the_level_distance() -> None:
    ether = make()
    for name, alt in (("a", 100.0), ("b", None)):
        location = Location(lat_deg=0.0 if name == "a" else 0.01, lon_deg=8.5, alt_geodetic_m=alt)
        for frame in FrameSender(radio_address(name)).frames("wifi", (location,)):
            ether.transmit(0.0, name, "wifi", frame)
    assert ether.distance_m("a", "b") == pytest.approx(1105.7, abs=0.5)


def test_frames_without_a_position_change_no_distance() -> None:
    ether = make()
    frames = FrameSender(radio_address("a")).frames(
        "wifi", (SelfId(description_type=0, text="survey"), Location())
    )
    for frame in [*frames, b"", b"\x00" * 400]:
        ether.transmit(0.0, "a", "wifi", frame)
    assert ether.distance_m("a", "b") is None
    assert [d.frame for d in ether.due(0.0) if d.receiver == "b"] == [*frames, b"", b"\x00" * 400]


def test_who_left_hears_nothing_and_what_was_under_way_is_lost() -> None:
    ether = make(SimpleChannel(delay_s=(1.0, 1.0)))
    ether.transmit(0.0, "a", "wifi", b"x")
    ether.leave("b")
    ether.transmit(0.1, "a", "wifi", b"y")
    assert [(d.receiver, d.frame) for d in ether.due(5.0)] == [("c", b"x"), ("c", b"y")]
    assert (ether.stats["a", "b"].sent, ether.stats["a", "b"].lost) == (1, 1)
    assert ether.receivers == ("a", "c")


def test_joining_twice_is_joining_once() -> None:
    ether = make()
    ether.join("b")
    ether.transmit(0.0, "a", "wifi", b"x")
    assert [d.receiver for d in ether.due(0.0)] == ["b", "c"]


def test_the_queue_is_bounded_and_says_what_it_dropped() -> None:
    ether = make(SimpleChannel(delay_s=(1.0, 1.0)), max_pending=5)
    for _ in range(4):
        ether.transmit(0.0, "a", "wifi", b"x")
    dropped = sum(pair.overflowed for pair in ether.stats.values())
    assert (len(ether.due(1.0)), dropped) == (5, 3)


def test_statistics_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl_mocks.air.ether.MAX_PAIRS", 4)
    ether = make()
    for i in range(10):
        ether.transmit(0.0, f"s{i}", "wifi", b"x")
    assert len(ether.stats) == 5
    assert sum(pair.sent for pair in ether.stats.values()) == 30
    assert ether.stats[REST].sent == 26


@pytest.mark.parametrize("position", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0), (0.0, 0.0)])
def test_a_position_that_is_none_is_refused(position: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="three finite numbers"):
        make().place("a", position)


def test_a_time_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="time of sending"):
        make().transmit(math.nan, "a", "wifi", b"x")


@pytest.mark.parametrize("delay", [-1.0, math.nan, math.inf])
def test_a_delay_that_is_none_is_a_bug_of_the_channel(delay: float) -> None:
    broken = DistanceProbe()
    broken.delay_s = delay
    with pytest.raises(ValueError, match="returned arrival"):
        make(broken).transmit(0.0, "a", "wifi", b"x")


# ---------------------------------------------------------------- a channel that decides later


def test_a_late_decision_is_delivered_when_it_is_made() -> None:
    ether = make(LateChannel(lost=(1,)))
    ether.transmit(0.0, "a", "wifi", b"x")
    ether.transmit(0.2, "a", "wifi", b"y")
    assert ether.next_due_s() == 1.0
    assert ether.due(0.9) == []
    assert [(d.receiver, d.frame, d.sent_s) for d in ether.due(1.0)] == [("b", b"x", 0.0), ("c", b"x", 0.0)]
    assert ether.next_due_s() == 1.2
    assert ether.due(5.0) == []
    assert ether.next_due_s() is None
    assert (ether.stats["a", "b"].sent, ether.stats["a", "b"].delivered, ether.stats["a", "b"].lost) == (
        2,
        1,
        1,
    )


def test_who_leaves_before_the_decision_loses_the_frame_once_and_for_all() -> None:
    ether = make(LateChannel())
    ether.transmit(0.0, "a", "wifi", b"x")
    ether.leave("b")
    ether.join("b")
    assert [d.receiver for d in ether.due(2.0)] == ["c"]
    pair = ether.stats["a", "b"]
    assert (pair.sent, pair.delivered, pair.lost) == (1, 0, 1)


def test_undecided_frames_are_bounded_too() -> None:
    ether = make(LateChannel(), max_pending=5)
    for _ in range(4):
        ether.transmit(0.0, "a", "wifi", b"x")
    assert sum(pair.overflowed for pair in ether.stats.values()) == 3
    assert len(ether.due(2.0)) == 5
    # Decided frames make room for new ones.
    ether.transmit(2.0, "a", "wifi", b"x")
    assert len(ether.due(4.0)) == 2


# ---------------------------------------------------------------- age of information


def location_frames(name: str, transport: str = "wifi") -> list[bytes]:
    location = Location(status=Status.AIRBORNE, lat_deg=47.0, lon_deg=8.5, alt_geodetic_m=100.0)
    return FrameSender(radio_address(name)).frames(transport, (location,))


def test_only_positions_refresh_what_is_known() -> None:
    ether = make(SimpleChannel(delay_s=(0.5, 0.5)))
    (position,) = location_frames("a")
    (other,) = FrameSender(radio_address("a")).frames("wifi", (SelfId(description_type=0, text="x"),))
    (nowhere,) = FrameSender(radio_address("a")).frames("wifi", (Location(),))
    for sent_s, frame in ((0.0, other), (1.0, position), (2.0, other), (3.0, nowhere), (5.0, position)):
        ether.transmit(sent_s, "a", "wifi", frame)
        ether.due(sent_s + 0.5)
    ether.finish(7.5)
    pair = ether.stats["a", "b"]
    # Heard at 1.5 s with an age of 0.5 s; grown to 4.5 s at 5.5 s and reset to 0.5 s; 2.5 s at the end. The
    # air begins at 0 s.
    assert pair.first_heard_s == 1.5
    assert pair.information_age_mean_s == pytest.approx((4.0 * 2.5 + 2.0 * 1.5) / 6.0)
    assert pair.information_age_max_s == pytest.approx(4.5)
    assert pair.delivered == 5
    assert ("b", "a") not in ether.stats


def test_ages_do_not_hang_on_where_time_begins() -> None:
    """Time begins at the machine's start in the process, and at 0 in lock-step."""
    rows = []
    for begin_s in (0.0, 1e6):
        ether = make(SimpleChannel(delay_s=(0.25, 0.25)))
        (position,) = location_frames("a")
        ether.due(begin_s)
        for sent_s in (1.0, 4.0):
            ether.transmit(begin_s + sent_s, "a", "wifi", position)
            ether.due(begin_s + sent_s + 0.5)
        ether.finish(begin_s + 10.0)
        rows.append(ether.stats["a", "b"].to_dict())
    assert rows[0] == rows[1]
    assert rows[0]["first_heard_s"] == 1.5


def test_what_is_known_of_who_left_ages_no_further() -> None:
    ether = make()
    (position,) = location_frames("a")
    ether.transmit(0.0, "a", "wifi", position)
    ether.due(0.0)
    ether.due(2.0)
    ether.leave("a")
    ether.due(50.0)
    ether.finish(100.0)
    pair = ether.stats["a", "b"]
    assert (pair.information_age_max_s, pair.observed_s) == (2.0, 2.0)


@pytest.mark.parametrize("channel", [SimpleChannel(delay_s=(0.5, 0.5)), LateChannel()])
def test_a_frame_of_who_left_begins_no_new_age(channel: Channel) -> None:
    """This holds whether or not its outcome is already known; the frame is still delivered."""
    ether = make(channel)
    (position,) = location_frames("a")
    ether.transmit(0.0, "a", "wifi", position)
    ether.due(1.0)
    ether.transmit(1.5, "a", "wifi", position)
    ether.leave("a")
    ether.join("a")
    assert len(ether.due(2.5)) == 2
    ether.finish(100.0)
    pair = ether.stats["a", "b"]
    assert (pair.delivered, pair.observed_s, pair.information_age_max_s) == (2, 0.5, 1.5)


def test_transports_are_counted_apart() -> None:
    ether = make()
    for transport in ("ble4", "ble4", "wifi"):
        (frame,) = location_frames("a", transport)
        ether.transmit(0.0, "a", transport, frame)
    ether.due(0.0)
    assert ether.stats["a", "c"].to_dict()["transports"] == {
        "ble4": {"sent": 2, "delivered": 2},
        "wifi": {"sent": 1, "delivered": 1},
    }


def test_pairs_that_share_statistics_have_no_common_age(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl_mocks.air.ether.MAX_PAIRS", 1)
    ether = make()
    (position,) = location_frames("a")
    ether.transmit(0.0, "a", "wifi", position)
    ether.due(0.0)
    ether.finish(1.0)
    assert ether.stats[REST].first_heard_s is None
    assert ether.stats["a", "b"].first_heard_s == 0.0
