"""The modelled link: queued, lost and late data, and the portions in which it is read."""

from __future__ import annotations

import numpy as np
import pytest

from sitl_mocks.examinations.modelled_link import ModelledLink


def link(kind, **more):
    return ModelledLink(kind, np.random.default_rng(1), **more)


def numbered(count, size=40):
    return [(n & 0xFFFF).to_bytes(2) + bytes(size - 2) for n in range(count)]


def numbers(data, size=40):
    return [data[at] << 8 | data[at + 1] for at in range(0, len(data), size)]


def test_a_full_udp_buffer_drops_the_newest():
    udp = link("udp")
    udp.tell(1.0, numbered(400))
    assert udp.dropped == 400 - 256
    assert len(udp.news(1.0)) == 256
    assert numbers(udp.read()) == list(range(64))
    assert udp.waiting
    udp.tell(1.1, numbered(1))
    rest = [numbers(udp.read()) for _ in range(4)]
    assert [len(part) for part in rest] == [64, 64, 64, 1]
    assert not udp.waiting


@pytest.mark.parametrize(("kind", "portion", "holds"), [("tcp", 65_536, 3_990_216), ("pty", 4_095, 19_712)])
def test_a_stream_is_read_in_portions_and_takes_no_more_than_it_holds(kind, portion, holds):
    stream = link(kind)
    stream.tell(1.0, numbered(120_000))
    taken = holds // 40
    assert stream.dropped == 120_000 - taken
    data = b""
    while stream.waiting:
        part = stream.read()
        assert len(part) <= portion
        data += part
    assert len(data) == 40 * taken


def test_what_a_router_holds_up_comes_late_and_after_what_came_later():
    udp = link("udp")
    udp.weather.delay_s = 2.0
    udp.tell(1.0, numbered(1))
    udp.weather.delay_s = 0.0
    udp.tell(1.5, [b"next"])
    assert udp.news(2.9) == [(1.5, b"next")]
    assert udp.news(3.0) == [(1.0, numbered(1)[0])]
    assert udp.read() == b"next" + numbered(1)[0]


def test_datagrams_are_doubled_and_change_their_order():
    udp = link("udp")
    udp.weather.duplicate = udp.weather.reorder = 0.5
    for n, frame in enumerate(numbered(100)):
        udp.tell(1.0 + 0.01 * n, [frame])
    udp.news(3.0)
    found = []
    while udp.waiting:
        found += numbers(udp.read())
    assert set(found) == set(range(100))
    assert 120 < len(found) < 180
    assert found != sorted(found)


@pytest.mark.parametrize("kind", ["udp", "tcp"])
def test_down_stands_a_stream_keeps_what_waits_and_datagrams_are_lost(kind):
    one = link(kind)
    one.weather.down_stands = True
    one.tell(1.0, numbered(3))
    assert one.news(2.0) == []
    one.weather.down_stands = False
    assert len(one.news(3.0)) == (0 if kind == "udp" else 3)


@pytest.mark.parametrize("kind", ["tcp", "pty"])
def test_up_stands_a_stream_keeps_one_send_and_throws_it_away_in_time(kind):
    one = link(kind)
    one.weather.up_stands = True
    one.send(1.0, b"one", 1.0)
    one.send(1.05, b"two", 1.05)
    assert one.arrived(1.1) == []
    one.weather.up_stands = False
    assert one.arrived(1.15) == [(1.0, b"one")]
    one.weather.up_stands = True
    one.send(4.0, b"lost", 4.0)
    one.arrived(4.25)
    one.weather.up_stands = False
    assert one.arrived(4.3) == []


def test_a_slow_stream_takes_its_time_and_loses_what_does_not_fit():
    pty = link("pty")
    pty.weather.rate_bps = 4000.0  # ten frames of 40 bytes a second
    pty.tell(1.0, numbered(200))
    assert pty.dropped == 200 - 103  # 4 KiB wait, and one is being sent
    assert len(pty.news(2.05)) == 10
    pty.weather.rate_bps = float("inf")
    pty.hurry(2.1)
    assert len(pty.news(2.1)) == 93
