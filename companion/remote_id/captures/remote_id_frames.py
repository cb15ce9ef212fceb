"""Finds Remote ID in capture files: reads each frame of a Bluetooth LE or Wi-Fi recording.

Supported link types (tcpdump.org/linktypes.html) are nRF sniffer, Bluetooth LE with and without
pseudo-header, and 802.11 with and without radiotap header. A frame with a wrong checksum is reported as such,
and its content is not read.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import BinaryIO, Final, NamedTuple

from companion.errors import ConfigError, PeerDataError
from companion.remote_id.captures.ble_link import (
    Sniffed,
    advertisement,
    crc_holds,
    strip_nordic,
    strip_pseudo_header,
)
from companion.remote_id.captures.capture_file import Packet, read_packets
from companion.remote_id.captures.radiotap import parse_radiotap
from companion.remote_id.codec import Payload, read_payload
from companion.remote_id.frames import (
    Frame,
    NanSyncBeaconError,
    NotRemoteIdError,
    parse_frames,
    parse_wifi_frames,
)
from companion.remote_id.messages import Message
from companion.remote_id.transports import WIFI_NAN


class Kind(enum.Enum):
    """Kind of a captured frame."""

    REMOTE_ID = "Remote ID"
    SYNC_BEACON = "NAN synchronisation beacon"
    """Synchronisation beacon of a Remote ID transmitter; it holds no Remote ID itself."""
    FOREIGN = "foreign"
    """Valid frame without Remote ID."""
    BAD_CRC = "bad CRC"
    BROKEN = "broken"
    """The frame violates the rules of its link, so it could not be searched for Remote ID."""


@dataclass(frozen=True, slots=True)
class CapturedFrame:
    """One frame of a capture. A frame with several Remote ID structures yields one of these for each."""

    number: int
    """Frame number, counted from 1 as capture tools do."""
    time_ns: int | None
    """Unix time; None if the file holds none."""
    kind: Kind
    transport: str | None = None
    address: str | None = None
    """Address of the transmitter, lower-case hex with colons."""
    rssi_dbm: float | None = None
    crc_ok: bool | None = None
    """Whether the checksum is correct; None if neither the file nor the frame shows it."""
    counter: int | None = None
    payload: bytes | None = None
    """A message or a pack as received, including padding."""
    messages: tuple[Message, ...] = ()
    """All messages that could be read."""
    faults: tuple[str, ...] = ()
    """Descriptions of the parts that could not be read."""


class _Link(NamedTuple):
    """Fields of the link's own header, and the function that reads the rest."""

    rssi_dbm: float | None
    crc_ok: bool | None
    find: Callable[[], tuple[tuple[Frame, ...], str | None]]
    """Returns the Remote ID frames, and the reason if they may be truncated."""


def read_capture(stream: BinaryIO, name: str) -> Iterator[CapturedFrame]:
    """Yield every frame of a capture file in order. Error texts contain `name`.

    Raises:
        ConfigError: the file is no capture file, or has an unsupported link type.
        PeerDataError: the file is damaged or ends inside a frame. All frames before it have been yielded.
    """
    for packet in read_packets(stream, name):
        link = _LINKS.get(packet.link_type)
        if link is None:
            raise ConfigError(
                f"{name}: packet {packet.number} has link type {packet.link_type}; "
                f"read are {', '.join(f'{known} ({text})' for known, text in _LINK_NAMES.items())}"
            )
        yield from _read(packet, link)


def _read(packet: Packet, read_link: Callable[[bytes], _Link]) -> Iterator[CapturedFrame]:
    result = CapturedFrame(number=packet.number, time_ns=packet.time_ns, kind=Kind.FOREIGN)
    try:
        link = read_link(packet.data)
        result = replace(result, rssi_dbm=link.rssi_dbm, crc_ok=link.crc_ok)
        if link.crc_ok is False:
            yield replace(result, kind=Kind.BAD_CRC)
            return
        frames, short = link.find()
    except NanSyncBeaconError as error:
        yield replace(result, kind=Kind.SYNC_BEACON, transport=WIFI_NAN, address=error.address)
    except NotRemoteIdError:
        yield result
    except PeerDataError as error:
        yield replace(result, kind=Kind.BROKEN, faults=(str(error),))
    else:
        for frame in frames:
            payload = _payload(frame)
            faults = payload.faults + ((short,) if short and payload.faults else ())
            yield replace(
                result,
                kind=Kind.REMOTE_ID,
                transport=frame.transport,
                address=frame.address,
                counter=frame.counter,
                payload=frame.payload,
                messages=payload.messages,
                faults=faults,
            )


def _payload(frame: Frame) -> Payload:
    try:
        return read_payload(frame.payload)
    except PeerDataError as error:
        return Payload((), (str(error),))


# ---------------------------------------------------------------- links


def _ble(sniffed: Sniffed) -> _Link:
    def find() -> tuple[tuple[Frame, ...], str | None]:
        found = advertisement(sniffed)
        frames = parse_frames(found.transport, found.data)
        short = "the advertisement continues in another PDU, which is not read" if found.continues else None
        return tuple(frame._replace(address=found.address) for frame in frames), short

    return _Link(sniffed.rssi_dbm, crc_holds(sniffed), find)


def _wifi(data: bytes) -> _Link:
    return _Link(None, None, lambda: (parse_wifi_frames(data), None))


def _radiotap(data: bytes) -> _Link:
    head = parse_radiotap(data)
    return _Link(head.rssi_dbm, not head.bad_fcs, lambda: (parse_wifi_frames(head.frame), None))


_LINKS: Final[Mapping[int, Callable[[bytes], _Link]]] = {
    105: _wifi,
    127: _radiotap,
    251: lambda data: _ble(Sniffed(data)),
    256: lambda data: _ble(strip_pseudo_header(data)),
    272: lambda data: _ble(strip_nordic(data)),
}
_LINK_NAMES: Final[Mapping[int, str]] = {
    105: "802.11",
    127: "802.11 with radiotap",
    251: "Bluetooth LE",
    256: "Bluetooth LE with pseudo-header",
    272: "nRF sniffer",
}
