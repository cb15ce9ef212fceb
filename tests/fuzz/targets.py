"""Every reader of bytes from others, as the fuzzer feeds it.

`feed` gives True where something was read, False where the input was refused; any exception that comes out of
it is a finding. `check` looks at what the reader remembers; AssertionError is a finding as well.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable
from functools import cache
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from companion import record
from companion.autopilot.link import AutopilotLink
from companion.autopilot.wire import MAX_FRAME_BYTES, FrameScanner, MavlinkReader, MavlinkWriter, is_known
from companion.config import TrafficConfig, VehicleConfig
from companion.events import DownloadMission, FlightMode, RemoteIdHeard, SetMode
from companion.geometry import LocalFrame
from companion.radio import ether_wire
from companion.radio.frames_io import TRANSPORTS, FrameReceiver, FrameSender, radio_address
from companion.radio.radiotap import build_radiotap, parse_radiotap
from companion.remote_id import codec, frames
from companion.remote_id.authentication import sign_pages
from companion.remote_id.mavlink import READABLE, decode_odid, encode_message_pack, encode_odid
from companion.traffic.tracks import Traffic
from tests.fuzz import radio_targets
from tests.fuzz.seeds import (
    ADDRESS,
    MESSAGES,
    Target,
    built,
    frame_seeds,
    payload_seeds,
    recorded_frames,
    remembered,
    taking,
    vectors,
)

MAX_TRACKS = 50
UTC_S = 1_750_000_000.0
SIGNER = "1596B0000DMUCA01"
PRIVATE_KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
PUBLIC_KEY = PRIVATE_KEY.public_key().public_bytes_raw().hex()
REMEMBERED = 60_000
"""Items and characters that the tracks may hold in all; they settle at half of it."""

# ---------------------------------------------------------------- readers without a memory


def _read_radiotap(data: bytes) -> None:
    frames.parse_wifi_frames(parse_radiotap(data).frame)


def _read_odid(data: bytes) -> None:
    decode_odid(_ODID_IDS[data[0] % len(_ODID_IDS)] if data else 0, data[1:])


_ODID_IDS = sorted(READABLE)


@cache
def _odid_seeds() -> list[bytes]:
    packed = [*(encode_odid(message, 0, 0) for message in MESSAGES), encode_message_pack(MESSAGES[:5], 0, 0)]
    return [bytes((_ODID_IDS.index(number),)) + payload for number, payload in packed] + [
        bytes((at,)) + bytes(range(60)) for at in range(len(_ODID_IDS))
    ]


@cache
def _ether_seeds() -> list[bytes]:
    said: list[ether_wire.Datagram] = [ether_wire.Join("a"), ether_wire.Leave(), ether_wire.Welcome(2)]
    said += [ether_wire.Heard(t, ADDRESS, built(t)[0]) for t in sorted(TRANSPORTS)]
    said += [ether_wire.Send(t, ADDRESS, built(t)[-1]) for t in sorted(TRANSPORTS)]
    return [ether_wire.encode(datagram) for datagram in said]


@cache
def _wifi_seeds() -> list[bytes]:
    return [*frame_seeds("wifi"), *frame_seeds("nan"), *vectors()["wifi_nan_sync_beacon_frame"]]


def _stateless() -> Iterable[Target]:
    payloads = payload_seeds()
    messages = [data for data in payloads if len(data) == codec.MESSAGE_SIZE]
    wifi = _wifi_seeds()
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


def _record(now_s: float, *events: Any, commands: tuple[Any, ...] = ()) -> None:
    """What was heard can be recorded, and is read back as it was."""
    step = record.Step(now_s=now_s, events=events, commands=commands)
    (again,) = record.read(io.BytesIO(record.MAGIC + record.encode(step)), "record")
    assert again == step


class _Hearing:
    """A receiver and the tracks behind it."""

    def __init__(self) -> None:
        self.receiver = FrameReceiver()
        self.traffic = Traffic(TrafficConfig(max_tracks=MAX_TRACKS, keys={SIGNER: PUBLIC_KEY}), "OWN")
        self.frame = LocalFrame(47.5, 8.5, 450.0)
        self.now_s = 0.0
        self.traffic.note_own(0.0, (0.0, 0.0, 0.0))

    def take(self, event: RemoteIdHeard | None) -> bool:
        self.now_s += 0.01
        if event is None:
            return False
        _record(self.now_s, event)
        self.traffic.hear(event, self.now_s, UTC_S, self.frame, 48.0)
        self.traffic.expire(self.now_s)
        flagged = self.traffic.flagged(self.now_s)
        if flagged:
            _record(self.now_s, event, commands=tuple(flagged))
        return True

    def check(self) -> None:
        traffic = self.traffic
        assert len(traffic.tracks) <= MAX_TRACKS
        assert remembered(traffic) < REMEMBERED
        for neighbour in traffic.neighbours(self.now_s):
            assert all(map(math.isfinite, (*neighbour.position_ned_m, *neighbour.velocity_ned_mps)))
            assert math.isfinite(neighbour.age_s)


@cache
def _signed(transport: str) -> list[bytes]:
    pages = sign_pages(PRIVATE_KEY, 1, SIGNER, (), UTC_S)
    return FrameSender(ADDRESS).frames(transport, (*MESSAGES[:2], *pages))


def _hearing(transport: str) -> Target:
    hearing = _Hearing()

    def feed(data: bytes) -> bool:
        # The address changes with the bytes, so that tracks and names come and go.
        address = radio_address(str(sum(data) % 997))
        return hearing.take(hearing.receiver.receive(transport, address, data, -60.0))

    return Target(f"hear {transport}", frame_seeds(transport) + _signed(transport), feed, hearing.check)


def _hearing_wifi() -> Target:
    hearing = _Hearing()
    return Target(
        "hear any wifi",
        _wifi_seeds(),
        lambda data: hearing.take(hearing.receiver.receive_wifi(data)),
        hearing.check,
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


@cache
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
        *radio_targets.make_targets(),
    ]
