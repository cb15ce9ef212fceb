"""Links lose data rather than deliver it late, wait for it, or end the flight."""

from __future__ import annotations

import errno
import fcntl
import os
import pty
import socket
import struct
import sys
import tty

import pytest

from companion.errors import ConfigError
from companion.runtime.links import LinkTrouble, SerialLink, TcpLink, UdpLink, open_link

MAVLINK = b"\xfd and the rest"
SIOCOUTQNSD = 0x894B
"""Linux: bytes of a TCP socket that were not sent even once."""


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
        made[-1].settimeout(30.0)
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_udpin_adopts_only_who_begins_like_mavlink(listening, sender):
    stray, vehicle = sender(), sender()
    stray.send(b"hello")
    assert listening.receive(0.0) == b""
    vehicle.send(MAVLINK)
    assert listening.receive(0.1) == MAVLINK
    listening.send(b"answer")
    assert vehicle.recv(100) == b"answer"


@pytest.mark.parametrize("magic", [0xFD, 0xFE])
def test_udpin_follows_a_vehicle_to_its_new_port(listening, sender, magic):
    before, after = sender(), sender()
    frame = bytes([magic, 1, 2])
    before.send(frame)
    assert listening.receive(0.0) == frame
    after.send(frame)
    assert listening.receive(2.9) == b"", "the present peer is not silent yet"
    after.send(frame)
    assert listening.receive(3.1) == frame
    listening.send(b"answer")
    assert after.recv(100) == b"answer"


def test_udpin_keeps_a_peer_that_speaks(listening, sender):
    vehicle, stray = sender(), sender()
    for second in range(10):
        vehicle.send(MAVLINK)
        stray.send(b"\xfd stray")
        assert listening.receive(float(second)) == MAVLINK


def test_udpout_hears_its_peer_only(sender, listening, trouble):
    link = UdpLink(("127.0.0.1", listening.port), trouble, listen=False)
    link.send(MAVLINK)
    assert listening.receive(0.0) == MAVLINK
    stray = sender()
    stray.sendto(MAVLINK, ("127.0.0.1", link.port))
    assert link.receive(100.0) == b""
    listening.send(b"answer")
    assert link.receive(100.0) == b"answer"
    link.close()


def test_udp_takes_a_flood_in_portions(listening, sender):
    vehicle = sender()
    for _ in range(100):
        vehicle.send(MAVLINK)
    assert len(listening.receive(0.0)) == 64 * len(MAVLINK)
    assert len(listening.receive(0.0)) == 36 * len(MAVLINK)


class Refusing:
    """A socket whose network refuses everything."""

    def __init__(self, number):
        self.number = number

    def sendto(self, *_):
        raise OSError(self.number, os.strerror(self.number))

    recvfrom = sendto


@pytest.mark.parametrize("number", [errno.EACCES, errno.ENETUNREACH, errno.ENOBUFS, errno.EPERM])
def test_udp_passes_over_what_the_network_refuses(listening, sender, trouble, monkeypatch, number):
    sender().send(MAVLINK)
    listening.receive(0.0)
    with monkeypatch.context() as patched:
        patched.setattr(listening, "_socket", Refusing(number))
        listening.send(b"x")
        assert trouble.errors == 1
        assert listening.receive(0.0) == b""
    assert trouble.errors > 1


@pytest.fixture
def tcp(trouble):
    """A link and the peer's end, which takes little."""
    with socket.socket() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        server.bind(("127.0.0.1", 0))
        server.listen()
        link = TcpLink(server.getsockname(), trouble)
        peer = server.accept()[0]
    peer.settimeout(30.0)
    yield link, peer
    link.close()
    peer.close()


def frames_sent(send, count):
    """Numbered frames of 100 bytes."""
    for number in range(count):
        send(b"%99d\n" % number)


def test_tcp_keeps_frames_whole_and_holds_nothing_old(tcp, trouble, until):
    link, peer = tcp
    frames_sent(link.send, 5_000)
    assert trouble.dropped > 1_000, "most of it had no room"
    taken = b""
    peer.setblocking(False)

    def marker_came():
        nonlocal taken
        link.send(b"%99s\n" % b"marker")
        try:
            taken += peer.recv(65536)
        except BlockingIOError:
            return False
        return b"marker" in taken

    until(marker_came)
    lines = taken.split(b"\n")[:-1]
    assert all(len(line) == 99 for line in lines)
    numbers = [int(line) for line in lines if b"marker" not in line]
    assert numbers == sorted(set(numbers))
    assert len(numbers) + trouble.dropped >= 5_000


@pytest.mark.skipif(sys.platform != "linux", reason="what the kernel holds unsent is told by Linux only")
def test_tcp_gives_the_kernel_nothing_more_while_it_holds_what_is_unsent(tcp, trouble):
    link, _ = tcp
    frames_sent(link.send, 5_000)
    assert trouble.dropped > 1_000
    unsent = struct.unpack("i", fcntl.ioctl(link.fileno(), SIOCOUTQNSD, struct.pack("i", 0)))[0]
    assert unsent <= 100, "more than one frame of those to come would be old"


def test_tcp_says_that_the_peer_is_gone(tcp):
    link, peer = tcp
    peer.sendall(b"last")
    peer.close()
    while (got := link.receive(0.0)) == b"":
        pass
    assert got == b"last"
    with pytest.raises(ConnectionError):
        link.receive(0.0)


@pytest.fixture
def serial_line(trouble):
    """A link on a pseudo-terminal, and the master's end."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    link = SerialLink(os.ttyname(slave), 57600, trouble)
    os.close(slave)
    ends = [master]
    yield link, ends
    link.close()
    for end in ends:
        os.close(end)


def test_serial_does_not_wait_for_a_port_that_takes_nothing(serial_line, trouble):
    link, (master,) = serial_line
    frames_sent(link.send, 5_000)
    assert trouble.dropped > 100
    taken = b""
    os.set_blocking(master, False)
    before = trouble.dropped
    while b"marker" not in taken:
        link.send(b"%99s\n" % b"marker")
        try:
            taken += os.read(master, 65536)
        except BlockingIOError:
            continue
        assert trouble.dropped < before + 100_000
    assert all(len(line) == 99 for line in taken.split(b"\n")[:-1])


def test_serial_drops_what_the_driver_could_send_only_late(serial_line, trouble, monkeypatch):
    link, (master,) = serial_line
    waiting = 57600 // 10
    monkeypatch.setattr(type(link._port), "out_waiting", property(lambda _: waiting))
    link.send(b"late")
    assert trouble.dropped == 1
    waiting = 0
    link.send(b"soon")
    assert os.read(master, 100) == b"soon"


def test_serial_reads_what_is_there_and_says_when_the_device_is_gone(serial_line, until):
    link, ends = serial_line
    assert link.receive(0.0) == b""
    os.write(ends[0], b"abc")
    got = b""

    def arrived():
        nonlocal got
        got += link.receive(0.0)
        return got == b"abc"

    until(arrived)
    os.close(ends.pop())
    with pytest.raises(OSError):
        link.receive(0.0)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("pigeon:a:1", "allowed are"),
        ("udpin:127.0.0.1:70000", "allowed are"),
        ("udpin:127.0.0.1:²", "allowed are"),
        ("tcp:127.0.0.1:" + 5000 * "9", "allowed are"),
        ("serial:/dev/null:²", "allowed are"),
        ("serial:/dev/null:0", "allowed are"),
        ("serial:/dev/null:99999999999999", "allowed are"),
        ("serial:/dev/nothing", "allowed are"),
        ("serial:/dev/nothing:57600", "nothing"),
        ("serial:/dev/null:57600", "serial:/dev/null"),
        ("tcp:a..b:5760", "no host name"),
    ],
)
def test_a_link_that_cannot_be_opened_is_bad_configuration(name, text):
    with pytest.raises(ConfigError, match=text):
        open_link(name)


def test_a_device_that_goes_while_it_is_opened_is_bad_configuration(monkeypatch):
    def gone(*_, **__):
        raise OSError(5, "Input/output error")  # not a SerialException

    monkeypatch.setattr("companion.runtime.links.serial.Serial", gone)
    with pytest.raises(ConfigError, match=r"serial:/dev/x:57600: .*Input/output error"):
        open_link("serial:/dev/x:57600")


def test_nobody_at_a_tcp_port_is_bad_configuration():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(ConfigError, match="nobody accepts connections there"):
        open_link(f"tcp:127.0.0.1:{port}")
