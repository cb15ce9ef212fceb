"""Datagrams between the simulated air and its clients (UDP on loopback), version 1.

    byte 0-1  "EA"
    byte 2    version, 1
    byte 3    kind
    from 4    body

| kind | direction | body |
|---|---|---|
| 1 JOIN | client -> air | name, UTF-8, 1 to 80 bytes. Repeated every 2 s; after 10 s of silence it has left |
| 2 LEAVE | client -> air | empty |
| 3 SEND | client -> air | transport, address, frame |
| 4 HEARD | air -> client | transport, address, frame |
| 5 WELCOME | air -> client | number of clients now on the air, u16 little-endian. Answers every JOIN |

transport: 1 BLE 4, 2 BLE 5, 3 Wi-Fi beacon, 4 Wi-Fi NAN. address: 6 bytes as written, most significant first.
frame: 1 to 1,000 bytes. Any valid datagram from an unknown client also joins that client. Without a JOIN, its
name is its port.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from companion.errors import ConfigError, PeerDataError
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN

MAX_DATAGRAM = 1100
MAX_NAME_BYTES = 80
MAX_FRAME_BYTES = 1000
SILENCE_S = 10.0
"""A client that sends nothing for this long is removed."""
JOIN_PERIOD_S = 2.0
"""Period at which a client repeats JOIN to stay on the air."""

_HEAD = struct.Struct("<2sBB")
_CLIENTS = struct.Struct("<H")
_MAGIC = b"EA"
_VERSION = 1
_ADDRESS_BYTES = 6
_CODES = {BLE4: 1, BLE5: 2, WIFI_BEACON: 3, WIFI_NAN: 4}
_TRANSPORTS = {code: name for name, code in _CODES.items()}


@dataclass(frozen=True, slots=True)
class Join:
    """A client joins, or confirms that it is still present."""

    name: str


@dataclass(frozen=True, slots=True)
class Leave:
    """A client leaves."""


@dataclass(frozen=True, slots=True)
class Send:
    """A client sends a frame."""

    transport: str
    address: str
    frame: bytes


@dataclass(frozen=True, slots=True)
class Heard:
    """The air delivers a frame to a client."""

    transport: str
    address: str
    frame: bytes


@dataclass(frozen=True, slots=True)
class Welcome:
    """The air answers a JOIN with the number of clients on it."""

    clients: int


Datagram = Join | Leave | Send | Heard | Welcome


def encode(datagram: Datagram) -> bytes:
    """Encode a datagram.

    Raises:
        ValueError: a name, address, transport or frame outside the limits in the module docstring.
    """
    match datagram:
        case Join(name=name):
            body = name.encode()
            if not 1 <= len(body) <= MAX_NAME_BYTES:
                raise ValueError(f"name of {len(body)} bytes; allowed: 1 to {MAX_NAME_BYTES}")
            return _head(1) + body
        case Leave():
            return _head(2)
        case Send():
            return _head(3) + _frame_body(datagram)
        case Heard():
            return _head(4) + _frame_body(datagram)
        case Welcome(clients=clients):
            return _head(5) + _CLIENTS.pack(min(clients, 0xFFFF))


def decode(data: bytes) -> Datagram:
    """Decode the datagram in `data`.

    Raises:
        PeerDataError: the bytes are no valid datagram. The text names the field.
    """
    if len(data) < _HEAD.size:
        raise PeerDataError(f"ether datagram of {len(data)} bytes, shorter than its header of {_HEAD.size}")
    magic, version, kind = _HEAD.unpack_from(data)
    if magic != _MAGIC:
        raise PeerDataError("ether datagram: wrong magic")
    if version != _VERSION:
        raise PeerDataError(f"ether datagram: version {version}, expected {_VERSION}")
    body = data[_HEAD.size :]
    if kind == 1:
        return Join(_name(body))
    if kind == 2 and not body:
        return Leave()
    if kind == 3:
        return Send(*_frame_fields(body))
    if kind == 4:
        return Heard(*_frame_fields(body))
    if kind == 5 and len(body) == _CLIENTS.size:
        return Welcome(_CLIENTS.unpack(body)[0])
    raise PeerDataError(f"ether datagram: kind {kind} with {len(body)} bytes")


def parse_endpoint(text: str, key: str) -> tuple[str, int]:
    """Split "HOST:PORT".

    Raises:
        ConfigError: the text has another form. The error names `key`.
    """
    host, _, port = text.rpartition(":")
    if not host or not (port.isascii() and port.isdigit()) or int(port) > 65535:
        raise ConfigError(f"{key}: {text!r}: expected HOST:PORT, such as 127.0.0.1:14640")
    return host, int(port)


def _head(kind: int) -> bytes:
    return _HEAD.pack(_MAGIC, _VERSION, kind)


def _frame_body(datagram: Send | Heard) -> bytes:
    code = _CODES.get(datagram.transport)
    if code is None:
        raise ValueError(f"transport {datagram.transport!r} is not one of {sorted(_CODES)}")
    address = bytes.fromhex(datagram.address.replace(":", ""))
    if len(address) != _ADDRESS_BYTES:
        raise ValueError(f"address {datagram.address!r} is not {_ADDRESS_BYTES} bytes")
    if not 1 <= len(datagram.frame) <= MAX_FRAME_BYTES:
        raise ValueError(f"frame of {len(datagram.frame)} bytes; allowed: 1 to {MAX_FRAME_BYTES}")
    return bytes((code,)) + address + datagram.frame


def _frame_fields(body: bytes) -> tuple[str, str, bytes]:
    start = 1 + _ADDRESS_BYTES
    if not start < len(body) <= start + MAX_FRAME_BYTES:
        raise PeerDataError(
            f"ether datagram: frame of {len(body) - start} bytes; allowed: 1 to {MAX_FRAME_BYTES}"
        )
    transport = _TRANSPORTS.get(body[0])
    if transport is None:
        raise PeerDataError(f"ether datagram: unknown transport {body[0]}")
    return transport, body[1:start].hex(":"), body[start:]


def _name(body: bytes) -> str:
    if not 1 <= len(body) <= MAX_NAME_BYTES:
        raise PeerDataError(f"ether datagram: name of {len(body)} bytes; allowed: 1 to {MAX_NAME_BYTES}")
    try:
        name = body.decode()
    except UnicodeDecodeError as error:
        raise PeerDataError("ether datagram: name is not UTF-8") from error
    if not name.isprintable():
        raise PeerDataError("ether datagram: name is not printable")
    return name
