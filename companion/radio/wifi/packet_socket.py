"""A raw socket on a monitor interface (packet(7)), for 802.11 frames with radiotap header in both directions.

Opening checks whether the interface supports this, and reports problems in words that say what to do. The
interface is checked again once a second, because a socket sends into one that another program has put into
another mode, or on another channel, without any error. An interface that vanishes or goes down in flight is
opened again when it is back.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import socket
import struct
from pathlib import Path
from typing import Final

from companion.errors import ConfigError

_ARPHRD_ETHER: Final = 1
_ARPHRD_RADIOTAP: Final = 803
_IFF_UP: Final = 1
_SIOCGIFFLAGS: Final = 0x8913
_SIOCGIFHWADDR: Final = 0x8927
_SIOCGIWFREQ: Final = 0x8B05
_IFREQ_SIZE: Final = 40
_SO_ATTACH_FILTER: Final = 26
_SOL_PACKET: Final = 263
_PACKET_STATISTICS: Final = 6
_ETH_P_ALL: Final = 3

_SYSFS: Final = Path("/sys/class/net")

_MAX_FRAME: Final = 1 << 16
_MAX_READS: Final = 256
"""Maximum number of frames read per call, so that a busy channel does not hold up the loop."""
_MAX_BYTES: Final = 1 << 16
"""No more frames are read after this many bytes. A forged frame of 2,300 bytes holds a thousand elements and
takes forty times as long to read as an ordinary one."""
_RECEIVE_BUFFER: Final = 1 << 20
_LOOK_S: Final = 1.0
_OVERLOAD: Final = frozenset((errno.EAGAIN, errno.ENOBUFS))
"""Errors after which the frame is lost, but the interface still works if it takes frames again soon."""
_FULL_S: Final = 1.0
"""An interface that took no frame for this long is in trouble: its queue no longer empties."""

_FILTER: Final = (
    (0x20, 0, 0, 0xFFFFF004),  # packet type
    (0x15, 10, 0, 4),  # outgoing: injected by another socket of this machine
    (0x30, 0, 0, 3),  # radiotap length, high byte
    (0x64, 0, 0, 8),
    (0x07, 0, 0, 0),
    (0x30, 0, 0, 2),  # low byte
    (0x4C, 0, 0, 0),
    (0x07, 0, 0, 0),
    (0x50, 0, 0, 0),  # first byte of the 802.11 frame
    (0x15, 3, 0, 0x80),  # beacon
    (0x15, 2, 0, 0x50),  # probe response
    (0x15, 1, 0, 0xD0),  # action
    (0x06, 0, 0, 0),  # drop everything else in the kernel
    (0x06, 0, 0, 0x40000),
)
"""Classic BPF (code, jump if true, jump if false, k). Passes only frame kinds that can carry Remote ID."""


class PacketSocket:
    """Raw socket on one monitor interface.

    Args:
        key: Configuration key that names the interface, for error texts.
        interface: Name of the interface.
        channel: Channel that it must be tuned to, if the driver reports it.
        listen: Receive frames. Otherwise the socket only sends.

    Raises:
        ConfigError: the interface cannot be used. The text says what to do.
    """

    def __init__(self, key: str, interface: str, channel: int, *, listen: bool) -> None:
        self.interface = interface
        self.trouble: str | None = None
        """Current problem; None if there is none."""
        self.dropped = 0
        """Number of frames that the kernel dropped because they were not fetched in time."""
        self._key = key
        self._channel = channel
        self._listen = listen
        self._looked_s: float | None = None
        self._full_since_s: float | None = None
        """Time of the first frame that was refused since one was last accepted."""
        self._socket = self._open()

    def keep_open(self, now_s: float, channel: int) -> None:
        """Check the interface once a second, and try to reopen a lost one.

        Args:
            channel: Channel that it must be tuned to now, if the driver reports it.
        """
        self._channel = channel
        if self._looked_s is not None and now_s - self._looked_s < _LOOK_S:
            return
        self._looked_s = now_s
        try:
            if self.trouble is None:
                _examine(self._key, self.interface, channel)
                return
            fresh = self._open()
        except OSError:
            return  # no file descriptor or memory left: that says nothing about the interface
        except ConfigError as error:
            self.trouble = str(error)
            return
        self._socket.close()
        self._socket, self.trouble = fresh, None

    def send(self, data: bytes, now_s: float) -> bool:
        """Send a frame with its radiotap header. Return False if the interface did not accept it."""
        try:
            self._socket.send(data)
        except OSError as error:
            if error.errno not in _OVERLOAD:
                self._lost(error)
                return False
            if self._full_since_s is None:
                self._full_since_s = now_s
            elif now_s - self._full_since_s >= _FULL_S:
                self._lost(error)
            return False
        self._full_since_s = None
        return True

    def receive(self) -> list[bytes]:
        """Return the frames (with radiotap header) that arrived since the last call, up to a limit."""
        frames: list[bytes] = []
        size = 0
        while len(frames) < _MAX_READS and size < _MAX_BYTES:
            try:
                frames.append(self._socket.recv(_MAX_FRAME))
                size += len(frames[-1])
            except BlockingIOError:
                break
            except OSError as error:
                self._lost(error)
                break
        self._count_dropped()
        return frames

    def close(self) -> None:
        """Release the interface."""
        self._socket.close()

    def _lost(self, error: OSError) -> None:
        self.trouble = f"{self._key}: {self.interface!r}: {error.strerror or error}"

    def _count_dropped(self) -> None:
        try:
            statistics = self._socket.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8)
        except OSError:
            return  # a lost interface is reported elsewhere
        self.dropped += int(struct.unpack("=II", statistics)[1])  # reading resets the kernel's count

    def _open(self) -> socket.socket:
        check_monitor(self._key, self.interface, self._channel)
        try:
            fresh = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
        except PermissionError as error:
            raise ConfigError(
                f"{self._key}: {self.interface!r}: raw frames need the capability CAP_NET_RAW; run as root "
                "or give it to the service (AmbientCapabilities=CAP_NET_RAW)"
            ) from error
        except OSError as error:
            raise ConfigError(
                f"{self._key}: {self.interface!r}: cannot open a raw socket: {error.strerror}"
            ) from error
        try:
            fresh.setblocking(False)
            if self._listen:
                fresh.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
                _attach_filter(fresh)
            fresh.bind((self.interface, _ETH_P_ALL if self._listen else 0))
        except OSError as error:
            fresh.close()
            raise ConfigError(f"{self._key}: {self.interface!r}: {error.strerror}") from error
        return fresh


def check_monitor(key: str, interface: str, channel: int) -> None:
    """Check that an interface exists, uses radiotap, is up, and is tuned as configured.

    Raises:
        ConfigError: a check failed. The text says which one, and the command that fixes it.
    """
    try:
        _examine(key, interface, channel)
    except OSError as error:  # no file descriptor or memory left
        raise ConfigError(f"{key}: {interface!r}: cannot be examined: {error.strerror}") from error


def _examine(key: str, interface: str, channel: int) -> None:
    """Same as `check_monitor`, but raises OSError if the interface cannot be examined."""
    names = [name for _, name in socket.if_nameindex()]
    if interface not in names:
        raise ConfigError(f"{key}: there is no network interface {interface!r}; allowed: {', '.join(names)}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        hardware = _ask(control, _SIOCGIFHWADDR, interface)
        flags = _ask(control, _SIOCGIFFLAGS, interface)
        frequency = _ask(control, _SIOCGIWFREQ, interface)
    if hardware is None or flags is None:
        raise ConfigError(f"{key}: {interface!r} vanished while it was examined")
    kind = struct.unpack_from("H", hardware, 16)[0]
    if kind != _ARPHRD_RADIOTAP:
        raise ConfigError(f"{key}: {_why_no_monitor(interface, kind)}")
    if not struct.unpack_from("H", flags, 16)[0] & _IFF_UP:
        raise ConfigError(f"{key}: {interface!r} is down: `ip link set {interface} up`")
    tuned = None if frequency is None else tuned_channel(frequency)
    if tuned is not None and tuned != channel:
        raise ConfigError(
            f"{key}: {interface!r} is tuned to channel {tuned}, but radio.channel is {channel}: "
            f"`iw dev {interface} set channel {channel}`"
        )


def tuned_channel(iwreq: bytes) -> int | None:
    """Return the channel in the kernel's answer to SIOCGIWFREQ; None if it gives none.

    The answer is a name of 16 bytes, then mantissa i32 and exponent i16 of the frequency in Hz. Instead of a
    frequency it may hold the channel number.
    """
    mantissa, exponent = struct.unpack_from("ih", iwreq, 16)
    if exponent == 0 and 0 < mantissa < 1000:
        return int(mantissa)
    return channel_of(round(mantissa * 10.0 ** (exponent - 6))) if 0 <= exponent <= 9 else None


def channel_of(frequency_mhz: int) -> int | None:
    """Return the channel with this centre frequency in the 2.4 and 5 GHz bands (IEEE 802.11 annex E)."""
    if frequency_mhz == 2484:
        return 14
    for start, first, last in ((2407, 1, 13), (5000, 32, 177)):
        channel, rest = divmod(frequency_mhz - start, 5)
        if rest == 0 and first <= channel <= last:
            return channel
    return None


def _why_no_monitor(interface: str, kind: int) -> str:
    if kind != _ARPHRD_ETHER:
        return f"{interface!r} has link type {kind}; radiotap ({_ARPHRD_RADIOTAP}) is needed"
    if not (_SYSFS / interface / "phy80211").exists():
        return f"{interface!r} is not a Wi-Fi interface"
    return (
        f"{interface!r} is not in monitor mode: `ip link set {interface} down; "
        f"iw dev {interface} set type monitor; ip link set {interface} up`"
    )


def _ask(control: socket.socket, request: int, interface: str) -> bytes | None:
    """Ask the kernel about an interface; None if it has no answer (no such interface, or another kind)."""
    try:
        return fcntl.ioctl(control, request, interface.encode().ljust(_IFREQ_SIZE, b"\0"))
    except OSError:
        return None


def _attach_filter(raw: socket.socket) -> None:
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *step) for step in _FILTER))
    raw.setsockopt(
        socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HP", len(_FILTER), ctypes.addressof(code))
    )
