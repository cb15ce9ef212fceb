"""The simulated air as a process: `Ether` behind a UDP socket on loopback (`sitl-mocks ether`).

The datagram format is that of `companion.radio.ether.datagrams`. The process prints "ether on HOST:PORT" when
it listens, and one JSON line with the statistics when it ends (SIGINT, SIGTERM).
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import ipaddress
import json
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass
from select import select

import msgspec
import numpy as np

from companion.errors import ConfigError, PeerDataError
from companion.radio.ether import datagrams as ether_wire
from companion.radio.ether.datagrams import Heard, Join, Leave, Send, Welcome
from sitl_mocks.air import air_settings
from sitl_mocks.air.air_settings import AirSettings, channel_of
from sitl_mocks.air.ether import Ether
from sitl_mocks.channel.air import Channel
from sitl_mocks.signals import end_signals

MAX_CLIENTS = 256
_MAX_READS = 512
"""Largest number of datagrams read between deliveries, so that a flood does not delay deliveries."""
_POLL_S = 0.1
_BUFFER_BYTES = 4 * 1024 * 1024

Endpoint = tuple[str, int]


@dataclass(slots=True)
class Counts:
    """Counters of the server."""

    datagrams: int = 0
    bad_datagrams: int = 0
    """Datagrams that do not have the wire format, or that only the server may send."""
    refused_clients: int = 0
    """Datagrams from endpoints beyond `MAX_CLIENTS`."""
    unsent: int = 0
    """Deliveries that the operating system did not accept."""


@dataclass(slots=True)
class _Client:
    name: str
    last_s: float


class EtherServer:
    """The air on one UDP socket. The caller passes in the time `now_s` (monotonic, s).

    Raises:
        ConfigError: the endpoint is not on loopback, or cannot be bound.
    """

    def __init__(self, host: str, port: int, channel: Channel, rng: np.random.Generator) -> None:
        self.counts = Counts()
        self.ether = Ether(channel, rng)
        self._clients: dict[Endpoint, _Client] = {}
        self._by_name: dict[str, Endpoint] = {}
        self._socket = _bind(host, port)

    @property
    def endpoint(self) -> Endpoint:
        """Host and port on which the server listens."""
        host, port = self._socket.getsockname()[:2]
        return str(host), int(port)

    @property
    def clients(self) -> tuple[str, ...]:
        """Names of the clients on the air."""
        return tuple(self._by_name)

    def wait(self, now_s: float) -> None:
        """Sleep until a datagram arrives, a delivery is due or the poll period is over."""
        due_s = self.ether.next_due_s()
        timeout = _POLL_S if due_s is None else min(max(due_s - now_s, 0.0), _POLL_S)
        select([self._socket], [], [], timeout)

    def step(self, now_s: float) -> None:
        """Read received datagrams, send due deliveries, and remove silent clients."""
        for data, endpoint in self._datagrams():
            self.counts.datagrams += 1
            try:
                self._take(now_s, ether_wire.decode(data), endpoint)
            except PeerDataError:
                self.counts.bad_datagrams += 1
        for delivery in self.ether.due(now_s):
            heard = Heard(delivery.transport, delivery.address, delivery.frame)
            self._send(ether_wire.encode(heard), self._by_name[delivery.receiver])
        silent = [e for e, client in self._clients.items() if now_s - client.last_s > ether_wire.SILENCE_S]
        for endpoint in silent:
            self._drop(endpoint)

    def statistics(self) -> dict[str, object]:
        """Statistics that `sitl-mocks ether` prints at its end. Pairs are named "sender>receiver"."""
        return {
            "clients": list(self.clients),
            "datagrams": self.counts.datagrams,
            "bad_datagrams": self.counts.bad_datagrams,
            "refused_clients": self.counts.refused_clients,
            "unsent": self.counts.unsent,
            "pairs": {f"{a}>{b}": stats.to_dict() for (a, b), stats in self.ether.stats.items()},
        }

    def close(self) -> None:
        """Release the socket."""
        self._socket.close()

    def _datagrams(self) -> Iterator[tuple[bytes, Endpoint]]:
        for _ in range(_MAX_READS):
            try:
                # Read one byte more than allowed, so that an oversized datagram is recognised.
                yield self._socket.recvfrom(ether_wire.MAX_DATAGRAM + 1)
            except BlockingIOError:
                return
            except ConnectionError:
                # An earlier delivery went to a client that has ended. `step` removes silent clients.
                continue

    def _take(self, now_s: float, datagram: ether_wire.Datagram, endpoint: Endpoint) -> None:
        if isinstance(datagram, Heard | Welcome):
            raise PeerDataError("ether datagram: clients may not send this kind")
        if isinstance(datagram, Leave):
            self._drop(endpoint)
            return
        client = self._clients.get(endpoint)
        if client is None:
            if len(self._clients) >= MAX_CLIENTS:
                self.counts.refused_clients += 1
                return
            client = self._enter(now_s, datagram, endpoint)
        client.last_s = now_s
        if isinstance(datagram, Join):
            self._send(ether_wire.encode(Welcome(len(self._clients))), endpoint)
        elif isinstance(datagram, Send):
            self.ether.transmit(
                now_s, client.name, datagram.transport, datagram.frame, address=datagram.address
            )

    def _enter(self, now_s: float, datagram: Join | Send, endpoint: Endpoint) -> _Client:
        name = datagram.name if isinstance(datagram, Join) else str(endpoint[1])
        if name in self._by_name:
            name = f"{name}@{endpoint[1]}"
        if name in self._by_name:
            raise PeerDataError(f"ether client {name!r} is already connected")
        client = self._clients[endpoint] = _Client(name, now_s)
        self._by_name[name] = endpoint
        self.ether.join(name)
        return client

    def _drop(self, endpoint: Endpoint) -> None:
        client = self._clients.pop(endpoint, None)
        if client is not None:
            del self._by_name[client.name]
            self.ether.leave(client.name)

    def _send(self, data: bytes, endpoint: Endpoint) -> None:
        try:
            self._socket.sendto(data, endpoint)
        except OSError:
            # UDP may lose datagrams, so a full buffer or a closed port is no error.
            self.counts.unsent += 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sitl-mocks ether`."""
    parser.description = (
        "Simulates the radio channel between aircraft, over UDP on loopback. Stop it with Ctrl-C."
    )
    parser.epilog = (
        "example: sitl-mocks ether --listen 127.0.0.1:14640 --delay 0.2 0.8 --loss 0.1; "
        "sitl-mocks ether --channel packets --parameters config/channel/standard.toml"
    )
    parser.add_argument(
        "--listen",
        default="127.0.0.1:14640",
        metavar="HOST:PORT",
        help="loopback endpoint (port 0: any free port; default: %(default)s)",
    )
    air_settings.add_arguments(parser)
    interval = parser.add_argument_group("options for --channel interval")
    interval.add_argument(
        "--delay",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="bounds of the uniform message delay (s)",
    )
    interval.add_argument("--loss", type=float, metavar="P", help="probability of loss, 0 to 1")
    interval.add_argument(
        "--range", type=float, metavar="M", help="radio range (m); no message is received beyond it"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="random seed of the channel (default: %(default)s)"
    )


def run(args: argparse.Namespace) -> int:
    """Run `sitl-mocks ether`: serve until SIGINT or SIGTERM.

    Raises:
        ConfigError: a channel parameter is out of range, or the endpoint cannot be bound.
    """
    if args.seed < 0:
        raise ConfigError(f"--seed: {args.seed} is out of range; allowed: 0 or more")
    channel = _channel(args)
    host, port = ether_wire.parse_endpoint(args.listen, "--listen")
    server = EtherServer(host, port, channel, np.random.default_rng(args.seed))
    with contextlib.closing(server), end_signals() as ended:
        print(f"ether on {server.endpoint[0]}:{server.endpoint[1]}", flush=True)
        while not ended:
            server.wait(time.monotonic())
            server.step(time.monotonic())
        server.ether.finish(time.monotonic())
        print(json.dumps(server.statistics()), flush=True)
    return 0


def _channel(args: argparse.Namespace) -> Channel:
    air, parameters = air_settings.with_options(AirSettings(delay_s=(0.0, 0.0)), None, args)
    for option, key in (("loss", "loss"), ("range", "range_m")):
        value = getattr(args, option)
        if value is None:
            continue
        if air.model != "interval":
            raise ConfigError(
                f'--{option}: allowed only with --channel interval; the channel model is "{air.model}"'
            )
        air = msgspec.structs.replace(air, **{key: value})
    return channel_of(air, parameters)


def _bind(host: str, port: int) -> socket.socket:
    address = "127.0.0.1" if host == "localhost" else host
    try:
        loopback = ipaddress.IPv4Address(address).is_loopback
    except ValueError as error:
        raise ConfigError(f"ether endpoint {host}:{port}: {host!r} is not an IPv4 address") from error
    if not loopback:
        # Anyone who can reach the air can inject any aircraft.
        raise ConfigError(f"ether endpoint {host}:{port}: only loopback addresses (127.0.0.1) are allowed")
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        sock.bind((address, port))
    except OSError as error:
        sock.close()
        reason = "already in use" if error.errno == errno.EADDRINUSE else str(error.strerror)
        raise ConfigError(f"ether endpoint {host}:{port}: {reason}") from error
    return sock
