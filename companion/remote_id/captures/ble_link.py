"""Reads advertising data from Bluetooth LE packets as sniffers capture them.

Link layer packets follow Bluetooth Core vol. 6 part B sections 2.1 to 2.3 and 3.1.1 (CRC). The supported
capture headers are the nRF sniffer's (protocol versions 1 to 3) and LINKTYPE_BLUETOOTH_LE_LL_WITH_PHDR of
tcpdump.org. An advertisement that continues in AUX_CHAIN_IND PDUs is not reassembled; only its first PDU is
read.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from companion.errors import PeerDataError
from companion.remote_id.frames import NotRemoteIdError
from companion.remote_id.transports import BLE4, BLE5

_ADVERTISING_ACCESS: Final = b"\xd6\xbe\x89\x8e"
_CRC_SIZE: Final = 3
_CRC_START: Final = 0xAAAAAA
"""0x555555 with reversed bit order. The whole CRC is calculated bit-reversed here."""
_CRC_POLYNOMIAL: Final = 0xDA6000
_ADDRESS_SIZE: Final = 6

_LEGACY_WITH_DATA: Final = {0, 2, 4, 6}
"""ADV_IND, ADV_NONCONN_IND, SCAN_RSP, ADV_SCAN_IND."""
_EXTENDED: Final = 7
_HAS_ADDRESS, _HAS_AUX_POINTER = 0x01, 0x10

_NORDIC_HEAD: Final = 7
_NORDIC_BLE_HEAD: Final = 10
_NORDIC_PACKETS: Final = {2, 6}
"""nRF sniffer message types that hold a packet: 2 is advertising, 6 is data (in version 1, any packet)."""
_PHDR: Final = struct.Struct("<BbbB4sH")
_CODED: Final = 2
_AUX_CHAIN: Final = 1


@dataclass(frozen=True, slots=True)
class Sniffed:
    """A link layer packet and what the sniffer reports about it."""

    packet: bytes
    """Bytes from the access address to the CRC."""
    coded: bool = False
    """Coded PHY: a coding indicator follows the access address."""
    rssi_dbm: float | None = None
    crc_ok: bool | None = None
    """Whether the CRC is correct; None if the sniffer did not check it."""
    chained: bool = False
    """The sniffer reports an AUX_CHAIN_IND, which is the later part of an advertisement."""


@dataclass(frozen=True, slots=True)
class Advertisement:
    """Advertising data of one PDU."""

    transport: str
    address: str | None
    """Address of the advertiser; None if the PDU holds none."""
    data: bytes
    continues: bool
    """The advertisement continues in a further PDU."""


def strip_nordic(data: bytes) -> Sniffed:
    """Strip the header of LINKTYPE_NORDIC_BLE.

    Raises NotRemoteIdError for messages of the sniffer itself, PeerDataError for a broken header.
    """
    if len(data) <= _NORDIC_HEAD:
        raise PeerDataError(f"nRF sniffer header of {len(data)} bytes, at least {_NORDIC_HEAD + 1} expected")
    version, kind, head_size = data[3], data[6], data[7]
    if not 1 <= version <= 3:
        raise PeerDataError(f"nRF sniffer protocol version {version}; allowed: 1 to 3")
    if kind not in _NORDIC_PACKETS:
        raise NotRemoteIdError(f"message {kind} of the nRF sniffer")
    start = _NORDIC_HEAD + head_size
    if head_size < _NORDIC_BLE_HEAD or len(data) < start:
        raise PeerDataError(f"nRF sniffer packet header of {head_size} bytes in {len(data)}")
    flags = data[8]
    return Sniffed(
        packet=data[start:],
        coded=flags >> 4 & 7 == _CODED,
        rssi_dbm=-float(data[10]),
        crc_ok=bool(flags & 1),
        chained=version == 3 and kind == 2 and flags >> 1 & 3 == _AUX_CHAIN,
    )


def strip_pseudo_header(data: bytes) -> Sniffed:
    """Strip the header of LINKTYPE_BLUETOOTH_LE_LL_WITH_PHDR. Raises PeerDataError."""
    if len(data) < _PHDR.size:
        raise PeerDataError(f"BLE pseudo-header of {len(data)} bytes, {_PHDR.size} expected")
    _, signal, _, _, _, flags = _PHDR.unpack_from(data)
    if not flags & 0x0001:
        raise PeerDataError("BLE packet that is still whitened")
    return Sniffed(
        packet=data[_PHDR.size :],
        coded=flags >> 14 == _CODED,
        rssi_dbm=float(signal) if flags & 0x0002 else None,
        crc_ok=bool(flags & 0x0800) if flags & 0x0400 else None,
        chained=flags >> 7 & 7 == 1 and flags >> 12 & 3 == _AUX_CHAIN,
    )


def crc_holds(sniffed: Sniffed) -> bool:
    """Whether the packet is intact, as the sniffer reports it or else by the packet's own CRC."""
    if sniffed.crc_ok is not None:
        return sniffed.crc_ok
    pdu, crc = _pdu_and_crc(sniffed)
    return crc == _crc(pdu)


def advertisement(sniffed: Sniffed) -> Advertisement:
    """Return the advertising data of a packet for which `crc_holds` is true.

    Raises NotRemoteIdError for another kind of packet, PeerDataError for inconsistent lengths.
    """
    pdu, _ = _pdu_and_crc(sniffed)
    kind, payload = pdu[0] & 15, pdu[2:]
    if sniffed.chained:
        raise NotRemoteIdError("the later part of an advertisement")
    if kind in _LEGACY_WITH_DATA:
        if len(payload) < _ADDRESS_SIZE:
            raise PeerDataError(f"advertising PDU with {len(payload)} bytes, shorter than its address")
        return Advertisement(
            BLE4, _address(payload[:_ADDRESS_SIZE]), payload[_ADDRESS_SIZE:], continues=False
        )
    if kind != _EXTENDED:
        raise NotRemoteIdError(f"advertising PDU of type {kind}, which holds no data")
    if not payload:
        raise PeerDataError("extended advertising PDU without a header")
    head_size = payload[0] & 0x3F
    head, data = payload[1 : 1 + head_size], payload[1 + head_size :]
    if len(head) < head_size:
        raise PeerDataError(f"extended advertising header of {head_size} bytes in {len(payload) - 1}")
    flags = head[0] if head else 0
    address = None
    if flags & _HAS_ADDRESS:
        if len(head) < 1 + _ADDRESS_SIZE:
            raise PeerDataError(f"extended advertising header of {head_size} bytes, shorter than its address")
        address = _address(head[1 : 1 + _ADDRESS_SIZE])
    return Advertisement(BLE5, address, data, continues=bool(flags & _HAS_AUX_POINTER))


def _pdu_and_crc(sniffed: Sniffed) -> tuple[bytes, bytes]:
    """Return the PDU with its header, and the CRC, of an advertising channel packet."""
    packet = sniffed.packet
    if len(packet) < len(_ADVERTISING_ACCESS):
        raise PeerDataError(f"BLE packet of {len(packet)} bytes, shorter than its access address")
    if not packet.startswith(_ADVERTISING_ACCESS):
        raise NotRemoteIdError("a packet of a connection, not an advertisement")
    start = len(_ADVERTISING_ACCESS) + (1 if sniffed.coded else 0)
    if len(packet) < start + 2:
        raise PeerDataError(f"BLE packet of {len(packet)} bytes, shorter than its header")
    end = start + 2 + packet[start + 1]
    if len(packet) < end + _CRC_SIZE:
        raise PeerDataError(f"BLE packet of {len(packet)} bytes, {end + _CRC_SIZE} announced")
    return packet[start:end], packet[end : end + _CRC_SIZE]


def _crc(pdu: bytes) -> bytes:
    register = _CRC_START
    for byte in pdu:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (_CRC_POLYNOMIAL if register & 1 else 0)
    return register.to_bytes(_CRC_SIZE, "little")


def _address(octets: bytes) -> str:
    return octets[::-1].hex(":")
