"""The ways to a controller: names, failures in words, and what a lost one says."""

import errno
import os
import select
import socket
import struct

import pytest

from companion.errors import ConfigError
from companion.radio.hci.channel import Channel, open_channel, user_channel_error
from tests.support.waiting import PATIENCE_S, until


def is_lost(channel: Channel) -> bool:
    try:
        channel.receive()
    except OSError:
        return True
    return False


@pytest.mark.parametrize(
    "name",
    ["", "user", "user:", "user:x", "user:-1", "user:65535", "user:hci0", "user:a:0", "uart:/dev/ttyUSB0",
     "uart::115200", "uart:/dev/ttyUSB0:fast", "uart:/dev/ttyUSB0:0", "tcp:localhost", "tcp::1", "tcp:h:0",
     "tcp:h:65536", "tcp:h:" + "9" * 5000, "udp:h:1", "user:²"],
)  # fmt: skip
def test_a_name_that_is_none_is_refused_with_the_forms(name: str) -> None:
    with pytest.raises(ConfigError, match="user:NUMBER, uart:DEVICE:BAUD or tcp:HOST:PORT"):
        open_channel(name)


@pytest.mark.parametrize(
    "name",
    ["tcp:127.0.0.1:1", "tcp:no\0name:5", "tcp:" + "x" * 70 + ".invalid:5", "uart:/dev/no-such-port:115200",
     "uart:/dev/null:115200", "uart:/dev/a\0b:115200", "user:60000"],
)  # fmt: skip
def test_what_is_not_there_is_refused_by_name(name: str) -> None:
    with pytest.raises(ConfigError) as caught:
        open_channel(name)
    assert str(caught.value).startswith(f"radio.channel: {name.partition(':')[0]}:")


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.EPERM, "CAP_NET_ADMIN"),
        (errno.EBUSY, "hciconfig hci3 down"),
        (errno.EUSERS, "another program"),
        (errno.ENODEV, "there is no hci3"),
        (errno.EAFNOSUPPORT, "no Bluetooth"),
        (132, "rfkill unblock bluetooth"),
        (errno.EIO, os.strerror(errno.EIO)),
    ],
)
def test_why_a_user_channel_cannot_be_had(code: int, words: str) -> None:
    text = user_channel_error(3, code)
    assert text.startswith("radio.channel: user:3: ")
    assert words in text


def test_tcp_both_ways_and_lost() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        channel = open_channel(f"tcp:127.0.0.1:{server.getsockname()[1]}")
        peer, _ = server.accept()
        with peer:
            assert channel.receive() == b""
            assert channel.send(b"\x01\x03\x0c\x00") == 4
            assert peer.recv(10) == b"\x01\x03\x0c\x00"
            peer.sendall(b"\x04")
            received: list[bytes] = []
            until(lambda: received.append(channel.receive()) or b"".join(received) == b"\x04")
        until(lambda: is_lost(channel))
        channel.close()


def test_a_peer_that_hangs_up_at_once_is_refused_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        connect = socket.create_connection

        def hung_up_on(where: tuple[str, int], timeout: float) -> socket.socket:
            ours = connect(where, timeout=timeout)
            theirs, _ = server.accept()
            theirs.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            theirs.close()  # a reset
            select.select([ours], [], [], PATIENCE_S)
            return ours

        monkeypatch.setattr(socket, "create_connection", hung_up_on)
        with pytest.raises(ConfigError, match=r"tcp:.*: Transport endpoint is not connected"):
            open_channel(f"tcp:127.0.0.1:{server.getsockname()[1]}")


def test_tcp_takes_what_fits_and_never_blocks() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        channel = open_channel(f"tcp:127.0.0.1:{server.getsockname()[1]}")
        peer, _ = server.accept()
        with peer:
            for _ in range(10_000):
                if channel.send(bytes(65536)) < 65536:
                    break
            else:
                pytest.fail("an endless buffer")
            assert channel.send(bytes(65536)) <= 65536
        channel.close()


def test_uart_both_ways_and_lost() -> None:
    master, slave = os.openpty()
    channel = open_channel(f"uart:{os.ttyname(slave)}:115200")
    os.close(slave)
    assert channel.receive() == b""
    assert channel.send(b"\x01\x03\x0c\x00\x0a\x0d\x11\x13") == 8  # nothing is translated
    assert os.read(master, 100) == b"\x01\x03\x0c\x00\x0a\x0d\x11\x13"
    os.write(master, b"\x04\x0a\x0d\x11\x13\x03")
    received: list[bytes] = []
    until(lambda: received.append(channel.receive()) or b"".join(received) == b"\x04\x0a\x0d\x11\x13\x03")
    os.close(master)
    until(lambda: is_lost(channel))
    channel.close()


def test_a_port_that_another_program_holds_is_refused() -> None:
    master, slave = os.openpty()
    name = f"uart:{os.ttyname(slave)}:115200"
    channel = open_channel(name)
    with pytest.raises(ConfigError, match="uart:"):
        open_channel(name)
    channel.close()
    os.close(slave)
    os.close(master)
