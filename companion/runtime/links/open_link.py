"""Opens the link to the autopilot (UDP, TCP or serial, non-blocking) that a string describes."""

from __future__ import annotations

import errno

from companion.errors import ConfigError
from companion.runtime.links.byte_link import Link, LinkTrouble
from companion.runtime.links.serial_link import SerialLink
from companion.runtime.links.tcp_link import TcpLink
from companion.runtime.links.udp_link import UdpLink

_FORMS = "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD"
_NOT_REACHED = {
    errno.ECONNREFUSED: "no program accepts connections there; first start the program at the other end",
    errno.EADDRNOTAVAIL: "this computer has no such address; use 0.0.0.0 to listen on all of its addresses",
    errno.EACCES: "this user may not open this port; ports from 1024 on are open to all users",
}


def open_link(name: str, trouble: LinkTrouble | None = None, key: str = "vehicle.link") -> Link:
    """Open the link that `name` describes.

    Args:
        name: link name, in the form of the configuration key vehicle.link.
        trouble: counts what goes wrong on the link.
        key: configuration key that holds the name, for error texts.

    Raises:
        ConfigError: `name` is not a link name, the port is in use, or the device or peer cannot be reached.
    """
    trouble = LinkTrouble() if trouble is None else trouble
    kind, _, rest = name.partition(":")
    if kind == "serial":
        device, _, baud = rest.rpartition(":")
        if not device or not _is_number(baud) or int(baud) == 0:
            raise ConfigError(f"{key}: {name!r}: allowed: {_FORMS}")
        return SerialLink(device, int(baud), trouble, key)
    host, _, port = rest.rpartition(":")
    if kind not in ("udpin", "udpout", "tcp") or not host or not _is_number(port) or int(port) > 65535:
        raise ConfigError(f"{key}: {name!r}: allowed: {_FORMS}")
    address = (host.strip("[]"), int(port))
    try:
        if kind == "tcp":
            return TcpLink(address, trouble)
        return UdpLink(address, trouble, listen=kind == "udpin")
    except UnicodeError as error:
        raise ConfigError(f"{key}: {name!r}: {host!r} is not a host name") from error
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise ConfigError(
                f"{key}: {name}: port {port} is in use by another program; close it or choose another"
            ) from error
        words = _NOT_REACHED.get(error.errno or 0, error.strerror or error)
        raise ConfigError(f"{key}: {name}: {words}") from error


def _is_number(text: str) -> bool:
    """Whether the text is one to nine ASCII digits, which is enough for every port and baud rate."""
    return text.isascii() and text.isdigit() and len(text) <= 9
