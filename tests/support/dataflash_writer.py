"""Writes small DataFlash logs, as ArduPilot's AP_Logger lays them out (LogStructure.h)."""

from __future__ import annotations

import struct
from pathlib import Path

HEAD = b"\xa3\x95"
_CODES = {
    "b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "f": "f", "d": "d", "n": "4s", "N": "16s",
    "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "M": "B", "q": "q", "Q": "Q",
}  # fmt: skip
_FACTORS = {"c": 100, "C": 100, "e": 100, "E": 100, "L": 10_000_000}
MULTIPLIERS = {"-": 0.0, "?": 1.0, "0": 1.0, "B": 1e-2, "C": 1e-3, "F": 1e-6, "G": 1e-7}


class DataFlashWriter:
    """Collects messages in `content`."""

    def __init__(self, *, with_units: bool = True) -> None:
        self.content = b""
        self._formats: dict[str, tuple[int, str]] = {}
        self._describe(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
        self.with_units = with_units
        if with_units:
            self._describe(129, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")
            self._describe(130, "MULT", "Qbd", "TimeUS,Id,Mult")
            for name, factor in MULTIPLIERS.items():
                self.write("MULT", 0, ord(name), factor)

    def define(self, name: str, characters: str, columns: str, multipliers: str = "") -> None:
        """Describe a type of message."""
        number = 131 + len(self._formats)
        self._describe(number, name, characters, columns)
        if self.with_units and multipliers:
            self.write("FMTU", 0, number, "-" * len(multipliers), multipliers)

    def write(self, name: str, *values: float | str) -> None:
        """Append a message. Values are in the units of the format characters: degrees for L, metres for e."""
        number, characters = self._formats[name]
        packed = [
            value.encode()
            if isinstance(value, str)
            else round(value * _FACTORS[c])
            if c in _FACTORS
            else value
            for c, value in zip(characters, values, strict=True)
        ]
        self.content += HEAD + bytes([number]) + struct.pack("<" + _layout(characters), *packed)

    def save(self, path: Path) -> Path:
        """Write the file."""
        path.write_bytes(self.content)
        return path

    def _describe(self, number: int, name: str, characters: str, columns: str) -> None:
        self._formats[name] = number, characters
        length = 3 + struct.calcsize("<" + _layout(characters))
        self.content += HEAD + bytes([128]) + struct.pack(
            "<BB4s16s64s", number, length, name.encode(), characters.encode(), columns.encode()
        )  # fmt: skip


def _layout(characters: str) -> str:
    return "".join(_CODES[c] for c in characters)
