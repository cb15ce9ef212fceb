"""The Wi-Fi radio with real parts: a TAP device that hands out radiotap, tshark as receiver, a real hostapd.

They need root, /dev/net/tun, tshark and hostapd; the reason of a skip names what is missing.
"""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import re
import select
import shutil
import signal
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from companion.errors import ConfigError
from companion.events import RemoteIdHeard
from companion.radio.wifi.packet_socket import PacketSocket
from companion.radio.wifi.section import WifiRadio
from companion.radio.wifi.wifi_radio import SYNC_PERIOD_S, WifiTransport, stamp
from companion.remote_id.captures.radiotap import build_radiotap, parse_radiotap
from companion.remote_id.codec import encode_pack
from companion.remote_id.frames import (
    build_beacon,
    build_nan_action,
    build_nan_sync_beacon,
    build_vendor_element,
    parse_wifi,
)
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

PATIENCE_S = 20.0
TUN = Path("/dev/net/tun")
IFF_TAP, IFF_NO_PI, IFF_UP = 0x0002, 0x1000, 0x1
TUNSETIFF, TUNSETLINK = 0x400454CA, 0x400454CD
SIOCGIFFLAGS, SIOCSIFFLAGS = 0x8913, 0x8914
RADIOTAP_LINK = 803

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


def until(found: Callable[[], object], what: str) -> None:
    end = time.monotonic() + PATIENCE_S
    while not found():
        assert time.monotonic() < end, f"{what} never came"
        time.sleep(0.02)


class Tap:
    """A TAP device whose link type is radiotap: what is read and written here is what goes over the air."""

    def __init__(self, link: int = RADIOTAP_LINK) -> None:
        self.fd = os.open(TUN, os.O_RDWR | os.O_NONBLOCK)
        # The kernel takes the next free number, so that tests side by side do not meet.
        request = struct.pack("16sH22x", b"ridair%d", IFF_TAP | IFF_NO_PI)
        self.name = fcntl.ioctl(self.fd, TUNSETIFF, request)[:16].rstrip(b"\0").decode()
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


@pytest.fixture
def tap() -> Iterator[Tap]:
    tap = Tap()
    tap.set_up(True)
    yield tap
    tap.close()


@pytest.fixture
def radio(tap: Tap) -> Iterator[WifiTransport]:
    transport = WifiTransport(WifiRadio(inject=tap.name, monitor=tap.name), OWN)
    yield transport
    transport.close()


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


# ---------------------------------------------------------------- TAP


@needs_tap
def test_a_beacon_goes_out_byte_for_byte(tap: Tap, radio: WifiTransport) -> None:
    radio.broadcast("wifi", FULL, 1.5)
    radio.broadcast("wifi", FULL, 2.0)
    pack = encode_pack(FULL)
    assert tap.sent(2) == [
        build_radiotap() + stamp(build_beacon(pack, 0, OWN), 0, 1_500_000),
        build_radiotap() + stamp(build_beacon(pack, 0, OWN), 1, 2_000_000),
    ]
    health = radio.health(2.0)
    assert (health.ok, health.frames_sent, health.missing) == (True, 2, ())
    assert health.can_send == {"wifi", "nan"}
    assert radio.own_addresses == {OWN}


@needs_tap
def test_nan_goes_out_once_with_its_synchronisation_beside_it(tap: Tap, radio: WifiTransport) -> None:
    radio.broadcast("nan", (LOCATION,), 1.0)
    action = build_nan_action(encode_pack((LOCATION,)), 0, OWN)
    sync = build_nan_sync_beacon(OWN)
    assert tap.sent(2) == [
        build_radiotap() + stamp(sync, 0, 1_000_000),
        build_radiotap() + stamp(action, 1, 0),
    ]
    assert radio.health(1.0).frames_sent == 1  # a synchronisation beacon is no Remote ID
    # On a grid of 512 TU, whatever the loop's rhythm, until NAN has been silent for 3 s.
    for n in range(1, 500):
        radio.heard(1.0 + 0.01 * n)
    times = [struct.unpack_from("<Q", frame, 12 + 24)[0] / 1e6 for frame in tap.sent(5)]
    for n, sent_s in enumerate(times, start=1):
        assert 1.0 + n * SYNC_PERIOD_S <= sent_s < 1.0 + n * SYNC_PERIOD_S + 0.011
    assert tap.waiting() == []


@needs_tap
def test_a_late_loop_sends_one_synchronisation_not_a_burst(tap: Tap, radio: WifiTransport) -> None:
    radio.broadcast("nan", (LOCATION,), 0.0)
    tap.sent(2)
    for now_s in (2.5, 2.6, 2.9):
        radio.heard(now_s)
    tap.sent(1)
    assert tap.waiting() == []


@needs_tap
@pytest.mark.parametrize(
    ("transport", "build"), [("wifi", build_beacon), ("nan", build_nan_action)], ids=["beacon", "nan"]
)
def test_frames_on_the_air_are_heard(
    tap: Tap, radio: WifiTransport, transport: str, build: Callable[[bytes, int, str], bytes]
) -> None:
    frame = build(encode_pack((BASIC_ID, SELF_ID)), 7, OTHER)
    tap.put(captured(frame))
    tap.put(captured(frame + b"\xde\xad\xbe\xef", flags=0x10, rssi_dbm=-90))
    heard = hear(radio, 2)
    assert heard == [
        RemoteIdHeard(
            transport=transport, address=OTHER, messages=(BASIC_ID, SELF_ID), rssi_dbm=rssi, counter=7
        )
        for rssi in (-61.0, -90.0)
    ]
    health = radio.health(0.0)
    assert (health.frames_heard, health.bad_frames, health.ok) == (2, 0, True)


@needs_tap
def test_what_is_no_hearing_is_left_out_and_what_is_bad_is_counted(tap: Tap, radio: WifiTransport) -> None:
    pack = encode_pack((SELF_ID,))
    theirs, own = build_beacon(pack, 0, OTHER), build_beacon(pack, 0, OWN)
    radio.broadcast("wifi", (SELF_ID,), 0.0)  # its own socket's copy
    tap.put(build_radiotap() + theirs)  # TX flags: the card reports what it sent
    tap.put(captured(own))
    tap.put(captured(theirs, flags=0x40))  # bad FCS
    tap.put(captured(theirs[:-30]))  # a torn element
    tap.put(captured(b"\x08\x01" + bytes(60)))  # a data frame
    tap.put(captured(b"\x80\x00" + bytes(40)))  # somebody's beacon
    tap.put(b"\0\0\xff\xff" + bytes(60))  # no radiotap
    tap.put(captured(theirs))
    (event,) = hear(radio, 1)
    assert (event.address, event.messages) == (OTHER, (SELF_ID,))
    health = radio.health(0.0)
    assert health.frames_heard == 1
    assert health.bad_frames == 2


@needs_tap
def test_a_flood_is_taken_in_portions_and_losses_are_told(tap: Tap, radio: WifiTransport) -> None:
    frame = captured(build_beacon(encode_pack(FULL), 0, OTHER))
    sent = 8000
    for _ in range(sent):
        tap.put(frame)
    total = portion = len(radio.heard(0.0))
    assert portion == 256
    while portion:
        portion = len(radio.heard(0.0))
        assert portion <= 256
        total += portion
    assert total < sent
    assert f"{sent - total} received frames lost" in radio.health(0.0).text


@needs_tap
def test_an_interface_that_goes_down_and_comes_back(tap: Tap, radio: WifiTransport) -> None:
    tap.set_up(False)
    until(lambda: radio.heard(0.0) or not radio.hears, "the loss")
    radio.broadcast("wifi", (SELF_ID,), 0.1)
    health = radio.health(0.1)
    assert not health.ok
    assert health.can_send == frozenset()
    assert "1 frames could not be sent" in health.text
    radio.heard(5.0)
    assert f"'{tap.name}' is down: `ip link set {tap.name} up`" in radio.health(5.0).text
    tap.set_up(True)
    radio.heard(5.5)
    assert radio.hears == frozenset()  # tried once a second
    radio.heard(6.1)
    assert radio.hears == {"wifi", "nan"}
    assert radio.health(6.1).can_send == {"wifi", "nan"}
    radio.broadcast("wifi", (SELF_ID,), 6.2)
    tap.sent(1)
    tap.put(captured(build_beacon(encode_pack((SELF_ID,)), 0, OTHER)))
    hear(radio, 1)


@needs_tap
def test_an_interface_that_vanishes(tap: Tap, radio: WifiTransport) -> None:
    tap.close()
    until(lambda: radio.heard(0.0) or not radio.hears, "the loss")
    for now_s in (1.0, 2.0, 3.0):
        radio.broadcast("wifi", (SELF_ID,), now_s)
        radio.broadcast("nan", (SELF_ID,), now_s)
        assert radio.heard(now_s) == []
    health = radio.health(3.0)
    assert not health.ok
    assert f"there is no network interface '{tap.name}'" in health.text
    assert health.can_send == frozenset()


@needs_tap
def test_a_card_tuned_elsewhere_is_told(tap: Tap, radio: WifiTransport) -> None:
    tap.put(captured(build_beacon(encode_pack((SELF_ID,)), 0, OTHER), mhz=2412))
    hear(radio, 1)
    health = radio.health(0.0)
    assert not health.ok
    assert "listens on channel 1, not on 6" in health.text


@needs_tap
def test_the_kernel_hands_over_what_others_sent_and_can_carry_remote_id(tap: Tap) -> None:
    listener = PacketSocket("radio.monitor", tap.name, 6, listen=True)
    sender = PacketSocket("radio.inject", tap.name, 6, listen=False)
    assert sender.send(captured(b"\x80\x00" + bytes(40)))
    wanted = [captured(bytes((kind, 0)) + bytes(40)) for kind in (0x80, 0x50, 0xD0)]
    for kind in (0x08, 0x40, 0xB4, 0xC0):
        tap.put(captured(bytes((kind, 0)) + bytes(40)))
    for data in wanted:
        tap.put(data)
    received: list[bytes] = []

    def all_there() -> bool:
        received.extend(listener.receive())
        return len(received) >= len(wanted)

    until(all_there, "frames")
    assert received == wanted
    assert listener.dropped == 0
    assert sender.receive() == []
    listener.close()
    sender.close()


@needs_tap
def test_without_the_right_to_raw_frames_it_says_which(tap: Tap) -> None:
    os.seteuid(65534)
    try:
        with pytest.raises(ConfigError, match=f"radio.inject: '{tap.name}': .*CAP_NET_RAW"):
            WifiTransport(WifiRadio(inject=tap.name), OWN)
    finally:
        os.seteuid(0)


@needs_tap
def test_five_ghz_goes_out_at_its_lowest_rate(tap: Tap) -> None:
    radio = WifiTransport(WifiRadio(inject=tap.name, channel=149), OWN)
    radio.broadcast("wifi", (SELF_ID,), 0.0)
    (data,) = tap.sent(1)
    assert data[:12] == build_radiotap(12)
    assert parse_wifi(parse_radiotap(data).frame).address == OWN
    assert (radio.wifi_channel, radio.hears) == (149, frozenset())
    radio.close()


@needs_tap
@pytest.mark.parametrize(
    ("link", "up", "words"),
    [
        (RADIOTAP_LINK, False, "is down: `ip link set"),
        (801, True, "link type 801; radiotap"),
        (1, True, "is not a Wi-Fi interface"),
    ],
)
def test_an_interface_that_is_none_for_us_says_why(link: int, up: bool, words: str) -> None:
    tap = Tap(link)
    try:
        tap.set_up(up)
        with pytest.raises(ConfigError, match=words):
            WifiTransport(WifiRadio(inject=tap.name), OWN)
    finally:
        tap.close()


@needs_tap
def test_a_part_that_fails_is_told_and_the_rest_works(tap: Tap, tmp_path: Path) -> None:
    config = WifiRadio(hostapd=str(tmp_path / "none"), inject="nosuch0", monitor=tap.name)
    radio = WifiTransport(config, OWN)
    health = radio.health(0.0)
    assert not health.ok
    assert [text.split(":")[0] for text in health.missing] == ["radio.hostapd", "radio.inject"]
    assert (radio.capabilities, radio.hears) == (frozenset(), {"wifi", "nan"})
    with pytest.raises(ValueError, match=r"radio\.inject: there is no network interface 'nosuch0'"):
        radio.broadcast("wifi", (SELF_ID,), 0.0)
    with pytest.raises(ConfigError, match="cannot send wifi"):
        radio.configure({"wifi": 1})
    radio.close()


# ---------------------------------------------------------------- tshark


FIELDS = [
    "wlan.fc.type_subtype",
    "wlan.sa",
    "wlan.bssid",
    "wlan.seq",
    "wlan.fixed.timestamp",
    "wlan.tag.oui",
    "wlan.tag.vendor.data",
    "nan.service_id",
    "nan.sda.service_info",
    "nan.sdea.service_update_indicator",
]


@needs_tap
@needs_tshark
def test_tshark_sees_what_we_send(tap: Tap, radio: WifiTransport, tmp_path: Path) -> None:
    """A receiver that is none of ours finds element and attributes where the standards want them."""
    wanted = f"wlan.sa == {OWN}"
    command = ["tshark", "-i", tap.name, "-n", "-l", "-Y", wanted, "-T", "fields"]
    command += [part for field in FIELDS for part in ("-e", field)]
    out = tmp_path / "fields.txt"
    with out.open("w") as stdout, (tmp_path / "log.txt").open("w") as log:
        process = subprocess.Popen(command, stdout=stdout, stderr=log)
    try:
        # How soon a capture begins nobody tells: the aircraft sends until it was seen on both transports.
        seconds = itertools.count(1.0)

        def seen() -> bool:
            assert process.poll() is None, (tmp_path / "log.txt").read_text()
            now_s = next(seconds)
            radio.broadcast("wifi", FULL, now_s)
            radio.broadcast("nan", FULL, now_s)
            return out.read_text().count("\n") >= 3

        until(seen, "a frame in tshark")
    finally:
        process.terminate()
        process.wait(PATIENCE_S)
    lines = [line.split("\t") for line in out.read_text().splitlines()]
    rows = [dict(zip(FIELDS, line, strict=True)) for line in lines if len(line) == len(FIELDS)]
    element = build_vendor_element(encode_pack(FULL), 0)
    (beacon,) = {row["wlan.tag.vendor.data"] for row in rows if row["wlan.bssid"] == OWN}
    assert bytes.fromhex(beacon.replace(":", "")) == element[5:]
    assert {int(row["wlan.tag.oui"]) for row in rows if row["wlan.bssid"] == OWN} == {0xFA0BBC}
    nan = [row for row in rows if row["wlan.bssid"] == "50:6f:9a:01:00:ff"]
    assert {row["nan.service_id"] for row in nan} == {"88:69:19:9d:92:09"}
    infos = {row["nan.sda.service_info"] for row in nan} - {""}
    assert [bytes.fromhex(info.replace("-", "")) for info in infos] == [element[6:]]
    assert {row["nan.sdea.service_update_indicator"] for row in nan} == {"", "0"}
    numbers = [int(row["wlan.seq"]) for row in rows]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))


# ---------------------------------------------------------------- hostapd


class Hostapd:
    """A hostapd without a card: its driver does nothing, all the rest is real."""

    interface = "rid0"

    def __init__(self, folder: Path) -> None:
        self.log = folder / "log.txt"
        self.path = folder / "control" / self.interface
        self._configuration = folder / "hostapd.conf"
        self._configuration.write_text(
            f"interface={self.interface}\ndriver=none\nctrl_interface={self.path.parent}\nssid=RID\n"
        )
        self.start()

    def start(self) -> None:
        assert HOSTAPD is not None
        with self.log.open("a") as log:
            command = [HOSTAPD, "-d", str(self._configuration)]
            self.process = subprocess.Popen(command, stdout=log, stderr=log)
        until(self.path.exists, "hostapd's socket")

    def set_elements(self) -> list[str]:
        """The elements that it was given so far, as it logs them."""
        return re.findall(r"CTRL_IFACE SET 'vendor_elements'='(\w*)'", self.log.read_text(errors="replace"))

    def stop(self) -> None:
        self.process.send_signal(signal.SIGCONT)
        self.process.terminate()
        self.process.wait(PATIENCE_S)


@pytest.fixture
def hostapd() -> Iterator[Hostapd]:
    folder = Path(tempfile.mkdtemp(prefix="rid-"))  # paths of sockets must be short
    hostapd = Hostapd(folder)
    yield hostapd
    hostapd.stop()
    shutil.rmtree(folder)


@needs_hostapd
def test_hostapd_takes_a_pack_of_nine(hostapd: Hostapd) -> None:
    radio = WifiTransport(WifiRadio(hostapd=str(hostapd.path), channel=6), OWN)
    assert (radio.capabilities, radio.hears) == ({"wifi"}, frozenset())
    assert radio.own_addresses == frozenset()  # this driver has no BSSID to tell
    assert radio.wifi_channel == 6
    for number, messages in enumerate((FULL, (LOCATION,)), start=1):
        radio.broadcast("wifi", messages, float(number))

        def taken(number: int = number) -> bool:
            radio.heard(float(number))
            return radio.health(float(number)).frames_sent == number

        until(taken, "OK")
    health = radio.health(2.0)
    assert (health.ok, health.can_send, health.missing) == (True, {"wifi"}, ())
    with pytest.raises(ValueError, match="nan"):
        radio.broadcast("nan", FULL, 2.0)
    with pytest.raises(ValueError, match="10 messages"):
        radio.broadcast("wifi", (*FULL, SELF_ID), 2.0)
    radio.broadcast("wifi", (), 2.0)
    radio.close()
    expected = [build_vendor_element(encode_pack(m), n).hex() for n, m in enumerate((FULL, (LOCATION,)))]
    until(lambda: len(hostapd.set_elements()) == 3, "the clearing")
    assert hostapd.set_elements() == [*expected, ""]


@needs_hostapd
def test_a_hostapd_that_dies_and_returns(hostapd: Hostapd) -> None:
    radio = WifiTransport(WifiRadio(hostapd=str(hostapd.path)), OWN)
    radio.broadcast("wifi", FULL, 0.0)
    radio.heard(0.0)
    hostapd.stop()
    radio.heard(1.0)
    radio.broadcast("wifi", FULL, 1.0)
    health = radio.health(1.0)
    assert (health.ok, health.can_send) == (False, frozenset())
    assert "check that hostapd runs" in health.text
    hostapd.start()
    seconds = itertools.count(2.0, 0.1)
    until(lambda: radio.heard(next(seconds)) or radio.health(0.0).ok, "the recovery")
    assert radio.health(0.0).can_send == {"wifi"}
    radio.close()


@needs_hostapd
def test_a_hostapd_that_hangs_and_goes_on(hostapd: Hostapd) -> None:
    radio = WifiTransport(WifiRadio(hostapd=str(hostapd.path)), OWN)
    hostapd.process.send_signal(signal.SIGSTOP)
    radio.broadcast("wifi", FULL, 0.0)
    radio.heard(2.5)
    health = radio.health(2.5)
    assert (health.ok, health.can_send) == (False, frozenset())
    assert "no answer to" in health.text
    hostapd.process.send_signal(signal.SIGCONT)
    seconds = itertools.count(4.0, 0.1)
    until(lambda: radio.heard(next(seconds)) or radio.health(0.0).ok, "the recovery")
    # What it was given before it hung would be old by now: it is off the air before we send again.
    element = build_vendor_element(encode_pack(FULL), 0)
    until(lambda: hostapd.set_elements()[-1] == "", "the clearing")
    assert hostapd.set_elements() == [element.hex(), ""]
    radio.close()


@needs_tap
@needs_hostapd
def test_injection_steps_in_for_a_lost_hostapd(hostapd: Hostapd, tap: Tap) -> None:
    radio = WifiTransport(WifiRadio(hostapd=str(hostapd.path), inject=tap.name), OWN)
    radio.broadcast("wifi", (SELF_ID,), 0.0)
    assert tap.waiting() == []
    hostapd.stop()
    radio.heard(1.0)
    radio.broadcast("wifi", (SELF_ID,), 1.0)
    (data,) = tap.sent(1)
    assert parse_wifi(parse_radiotap(data).frame).address == OWN
    assert radio.health(1.0).can_send == {"wifi", "nan"}
    assert not radio.health(1.0).ok
    radio.close()
