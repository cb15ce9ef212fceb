"""What a fuzz target is, and the sound inputs that damaged ones are made from."""

from __future__ import annotations

import enum
import gzip
import io
import json
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from companion.autopilot.tlog import read_tlog
from companion.autopilot.wire import Frame, FrameScanner
from companion.errors import PeerDataError
from companion.radio.frames_io import FrameSender
from companion.remote_id import codec
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

DATA = Path(__file__).parents[1] / "data"
CAPTURES = Path(__file__).resolve().parents[3] / "shared" / "data" / "remote_id"
"""Recordings of real transmitters, with true serial numbers: beside the checkout, where they are at all."""
ADDRESS = "c2:01:02:03:04:05"


@dataclass(frozen=True)
class Target:
    """A reader."""

    name: str
    seeds: list[bytes]
    feed: Callable[[bytes], bool]
    check: Callable[[], None] = lambda: None


def taking(read: Callable[[bytes], object], *refusals: type[Exception]) -> Callable[[bytes], bool]:
    """Feed a reader that raises PeerDataError, or one of `refusals`, for what it refuses."""
    refused = (PeerDataError, *refusals)

    def feed(data: bytes) -> bool:
        try:
            read(data)
        except refused:
            return False
        return True

    return feed


def remembered(root: object) -> int:
    """Items in all containers that an object of ours holds, directly or through others of ours."""
    total, seen, todo = 0, set(), [root]
    while todo:
        value = todo.pop()
        if id(value) in seen or isinstance(value, enum.Enum):
            continue
        seen.add(id(value))
        if isinstance(value, Mapping):
            total += len(value)
            todo += [*value, *value.values()]
        elif isinstance(value, list | tuple | set | frozenset | deque):
            total += len(value)
            todo += value
        elif isinstance(value, bytes | bytearray | str):
            total += len(value)
        elif type(value).__module__.startswith("companion"):
            names = {name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ())}
            todo += [
                getattr(value, name)
                for name in names | set(getattr(value, "__dict__", ()))
                if hasattr(value, name)
            ]
    return total


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


@cache
def built(transport: str) -> list[bytes]:
    """Frames as we send them."""
    sender = FrameSender(ADDRESS)
    sizes = range(1, len(MESSAGES) + 1)
    return [frame for size in sizes for frame in sender.frames(transport, MESSAGES[:size])]


@cache
def frame_seeds(transport: str) -> list[bytes]:
    """Frames of a transport."""
    kind = {
        "ble4": "ble_legacy_adv_data",
        "ble5": "ble_extended_adv_data",
        "wifi": "wifi_beacon_frame",
        "nan": "wifi_nan_action_frame",
    }[transport]
    return built(transport) + vectors()[kind]


@cache
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
