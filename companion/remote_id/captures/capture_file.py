"""Reads the packets of a capture file: pcap and pcapng, as written by tcpdump, Wireshark and sniffers.

The formats are draft-ietf-opsawg-pcap and draft-ietf-opsawg-pcapng. Times keep nanosecond resolution. A file
may hold several interfaces with different link types. If a file ends inside a packet, all complete packets
are returned before the error is raised.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, Final, NamedTuple

from companion.errors import ConfigError, PeerDataError

_PCAP_NS_PER_TICK: Final = {0xA1B2C3D4: 1000, 0xA1B23C4D: 1}
"""Nanoseconds per tick by magic number. The magic number also determines the byte order."""
_SECTION: Final = 0x0A0D0D0A
_BYTE_ORDER: Final = 0x1A2B3C4D
_INTERFACE, _OLD_PACKET, _SIMPLE_PACKET, _PACKET = 1, 2, 3, 6
_TIME_RESOLUTION, _TIME_OFFSET = 9, 14
"""Option codes of an interface block."""
_MAX_BYTES: Final = 1 << 24
"""Upper limit for a length. A greater length means a damaged file, and must not exhaust the memory."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One captured packet."""

    number: int
    """Packet number, counted from 1 as capture tools do."""
    time_ns: int | None
    """Unix time; None if the file holds none."""
    link_type: int
    """LINKTYPE_ value (tcpdump.org/linktypes.html)."""
    data: bytes


def read_packets(stream: BinaryIO, name: str) -> Iterator[Packet]:
    """Return the packets of the file in order. Error texts contain `name`.

    Raises:
        ConfigError: the file is no capture file.
        PeerDataError: the file is damaged or ends inside a packet. The text gives the packet number and byte
            offset.
    """
    head = stream.read(4)
    for order in ("<", ">"):
        if len(head) == 4:
            magic = struct.unpack(f"{order}I", head)[0]
            if magic in _PCAP_NS_PER_TICK:
                return _read_pcap(_Source(stream, name, order, len(head)), _PCAP_NS_PER_TICK[magic])
            if magic == _SECTION:
                return _read_pcapng(_Source(stream, name, order, len(head)))
    what = f"starts with {head.hex()}" if head else "is empty"
    raise ConfigError(f"{name}: {what}; expected a capture, pcap or pcapng")


def is_capture(head: bytes) -> bool:
    """Whether a file that begins with these four bytes is a capture file."""
    numbers = (int.from_bytes(head, "little"), int.from_bytes(head, "big"))
    return any(number == _SECTION or number in _PCAP_NS_PER_TICK for number in numbers)


class _Source:
    """Bytes of the file, with the position for error texts."""

    def __init__(self, stream: BinaryIO, name: str, order: str, offset: int) -> None:
        self._stream = stream
        self._name = name
        self.order = order
        self.offset = offset
        self.number = 1
        """Number of the next packet."""

    def read_exactly(self, size: int) -> bytes:
        """Read exactly `size` bytes."""
        if not 0 <= size <= _MAX_BYTES:
            raise self.damaged(f"has a length of {size} bytes")
        data = self._stream.read(size)
        if len(data) < size:
            raise self.damaged(f"is cut short, {size - len(data)} bytes are missing")
        self.offset += size
        return data

    def read_or_end(self, size: int) -> bytes | None:
        """Read exactly `size` bytes; return None at the end of the file."""
        data = self._stream.read(size)
        if not data:
            return None
        if len(data) < size:
            raise self.damaged("is cut short")
        self.offset += size
        return data

    def unpack(self, layout: str, data: bytes, at: int = 0) -> tuple[int, ...]:
        """Unpack integers from `data`, starting at offset `at`."""
        if len(data) - at < struct.calcsize("<" + layout):
            raise self.damaged(f"has {len(data) - at} bytes where its head should be")
        return struct.unpack_from(self.order + layout, data, at)

    def damaged(self, how: str) -> PeerDataError:
        """Return the error for the packet that is being read."""
        return PeerDataError(f"{self._name}: packet {self.number}, at byte {self.offset}, {how}")


# ---------------------------------------------------------------- pcap


def _read_pcap(source: _Source, ns_per_tick: int) -> Iterator[Packet]:
    *_, link_type = source.unpack("HHiIII", source.read_exactly(20))
    link_type &= 0xFFFF  # the upper bits give the length of a frame check sequence
    while (head := source.read_or_end(16)) is not None:
        seconds, ticks, captured, _ = source.unpack("IIII", head)
        data = source.read_exactly(captured)
        yield Packet(source.number, seconds * 1_000_000_000 + ticks * ns_per_tick, link_type, data)
        source.number += 1


# ---------------------------------------------------------------- pcapng


class _Interface(NamedTuple):
    link_type: int
    snap_length: int
    ticks_per_s: int
    offset_s: int


def _read_pcapng(source: _Source) -> Iterator[Packet]:
    interfaces: list[_Interface] = []
    _read_section_head(source)
    while (head := source.read_or_end(4)) is not None:
        if int.from_bytes(head, "big") == _SECTION:  # the same value in either byte order
            _read_section_head(source)
            interfaces = []
            continue
        (kind,) = source.unpack("I", head)
        body = _read_block(source, source.read_exactly(4))
        if kind == _INTERFACE:
            interfaces.append(_interface(source, body))
        elif kind in (_PACKET, _OLD_PACKET, _SIMPLE_PACKET):
            yield _packet(source, kind, body, interfaces)
            source.number += 1


def _read_section_head(source: _Source) -> None:
    length, magic = source.read_exactly(4), source.read_exactly(4)
    for order in ("<", ">"):
        if struct.unpack(f"{order}I", magic)[0] == _BYTE_ORDER:
            source.order = order
            _read_block(source, length, already=4)
            return
    raise source.damaged(f"stands behind a section head with byte order {magic.hex()}")


def _read_block(source: _Source, length_field: bytes, already: int = 0) -> bytes:
    """Return the body of a block whose type, length and first `already` bytes have been read."""
    (length,) = source.unpack("I", length_field)
    if length % 4 or length < 12 + already:
        raise source.damaged(f"has a block of {length} bytes")
    body = source.read_exactly(length - 12 - already)
    if source.read_exactly(4) != length_field:
        raise source.damaged("ends with a length that differs from the one at its start")
    return body


def _interface(source: _Source, body: bytes) -> _Interface:
    link_type, _, snap_length = source.unpack("HHI", body)
    ticks_per_s, offset_s = 1_000_000, 0
    at = 8
    while at + 4 <= len(body):
        code, size = source.unpack("HH", body, at)
        value = body[at + 4 : at + 4 + size]
        if code == _TIME_RESOLUTION and len(value) == 1:
            ticks_per_s = 2 ** (value[0] & 0x7F) if value[0] & 0x80 else 10 ** value[0]
        elif code == _TIME_OFFSET and len(value) == 8:
            (offset_s,) = source.unpack("q", value)
        elif code == 0:
            break
        at += 4 + (size + 3) // 4 * 4
    return _Interface(link_type, snap_length, ticks_per_s, offset_s)


def _packet(source: _Source, kind: int, body: bytes, interfaces: list[_Interface]) -> Packet:
    index, high, low = 0, 0, 0
    if kind == _SIMPLE_PACKET:
        (captured,) = source.unpack("I", body)
        head_size = 4
        if interfaces and interfaces[0].snap_length:
            captured = min(captured, interfaces[0].snap_length)
    else:
        layout = "IIIII" if kind == _PACKET else "HHIIII"
        index, *_, high, low, captured, _ = source.unpack(layout, body)
        head_size = 20
    if index >= len(interfaces):
        raise source.damaged(f"names interface {index} of {len(interfaces)}")
    data = body[head_size : head_size + captured]
    if len(data) < captured:
        raise source.damaged(f"announces {captured} bytes in a block that holds {len(data)}")
    interface = interfaces[index]
    time_ns = None
    if kind != _SIMPLE_PACKET:
        ticks = high << 32 | low
        time_ns = interface.offset_s * 1_000_000_000 + ticks * 1_000_000_000 // interface.ticks_per_s
    return Packet(source.number, time_ns, interface.link_type, data)
