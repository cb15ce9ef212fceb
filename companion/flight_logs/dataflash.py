"""Reads ArduPilot's DataFlash logs (.bin) as a stream.

A log is a row of messages: the bytes A3 95, a byte for the type, and the fields without gaps, little endian.
FMT messages (type 128) describe all types, so that logs of all firmware versions can be read. Nothing has a
checksum: a message counts if another one, or the end of the file, follows where its length says so. Formats
and their characters are those of ArduPilot's AP_Logger (LogStructure.h).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO

from companion.errors import PeerDataError
from companion.flight_logs.logged import LogCounts, plain

HEAD = b"\xa3\x95"
_FMT_TYPE, _FMT_LENGTH = 128, 89
_FMT = struct.Struct("<BB4s16s64s")
_CHUNK = 1 << 20
_SEARCH_LIMIT = 65536
"""The first message of a log begins within this many bytes."""
_SCALED = {"c": ("h", 100), "C": ("H", 100), "e": ("i", 100), "E": ("I", 100), "L": ("i", 10_000_000)}
"""Format characters of integers that are divided by a number."""
_PLAIN = {
    "a": "64s", "b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "f": "f", "d": "d", "n": "4s",
    "N": "16s", "Z": "64s", "M": "B", "q": "q", "Q": "Q", "g": "e",
}  # fmt: skip
Fields = dict[str, float | str]
"""A message's fields by their names, in the units that the format characters say."""


class _Format:
    """How the messages of one type are laid out."""

    def __init__(self, name: str, length: int, characters: str, columns: list[str]) -> None:
        self.name = name
        self.length = length
        self.columns = columns
        self._struct = struct.Struct("<" + "".join(_layout(c) for c in characters))
        if self._struct.size + 3 > length:
            raise ValueError(f"{name}: {self._struct.size + 3} bytes of fields in {length}")
        self._divisors = [(n, _SCALED[c][1]) for n, c in enumerate(characters) if c in _SCALED]
        self._texts = [n for n, c in enumerate(characters) if c in "nNZ"]

    def fields(self, buffer: bytes, at: int) -> Fields:
        values = list(self._struct.unpack_from(buffer, at))
        for n, divisor in self._divisors:
            values[n] /= divisor
        for n in self._texts:
            values[n] = plain(values[n].decode("utf-8", "replace"))
        return dict(zip(self.columns, values, strict=False))


def _layout(character: str) -> str:
    return _SCALED[character][0] if character in _SCALED else _PLAIN[character]


class DataFlashReader:
    """Reads the messages of a log one after the other."""

    def __init__(self, stream: BinaryIO, name: str, wanted: frozenset[str], counts: LogCounts) -> None:
        """Begin at the stream's position.

        Args:
            stream: the file; it is read as needed.
            name: what to call it in errors.
            wanted: names of the messages to yield; the others are only counted.
            counts: filled in while reading.
        """
        self._stream = stream
        self._name = name
        self._wanted = wanted
        self._counts = counts
        self._formats: dict[int, _Format] = {}
        self._lengths = [0] * 256
        self._lengths[_FMT_TYPE] = _FMT_LENGTH
        self._factors: dict[str, float] = {}
        self._factor_ids: dict[int, str] = {}
        self._buffer = b""
        self._at = 0
        self._ended = False
        self._damaged = False

    def messages(self) -> Iterator[tuple[str, Fields]]:
        """Yield each wanted message: its name and its fields.

        Raises:
            PeerDataError: this is no DataFlash log.
        """
        while True:
            yield from self._whole()
            if not self._is_torn():
                self._skip()
            elif not self._more():
                break
        if not self._counts.messages:
            raise PeerDataError(f"{self._name}: this is no DataFlash log: it has no whole message")
        self._counts.torn_bytes = len(self._buffer) - self._at

    def factor(self, name: str, column: str) -> float | None:
        """Factor from a field's number to its SI unit, as the log itself says; None if it does not."""
        for kind, one in self._formats.items():
            if one.name == name and column in one.columns:
                ids, index = self._factor_ids.get(kind, ""), one.columns.index(column)
                return self._factors.get(ids[index]) if index < len(ids) else None
        return None

    def _more(self) -> bool:
        """Drop what was used and read on; False if the end was reached before."""
        if self._ended:
            return False
        more = self._stream.read(_CHUNK)
        self._ended = not more
        self._buffer, self._at = self._buffer[self._at :] + more, 0
        return True

    def _whole(self) -> Iterator[tuple[str, Fields]]:
        """Yield the messages in the buffer up to the first place that needs a closer look."""
        buffer, lengths, formats, counts = self._buffer, self._lengths, self._formats, self._counts
        start = at = self._at
        end = len(buffer)
        while at + 3 <= end and buffer[at] == 0xA3 and buffer[at + 1] == 0x95:
            kind = buffer[at + 2]
            length = lengths[kind]
            after = at + length
            if not length or after > end or (after + 2 > end and not self._ended):
                break
            if kind == _FMT_TYPE or kind in formats:
                if after + 2 <= end and buffer[after : after + 2] != HEAD:
                    break  # not followed by another one, so it may be damaged
                self._at = after
                if kind == _FMT_TYPE:
                    self._define(buffer, at + 3)
                else:
                    one = formats[kind]
                    fields = one.fields(buffer, at + 3)
                    if one.name in ("FMTU", "MULT"):
                        self._units(one.name, fields)
                    if one.name in self._wanted:
                        yield one.name, fields
            at = after
            counts.messages += 1
        self._damaged &= at == start
        self._at = at

    def _is_torn(self) -> bool:
        """Whether the rest of the buffer is empty or the beginning of a message, whose end follows or is
        missing."""
        left = len(self._buffer) - self._at
        if left < 3:
            return HEAD.startswith(self._buffer[self._at : self._at + 2])
        if self._buffer[self._at : self._at + 2] != HEAD:
            return False
        length = self._lengths[self._buffer[self._at + 2]]
        return bool(length) and (left < length or (left < length + 2 and not self._ended))

    def _skip(self) -> None:
        """Go to the next place where a message begins that is followed by another."""
        if not self._counts.messages and self._at > _SEARCH_LIMIT:
            raise PeerDataError(
                f"{self._name}: this is no DataFlash log: no message begins in its first bytes"
            )
        start = self._at
        at = self._buffer.find(HEAD, start + 1)
        if at < 0:
            # The last byte may be the first one of a head.
            at = len(self._buffer) - (not self._ended and self._buffer.endswith(HEAD[:1]))
        self._at = max(at, start + 1)
        self._counts.damaged_bytes += self._at - start
        self._counts.damaged_spans += not self._damaged
        self._damaged = True

    def _define(self, buffer: bytes, at: int) -> None:
        kind, length, name, characters, columns = _FMT.unpack_from(buffer, at)
        if kind == _FMT_TYPE:
            return
        try:
            one = _Format(
                plain(name.decode("ascii")),
                length,
                plain(characters.decode("ascii")),
                plain(columns.decode("ascii")).split(","),
            )
        except (ValueError, KeyError):  # a damaged description, or a format of the future
            self._counts.bad_values += 1
            return
        self._lengths[kind] = length
        if one.name in self._wanted or one.name in ("FMTU", "MULT"):
            self._formats[kind] = one
        else:
            self._formats.pop(kind, None)

    def _units(self, name: str, fields: Fields) -> None:
        try:
            if name == "MULT":
                self._factors[chr(int(fields["Id"]) & 0xFF)] = float(fields["Mult"])
            else:
                self._factor_ids[int(fields["FmtType"])] = str(fields["MultIds"])
        except (KeyError, ValueError, OverflowError):
            self._counts.bad_values += 1
