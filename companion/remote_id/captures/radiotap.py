"""The radiotap header that a monitor interface puts before each 802.11 frame (radiotap.org).

It is read as the standard defines it: a chain of presence words, then the fields in bit order at their
natural alignment (counted from the start of the header). Data of other namespaces is skipped by the length
given in it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from companion.errors import PeerDataError

_HEAD: Final = struct.Struct("<BBHI")
_WORD: Final = struct.Struct("<I")

_FLAGS: Final = 1
_RATE: Final = 2
_CHANNEL: Final = 3
_DBM_SIGNAL: Final = 5
_RX_FLAGS: Final = 14
_TX_FLAGS: Final = 15
_ZERO_LENGTH_PSDU: Final = 26
_TLV: Final = 28
_RADIOTAP_NAMESPACE: Final = 29
_VENDOR_NAMESPACE: Final = 30
_MORE: Final = 31

_FIELDS: Final[tuple[tuple[int, int], ...]] = (
    (8, 8),  # 0 TSFT
    (1, 1),  # 1 flags
    (1, 1),  # 2 rate
    (2, 4),  # 3 channel: MHz, flags
    (2, 2),  # 4 FHSS
    (1, 1),  # 5 antenna signal, dBm
    (1, 1),  # 6 antenna noise, dBm
    (2, 2),  # 7 lock quality
    (2, 2),  # 8 TX attenuation
    (2, 2),  # 9 TX attenuation, dB
    (1, 1),  # 10 TX power, dBm
    (1, 1),  # 11 antenna
    (1, 1),  # 12 antenna signal, dB
    (1, 1),  # 13 antenna noise, dB
    (2, 2),  # 14 RX flags
    (2, 2),  # 15 TX flags
    (1, 1),  # 16 RTS retries
    (1, 1),  # 17 data retries
    (4, 8),  # 18 extended channel
    (1, 3),  # 19 MCS
    (4, 8),  # 20 A-MPDU status
    (2, 12),  # 21 VHT
    (8, 12),  # 22 timestamp
    (2, 12),  # 23 HE
    (2, 12),  # 24 HE-MU
    (2, 6),  # 25 HE-MU, other user
    (1, 1),  # 26 zero-length PSDU
    (2, 4),  # 27 L-SIG
)
"""Alignment and size of each field by its bit. Bit 28 means that the rest of the header is a list of TLVs."""
_VENDOR_HEAD: Final = (2, 6)
"""Alignment and size of the vendor header: OUI, sub-namespace, length of the data after it."""

_FLAG_FCS: Final = 0x10
_FLAG_BAD_FCS: Final = 0x40
_RX_FLAG_BAD_PLCP: Final = 0x0002
_TX_FLAG_NO_ACK: Final = 0x0008
_FCS_SIZE: Final = 4


@dataclass(frozen=True, slots=True)
class Radiotap:
    """A captured frame and what the card reports about it."""

    frame: bytes
    """802.11 frame without frame check sequence. Empty only if the card reports a zero-length PSDU."""
    rssi_dbm: float | None
    channel_mhz: int | None
    """Centre frequency."""
    bad_fcs: bool
    """The frame's check sequence or PLCP header failed, so its bytes must not be trusted."""
    transmitted: bool
    """The card sent this frame itself (TX flags are present); it did not receive it."""


def parse_radiotap(data: bytes) -> Radiotap:
    """Parse the header and return the frame after it.

    If a field is given several times (per antenna), the first one counts.

    Raises:
        PeerDataError: the header is truncated or inconsistent. The text names the offset.
    """
    if len(data) < _HEAD.size:
        raise PeerDataError(f"radiotap header of {len(data)} bytes, shorter than its {_HEAD.size} fixed ones")
    version, _, length, _ = _HEAD.unpack_from(data)
    if version != 0:
        raise PeerDataError(f"radiotap version is {version}; allowed: 0")
    if not _HEAD.size <= length <= len(data):
        raise PeerDataError(f"radiotap length is {length}, in {len(data)} bytes")
    fields: dict[int, int] = {}
    for bit, offset in _walk(data, length):
        fields.setdefault(bit, offset)
    flags = data[fields[_FLAGS]] if _FLAGS in fields else 0
    rx_flags = _u16(data, fields[_RX_FLAGS]) if _RX_FLAGS in fields else 0
    end = len(data) - (_FCS_SIZE if flags & _FLAG_FCS else 0)
    if end <= length and _ZERO_LENGTH_PSDU not in fields:
        raise PeerDataError(f"no frame behind the radiotap header of {length} bytes in {len(data)}")
    signal = fields.get(_DBM_SIGNAL)
    channel = fields.get(_CHANNEL)
    return Radiotap(
        frame=data[length:end],
        rssi_dbm=None if signal is None else float(struct.unpack_from("<b", data, signal)[0]),
        channel_mhz=None if channel is None else _u16(data, channel),
        bad_fcs=bool(flags & _FLAG_BAD_FCS or rx_flags & _RX_FLAG_BAD_PLCP),
        transmitted=_TX_FLAGS in fields,
    )


def build_radiotap(rate_500kbps: int = 2, *, no_ack: bool = True) -> bytes:
    """Build the header for a frame to inject: rate and TX flags, 12 bytes. Raises ValueError.

    Args:
        rate_500kbps: Legacy rate in units of 500 kb/s; 2 is 1 Mb/s (2.4 GHz only), 12 is 6 Mb/s.
        no_ack: Expect no acknowledgement, so that the frame is sent only once.
    """
    if not 0 < rate_500kbps <= 0xFF:
        raise ValueError(f"rate_500kbps is {rate_500kbps!r}; allowed: 1 to 255")
    present = 1 << _RATE | 1 << _TX_FLAGS
    tail = struct.pack("<BxH", rate_500kbps, _TX_FLAG_NO_ACK if no_ack else 0)
    return _HEAD.pack(0, 0, _HEAD.size + len(tail), present) + tail


def _walk(data: bytes, length: int) -> Iterator[tuple[int, int]]:
    """Yield bit and offset of each field of the radiotap namespace. All lie inside the header."""
    words = _presence_words(data, length)
    offset = _HEAD.size + _WORD.size * (len(words) - 1)
    vendor = False
    for word in words:
        if not vendor:
            for bit, (alignment, size) in enumerate(_FIELDS):
                if word >> bit & 1:
                    offset = _place(offset, alignment, size, length, f"field {bit}")
                    yield bit, offset
                    offset += size
            if word >> _TLV & 1:
                return  # the following TLVs carry their own types; we read none of them
        if word >> _VENDOR_NAMESPACE & 1:
            if word >> _RADIOTAP_NAMESPACE & 1:
                raise PeerDataError(f"radiotap presence word 0x{word:08x} names two namespaces")
            offset = _place(offset, *_VENDOR_HEAD, length, "vendor namespace")
            skip = _u16(data, offset + 4)
            offset = _place(offset + _VENDOR_HEAD[1], 1, skip, length, "vendor data") + skip
            vendor = True
        elif word >> _RADIOTAP_NAMESPACE & 1:
            vendor = False
        elif not vendor:
            return  # this word continues with bit 32, where no field is defined


def _presence_words(data: bytes, length: int) -> list[int]:
    words: list[int] = []
    offset = _HEAD.size - _WORD.size
    while not words or words[-1] >> _MORE & 1:
        if offset + _WORD.size > length:
            raise PeerDataError(f"radiotap presence words run past the header's end at {length}")
        words += _WORD.unpack_from(data, offset)
        offset += _WORD.size
    return words


def _place(offset: int, alignment: int, size: int, length: int, name: str) -> int:
    """Return the aligned start of a field. Raises PeerDataError if it does not end inside the header."""
    start = (offset + alignment - 1) // alignment * alignment
    if start + size > length:
        raise PeerDataError(f"radiotap {name} of {size} bytes at {start} runs past the end at {length}")
    return start


def _u16(data: bytes, offset: int) -> int:
    return int.from_bytes(data[offset : offset + 2], "little")
