"""Readers of what a Bluetooth controller, hostapd and capture files say, and of pages of authentication."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Iterable
from functools import cache

from companion.errors import ConfigError, PeerDataError
from companion.radio.hci.advertising import HciCounts
from companion.radio.hci.controller_events import H4Reader, parse_event
from companion.radio.hci.session import HciSession
from companion.radio.wifi.hostapd import parse_status
from companion.remote_id.authentication import Assembler
from companion.remote_id.captures.radiotap import build_radiotap
from companion.remote_id.captures.remote_id_frames import Kind, read_capture
from companion.remote_id.codec import decode, encode
from companion.remote_id.messages import Authentication
from tests.fuzz.seeds import ADDRESS, Target, built, captured, frame_seeds, taking, vectors

_LINK_TYPES = (105, 127, 251, 256, 272)
"""802.11, with radiotap, Bluetooth LE, with pseudo-header, nRF sniffer."""
_ACCESS_ADDRESS = 0x8E89BED6


# ---------------------------------------------------------------- captures


def pcap(link_type: int, packets: Iterable[bytes]) -> bytes:
    """A capture file."""
    head = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link_type)
    return head + b"".join(struct.pack("<IIII", 1, 2, len(p), len(p)) + p for p in packets)


@cache
def _capture_seeds() -> list[bytes]:
    wifi = [build_radiotap() + frame for transport in ("wifi", "nan") for frame in built(transport)[:2]]
    # The first packets are enough; the last one is cut short.
    return [pcap(127, wifi), pcap(105, built("wifi")[:3]), *(data[:900] for data in captured())]


def _read_file(data: bytes) -> bool:
    packets = 0
    try:
        for _ in read_capture(io.BytesIO(data), "capture"):
            packets += 1
    except (PeerDataError, ConfigError):
        return packets > 0
    return True


@cache
def _packet_seeds() -> list[bytes]:
    """Index of a link type, then a packet of it."""
    ble = [
        struct.pack("<IBB", _ACCESS_ADDRESS, 0x42, 6 + len(data))
        + bytes.fromhex("0504030201c2")
        + data
        + bytes(3)
        for data in frame_seeds("ble4")
    ]
    sniffed = bytes(6) + struct.pack("<BHBHBBBHI", 6, len(ble[0]), 2, 1, 2, 10, 1, 37, 60)
    wifi = frame_seeds("wifi") + frame_seeds("nan")
    return [
        *(b"\0" + frame for frame in wifi),
        *(b"\1" + build_radiotap() + frame for frame in wifi),
        *(b"\2" + frame for frame in ble),
        *(b"\3" + struct.pack("<BbbBIH", 0, -60, -90, 0, _ACCESS_ADDRESS, 0x0C13) + frame for frame in ble),
        *(b"\4" + sniffed + frame for frame in ble),
    ]


def _read_packet(data: bytes) -> None:
    link_type = _LINK_TYPES[data[0] % len(_LINK_TYPES)] if data else 0
    (*_, last) = read_capture(io.BytesIO(pcap(link_type, [data[1:]])), "capture")
    if last.kind is Kind.BROKEN:
        raise ConfigError(str(last.faults))  # counts as refused


# ---------------------------------------------------------------- Bluetooth controller


def _complete(opcode: int, status: int = 0) -> bytes:
    """Command Complete with more return parameters than any command has, all bits set."""
    body = struct.pack("<BHB", 1, opcode, status) + b"\xff" * 60
    return bytes((0x04, 0x0E, len(body))) + body


def _extended_report(data: bytes, event_type: int = 0) -> bytes:
    report = struct.pack(
        "<HB6sBBBbbHB6sB", event_type, 1, bytes(6), 3, 3, 1, 127, -60, 0, 0, bytes(6), len(data)
    )
    body = b"\x0d\x01" + report + data
    return bytes((0x04, 0x3E, len(body))) + body


def _legacy_report(data: bytes) -> bytes:
    body = b"\x02\x01\x03\x01" + bytes(6) + bytes((len(data),)) + data + b"\xc4"
    return bytes((0x04, 0x3E, len(body))) + body


@cache
def _hci_seeds() -> list[bytes]:
    long = [frame for frame in frame_seeds("ble5") if len(frame) <= 229]
    return [
        *(_extended_report(frame) for frame in long),
        *(
            _extended_report(frame[:100], 0x20) + _extended_report(frame[100:])
            for frame in frame_seeds("ble5")
        ),
        *(_extended_report(frame, 0x10) for frame in frame_seeds("ble4")),
        *(_legacy_report(frame) for frame in frame_seeds("ble4")),
        *(_complete(opcode) for opcode in (0x0C03, 0x1003, 0x2036, 0x2037, 0x2039, 0x2041, 0x2042)),
        bytes.fromhex("040f0400010c20"),
        bytes.fromhex("043e061243010001 00"),
        bytes.fromhex("041001 05"),
    ]


def _events() -> Target:
    return Target("hci event", [packet[1:] for packet in _hci_seeds()], taking(parse_event))


def _stream() -> Target:
    reader = H4Reader()

    def check() -> None:
        assert len(reader._buffer) <= 3 + 255

    return Target("hci stream", _hci_seeds(), lambda data: bool(reader.feed(data)), check)


class _Session:
    """A session whose controller answers every command, and says other things beside."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.turn = 0
        self._open()

    def _open(self) -> None:
        self.session = HciSession(ADDRESS, send=True, listen=True, counts=HciCounts(), now_s=self.now_s)

    def feed(self, data: bytes) -> bool:
        self.now_s, self.turn = self.now_s + 0.01, self.turn + 1
        session = self.session
        if self.turn % 50 == 0:
            session.offer("ble5", built("ble5")[:1], self.now_s)
            session.offer("ble4", built("ble4")[:2], self.now_s)
        session.receive(data, self.now_s)
        for packet in session.packets():
            session.receive(_complete(int.from_bytes(packet[1:3], "little")), self.now_s)
        heard = bool(session.heard)
        session.heard.clear()
        self.check()
        if session.failure is not None:
            self._open()
        return heard

    def check(self) -> None:
        session = self.session
        assert len(session._reassembler._partial) <= 64
        assert len(session._waiting) < 100
        assert all(len(each.queue) < 100 for each in session.sets.values())


# ---------------------------------------------------------------- authentication


def _assembler() -> Target:
    assembler = Assembler(max_sets=20)
    now_s = 0.0

    def feed(data: bytes) -> bool:
        nonlocal now_s
        now_s += 0.01
        page = decode(data)
        if not isinstance(page, Authentication):
            return False
        whole = assembler.add_page(str(data[-1] % 40), page, now_s, data[-2], vouched=data[-1] % 2 == 0)
        return whole is not None

    def check() -> None:
        assert len(assembler) <= 40
        assert assembler.held_bytes() <= 40 * (17 + 2 * 15 * 23)

    pages = [encode(Authentication(auth_type=1, page=n, data=bytes(23))) for n in range(1, 4)]
    heads = [
        encode(Authentication(auth_type=1, page=0, data=bytes(17), last_page=n, length=17 + 23 * n))
        for n in range(3)
    ]
    return Target("authentication", pages + heads + vectors()["auth"], _refusing(feed), check)


def _refusing(feed: Callable[[bytes], bool]) -> Callable[[bytes], bool]:
    def wrapped(data: bytes) -> bool:
        try:
            return feed(data)
        except PeerDataError:
            return False

    return wrapped


def _status(data: bytes) -> bool:
    return parse_status(data.decode("utf-8", "replace"), "wlan0").state == "ENABLED"


def make_targets() -> list[Target]:
    """All of them, with empty memories."""
    session = _Session()
    status = b"state=ENABLED\nchannel=6\nbeacon_int=100\nbss[0]=wlan0\nbssid[0]=02:00:00:00:00:01\n"
    return [
        Target("capture file", _capture_seeds(), _read_file),
        Target("capture packet", _packet_seeds(), taking(_read_packet, ConfigError)),
        _events(),
        _stream(),
        Target("hci session", _hci_seeds(), session.feed, session.check),
        Target(
            "hostapd status",
            [status],
            lambda data: parse_status(data.decode("utf-8", "replace"), "wlan0").state == "ENABLED",
        ),
        _assembler(),
    ]
