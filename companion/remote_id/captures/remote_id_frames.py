"""Remote ID in capture files: what each frame of a recording of Bluetooth LE or Wi-Fi holds.

Link types (tcpdump.org/linktypes.html): nRF sniffer, Bluetooth LE with pseudo-header and plain, 802.11 with
radiotap header and plain. A frame whose checksum failed is reported as such and its content not believed.
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
    """What a captured frame is."""

    REMOTE_ID = "Remote ID"
    SYNC_BEACON = "NAN synchronisation beacon"
    """Of a transmitter of Remote ID; holds none."""
    FOREIGN = "foreign"
    """Sound, and of something else."""
    BAD_CRC = "bad CRC"
    BROKEN = "broken"
    """Breaks the rules of its link, so that no Remote ID could be looked for."""


@dataclass(frozen=True, slots=True)
class CapturedFrame:
    """One frame of a capture; of a frame with several Remote ID structures, one of them."""

    number: int
    """From 1, as capture tools count."""
    time_ns: int | None
    """Unix time."""
    kind: Kind
    transport: str | None = None
    address: str | None = None
    """Transmitter, lower-case hex with colons."""
    rssi_dbm: float | None = None
    crc_ok: bool | None = None
    """None where neither the file nor the frame tells."""
    counter: int | None = None
    payload: bytes | None = None
    """A message or a pack as it came, with padding."""
    messages: tuple[Message, ...] = ()
    """All that could be read."""
    faults: tuple[str, ...] = ()
    """What could not, in words."""


class _Link(NamedTuple):
    """What the link's own header says, and how to read on."""

    rssi_dbm: float | None
    crc_ok: bool | None
    find: Callable[[], tuple[tuple[Frame, ...], str | None]]
    """Its frames of Remote ID, and why they may be cut short."""


def read_capture(stream: BinaryIO, name: str) -> Iterator[CapturedFrame]:
    """Every frame of a capture file in order; `name` stands in the errors.

    Raises:
        ConfigError: it is no capture file, or one of another kind of link.
        PeerDataError: the file is damaged or ends inside a frame; all frames before were given.
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
        short = "the advertisement goes on in a further PDU, which is not read" if found.continues else None
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
