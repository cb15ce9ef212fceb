"""Serves a few constant files over MAVLink FTP, for reading only (mavlink.io, services/ftp).

Each request payload has one reply payload. The client asks again for what got lost, and the same request has
the same answer. A burst is one packet long, which the protocol allows: the client then asks for the next one.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

PAYLOAD_BYTES = 251
"""Length of FILE_TRANSFER_PROTOCOL's payload."""
DATA_BYTES = 239
"""Length of the payload after its header."""
MOST_SESSIONS = 8
"""Largest number of open files of all clients together. Beyond it, the file opened first is closed."""
_HEAD = struct.Struct("<HBBBBBxI")
_U32 = struct.Struct("<I")
_ACK: int = mavlink.MAV_FTP_OPCODE_ACK
_NAK: int = mavlink.MAV_FTP_OPCODE_NAK
_BURST: int = mavlink.MAV_FTP_OPCODE_BURSTREADFILE


class Reply(NamedTuple):
    """Reply to one request."""

    payload: bytes
    """Always `PAYLOAD_BYTES` long."""
    refused: bool
    """Whether the reply is a NAK other than the end of the file."""


class _NakError(Exception):
    """Carries the MAV_FTP_ERR of a NAK."""

    def __init__(self, error: int) -> None:
        super().__init__()
        self.error = error


def crc32(data: bytes) -> int:
    """MAVLink's CRC-32. It is zlib's without the inversion at both ends (mavlink.io, guide/crc)."""
    return zlib.crc32(data, 0xFFFF_FFFF) ^ 0xFFFF_FFFF


def is_request(payload: bytes) -> bool:
    """Whether a payload is a request. An ACK or a NAK must not be answered."""
    return payload[3] < _ACK


def sequence(payload: bytes) -> int:
    """Sequence number of a request. A repeated request has the same number."""
    return payload[0] | payload[1] << 8


class FileServer:
    """Answers requests for the files. A session is a client's own number for a file that it has opened."""

    def __init__(self, files: Mapping[str, bytes]) -> None:
        """Serve these files, by their path from the root without a leading slash."""
        self._files = {path.encode("ascii"): data for path, data in files.items()}
        self._open: dict[tuple[int, int, int], bytes] = {}
        """(System, component, session) -> the open file, in order of opening."""

    def reply(self, system_id: int, component_id: int, request: bytes) -> Reply:
        """Answer one request of a client. Every request gets an answer, even an invalid one.

        Args:
            request: the payload, `PAYLOAD_BYTES` long.
        """
        seq, session, opcode, size, _, _, offset = _HEAD.unpack_from(request)
        key, refused = (system_id, component_id, session), False
        try:
            if size > DATA_BYTES:
                raise _NakError(mavlink.MAV_FTP_ERR_INVALIDDATASIZE)
            kind, data = _ACK, self._answer(key, opcode, size, offset, request[_HEAD.size :][:size])
        except _NakError as nak:
            kind, data, refused = _NAK, bytes((nak.error,)), nak.error != mavlink.MAV_FTP_ERR_EOF
        head = _HEAD.pack((seq + 1) & 0xFFFF, session, kind, len(data), opcode, opcode == _BURST, offset)
        return Reply((head + data).ljust(PAYLOAD_BYTES, b"\0"), refused)

    def _answer(self, key: tuple[int, int, int], opcode: int, size: int, offset: int, data: bytes) -> bytes:
        """Data of the ACK."""
        if opcode == mavlink.MAV_FTP_OPCODE_NONE:
            return b""
        if opcode == mavlink.MAV_FTP_OPCODE_TERMINATESESSION:
            self._open.pop(key, None)
            return b""
        if opcode == mavlink.MAV_FTP_OPCODE_RESETSESSION:
            # A reset closes the client's own files, not those of another client.
            self._open = {k: file for k, file in self._open.items() if k[:2] != key[:2]}
            return b""
        if opcode == mavlink.MAV_FTP_OPCODE_OPENFILERO:
            file = self._file(data)
            self._open.pop(key, None)
            if len(self._open) >= MOST_SESSIONS:
                del self._open[next(iter(self._open))]
            self._open[key] = file
            return _U32.pack(len(file))
        if opcode == mavlink.MAV_FTP_OPCODE_CALCFILECRC:
            return _U32.pack(crc32(self._file(data)))
        if opcode not in (mavlink.MAV_FTP_OPCODE_READFILE, _BURST):
            raise _NakError(mavlink.MAV_FTP_ERR_UNKNOWNCOMMAND)
        if key not in self._open:
            raise _NakError(mavlink.MAV_FTP_ERR_INVALIDSESSION)
        if size == 0:
            raise _NakError(mavlink.MAV_FTP_ERR_INVALIDDATASIZE)
        piece = self._open[key][offset : offset + size]
        if not piece:
            raise _NakError(mavlink.MAV_FTP_ERR_EOF)
        return piece

    def _file(self, path: bytes) -> bytes:
        file = self._files.get(path.split(b"\0", 1)[0].removeprefix(b"/"))
        if file is None:
            raise _NakError(mavlink.MAV_FTP_ERR_FILENOTFOUND)
        return file
