"""Real parts of the Wi-Fi tests: a TAP device that hands out radiotap, and what the tests need beside it."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import shutil
import socket
import struct
from pathlib import Path

import pytest

from companion.events import RemoteIdHeard
from companion.radio.wifi.wifi_radio import WifiTransport
from companion.remote_id.messages import (
    Authentication,
    BasicId,
    IdType,
    Location,
    Message,
    OperatorId,
    SelfId,
    Status,
    System,
    UaType,
)
from tests.support.waiting import PATIENCE_S, until

TUN = Path("/dev/net/tun")
IFF_TAP, IFF_NO_PI, IFF_UP = 0x0002, 0x1000, 0x1
TUNSETIFF, TUNSETLINK = 0x400454CA, 0x400454CD
SIOCGIFFLAGS, SIOCSIFFLAGS = 0x8913, 0x8914
ETHERNET_LINK, RADIOTAP_LINK = 1, 803

OWN = "c2:01:02:03:04:05"
OTHER = "c2:00:00:00:00:01"
LOCATION = Location(status=Status.AIRBORNE, lat_deg=47.5, lon_deg=8.5, alt_geodetic_m=500.0)
BASIC_ID = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="DMUCA0001")
SELF_ID = SelfId(description_type=0, text="survey")
FULL: tuple[Message, ...] = (
    BASIC_ID,
    LOCATION,
    SELF_ID,
    System(operator_lat_deg=47.5, operator_lon_deg=8.5),
    OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8"),
    *(Authentication(auth_type=1, page=page, data=bytes([page]) * 23) for page in range(1, 5)),
)

needs_tap = pytest.mark.skipif(
    os.geteuid() != 0 or not os.access(TUN, os.R_OK | os.W_OK),
    reason="REAL PART MISSING: a radio of TAP needs root" + ("" if TUN.exists() else " and /dev/net/tun"),
)
needs_tshark = pytest.mark.skipif(
    shutil.which("tshark") is None, reason="REAL PART MISSING: tshark (Debian package tshark)"
)
HOSTAPD = shutil.which("hostapd", path=os.environ.get("PATH", os.defpath) + ":/usr/sbin")
needs_hostapd = pytest.mark.skipif(
    HOSTAPD is None, reason="REAL PART MISSING: hostapd (Debian package hostapd)"
)


class Tap:
    """A TAP device whose link type is radiotap: what is read and written here is what goes over the air."""

    def __init__(self, link: int = RADIOTAP_LINK) -> None:
        self.fd = os.open(TUN, os.O_RDWR | os.O_NONBLOCK)
        # The kernel takes the next free number, so that tests side by side do not meet.
        request = struct.pack("16sH22x", b"ridair%d", IFF_TAP | IFF_NO_PI)
        self.name = fcntl.ioctl(self.fd, TUNSETIFF, request)[:16].rstrip(b"\0").decode()
        self.set_link(link)

    def set_link(self, link: int) -> None:
        fcntl.ioctl(self.fd, TUNSETLINK, link)

    def set_up(self, up: bool) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
            request = struct.pack("16sH22x", self.name.encode(), 0)
            flags = struct.unpack_from("H", fcntl.ioctl(control, SIOCGIFFLAGS, request), 16)[0]
            flags = flags | IFF_UP if up else flags & ~IFF_UP
            fcntl.ioctl(control, SIOCSIFFLAGS, struct.pack("16sH22x", self.name.encode(), flags))

    def sent(self, count: int) -> list[bytes]:
        """The next frames that went on the air; the kernel's own traffic (no radiotap) is left out."""
        frames: list[bytes] = []
        while len(frames) < count:
            assert select.select([self.fd], [], [], PATIENCE_S)[0], f"{count - len(frames)} frames never came"
            frames += self.waiting()
        assert len(frames) == count
        return frames

    def waiting(self) -> list[bytes]:
        frames = []
        with contextlib.suppress(BlockingIOError):
            while True:
                data = os.read(self.fd, 4096)
                if data.startswith(b"\0\0\x0c\0"):
                    frames.append(data)
        return frames

    def put(self, data: bytes) -> None:
        os.write(self.fd, data)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            os.close(self.fd)


def hear(radio: WifiTransport, count: int) -> list[RemoteIdHeard]:
    heard: list[RemoteIdHeard] = []

    def enough() -> bool:
        heard.extend(radio.heard(0.0))
        return len(heard) >= count

    until(enough, f"{count} frames")
    return heard


def captured(frame: bytes, *, flags: int = 0, rssi_dbm: int = -61, mhz: int = 2437) -> bytes:
    """A frame as a monitor interface hands it out: flags, rate, channel, signal."""
    fields = struct.pack("<BBHHb", flags, 2, mhz, 0xA0, rssi_dbm)
    return struct.pack("<BBHI", 0, 0, 8 + len(fields), 0b101110) + fields + frame
