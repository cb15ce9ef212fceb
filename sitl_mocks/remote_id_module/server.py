"""A Remote ID module in real time: `sitl-mocks module`.

The command prints "link" with the link for the companion's configuration, then "ready". At its end it prints
one JSON line with the module's final state. Only this part of the module uses a socket and a clock.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import socket
import time
import tty
from select import select
from typing import Protocol

from companion.errors import ConfigError
from sitl_mocks.remote_id_module.module import PARAMETERS, ModuleOptions, RemoteIdModule
from sitl_mocks.signals import end_signals

_POLL_S = 0.02
_READ_BYTES = 4096
_MAX_READS = 64
_BAUD = 57600


class Port(Protocol):
    """Connection between the companion and the module. No method blocks."""

    @property
    def name(self) -> str:
        """Link for the companion's configuration."""
        ...

    def fileno(self) -> int:
        """File descriptor for `select`."""
        ...

    def read(self) -> bytes:
        """Return the bytes received."""
        ...

    def write(self, data: bytes) -> None:
        """Send as much as possible."""
        ...

    def close(self) -> None:
        """Release the port."""
        ...


class UdpPort:
    """One UDP socket. Answers go to the peer that sent the latest datagram."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peer: tuple[str, int] | None = None
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise ConfigError(f"--link: udpin:{host}:{port}: {error.strerror or error}") from error

    @property
    def name(self) -> str:
        """`udpout:HOST:PORT`."""
        host, port = self._socket.getsockname()
        return f"udpout:{host}:{port}"

    def fileno(self) -> int:
        """File descriptor for `select`."""
        return self._socket.fileno()

    def read(self) -> bytes:
        """Return the bytes received."""
        parts = []
        for _ in range(_MAX_READS):
            try:
                data, self._peer = self._socket.recvfrom(_READ_BYTES)
            except BlockingIOError:
                break
            except ConnectionError:
                continue
            parts.append(data)
        return b"".join(parts)

    def write(self, data: bytes) -> None:
        """Send to the latest peer, whether it is still present or not."""
        if self._peer is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(data, self._peer)

    def close(self) -> None:
        """Release the socket."""
        self._socket.close()


class SerialPort:
    """A pseudo terminal, which is a serial port to the companion."""

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)

    @property
    def name(self) -> str:
        """`serial:DEVICE:BAUD`."""
        return f"serial:{os.ttyname(self._slave)}:{_BAUD}"

    def fileno(self) -> int:
        """File descriptor for `select`."""
        return self._master

    def read(self) -> bytes:
        """Return the bytes received."""
        try:
            return os.read(self._master, _READ_BYTES)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Send to the terminal. Bytes that do not fit its buffer are lost, as on a wire without a reader."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)

    def close(self) -> None:
        """Release both ends."""
        os.close(self._master)
        os.close(self._slave)


def open_port(spec: str) -> Port:
    """Open "serial" or "udpin:HOST:PORT". Raises ConfigError."""
    if spec == "serial":
        return SerialPort()
    kind, _, rest = spec.partition(":")
    host, _, port = rest.rpartition(":")
    if kind != "udpin" or not host or not (port.isascii() and port.isdigit()) or int(port) > 65535:
        raise ConfigError(f"--link: {spec!r}; allowed: serial, udpin:HOST:PORT")
    return UdpPort(host, int(port))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sitl-mocks module`."""
    parser.description = (
        "Simulates a Remote ID module with ArduRemoteID firmware, in real time. Stop it with Ctrl-C."
    )
    parser.epilog = "example: sitl-mocks module --link serial --param WIFI_BCN_RATE=1 --noise"
    add = parser.add_argument
    add(
        "--link",
        default="udpin:127.0.0.1:0",
        metavar="KIND",
        help="serial (a pseudo-terminal) or udpin:HOST:PORT (port 0: any free port; default: %(default)s)",
    )
    add(
        "--param",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="value of a parameter in its flash memory; may be repeated",
    )
    add(
        "--boot",
        type=float,
        default=1.0,
        metavar="S",
        help="silence after the start (s; default: %(default)g)",
    )
    add("--noise", action="store_true", help="send log lines between the frames, as the firmware does")


def options_of(args: argparse.Namespace) -> ModuleOptions:
    """Make the module options from the arguments. Raises ConfigError."""
    params = {}
    for text in args.param:
        name, _, value = text.partition("=")
        if name not in PARAMETERS:
            raise ConfigError(f"--param: {name!r}; allowed: {', '.join(PARAMETERS)}")
        try:
            params[name] = float(value)
        except ValueError as error:
            raise ConfigError(f"--param: {text!r}: {value!r} is not a number") from error
    return ModuleOptions(params=params, boot_s=args.boot, noise=args.noise)


def run(args: argparse.Namespace) -> int:
    """Run `sitl-mocks module` until SIGINT or SIGTERM.

    Raises:
        ConfigError: an option is out of range, or a link cannot be opened.
    """
    options = options_of(args)
    with end_signals() as ended, contextlib.closing(open_port(args.link)) as port:
        print(f"link {port.name}", flush=True)
        print("ready", flush=True)
        start_s = time.monotonic()
        module = RemoteIdModule(options)
        while not ended:
            select([port], [], [], _POLL_S)
            now_s = time.monotonic() - start_s
            module.receive(port.read(), now_s)
            port.write(module.drain())
        print(json.dumps(_left(module, time.monotonic() - start_s)), flush=True)
    return 0


def _left(module: RemoteIdModule, now_s: float) -> dict[str, object]:
    return {
        "refusal": module.refusal(now_s),
        "received": dict(module.received),
        "param_sets": module.param_sets,
        "catastrophes": module.catastrophes,
        "on_air": {
            entry.transport: [type(message).__name__ for message in entry.messages]
            for entry in module.on_air(now_s)
        },
    }
