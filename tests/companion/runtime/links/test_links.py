"""Links lose data rather than deliver it late, wait for it, or end the flight: UDP, and names of links."""

from __future__ import annotations

import errno
import os
import socket
import sys

import pytest

from companion.autopilot.wire import MavlinkWriter
from companion.errors import ConfigError
from companion.runtime.links.byte_link import READ_BYTES, LinkTrouble, Received
from companion.runtime.links.open_link import open_link
from companion.runtime.links.udp_link import UdpLink

MAVLINK = b"\xfd and the rest"


def heartbeat(system=1, component=1, mav_type=2, autopilot=3):
    writer = MavlinkWriter(system, component)
    return writer.pack(writer.encoder.heartbeat_encode(mav_type, autopilot, 1, 4, 4))


@pytest.fixture
def trouble():
    return LinkTrouble()


@pytest.fixture
def listening(trouble):
    link = UdpLink(("127.0.0.1", 0), trouble, listen=True)
    yield link
    link.close()


@pytest.fixture
def sender(listening):
    """Make sockets that send to the listening link."""
    made = []

    def make():
        made.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        made[-1].connect(("127.0.0.1", listening.port))
        made[-1].settimeout(60.0)
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_udpin_adopts_only_who_begins_like_mavlink(listening, sender):
    stray, vehicle = sender(), sender()
    stray.send(b"hello")
    assert listening.receive(0.0).data == b""
    vehicle.send(MAVLINK)
    assert listening.receive(0.1).data == MAVLINK
    listening.send(b"answer")
    assert vehicle.recv(100) == b"answer"


@pytest.mark.parametrize("magic", [0xFD, 0xFE])
def test_udpin_follows_a_vehicle_to_its_new_port(listening, sender, magic):
    before, after = sender(), sender()
    frame = bytes([magic, 1, 2])
    before.send(frame)
    assert listening.receive(0.0).data == frame
    after.send(frame)
    assert listening.receive(2.9).data == b"", "the present peer is not silent yet"
    after.send(frame)
    assert listening.receive(3.1).data == frame
    listening.send(b"answer")
    assert after.recv(100) == b"answer"


def test_udpin_keeps_a_peer_that_speaks(listening, sender):
    vehicle, stray = sender(), sender()
    for second in range(10):
        vehicle.send(MAVLINK)
        stray.send(b"\xfd stray")
        assert listening.receive(float(second)).data == MAVLINK


def test_udpin_lets_only_an_autopilot_take_the_place_of_one(listening, sender):
    """A ground station's heartbeat in a pause of the vehicle would keep the vehicle out from then on."""
    vehicle, station, anew = sender(), sender(), sender()
    vehicle.send(heartbeat())
    assert listening.receive(0.0).data == heartbeat()
    for data in (heartbeat(255, 190, mav_type=6, autopilot=8), heartbeat(1, 1, mav_type=6), MAVLINK):
        station.send(data)
        assert listening.receive(4.0).data == b""
    vehicle.send(MAVLINK)
    assert listening.receive(5.0).data == MAVLINK
    anew.send(heartbeat())
    assert listening.receive(6.0).data == b"", "the present peer is not silent yet"
    anew.send(heartbeat())
    assert listening.receive(9.0).data == heartbeat()


def test_udpout_hears_its_peer_only(sender, listening, trouble):
    link = UdpLink(("127.0.0.1", listening.port), trouble, listen=False)
    link.send(MAVLINK)
    assert listening.receive(0.0).data == MAVLINK
    stray = sender()
    stray.sendto(MAVLINK, ("127.0.0.1", link.port))
    assert link.receive(100.0).data == b""
    listening.send(b"answer")
    assert link.receive(100.0).data == b"answer"
    link.close()


def test_udp_takes_a_flood_in_portions_that_strangers_count_in(listening, sender):
    vehicle, stranger = sender(), sender()
    for _ in range(150):
        vehicle.send(MAVLINK)
        stranger.send(MAVLINK)
    assert listening.receive(0.0) == Received(128 * MAVLINK, emptied=False)
    assert listening.receive(0.0) == Received(22 * MAVLINK, emptied=True)
    assert listening.receive(0.0) == Received(b"", emptied=True)


def test_udp_takes_no_more_bytes_than_the_parser_can_do_with(listening, sender):
    vehicle = sender()
    large = b"\xfd" * 1400
    for _ in range(20):
        vehicle.send(large)
    portion = -(-READ_BYTES // len(large))
    assert listening.receive(0.0) == Received(portion * large, emptied=False)
    assert listening.receive(0.0) == Received((20 - portion) * large, emptied=True)


class Flood:
    """A socket that is never empty, of two senders in turn."""

    def __init__(self):
        self.reads = 0

    def recvfrom(self, _):
        self.reads += 1
        return MAVLINK, ("127.0.0.1", self.reads % 2)


def test_a_flood_that_never_ends_does_not_hold_a_call(listening, trouble, monkeypatch):
    flood = Flood()
    with monkeypatch.context() as patched:
        patched.setattr(listening, "_socket", flood)
        assert listening.receive(0.0) == Received(128 * MAVLINK, emptied=False)
    assert flood.reads == 256
    assert trouble.left_out == 128


def test_after_a_stall_all_that_waited_is_had_by_reading_until_empty(listening, sender):
    """They are more than a socket of the usual size has room for."""
    vehicle = sender()
    for number in range(500):
        vehicle.send(MAVLINK + b"%d\n" % number)
    data, received = b"", Received(emptied=False)
    while not received.emptied:
        received = listening.receive(0.0)
        data += received.data
    assert data.split(b"\n")[-2] == MAVLINK + b"499"


def test_udp_sends_nothing_behind_what_has_not_left(listening, sender, trouble, monkeypatch):
    vehicle, queued, now = sender(), 0, 1000.0
    vehicle.send(MAVLINK)
    listening.receive(0.0)
    monkeypatch.setattr(UdpLink, "_queued", lambda _: queued)
    monkeypatch.setattr("companion.runtime.clock.now_s", lambda: now)
    listening.send(b"1")
    queued, now = 768, 1000.05
    listening.send(b"2")  # the first is on its way, for all we know
    now = 1000.15
    listening.send(b"3")
    assert trouble.dropped == 1
    queued = 0
    listening.send(b"4")
    assert [vehicle.recv(100) for _ in range(3)] == [b"1", b"2", b"4"]


@pytest.mark.parametrize(("held_up_s", "leaves"), [(0.05, True), (0.15, False)])
def test_udp_sends_nothing_when_the_process_was_held_up_before_it(
    listening, sender, trouble, monkeypatch, held_up_s, leaves
):
    vehicle = sender()
    vehicle.send(MAVLINK)
    listening.receive(0.0)
    now = [1000.0]
    monkeypatch.setattr("companion.runtime.clock.now_s", lambda: now[0])

    def queued():
        now[0] += held_up_s
        return 0

    monkeypatch.setattr(listening, "_queued", queued)
    listening.send(b"held up")
    assert trouble.dropped == (0 if leaves else 1)
    monkeypatch.setattr(listening, "_queued", lambda: 0)
    listening.send(b"in time")
    assert vehicle.recv(100) == (b"held up" if leaves else b"in time")


@pytest.mark.skipif(sys.platform != "linux", reason="told by Linux only")
def test_udp_asks_the_kernel_what_has_not_left(listening, sender):
    sender().send(MAVLINK)
    listening.receive(0.0)
    listening.send(b"x")
    assert listening._queued() == 0, "the loopback takes all at once"


class Refusing:
    """A socket whose network refuses everything."""

    def __init__(self, number, descriptor):
        self.number = number
        self.fileno = lambda: descriptor

    def sendto(self, *_):
        raise OSError(self.number, os.strerror(self.number))

    recvfrom = sendto


@pytest.mark.parametrize("number", [errno.EACCES, errno.ENETUNREACH, errno.ENOBUFS, errno.EPERM])
def test_udp_passes_over_what_the_network_refuses(listening, sender, trouble, monkeypatch, number):
    sender().send(MAVLINK)
    listening.receive(0.0)
    with monkeypatch.context() as patched:
        patched.setattr(listening, "_socket", Refusing(number, listening.fileno()))
        listening.send(b"x")
        assert trouble.errors == 1
        assert listening.receive(0.0) == Received(b"", emptied=False)
    assert trouble.errors > 1


def test_udp_drops_what_a_full_socket_does_not_take(listening, sender, trouble, monkeypatch):
    sender().send(MAVLINK)
    listening.receive(0.0)
    with monkeypatch.context() as patched:
        patched.setattr(listening, "_socket", Refusing(errno.EAGAIN, listening.fileno()))
        listening.send(b"x")
    assert (trouble.dropped, trouble.errors) == (1, 0)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("pigeon:a:1", "allowed:"),
        ("udpin:127.0.0.1:70000", "allowed:"),
        ("udpin:127.0.0.1:²", "allowed:"),
        ("tcp:127.0.0.1:" + 5000 * "9", "allowed:"),
        ("serial:/dev/null:²", "allowed:"),
        ("serial:/dev/null:0", "allowed:"),
        ("serial:/dev/null:99999999999999", "allowed:"),
        ("serial:/dev/nothing", "allowed:"),
        ("serial:/dev/nothing:57600", "nothing"),
        ("serial:/dev/null:57600", "serial:/dev/null"),
        ("tcp:a..b:5760", "not a host name"),
    ],
)
def test_a_link_that_cannot_be_opened_is_bad_configuration(name, text):
    with pytest.raises(ConfigError, match=text):
        open_link(name)


def test_a_device_that_goes_while_it_is_opened_is_bad_configuration(monkeypatch):
    def gone(*_, **__):
        raise OSError(5, "Input/output error")  # not a SerialException

    monkeypatch.setattr("companion.runtime.links.serial_link.serial.Serial", gone)
    with pytest.raises(ConfigError, match=r"serial:/dev/x:57600: .*Input/output error"):
        open_link("serial:/dev/x:57600")


def test_nobody_at_a_tcp_port_is_bad_configuration():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(ConfigError, match="no program accepts connections there"):
        open_link(f"tcp:127.0.0.1:{port}")
