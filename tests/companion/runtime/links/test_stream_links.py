"""TCP and serial: frames leave whole and soon, or not at all, whatever the far end does."""

from __future__ import annotations

import fcntl
import os
import pty
import socket
import struct
import sys
import termios
import tty
from types import SimpleNamespace

import pytest

from companion.runtime.links.byte_link import READ_BYTES, LinkTrouble, Received
from companion.runtime.links.serial_link import SerialLink
from companion.runtime.links.tcp_link import TcpLink

linux = pytest.mark.skipif(sys.platform != "linux", reason="what the kernel holds is told by Linux only")
SIOCOUTQNSD = 0x894B
"""Linux: bytes of a TCP socket that were not sent even once."""
BACKOFF_AT = 4
"""Byte offset in Linux's struct tcp_info of how often the probe of a closed window was put off."""
UNHEARD = 1024
LDISC = 4095
"""What the reader's side of a pseudo-terminal holds for good."""


@pytest.fixture
def trouble():
    return LinkTrouble()


@pytest.fixture
def clock(monkeypatch):
    """The links' clock, which stands still but for waiting: the kernel's answers are never late."""
    now = SimpleNamespace(s=1000.0)

    def sleep(seconds):
        now.s += seconds

    monkeypatch.setattr("companion.runtime.clock.now_s", lambda: now.s)
    monkeypatch.setattr("companion.runtime.links.stream_link.time", SimpleNamespace(sleep=sleep))
    return now


@pytest.fixture
def tcp(trouble):
    """A link and the peer's end, which takes little."""
    yield from tcp_pair(trouble, 2048)


@pytest.fixture
def open_tcp(trouble):
    """A link and the peer's end, which takes much."""
    yield from tcp_pair(trouble, 256 * 1024)


def tcp_pair(trouble, buffer):
    with socket.socket() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        server.bind(("127.0.0.1", 0))
        server.listen()
        link = TcpLink(server.getsockname(), trouble)
        peer = server.accept()[0]
    if sys.platform == "linux":
        # The kernel's own limit does not know the tests' clock.
        link._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 0)
    peer.settimeout(60.0)
    yield link, peer
    if link.fileno() >= 0:
        link.close()
    peer.close()


@pytest.fixture
def serial_line(trouble):
    """A link on a pseudo-terminal, and the master's end."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    link = SerialLink(os.ttyname(slave), 57600, trouble)
    os.close(slave)
    ends = [master]
    yield link, ends
    if link._port.is_open:
        link.close()
    for end in ends:
        os.close(end)


def frames_sent(link, count, talk=lambda: None):
    """Numbered frames of 100 bytes, to a far end that talks meanwhile."""
    for number in range(count):
        talk()
        link.receive(0.0)
        link.send(b"%99d\n" % number)


def read(end):
    """All that waits at a master's end."""
    taken = b""
    try:
        while data := os.read(end, 65536):
            taken += data
    except BlockingIOError:
        pass
    return taken


# ---------------------------------------------------------------- TCP


def test_tcp_keeps_frames_whole_and_holds_nothing_old(tcp, trouble, clock, until):
    link, peer = tcp
    frames_sent(link, 5_000, lambda: peer.send(b"."))
    assert trouble.dropped > 1_000, "most of it had no room"
    taken = b""
    peer.setblocking(False)

    def marker_came():
        nonlocal taken
        peer.send(b".")
        link.receive(0.0)
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


@linux
def test_tcp_gives_the_kernel_nothing_more_while_it_holds_what_is_unsent(tcp, trouble, clock):
    link, peer = tcp
    frames_sent(link, 5_000, lambda: peer.send(b"."))
    assert trouble.dropped > 1_000
    unsent = struct.unpack("i", fcntl.ioctl(link.fileno(), SIOCOUTQNSD, struct.pack("i", 0)))[0]
    assert unsent <= 100, "more than one frame of those to come would be old"


def all_until_the_end(peer):
    """What the far end reads, and how the stream ends for it."""
    taken = b""
    try:
        while data := peer.recv(65536):
            taken += data
    except ConnectionResetError as error:
        return taken, type(error)
    return taken, None


@linux
@pytest.mark.parametrize("late", ["look", "discard"])
def test_tcp_is_aborted_with_what_does_not_arrive_and_that_never_leaves(tcp, trouble, clock, late, until):
    link, peer = tcp
    frames_sent(link, 500, lambda: peer.send(b"."))
    given = 100 * (500 - trouble.dropped)
    link.receive(0.0)
    clock.s += 0.19
    link.receive(0.0)
    if late == "look":
        clock.s += 0.02
    with pytest.raises(ConnectionAbortedError):
        link.receive(0.0) if late == "look" else link.discard()
    assert trouble.discarded == (late == "look")
    # The first probe of a window that is not quite closed carries what fits; from the second one on, what is
    # left stays here.
    until(lambda: link._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 8)[BACKOFF_AT])
    here = link._here()
    link.abort()
    taken, end = all_until_the_end(peer)
    assert 0 < here < given
    assert len(taken) == given - here, "what its kernel had taken it reads, and not a byte more"
    assert end is ConnectionResetError


def test_tcp_with_nothing_on_its_way_has_nothing_to_discard(tcp, until):
    link, peer = tcp
    link.send(b"frame")
    assert peer.recv(100) == b"frame"
    until(lambda: link._queued() == 0)
    link.discard()
    link.send(b"more")
    assert peer.recv(100) == b"more"


def test_tcp_lets_the_last_words_leave_when_it_is_closed(tcp):
    link, peer = tcp
    link.send(b"hold")
    link.close()
    assert all_until_the_end(peer) == (b"hold", None)


def test_tcp_says_that_the_peer_is_gone_after_its_last_words(tcp):
    link, peer = tcp
    peer.sendall(b"last")
    peer.close()
    while not (got := link.receive(0.0)).data:
        pass
    assert got.data == b"last"
    with pytest.raises(ConnectionError):
        link.receive(0.0)


def test_a_stream_is_read_in_portions_until_it_is_empty(tcp, until):
    link, peer = tcp
    told = 2 * READ_BYTES + 100
    peer.sendall(told * b".")
    first = link.receive(0.0)
    assert first == Received(READ_BYTES * b".", emptied=False)
    left = told - READ_BYTES

    def emptied():
        nonlocal left
        received = link.receive(0.0)
        left -= len(received.data)
        return left == 0 and received.emptied

    until(emptied)


def test_a_writer_of_single_bytes_does_not_hold_a_call(tcp, monkeypatch):
    link, _ = tcp
    monkeypatch.setattr(link, "_read", lambda _: b".")
    assert link.receive(0.0) == Received(64 * b".", emptied=False)


# ---------------------------------------------------------------- a far end that says nothing


@pytest.fixture(params=["open_tcp", "serial_line"])
def stopped(request):
    """A link, how its far end talks and how it reads."""
    link, end = request.getfixturevalue(request.param)
    if request.param == "open_tcp":
        return link, lambda: end.send(b"."), lambda: end.recv(65536)
    return link, lambda: os.write(end[0], b"."), lambda: read(end[0])


def test_a_far_end_that_says_nothing_finds_few_frames_when_it_goes_on(stopped, trouble, clock, until):
    link, talk, read = stopped
    for number in range(200):
        link.send(b"%64d\n" % number)
    assert trouble.dropped == 200 - UNHEARD // 65
    lines = read().splitlines()
    assert [int(line) for line in lines] == list(range(UNHEARD // 65))
    talk()
    until(lambda: link.receive(0.0).data)
    link.send(b"%64d\n" % 200)
    assert int(read()) == 200


def test_a_far_end_that_waits_to_be_spoken_to_is_spoken_to(stopped, clock, until):
    link, _, read = stopped
    for number in range(200):
        link.send(b"%64d\n" % number)
    read()
    until(lambda: link._queued() == 0)
    clock.s += 4.9
    link.send(b"%64d\n" % 200)
    clock.s += 0.1
    for number in (201, 202):
        link.send(b"%64d\n" % number)
    assert [int(line) for line in read().splitlines()] == [201]


# ---------------------------------------------------------------- serial


def reader_is_full(master):
    """Whether the kernel, which hands over in a thread of its own, has filled the reader's side."""
    waits = fcntl.ioctl(master, termios.FIONREAD, bytes(4))
    return struct.unpack("i", waits) == (LDISC,)


@linux
def test_a_pseudo_terminal_that_talks_and_does_not_read_keeps_little(serial_line, clock, until):
    link, (master,) = serial_line
    frames_sent(link, 50, lambda: os.write(master, b"."))
    until(lambda: reader_is_full(master))
    for number in range(1_000):
        os.write(master, b".")
        link.receive(0.0)
        link.send(b"%99d\n" % number)
        clock.s += 0.05
    taken = read(master)
    assert len(taken) == LDISC + 100, "and without flushing some 16 kB"
    assert taken.endswith(b"%99d\n" % 999)


@linux
def test_what_a_pseudo_terminal_holds_is_discarded_up_to_what_cannot_be(serial_line, clock, until):
    link, (master,) = serial_line
    frames_sent(link, 100, lambda: os.write(master, b"."))
    until(lambda: reader_is_full(master))
    link.discard()
    assert len(read(master)) == LDISC
    link.send(b"new\n")
    assert read(master) == b"new\n"


def test_sends_that_follow_each_other_closely_all_reach_a_reader_that_is_well(serial_line, clock, until):
    link, (master,) = serial_line
    taken = b""

    def came():
        nonlocal taken
        taken += read(master)
        return taken == b"answer\nsetpoint\n" * 10

    for _ in range(10):
        os.write(master, b".")
        link.receive(0.0)
        link.send(b"answer\n")
        link.send(b"setpoint\n")
        taken += read(master)
        clock.s += 0.05
    until(came)


@pytest.fixture
def uart(serial_line, trouble, monkeypatch, clock):
    """A link whose driver says what waits in it; flushing empties it, unless it `keeps`."""
    link, ends = serial_line
    driver = SimpleNamespace(waiting=0, keeps=False, flushed=0, master=ends[0])

    def flush(_fd, queue):
        assert queue == termios.TCOFLUSH
        driver.flushed += 1
        driver.waiting = driver.waiting if driver.keeps else 0

    monkeypatch.setattr(type(link._port), "out_waiting", property(lambda _: driver.waiting))
    monkeypatch.setattr("companion.runtime.links.serial_link.termios.tcflush", flush)
    monkeypatch.setattr(link, "_is_pty", False)
    monkeypatch.setattr(link, "_keeps", False)
    return link, driver


def test_serial_drops_what_the_driver_could_send_only_late(uart, trouble):
    link, driver = uart
    driver.waiting = 57600 // 10 // 10 + 1
    link.send(b"late")
    assert trouble.dropped == 1
    driver.waiting = 57600 // 10 // 10
    link.send(b"soon")
    assert read(driver.master) == b"soon"


def test_serial_throws_away_what_the_line_does_not_carry_and_goes_on(uart, trouble, clock):
    link, driver = uart
    link.send(576 * b".")  # a tenth of a second of line
    driver.waiting = 576
    clock.s += 0.19
    link.receive(0.0)
    assert not trouble.discarded, "it may be on its way"
    clock.s += 0.02
    link.receive(0.0)
    assert (trouble.discarded, driver.flushed, driver.waiting) == (1, 1, 0)
    read(driver.master)
    link.send(b"new")
    assert read(driver.master) == b"new"
    assert trouble.dropped == 0


def test_serial_leaves_a_slow_line_its_time(uart, trouble, clock):
    link, driver = uart
    link.send(2880 * b".")  # half a second of line
    for tick in range(1, 10):
        clock.s += 0.05
        driver.waiting = 2880 - 288 * tick
        link.receive(0.0)
    assert (trouble.discarded, driver.flushed) == (0, 0)


def test_serial_is_lost_where_the_driver_neither_sends_nor_flushes(uart, trouble, clock):
    link, driver = uart
    driver.keeps = True
    link.send(65 * b".")
    driver.waiting = 65
    clock.s += 0.15
    link.receive(0.0)
    assert trouble.discarded == 1
    clock.s += 0.1
    with pytest.raises(OSError, match="neither sends"):
        link.receive(0.0)


def test_serial_reads_what_is_there_and_says_when_the_device_is_gone(serial_line, until):
    link, ends = serial_line
    assert link.receive(0.0) == Received(b"", emptied=True)
    os.write(ends[0], b"abc")
    got = b""

    def arrived():
        nonlocal got
        got += link.receive(0.0).data
        return got == b"abc"

    until(arrived)
    os.close(ends.pop())
    with pytest.raises(OSError):
        link.receive(0.0)


def test_a_serial_port_that_is_aborted_can_be_opened_again(serial_line, trouble, until):
    link, (master,) = serial_line
    name = link._port.name
    held = os.open(name, os.O_RDWR | os.O_NOCTTY)  # or the master would see the end
    link.abort()
    until(lambda: not link._port.is_open)
    again = SerialLink(name, 57600, trouble)
    again.send(b"x")
    assert read(master) == b"x"
    again.close()
    os.close(held)


@linux
@pytest.mark.parametrize(("held_up_s", "leaves"), [(0.05, True), (0.15, False)])
def test_data_does_not_leave_when_the_process_was_held_up_before_it_was_written(
    open_tcp, clock, monkeypatch, trouble, held_up_s, leaves
):
    link, peer = open_tcp
    asked = link._queued

    def queued():
        clock.s += held_up_s
        return asked()

    monkeypatch.setattr(link, "_queued", queued)
    link.send(b"x" * 50)
    assert trouble.dropped == (0 if leaves else 1)
    peer.setblocking(False)
    if leaves:
        assert peer.recv(100) == b"x" * 50
    else:
        with pytest.raises(BlockingIOError):
            peer.recv(100)
