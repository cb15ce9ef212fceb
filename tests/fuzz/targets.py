"""Every reader of bytes from others, as the fuzzer feeds it.

`feed` gives True where something was read, False where the input was refused; any exception that comes out of
it is a finding. `check` looks at what the reader remembers; AssertionError is a finding as well.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable
from functools import cache, partial
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion import event_record
from companion.autopilot import readers
from companion.autopilot.link import AutopilotLink
from companion.autopilot.lists.fence import areas_from_items
from companion.autopilot.lists.list_download import item_from_int
from companion.autopilot.signing import Signing
from companion.autopilot.wire import (
    MAGIC_V2,
    MAX_FRAME_BYTES,
    FrameScanner,
    MavlinkReader,
    MavlinkWriter,
    is_known,
)
from companion.config import TrafficConfig, VehicleConfig
from companion.errors import ConfigError
from companion.events import (
    DownloadFence,
    DownloadMission,
    FenceDownloaded,
    FlightMode,
    RemoteIdHeard,
    SetMode,
)
from companion.geofence import check_areas
from companion.geometry import LocalFrame
from companion.radio.ether import datagrams
from companion.radio.frames_io import TRANSPORTS, FrameReceiver, FrameSender, radio_address
from companion.remote_id import codec, frames
from companion.remote_id.authentication import AuthenticationData, split
from companion.remote_id.captures.radiotap import build_radiotap, parse_radiotap
from companion.remote_id.drip.det import Det, det_of, make_det
from companion.remote_id.drip.evidence import (
    MANIFEST,
    NO_HASH,
    WRAPPER,
    decode_evidence,
    manifest_content,
    read_manifest,
    read_wrapper,
    sign,
    wrapper_content,
)
from companion.remote_id.drip.hashes import message_hash
from companion.remote_id.drip.link import decode_link, endorse
from companion.remote_id.mavlink import READABLE, decode_odid, encode_message_pack, encode_odid
from companion.traffic.tracks import Traffic
from tests.fuzz import log_targets, radio_targets, sensor_targets
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
from tests.support.place import LAT_E7, LON_E7

MAX_TRACKS = 50
UTC_S = 1_750_000_000.0
SIGNER = "1596B0000DMUCA01"
PRIVATE_KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
PUBLIC_KEY = PRIVATE_KEY.public_key().public_bytes_raw().hex()
REMEMBERED = 90_000
DET = make_det(bytes.fromhex(PUBLIC_KEY), 16376, 10)
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
    said: list[datagrams.Datagram] = [datagrams.Join("a"), datagrams.Leave(), datagrams.Welcome(2)]
    said += [datagrams.Heard(t, ADDRESS, built(t)[0]) for t in sorted(TRANSPORTS)]
    said += [datagrams.Send(t, ADDRESS, built(t)[-1]) for t in sorted(TRANSPORTS)]
    return [datagrams.encode(datagram) for datagram in said]


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
    yield Target("ether", _ether_seeds(), taking(datagrams.decode))


# ---------------------------------------------------------------- radio frame to track


def _record(now_s: float, *events: Any, commands: tuple[Any, ...] = ()) -> None:
    """What was heard can be recorded, and is read back as it was."""
    step = event_record.Step(now_s=now_s, events=events, commands=commands)
    (again,) = event_record.read(io.BytesIO(event_record.MAGIC + event_record.encode(step)), "record")
    assert again == step


class _Hearing:
    """A receiver and the tracks behind it."""

    def __init__(self) -> None:
        self.receiver = FrameReceiver()
        keys, anchors = {SIGNER: PUBLIC_KEY}, {str(DET): PUBLIC_KEY}
        self.traffic = Traffic(TrafficConfig(max_tracks=MAX_TRACKS, keys=keys, anchors=anchors), "OWN")
        self.frame = LocalFrame(47.5, 8.5, 450.0)
        self.now_s = 0.0
        self.traffic.note_own(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

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
    return [
        frame
        for data in _drip_seeds()
        for frame in FrameSender(ADDRESS).frames(
            transport, (*MESSAGES[:2], *split(AuthenticationData(5, UTC_S, data))[:7])
        )
    ]


@cache
def _drip_seeds() -> list[bytes]:
    """A Link, a Manifest and a Wrapper, dated for the whole run."""
    begin, end = int(UTC_S), int(UTC_S) + 100_000_000
    messages = [codec.encode(message) for message in MESSAGES[:2]]
    manifest = manifest_content(NO_HASH, NO_HASH, list(map(message_hash, messages)))
    return [
        endorse(PRIVATE_KEY, DET, DET, bytes.fromhex(PUBLIC_KEY), begin, end).link(),
        sign(PRIVATE_KEY, DET, MANIFEST, manifest, begin, end).encode(),
        sign(PRIVATE_KEY, DET, WRAPPER, wrapper_content(messages), begin, end).encode(),
    ]


def _read_evidence(data: bytes) -> None:
    evidence = decode_evidence(data)
    assert evidence.encode() == data
    (read_manifest if evidence.sam_type == MANIFEST else read_wrapper)(evidence.content)


def _read_link(data: bytes) -> None:
    link = decode_link(data)
    assert link.link() == data
    assert det_of(link.child.identity) == link.child


def _drip_hearing() -> Target:
    """Damaged DRIP data in sound pages, from an aircraft that is heard."""
    hearing = _Hearing()

    def feed(data: bytes) -> bool:
        pages = split(AuthenticationData(5, UTC_S, data[:201]))
        before = sum(hearing.traffic.signatures.counts.values()) if hearing.traffic.signatures else 0
        hearing.take(RemoteIdHeard(transport="wifi", address=ADDRESS, messages=(*MESSAGES[:2], *pages)))
        return hearing.traffic.signatures is not None and (
            sum(hearing.traffic.signatures.counts.values()) > before
        )

    return Target("drip heard", _drip_seeds(), feed, hearing.check)


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


def _payload(message: Any) -> bytes:
    """As laid out; MAVLink 2 cuts zeros from the end, of which these have none."""
    message.pack(mavlink.MAVLink(None))
    return bytes(message.get_payload())


def _vertex(seq: int, command: int = 5001, size: float = 4.0) -> bytes:
    """MISSION_ITEM_INT of a fence: corners of a square, then circles."""
    x, y = 473960000 + 40000 * (seq in (1, 2)), 85430000 + 70000 * (seq in (2, 3))
    return _payload(
        mavlink.MAVLink_mission_item_int_message(1, 191, seq, 5, command, 0, 1, size, 0, 0, 0, x, y, 0, 1)
    )


@cache
def _fence_seeds() -> list[bytes]:
    square = [_vertex(seq) for seq in range(4)]
    circle = _vertex(4, 5004, 25.0)
    return [b"".join(square), circle, b"".join((*square, circle)), _vertex(0, 5000) + circle]


@cache
def _adsb_seeds() -> list[bytes]:
    values = (0x4B1234, LAT_E7, LON_E7, 0, 500_000, 9000, 6000, -250, b"HBABC", 1, 1)
    return [_payload(mavlink.MAVLink_adsb_vehicle_message(*values, flags, 7000)) for flags in (0xBF, 0x3F, 3)]


@cache
def _content_seeds() -> list[bytes]:
    fence = [
        (mavlink.MAVLINK_MSG_ID_MISSION_COUNT, _payload(mavlink.MAVLink_mission_count_message(1, 191, 4, 1))),
        *((mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT, _vertex(seq)) for seq in range(4)),
    ]
    adsb = [(mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE, payload) for payload in _adsb_seeds()]
    recorded = [(frame.message_id, frame.payload) for frame in recorded_frames()]
    return [number.to_bytes(3, "little") + payload for number, payload in (*recorded, *fence, *adsb)]


def _read_adsb(data: bytes) -> None:
    event = readers.adsb_vehicle(readers.unpack(mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE, data))
    if event is None:
        raise ConfigError("no position")  # counts as refused
    _record(0.0, event)
    numbers = (event.lat_deg, event.lon_deg, event.alt_m or 0.0, *(event.velocity_ned_mps or ()))
    assert all(map(math.isfinite, numbers))


def _read_fence(data: bytes) -> None:
    size = len(_vertex(0))
    items = [
        item_from_int(readers.unpack(mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT, data[at : at + size]))
        for at in range(0, len(data), size)
    ]
    areas = areas_from_items(items)
    _record(0.0, FenceDownloaded(areas=areas))
    check_areas(areas)


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
        if turn % 300 == 0:
            link.send(DownloadFence(), now_s)
        events = link.receive(_reframed(data, writer), now_s)
        events += link.advance(now_s)
        if events:
            _record(now_s, *events)
        assert len(link.drain()) < 100_000
        return bool(events)

    return Target("mavlink link", _content_seeds(), feed)


_KEY = bytes(range(32))


@cache
def _signed_seeds() -> list[bytes]:
    signing = Signing(_KEY, 1000, 0.0)
    return [signing.sign(frame.raw) for frame in recorded_frames() if frame.raw[0] == MAGIC_V2]


def _signed_link() -> Target:
    """A link with a key: signed frames damaged, and damaged content rightly signed by many senders."""
    ours, theirs = Signing(_KEY, 1000, 0.0), Signing(_KEY, 100_000, 0.0)
    link = AutopilotLink(VehicleConfig(), signing=ours)
    beat = MavlinkWriter(1, 1).pack_payload(0, bytes(9))
    link.receive(theirs.sign(beat), 0.0)
    now_s, turn = 0.0, 0

    def feed(data: bytes) -> bool:
        nonlocal now_s, turn
        now_s, turn = now_s + 0.01, turn + 1
        before = ours.counts.valid
        framed = _reframed(data, MavlinkWriter(turn % 7 % 3 + 1, 1)) if turn % 2 else b""
        link.receive(theirs.sign(framed, turn % 256) if framed else data, now_s)
        link.advance(now_s)
        link.drain()
        return ours.counts.valid > before

    def check() -> None:
        # Whatever came before: the vehicle itself is still believed.
        link.receive(bytes(MAX_FRAME_BYTES), now_s)
        before = ours.counts.valid
        link.receive(theirs.sign(beat) + theirs.sign(beat), now_s)
        assert ours.counts.valid > before

    return Target("mavlink signed", _signed_seeds() + _content_seeds(), feed, check)


@cache
def makers() -> dict[str, Callable[[], Target]]:
    """For each reader, by name, what makes it with an empty memory."""
    made: dict[str, Callable[[], Target]] = {}
    for target in _stateless():
        made[target.name] = lambda target=target: target  # type: ignore[misc]
    for make in (
        *(partial(_hearing, transport) for transport in sorted(TRANSPORTS)),
        _hearing_wifi,
        _scanner,
        _decoder,
        lambda: Target("adsb", _adsb_seeds(), taking(_read_adsb, ConfigError)),
        lambda: Target("fence items", _fence_seeds(), taking(_read_fence)),
        lambda: Target("drip evidence", _drip_seeds(), taking(_read_evidence)),
        lambda: Target("drip link", _drip_seeds(), taking(_read_link)),
        lambda: Target("drip entity tag", [DET.data], taking(Det)),
        _drip_hearing,
        _link,
        _signed_link,
        sensor_targets.sensed,
    ):
        made[make().name] = make
    for group in (log_targets.make_targets, radio_targets.make_targets):
        for at, target in enumerate(group()):
            made[target.name] = lambda group=group, at=at: group()[at]  # type: ignore[misc]
    return made


def make_targets() -> list[Target]:
    """Every reader, with empty memories."""
    return [make() for make in makers().values()]
