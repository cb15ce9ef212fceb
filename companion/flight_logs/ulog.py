"""Reads PX4's ULog files (.ulg) as a stream.

The format is that of https://docs.px4.io/main/en/dev_log/ulog_file_format.html: a header of 16 bytes, then
messages of a length (2 bytes), a type (1 byte) and content, little endian. Formats and subscriptions come
before the data that use them. After a damaged place the reader goes on at the next synchronisation mark.
"""

from __future__ import annotations

import itertools
import os
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import BinaryIO

from companion.errors import PeerDataError
from companion.flight_logs.logged import LogCounts, plain

MAGIC = b"ULog\x01\x12\x35"
_HEADER = struct.Struct("<7sBQ")
_HEAD = struct.Struct("<HB")
_SYNC = bytes([0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12])
_KINDS = frozenset(b"BFIMPQARDLCSO")
_DATA = ord("D")
_CHUNK = 1 << 20
_SIZES = {
    "int8_t": "b", "uint8_t": "B", "int16_t": "h", "uint16_t": "H", "int32_t": "i", "uint32_t": "I",
    "int64_t": "q", "uint64_t": "Q", "float": "f", "double": "d", "bool": "?", "char": "s",
}  # fmt: skip
_MOST_NESTED = 8
_MOST_BYTES = 65535
"""Most bytes of one message: its length has two bytes."""
Value = float | bool | str | tuple[float, ...]
Fields = dict[str, Value]


@dataclass(frozen=True, slots=True)
class Logged:
    """A text of the autopilot."""

    time_s: float
    severity: int
    """As MAV_SEVERITY, 0 to 7."""
    text: str


@dataclass(slots=True)
class Told:
    """Facts about the vehicle that the log states once."""

    start_s: float = 0.0
    info: dict[str, str | float] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)


class _Topic:
    """How the messages of one subscription are laid out, as far as they are wanted."""

    def __init__(self, name: str, instance: int, parts: list[tuple[str, str, int]]) -> None:
        """Lay out the topic.

        Args:
            name: the topic.
            instance: its number among several of the same topic.
            parts: name (empty for what is skipped), code and number of elements of every field, in order.
        """
        self.name = name
        self.instance = instance
        self._struct = struct.Struct("<" + "".join(f"{count}{code}" for _, code, count in parts))
        self.length = 2 + self._struct.size
        """Length of a message's content, without padding at its end, which need not be there."""
        self._wanted = [(name, code, count) for name, code, count in parts if name]

    def fields(self, buffer: bytes, at: int) -> Fields:
        values = iter(self._struct.unpack_from(buffer, at))
        found: Fields = {}
        for name, code, count in self._wanted:
            if code == "s":
                found[name] = _text(next(values))
            else:
                found[name] = next(values) if count == 1 else tuple(itertools.islice(values, count))
        return found


class UlogReader:
    """Reads the messages of a log one after the other."""

    def __init__(
        self, stream: BinaryIO, name: str, wanted: Mapping[str, frozenset[str]], counts: LogCounts
    ) -> None:
        """Read the header.

        Args:
            stream: the file, read from its beginning as needed.
            name: what to call it in errors.
            wanted: topics to yield, with those of their fields that are read, where a log has them.
            counts: filled in while reading.

        Raises:
            PeerDataError: this is no ULog file.
        """
        self._stream = stream
        self._name = name
        self._wanted = wanted
        self._counts = counts
        self._formats: dict[str, list[tuple[str, int, str]]] = {}
        self._lengths: dict[str, int] = {}
        """Bytes of one element of each type that was measured."""
        self._topics: dict[int, _Topic] = {}
        self._sizes: dict[int, tuple[int, int]] = {}
        """Lengths that the data of each subscription may have."""
        self._size_bytes = stream.seek(0, os.SEEK_END)
        stream.seek(0)
        self._buffer = stream.read(_HEADER.size)
        self._at = _HEADER.size
        self._offset = 0
        """Offset of the buffer in the file."""
        self._ends: list[int] = []
        """Offsets at which a part of the file ends and another one was appended."""
        if len(self._buffer) < _HEADER.size or not self._buffer.startswith(MAGIC):
            raise PeerDataError(f"{name}: this is no ULog file: its first bytes are {self._buffer[:8]!r}")
        _, _, start_us = _HEADER.unpack(self._buffer)
        self.told = Told(start_us / 1e6)

    def messages(self) -> Iterator[tuple[str, int, Fields] | Logged]:
        """Yield each wanted message: its topic, instance and fields; and each text.

        Raises:
            PeerDataError: the log is of a kind that is not known.
        """
        while True:
            yield from self._data()
            head = self._head()
            if head is None:
                return
            size, kind = head
            content = self._at + _HEAD.size
            if kind == _DATA:
                continue  # the buffer now holds all of it, so it is read in the next round
            found = self._other(chr(kind), self._buffer[content : content + size])
            self._at = content + size
            self._counts.messages += 1
            if found is not None:
                yield found

    def _data(self) -> Iterator[tuple[str, int, Fields]]:
        """Yield the data in the buffer up to the first place that needs a closer look."""
        buffer, sizes, topics, counts = self._buffer, self._sizes, self._topics, self._counts
        at, end = self._at, min(len(buffer), self._part_end() - self._offset)
        while at + _HEAD.size + 2 <= end:
            size, kind = _HEAD.unpack_from(buffer, at)
            after = at + _HEAD.size + size
            if kind != _DATA or after > end:
                break
            number = buffer[at + 3] | buffer[at + 4] << 8
            if number not in sizes or size not in sizes[number]:
                break
            counts.messages += 1
            topic = topics.get(number)
            if topic is not None:
                self._at = after
                yield topic.name, topic.instance, topic.fields(buffer, at + 5)
            at = after
        self._at = at

    def _head(self) -> tuple[int, int] | None:
        """Length and type of the next message, which is whole; None at the end."""
        while True:
            if len(self._buffer) - self._at < _HEAD.size + _MOST_BYTES and self._more():
                continue
            left = min(len(self._buffer) - self._at, self._part_end() - self._offset - self._at)
            if left >= _HEAD.size:
                size, kind = _HEAD.unpack_from(self._buffer, self._at)
                if self._is_sound(size, kind):
                    if _HEAD.size + size <= left:
                        return size, kind
                elif self._skip():
                    continue
                else:
                    left = 0
            if not self._ends:
                self._counts.torn_bytes = left
                return None
            # The rest of a part that was not finished when something was appended.
            self._go_to(self._ends.pop(0))

    def _more(self) -> bool:
        more = self._stream.read(_CHUNK)
        if more:
            self._offset += self._at
            self._buffer, self._at = self._buffer[self._at :] + more, 0
        return bool(more)

    def _part_end(self) -> int:
        return self._ends[0] if self._ends else self._offset + len(self._buffer)

    def _go_to(self, offset: int) -> None:
        self._stream.seek(offset)
        self._offset, self._buffer, self._at = offset, b"", 0

    def _is_sound(self, size: int, kind: int) -> bool:
        if kind == _DATA and size < 2:
            return False
        if kind == _DATA and len(self._buffer) - self._at >= _HEAD.size + 2:
            (number,) = struct.unpack_from("<H", self._buffer, self._at + _HEAD.size)
            return size in self._sizes.get(number, ())
        return kind in _KINDS

    def _skip(self) -> bool:
        """Continue after the next synchronisation mark of this part; False if there is none."""
        start = self._offset + self._at
        self._counts.damaged_spans += 1
        while True:
            end = self._ends[0] - self._offset if self._ends else len(self._buffer)
            found = self._buffer.find(_SYNC, self._at, end)
            if found >= 0:
                self._at = found + len(_SYNC)
                break
            self._at = max(self._at, min(end, len(self._buffer)) - len(_SYNC) + 1)
            if (self._ends and end <= len(self._buffer)) or not self._more():
                self._at = min(end, len(self._buffer))
                break
        self._counts.damaged_bytes += self._offset + self._at - start
        return found >= 0

    def _other(self, kind: str, content: bytes) -> Logged | None:
        """Take in a message other than data. Returns the text that it logs; None if it is no text."""
        try:
            match kind:
                case "L":
                    level, time_us = struct.unpack_from("<BQ", content)
                    return Logged(time_us / 1e6, _severity(level), _text(content[9:]))
                case "C":
                    level, _, time_us = struct.unpack_from("<BHQ", content)
                    return Logged(time_us / 1e6, _severity(level), _text(content[11:]))
                case "F":
                    self._format(content.decode("ascii"))
                case "A":
                    instance, number = struct.unpack_from("<BH", content)
                    self._subscribe(number, instance, content[3:].decode("ascii"))
                case "I" | "P":
                    self._key(kind, content)
                case "O":
                    self._counts.dropouts += 1
                    self._counts.dropouts_s += struct.unpack_from("<H", content)[0] / 1e3
                case "B" if not self._counts.messages:  # only the first message may hold the flags
                    self._flags(content)
                case _:
                    pass
        except (struct.error, ValueError, KeyError, IndexError):
            self._counts.bad_values += 1
        return None

    def _flags(self, content: bytes) -> None:
        incompatible, offsets = content[8:16], struct.unpack_from("<3Q", content, 16)
        if incompatible[0] & ~1 or any(incompatible[1:]):
            raise PeerDataError(
                f"{self._name}: this ULog file has parts of a kind that is not known "
                f"(incompatible flags {incompatible.hex()}); allowed: data appended to the file"
            )
        if incompatible[0] & 1:
            self._ends = sorted(offset for offset in offsets if _HEADER.size < offset < self._size_bytes)

    def _format(self, text: str) -> None:
        """Take in a message's format: NAME:TYPE FIELD;TYPE[COUNT] FIELD;..."""
        name, _, rest = text.partition(":")
        fields = []
        for one in filter(None, rest.split(";")):
            kind, _, column = one.strip().partition(" ")
            kind, _, count = kind.partition("[")
            fields.append((kind, int(count.rstrip("]")) if count else 1, column))
        self._formats[name] = fields
        self._lengths.clear()

    def _subscribe(self, number: int, instance: int, name: str) -> None:
        fields, padding = self._formats[name], 0
        if fields and fields[-1][2].startswith("_padding"):
            padding, fields = fields[-1][1], fields[:-1]
        wanted = self._wanted.get(name, frozenset())
        parts = []
        for kind, count, column in fields:
            if column in wanted and kind in _SIZES:
                parts.append((column, _SIZES[kind], count))
            else:
                parts.append(("", "x", count * self._size(kind, 0)))
        topic = _Topic(name, instance, parts)
        self._sizes[number] = topic.length, topic.length + padding
        if name in self._wanted:
            self._topics[number] = topic

    def _size(self, kind: str, depth: int) -> int:
        if kind in _SIZES:
            return struct.calcsize("<" + _SIZES[kind])
        if depth > _MOST_NESTED:
            raise ValueError(f"format {kind} contains itself")
        if kind not in self._lengths:
            parts = (count * self._size(inner, depth + 1) for inner, count, _ in self._formats[kind])
            self._lengths[kind] = sum(parts)
        if not 0 <= self._lengths[kind] <= _MOST_BYTES:
            raise ValueError(f"format {kind} is longer than a message")
        return self._lengths[kind]

    def _key(self, kind: str, content: bytes) -> None:
        """Take in an information or a parameter: a length, TYPE NAME, and the value."""
        length = content[0]
        type_name, _, key = content[1 : 1 + length].decode("ascii").partition(" ")
        value = content[1 + length :]
        found: str | float
        if type_name.startswith("char"):
            found = _text(value)
        else:
            found = struct.unpack_from("<" + _SIZES[type_name], value)[0]
        if kind == "I":
            self.told.info[key] = found
        elif not isinstance(found, str):
            self.told.parameters[key] = found


def _severity(level: int) -> int:
    """Severity of a text's level, which is a digit."""
    return min(max(level - ord("0"), 0), 7)


def _text(content: bytes) -> str:
    return plain(content.decode("utf-8", "replace"))
