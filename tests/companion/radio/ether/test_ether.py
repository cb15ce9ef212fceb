"""The simulated radio against a hand-held air: join, send, hear, silence, hostile datagrams."""

import socket
from collections.abc import Iterator

import pytest

from companion.errors import ConfigError
from companion.radio.ether import datagrams
from companion.radio.ether.datagrams import Heard, Join, Leave, Send, Welcome
from companion.radio.ether.ether_radio import EtherTransport
from companion.radio.frames_io import FrameSender
from companion.remote_id.messages import Location, SelfId

ADDRESS = "c2:01:02:03:04:05"
OTHER = "c2:00:00:00:00:01"
MESSAGES = (SelfId(description_type=0, text="survey"), Location(lat_deg=47.5, lon_deg=8.5))


@pytest.fixture
def air() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(60.0)
        yield sock


@pytest.fixture
def radio(air: socket.socket) -> Iterator[EtherTransport]:
    transport = EtherTransport(f"127.0.0.1:{air.getsockname()[1]}", "a", ADDRESS)
    yield transport
    transport.close()


def received(air: socket.socket) -> datagrams.Datagram:
    return datagrams.decode(air.recv(2000))


def test_it_joins_at_once_and_says_goodbye(air: socket.socket) -> None:
    radio = EtherTransport(f"127.0.0.1:{air.getsockname()[1]}", "aircraft 1", ADDRESS)
    assert received(air) == Join("aircraft 1")
    radio.close()
    assert received(air) == Leave()


def test_it_stays_joined_by_repeating(air: socket.socket, radio: EtherTransport) -> None:
    received(air)
    for now in (0.0, 1.0, 1.9, 2.0, 3.9, 4.0):
        radio.heard(now)
    assert [received(air) for _ in range(3)] == [Join("a")] * 3
    air.setblocking(False)
    with pytest.raises(BlockingIOError):
        air.recv(2000)


@pytest.mark.parametrize(("transport", "frames"), [("ble4", 2), ("ble5", 1), ("wifi", 1), ("nan", 1)])
def test_it_sends_the_frames_of_the_transport(
    air: socket.socket, radio: EtherTransport, transport: str, frames: int
) -> None:
    received(air)
    radio.broadcast(transport, MESSAGES, 0.0)
    assert received(air) == Join("a")
    expected = FrameSender(ADDRESS).frames(transport, MESSAGES)
    assert [received(air) for _ in range(frames)] == [Send(transport, ADDRESS, f) for f in expected]
    assert radio.health(0.0).frames_sent == frames


def test_it_hears_frames_and_counts_what_is_none(air: socket.socket, radio: EtherTransport) -> None:
    client = air.recvfrom(2000)[1]
    (good,) = FrameSender(OTHER).frames("ble5", MESSAGES)
    for data in (
        b"",
        b"junk",
        datagrams.encode(Join("not for a client")),
        datagrams.encode(Heard("ble5", OTHER, good[:-30])),
        b"EA\x01\x04" + b"\xff" * 1500,
        datagrams.encode(Heard("ble5", OTHER, good)),
    ):
        air.sendto(data, client)
    events = radio.heard(0.0)
    assert [len(event.messages) for event in events] == [2]
    assert (events[-1].transport, events[-1].address) == ("ble5", OTHER)
    health = radio.health(0.0)
    assert (health.frames_heard, health.bad_frames) == (1, 5)
    assert radio.heard(0.0) == []


def test_health_is_ok_only_while_the_air_answers(air: socket.socket, radio: EtherTransport) -> None:
    client = air.recvfrom(2000)[1]
    radio.heard(0.0)
    assert not radio.health(0.0).ok
    assert "no answer yet" in radio.health(0.0).text
    assert radio.health(0.0).can_send == frozenset()
    air.sendto(datagrams.encode(Welcome(2)), client)
    radio.heard(1.0)
    assert radio.health(1.0).ok
    for second in range(2, 8):
        radio.heard(float(second))
    assert radio.health(7.0).ok
    assert radio.health(7.0).can_send == {"ble4", "ble5", "wifi", "nan"}
    assert not radio.health(7.1).ok
    assert radio.health(7.1).can_send == frozenset()
    assert "silent for 6 s" in radio.health(7.1).text
    assert radio.hears == {"ble4", "ble5", "wifi", "nan"}
    radio.heard(7.1)
    assert radio.hears == frozenset()


def test_a_dead_air_is_no_exception(radio: EtherTransport, air: socket.socket) -> None:
    air.close()
    for now in range(5):
        radio.broadcast("wifi", MESSAGES, float(now))
        assert radio.heard(float(now)) == []
    health = radio.health(5.0)
    assert not health.ok
    assert "could not be sent" in health.text
    assert health.frames_sent < 5


def test_an_unknown_transport_is_refused(radio: EtherTransport) -> None:
    with pytest.raises(ValueError, match="smoke"):
        radio.broadcast("smoke", MESSAGES, 0.0)


@pytest.mark.parametrize("endpoint", ["127.0.0.1", "127.0.0.1:0", "host.invalid:5", "\0:5"])
def test_an_endpoint_that_is_none_names_the_key(endpoint: str) -> None:
    with pytest.raises(ConfigError, match=r"radio\.address"):
        EtherTransport(endpoint, "a", ADDRESS)


def test_a_pause_of_our_own_is_no_silence_of_the_air(air: socket.socket, radio: EtherTransport) -> None:
    client = air.recvfrom(2000)[1]
    air.sendto(datagrams.encode(Welcome(2)), client)
    radio.heard(0.0)
    radio.heard(20.0)
    assert radio.health(20.0).ok
    for tenth in range(200, 300):
        radio.heard(tenth / 10.0)
    assert not radio.health(30.0).ok
