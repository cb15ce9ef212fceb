"""Every reader of bytes from others, as the fuzzer feeds it.

`feed` gives True where something was read, False where the input was refused; any exception that comes out of
it is a finding. `check` looks at what the reader remembers; AssertionError is a finding as well.
"""

from __future__ import annotations

import gzip
import io
import json
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from companion import record
from companion.autopilot.link import AutopilotLink
from companion.autopilot.tlog import read_tlog
from companion.autopilot.wire import (
    MAX_FRAME_BYTES,
    Frame,
    FrameScanner,
    MavlinkReader,
    MavlinkWriter,
    is_known,
)
from companion.config import TrafficConfig, VehicleConfig
from companion.errors import PeerDataError
from companion.events import DownloadMission, FlightMode, RemoteIdHeard, SetMode
from companion.geometry import LocalFrame
from companion.radio import ether_wire
from companion.radio.frames_io import TRANSPORTS, FrameReceiver, FrameSender, radio_address
from companion.radio.radiotap import build_radiotap, parse_radiotap
from companion.remote_id import codec, frames
from companion.remote_id.mavlink import READABLE, decode_odid, encode_message_pack, encode_odid
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
from companion.traffic.tracks import Traffic

DATA = Path(__file__).parents[1] / "data"
CAPTURES = Path(__file__).resolve().parents[3] / "shared" / "data" / "remote_id"
"""Recordings of real transmitters, with true serial numbers: beside the checkout, where they are at all."""
ADDRESS = "c2:01:02:03:04:05"
MAX_TRACKS = 50


@dataclass(frozen=True)
class Target:
    """A reader."""

    name: str
    seeds: list[bytes]
    feed: Callable[[bytes], bool]
    check: Callable[[], None] = lambda: None


# ---------------------------------------------------------------- seeds

MESSAGES: tuple[Message, ...] = (
    BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="1596B0000DMUCA01"),
    Location(
        status=Status.AIRBORNE,
        lat_deg=47.5,
        lon_deg=8.5,
        alt_geodetic_m=500.0,
        direction_deg=90.0,
        speed_mps=5.0,
        vertical_speed_mps=0.5,
        horizontal_accuracy_m=3.0,
        timestamp_s=1234.5,
    ),
    System(operator_lat_deg=47.5, operator_lon_deg=8.5, operator_alt_geodetic_m=450.0),
    SelfId(description_type=0, text="survey"),
    OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8"),
    Authentication(auth_type=1, page=0, data=bytes(range(17)), last_page=1, length=40),
    Authentication(auth_type=1, page=1, data=bytes(range(23))),
)


@cache
def vectors() -> dict[str, list[bytes]]:
    """Bytes of the vector file by kind, and of the captures where they are."""
    file = json.loads(gzip.decompress((DATA / "vectors.json.gz").read_bytes()))["vectors"]
    found: dict[str, list[bytes]] = {}
    for kind, entries in file.items():
        for entry in entries:
            name = entry["type"] if kind == "transport" else kind
            if entry["hex"]:
                found.setdefault(name, []).append(bytes.fromhex(entry["hex"]))
    return found


@cache
def captured() -> list[bytes]:
    """Whole capture files, where they are."""
    return [path.read_bytes() for path in sorted(CAPTURES.glob("*.pcap*"))]


def built(transport: str) -> list[bytes]:
    """Frames as we send them."""
    sender = FrameSender(ADDRESS)
    sizes = range(1, len(MESSAGES) + 1)
    return [frame for size in sizes for frame in sender.frames(transport, MESSAGES[:size])]


def frame_seeds(transport: str) -> list[bytes]:
    """Frames of a transport."""
    kind = {
        "ble4": "ble_legacy_adv_data",
        "ble5": "ble_extended_adv_data",
        "wifi": "wifi_beacon_frame",
        "nan": "wifi_nan_action_frame",
    }[transport]
    return built(transport) + vectors()[kind]


def payload_seeds() -> list[bytes]:
    """Messages and packs."""
    named = ("basic_id", "location", "auth", "self_id", "system", "operator_id", "message_pack", "decode")
    return [data for name in named for data in vectors()[name]] + [codec.encode_pack(MESSAGES)]


@cache
def recorded_frames() -> list[Frame]:
    """MAVLink frames of the recorded flights, up to four of each message."""
    kept: dict[tuple[str, int], list[Frame]] = {}
    for path in sorted(DATA.glob("*.tlog.gz")):
        scanner = FrameScanner()
        stream = io.BytesIO(gzip.decompress(path.read_bytes()))
        for _, raw in read_tlog(stream, path.name):
            for frame in scanner.frames(raw):
                some = kept.setdefault((path.name, frame.message_id), [])
                if len(some) < 4:
                    some.append(frame)
    return [frame for some in kept.values() for frame in some]


# ---------------------------------------------------------------- readers without a memory


def taking(read: Callable[[bytes], object]) -> Callable[[bytes], bool]:
    """Feed a reader that raises PeerDataError for what it refuses."""

    def feed(data: bytes) -> bool:
        try:
            read(data)
        except PeerDataError:
            return False
        return True

    return feed


def _read_radiotap(data: bytes) -> None:
    frames.parse_wifi_frames(parse_radiotap(data).frame)


def _read_odid(data: bytes) -> None:
    decode_odid(_ODID_IDS[data[0] % len(_ODID_IDS)] if data else 0, data[1:])


_ODID_IDS = sorted(READABLE)


def _odid_seeds() -> list[bytes]:
    packed = [*(encode_odid(message, 0, 0) for message in MESSAGES), encode_message_pack(MESSAGES[:5], 0, 0)]
    return [bytes((_ODID_IDS.index(number),)) + payload for number, payload in packed] + [
        bytes((at,)) + bytes(range(60)) for at in range(len(_ODID_IDS))
    ]


def _ether_seeds() -> list[bytes]:
    said: list[ether_wire.Datagram] = [ether_wire.Join("a"), ether_wire.Leave(), ether_wire.Welcome(2)]
    said += [ether_wire.Heard(t, ADDRESS, built(t)[0]) for t in sorted(TRANSPORTS)]
    said += [ether_wire.Send(t, ADDRESS, built(t)[-1]) for t in sorted(TRANSPORTS)]
    return [ether_wire.encode(datagram) for datagram in said]


def _stateless() -> Iterable[Target]:
    payloads = payload_seeds()
    messages = [data for data in payloads if len(data) == codec.MESSAGE_SIZE]
    wifi = [*frame_seeds("wifi"), *frame_seeds("nan"), *vectors()["wifi_nan_sync_beacon_frame"]]
    yield Target("message", messages, taking(codec.decode))
    yield Target("pack", payloads, taking(codec.decode_pack))
    yield Target("payload", payloads, taking(codec.decode_payload))
    for transport in sorted(TRANSPORTS):
        yield Target(
            f"frame {transport}",
            frame_seeds(transport),
            taking(lambda data, transport=transport: frames.parse_frames(transport, data)),
        )
    yield Target("wifi", wifi, taking(frames.parse_wifi_frames))
    yield Target("radiotap", [build_radiotap() + frame for frame in wifi], taking(_read_radiotap))
    yield Target("odid", _odid_seeds(), taking(_read_odid))
    yield Target("ether", _ether_seeds(), taking(ether_wire.decode))


# ---------------------------------------------------------------- radio frame to track


def _record(now_s: float, *events: Any) -> None:
    """What was heard can be recorded, and is read back as it was."""
    step = record.Step(now_s=now_s, events=events, commands=())
    (again,) = record.read(io.BytesIO(record.MAGIC + record.encode(step)), "record")
    assert again == step


class _Hearing:
    """A receiver and the tracks behind it."""

    def __init__(self) -> None:
        self.receiver = FrameReceiver()
        self.traffic = Traffic(TrafficConfig(max_tracks=MAX_TRACKS), "OWN")
        self.frame = LocalFrame(47.5, 8.5, 450.0)
        self.now_s = 0.0
        self.traffic.note_own(0.0, (0.0, 0.0, 0.0))

    def take(self, event: RemoteIdHeard | None) -> bool:
        self.now_s += 0.01
        if event is None:
            return False
        _record(self.now_s, event)
        self.traffic.hear(event, self.now_s, 1234.0, self.frame, 48.0)
        self.traffic.expire(self.now_s)
        return True

    def check(self) -> None:
        traffic = self.traffic
        assert len(traffic.tracks) <= MAX_TRACKS
        assert len(traffic._names) <= 4 * MAX_TRACKS
        for track in traffic.tracks.values():
            assert len(track.leads_s) <= 5
        for neighbour in traffic.neighbours(self.now_s):
            assert all(map(math.isfinite, (*neighbour.position_ned_m, *neighbour.velocity_ned_mps)))
            assert math.isfinite(neighbour.age_s)


def _hearing(transport: str) -> Target:
    hearing = _Hearing()

    def feed(data: bytes) -> bool:
        # The address changes with the bytes, so that tracks and names come and go.
        address = radio_address(str(sum(data) % 997))
        return hearing.take(hearing.receiver.receive(transport, address, data, -60.0))

    return Target(f"hear {transport}", frame_seeds(transport), feed, hearing.check)


def _hearing_wifi() -> Target:
    hearing = _Hearing()
    seeds = [*frame_seeds("wifi"), *frame_seeds("nan"), *vectors()["wifi_nan_sync_beacon_frame"]]
    return Target(
        "hear any wifi", seeds, lambda data: hearing.take(hearing.receiver.receive_wifi(data)), hearing.check
    )


# ---------------------------------------------------------------- MAVLink


def _scanner() -> Target:
    scanner = FrameScanner()
    good = MavlinkWriter(1, 1).pack_payload(0, bytes(9))

    def feed(data: bytes) -> bool:
        found = scanner.frames(data)
        assert scanner.pending_bytes <= MAX_FRAME_BYTES
        return bool(found)

    def check() -> None:
        # Whatever came before: once it has passed, a sound frame is found again.
        found = scanner.frames(bytes(MAX_FRAME_BYTES) + good + good)
        assert good in [frame.raw for frame in found]

    return Target("mavlink stream", [frame.raw for frame in recorded_frames()], feed, check)


def _reframed(data: bytes, writer: MavlinkWriter) -> bytes:
    """A sound frame round damaged content: message id (3 bytes), then payload."""
    message_id = int.from_bytes(data[:3], "little")
    if not is_known(message_id):
        message_id %= 256
    if not is_known(message_id):
        return b""
    return writer.pack_payload(message_id, data[3:258] or b"\0")


def _content_seeds() -> list[bytes]:
    return [frame.message_id.to_bytes(3, "little") + frame.payload for frame in recorded_frames()]


def _decoder() -> Target:
    """MAVLink messages as pymavlink decodes them."""
    writer, reader = MavlinkWriter(1, 1), MavlinkReader()
    return Target("mavlink decode", _content_seeds(), lambda data: bool(reader.feed(_reframed(data, writer))))


def _link() -> Target:
    """The link to the autopilot, in the midst of whatever it was asked for."""
    link = AutopilotLink(VehicleConfig())
    writers = [MavlinkWriter(1, 1), MavlinkWriter(255, 190), MavlinkWriter(7, 1), MavlinkWriter(1, 236)]
    now_s, turn = 0.0, 0

    def feed(data: bytes) -> bool:
        nonlocal now_s, turn
        now_s, turn = now_s + 0.01, turn + 1
        writer = writers[0] if turn % 3 else writers[turn // 3 % len(writers)]
        if turn % 200 == 0:
            link.send(DownloadMission() if turn % 400 else SetMode(mode=FlightMode.EXTERNAL), now_s)
        events = link.receive(_reframed(data, writer), now_s)
        events += link.advance(now_s)
        if events:
            _record(now_s, *events)
        assert len(link.drain()) < 100_000
        return bool(events)

    return Target("mavlink link", _content_seeds(), feed)


def make_targets() -> list[Target]:
    """Every reader, with empty memories."""
    return [
        *_stateless(),
        *(_hearing(transport) for transport in sorted(TRANSPORTS)),
        _hearing_wifi(),
        _scanner(),
        _decoder(),
        _link(),
    ]
