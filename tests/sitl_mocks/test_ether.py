"""The simulated air: who hears what and when, by which distance, and what is counted."""

import math

import numpy as np
import pytest

from companion.radio.frames_io import FrameSender, radio_address
from companion.remote_id.messages import Location, SelfId, Status
from sitl_mocks.channel.simple import SimpleChannel
from sitl_mocks.ether import REST, Delivery, Ether, PairStats


class DistanceProbe:
    """A perfect channel that notes the distances it was asked about."""

    def __init__(self) -> None:
        self.asked: list[float | None] = []

    def deliver(
        self, sender: str, receiver: str, transport: str, distance_m: float | None, rng: np.random.Generator
    ) -> float | None:
        self.asked.append(distance_m)
        return 0.0


def make(channel: SimpleChannel | DistanceProbe | None = None, seed: int = 1, **options: int) -> Ether:
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
    monkeypatch.setattr("sitl_mocks.ether.MAX_PAIRS", 4)
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
    class Broken(DistanceProbe):
        def deliver(self, *_: object) -> float | None:  # type: ignore[override]
            return delay

    with pytest.raises(ValueError, match="gave a delay"):
        make(Broken()).transmit(0.0, "a", "wifi", b"x")
