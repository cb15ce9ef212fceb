"""Sockets of the served mock vehicle: each turns datagrams or a byte stream into links of the vehicle.

`udpout` sends to a fixed peer. `udpin` and `tcpin` open one link for every peer that connects. Nothing here
blocks or reads a clock.
"""

from __future__ import annotations

import contextlib
import errno
import itertools
import socket
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Protocol

from companion.errors import ConfigError
from sitl_mocks.vehicle.mock_vehicle import MockVehicle

MAX_PEERS = 16
PEER_SILENCE_S = 60.0
_READ_BYTES = 65536
_MAX_READS = 256
_MAX_UNSENT_BYTES = 1 << 20
_LOOPBACK = "127.0.0.1"
_UDP_PAYLOAD = 1400

Address = tuple[str, int]


@dataclass(slots=True)
class Airframe:
    """The vehicle that all ports share, and the counter for its link numbers."""

    vehicle: MockVehicle
    numbers: Iterator[int] = field(default_factory=itertools.count)

    def open(self) -> int:
        """Open a fresh link and return its number."""
        number = next(self.numbers)
        self.vehicle.open_link(number)
        return number


class Port(Protocol):
    """One endpoint through which peers reach the vehicle."""

    @property
    def name(self) -> str:
        """`kind:host:port` with the actual port."""

    def sockets(self) -> list[socket.socket]:
        """All sockets to wait on for reading."""

    def receive(self, now_s: float) -> None:
        """Read all waiting bytes and pass them to the vehicle."""

    def send(self) -> None:
        """Send the vehicle's pending bytes for this port's links."""

    def reboot(self) -> None:
        """React to a restart of the vehicle."""

    def close(self) -> None:
        """Release the sockets."""


class UdpOut:
    """Sends to one peer and receives only from that peer."""

    def __init__(self, airframe: Airframe, address: Address) -> None:
        self._vehicle = airframe.vehicle
        self._link = airframe.open()
        self._peer = address
        self._socket = _datagram_socket()
        bind = _LOOPBACK if address[0].startswith("127.") else ""
        _bind(self._socket, (bind, 0), "udpout")

    @property
    def name(self) -> str:
        """`udpout:HOST:PORT` of the peer."""
        return f"udpout:{self._peer[0]}:{self._peer[1]}"

    def sockets(self) -> list[socket.socket]:
        """The one UDP socket."""
        return [self._socket]

    def receive(self, now_s: float) -> None:
        """Read the peer's datagrams and drop those of other senders."""
        for data, address in _datagrams(self._socket):
            if address == self._peer:
                self._vehicle.receive(data, now_s, self._link)

    def send(self) -> None:
        """Send to the peer, whether it is present or not."""
        _send_datagrams(self._socket, self._vehicle.drain(self._link), self._peer)

    def reboot(self) -> None:
        """Do nothing: a restart is not visible on UDP."""

    def close(self) -> None:
        """Release the socket."""
        self._socket.close()


class UdpIn:
    """Waits for peers. Each peer gets a link, which is closed after PEER_SILENCE_S of silence."""

    def __init__(self, airframe: Airframe, address: Address) -> None:
        self._airframe = airframe
        self._links: dict[Address, int] = {}
        self._heard: dict[Address, float] = {}
        self._socket = _datagram_socket()
        _bind(self._socket, address, "udpin")

    @property
    def name(self) -> str:
        """Address on which the port listens."""
        host, port = self._socket.getsockname()
        return f"udpin:{host}:{port}"

    def sockets(self) -> list[socket.socket]:
        """The one UDP socket."""
        return [self._socket]

    def receive(self, now_s: float) -> None:
        """Read datagrams. A new peer gets a link as long as there are fewer than MAX_PEERS."""
        for data, address in _datagrams(self._socket):
            if address not in self._links:
                if len(self._links) >= MAX_PEERS:
                    continue
                self._links[address] = self._airframe.open()
            self._heard[address] = now_s
            self._airframe.vehicle.receive(data, now_s, self._links[address])
        for address in [a for a, at in self._heard.items() if now_s - at > PEER_SILENCE_S]:
            del self._heard[address]
            self._airframe.vehicle.close_link(self._links.pop(address))

    def send(self) -> None:
        """Send to every peer."""
        for address, link in self._links.items():
            _send_datagrams(self._socket, self._airframe.vehicle.drain(link), address)

    def reboot(self) -> None:
        """Do nothing: a restart is not visible on UDP."""

    def close(self) -> None:
        """Release the socket."""
        self._socket.close()


@dataclass(slots=True)
class _Client:
    link: int
    unsent: bytearray = field(default_factory=bytearray)


class TcpIn:
    """Accepts clients; each gets a link.

    Clients that do not read, and all clients at a reboot, are disconnected.
    """

    def __init__(self, airframe: Airframe, address: Address) -> None:
        self._airframe = airframe
        self._clients: dict[socket.socket, _Client] = {}
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._socket.setblocking(False)
        _bind(self._socket, address, "tcpin")
        self._socket.listen()

    @property
    def name(self) -> str:
        """Address on which the port listens."""
        host, port = self._socket.getsockname()
        return f"tcpin:{host}:{port}"

    def sockets(self) -> list[socket.socket]:
        """The listening socket and the clients' sockets."""
        return [self._socket, *self._clients]

    def receive(self, now_s: float) -> None:
        """Accept waiting clients and read from all clients."""
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while True:
                client, _ = self._socket.accept()
                if len(self._clients) >= MAX_PEERS:
                    client.close()
                    continue
                client.setblocking(False)
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._clients[client] = _Client(self._airframe.open())
        for client, state in list(self._clients.items()):
            try:
                data = client.recv(_READ_BYTES)
            except BlockingIOError:
                continue
            except OSError:
                data = b""
            if data:
                self._airframe.vehicle.receive(data, now_s, state.link)
            else:
                self._drop(client)

    def send(self) -> None:
        """Send to every client as much as its socket accepts."""
        for client, state in list(self._clients.items()):
            state.unsent += self._airframe.vehicle.drain(state.link)
            if not state.unsent:
                continue
            try:
                del state.unsent[: client.send(state.unsent)]
            except BlockingIOError:
                if len(state.unsent) > _MAX_UNSENT_BYTES:
                    self._drop(client)
            except OSError:
                self._drop(client)

    def reboot(self) -> None:
        """Close all connections, as the autopilot does when it restarts."""
        for client in list(self._clients):
            self._drop(client)

    def close(self) -> None:
        """Release every socket."""
        self.reboot()
        self._socket.close()

    def _drop(self, client: socket.socket) -> None:
        self._airframe.vehicle.close_link(self._clients.pop(client).link)
        client.close()


def open_port(spec: str, airframe: Airframe) -> Port:
    """Open `udpout:HOST:PORT`, `udpin:HOST:PORT` or `tcpin:HOST:PORT`. An empty host means loopback.

    Raises:
        ConfigError: `spec` is malformed, its host is unknown, or its address cannot be bound.
    """
    kind, _, rest = spec.partition(":")
    host, _, port_text = rest.rpartition(":")
    if kind not in ("udpout", "udpin", "tcpin") or not port_text.isascii() or not port_text.isdigit():
        raise ConfigError(f"link {spec!r}; allowed: udpout:HOST:PORT, udpin:HOST:PORT, tcpin:HOST:PORT")
    port = int(port_text)
    if port > 65535 or (kind == "udpout" and port == 0):
        raise ConfigError(
            f"link {spec!r}: port {port} is out of range; allowed: 0 to 65535 (udpout: 1 to 65535)"
        )
    address = (_resolve(host or _LOOPBACK, spec), port)
    if kind == "udpout":
        return UdpOut(airframe, address)
    return UdpIn(airframe, address) if kind == "udpin" else TcpIn(airframe, address)


def _resolve(host: str, spec: str) -> str:
    try:
        return socket.gethostbyname(host)
    except (OSError, UnicodeError) as error:
        raise ConfigError(f"link {spec!r}: host {host!r} is unknown ({error})") from error


def _datagram_socket() -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    return sock


def _bind(sock: socket.socket, address: Address, kind: str) -> None:
    try:
        sock.bind(address)
    except OSError as error:
        sock.close()
        reason = "already in use" if error.errno == errno.EADDRINUSE else str(error.strerror)
        raise ConfigError(f"link {kind}:{address[0]}:{address[1]}: {reason}") from error


def _datagrams(sock: socket.socket) -> Iterator[tuple[bytes, Address]]:
    for _ in range(_MAX_READS):
        try:
            yield sock.recvfrom(_READ_BYTES)
        except BlockingIOError:
            return
        except ConnectionError:
            # A host reported that the port of an earlier datagram is closed.
            continue


def _send_datagrams(sock: socket.socket, data: bytes, address: Address) -> None:
    for at in range(0, len(data), _UDP_PAYLOAD):
        # UDP may lose datagrams: a full buffer or an absent network is no error. Frames may span datagrams.
        with contextlib.suppress(OSError):
            sock.sendto(data[at : at + _UDP_PAYLOAD], address)
