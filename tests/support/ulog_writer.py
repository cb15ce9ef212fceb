"""Writes small ULog files, as https://docs.px4.io/main/en/dev_log/ulog_file_format.html describes them."""

from __future__ import annotations

import re
import struct
from pathlib import Path

MAGIC = b"ULog\x01\x12\x35\x01"
SYNC = bytes([0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12])
_CODES = {
    "int8_t": "b", "uint8_t": "B", "int16_t": "h", "uint16_t": "H", "int32_t": "i", "uint32_t": "I",
    "int64_t": "q", "uint64_t": "Q", "float": "f", "double": "d", "bool": "?", "char": "s",
}  # fmt: skip
_OFFSETS_AT = 16 + 3 + 16
"""Position of the offsets of appended data: after the file header, the message header and the flags."""


class UlogWriter:
    """Collects messages in `content`."""

    def __init__(self, start_us: int) -> None:
        self.content = MAGIC + struct.pack("<Q", start_us)
        self._layouts: dict[str, str] = {}
        self._fields: dict[str, str] = {}
        self._numbers: dict[tuple[str, int], int] = {}
        self._appended = 0
        self.message("B", bytes(40))

    def message(self, kind: str, content: bytes) -> None:
        """Append a message."""
        self.content += struct.pack("<H", len(content)) + kind.encode() + content

    def info(self, type_name: str, key: str, value: float | str) -> None:
        """Append an information message about the vehicle."""
        self.message("I", self._pair(type_name, key, value))

    def parameter(self, type_name: str, key: str, value: float) -> None:
        """Append a parameter."""
        self.message("P", self._pair(type_name, key, value))

    def define(self, name: str, fields: str) -> None:
        """Describe a topic: TYPE NAME;TYPE[COUNT] NAME;..."""
        self.message("F", f"{name}:{fields}".encode())
        self._fields[name] = fields
        layout = ""
        for kind, count, column in re.findall(r"(\w+)(?:\[(\d+)\])? (\w+);", fields):
            if not column.startswith("_padding"):
                layout += f"{count}{_CODES[kind]}"
        self._layouts[name] = layout

    def same(self, name: str, other: str) -> None:
        """Describe a topic with the same fields as another one, in a separate format definition."""
        self.define(name, self._fields[other])

    def subscribe(self, name: str, instance: int = 0) -> None:
        """Begin to log a topic."""
        number = self._numbers[name, instance] = len(self._numbers)
        self.message("A", struct.pack("<BH", instance, number) + name.encode())

    def data(self, name: str, *values: float | bytes, instance: int = 0) -> None:
        """Append data of a topic. Values of arrays follow one another, and texts are bytes."""
        number = self._numbers[name, instance]
        self.message("D", struct.pack("<H", number) + struct.pack("<" + self._layouts[name], *values))

    def text(self, time_us: int, severity: int, text: str) -> None:
        """Append a log text of the autopilot."""
        self.message("L", struct.pack("<BQ", ord("0") + severity, time_us) + text.encode())

    def tagged(self, time_us: int, severity: int, text: str) -> None:
        """Append a log text with a tag."""
        self.message("C", struct.pack("<BHQ", ord("0") + severity, 7, time_us) + text.encode())

    def dropout(self, milliseconds: int) -> None:
        """Append a dropout message: nothing was logged for a while."""
        self.message("O", struct.pack("<H", milliseconds))

    def sync(self) -> None:
        """Append a synchronisation mark."""
        self.message("S", SYNC)

    def append_here(self) -> None:
        """Mark the data from here on as appended to a file that was already finished or cut off."""
        flags = bytearray(self.content)
        flags[16 + 3 + 8] |= 1
        struct.pack_into("<Q", flags, _OFFSETS_AT + 8 * self._appended, len(flags))
        self._appended += 1
        self.content = bytes(flags)

    def save(self, path: Path) -> Path:
        """Write the file."""
        path.write_bytes(self.content)
        return path

    def _pair(self, type_name: str, key: str, value: float | str) -> bytes:
        if isinstance(value, str):
            type_name, packed = f"char[{len(value)}]", value.encode()
        else:
            packed = struct.pack("<" + _CODES[type_name], value)
        name = f"{type_name} {key}".encode()
        return bytes([len(name)]) + name + packed
