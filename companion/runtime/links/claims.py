"""Claims of the own aircraft and of its link: a second companion on this computer refuses to fly them.

A serial port and a `udpin` address have one user. Two companions on one `udpout` or `tcp` address would both
command the vehicle, as would two that reach one aircraft by different links. Vehicles of different system ids
may share the address of a router. A claim is a socket in Linux's
abstract namespace. It counts for all users, folders and private temporary folders of a computer, and needs no
disk. The kernel releases it when the process ends in any way, so a crash never prevents a restart.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
from collections.abc import Callable, Iterator

from companion.config import EXAMPLE_ID, Config
from companion.errors import ConfigError
from companion.radio.ether.section import EtherRadio

_REFUSALS = 4096
"""Number of refused companions that can learn which process holds a claim; the kernel may allow fewer."""
_CREDENTIALS = struct.Struct("3i")
"""Linux's struct ucred: process, user and group."""


@contextlib.contextmanager
def claimed(config: Config, say: Callable[[str], None]) -> Iterator[None]:
    """Hold the aircraft and its link for as long as the context lasts.

    The aircraft of a simulated air (`ether`) and the identity of the examples are not claimed: several
    simulations may use them at once.

    Args:
        say: told if this computer cannot tell whether another companion runs.

    Raises:
        ConfigError: another process holds one of them. The text names the process.
    """
    with contextlib.ExitStack() as claims:
        try:
            endpoint = _endpoint(config.vehicle.link)
            if endpoint is not None:
                claims.enter_context(
                    _claim(
                        f"link {endpoint} system {config.vehicle.system_id}",
                        f"vehicle.link: {config.vehicle.link}: another companion uses it",
                    )
                )
            name = config.identity.name
            if name != EXAMPLE_ID and not any(isinstance(radio, EtherRadio) for radio in config.radio):
                claims.enter_context(
                    _claim(
                        f"aircraft {name}", f"identity.uas_id: {name}: another companion flies this aircraft"
                    )
                )
        except OSError as error:
            say(f"it is unknown whether another companion flies this aircraft: {error.strerror or error}")
        yield


def _endpoint(link: str) -> str | None:
    """The address of a link that several programs can use at once, in one form; None for other links."""
    kind, _, rest = link.partition(":")
    if kind not in ("udpout", "tcp"):
        return None
    host, _, port = rest.rpartition(":")
    try:
        found = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError):
        return None  # opening the link will report it
    return " ".join((kind, *map(str, found[0][4])))


def _claim(name: str, refusal: str) -> socket.socket:
    """Raises ConfigError if another process holds this claim, OSError if there are no claims here."""
    address = f"\0dmuca-companion {name}"
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        claim.bind(address)
        claim.listen(_REFUSALS)
    except OSError as error:
        claim.close()
        if error.errno != errno.EADDRINUSE:
            raise
        raise ConfigError(f"{refusal} ({_holder(address)}); stop that one first") from error
    return claim


def _holder(address: str) -> str:
    """The process that holds a claim, in words."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.setblocking(False)
            probe.connect(address)
            data = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    except OSError:
        return "its process is unknown"
    process: int = _CREDENTIALS.unpack(data)[0]
    return f"process {process}" if process else "a process of another container"
