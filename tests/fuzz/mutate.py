"""Bytes that nearly are what a reader expects."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

_VALUES = bytes((0, 1, 2, 8, 9, 10, 0x0D, 0x16, 24, 25, 26, 31, 0x7F, 0x80, 0xDD, 0xF2, 0xFD, 0xFE, 0xFF))
_WORDS = tuple(
    value.to_bytes(size, order)
    for size in (2, 4)
    for value in (0, 1, 0x7FFF, 0x8000, 0xFFFE, 0xFFFF, 2 ** (8 * size - 1), 2 ** (8 * size) - 1)
    for order in ("little", "big")
)
_MOST = 2000
"""Longer inputs are for the test of doubling sizes."""


class Mutator:
    """Draws inputs from seeds; the same `Random` and seeds draw the same."""

    def __init__(self, random: Random, seeds: Sequence[bytes]) -> None:
        self._random = random.random
        self._bits = random.getrandbits
        self._seeds = seeds
        self._ways = (
            self._flip,
            self._flip,
            self._byte,
            self._value,
            self._value,
            self._length,
            self._length,
            self._word,
            self._cut,
            self._cut_front,
            self._extend,
            self._splice,
            self._repeat,
            self._remove,
        )

    def draw(self) -> bytes:
        """One input: a seed, changed in one to four ways; one in 64 is noise."""
        if self._below(64) == 0:
            return self._noise(self._below(300))
        data = bytearray(self._seeds[self._below(len(self._seeds))])
        for _ in range(1 + self._below(4)):
            if not data:
                return self._noise(self._below(40))
            self._ways[self._below(len(self._ways))](data)
        return bytes(data[:_MOST])

    def _below(self, limit: int) -> int:
        return int(self._random() * limit)

    def _noise(self, size: int) -> bytes:
        return self._bits(8 * size).to_bytes(size, "little") if size else b""

    def _flip(self, data: bytearray) -> None:
        data[self._below(len(data))] ^= 1 << self._below(8)

    def _byte(self, data: bytearray) -> None:
        data[self._below(len(data))] = self._below(256)

    def _value(self, data: bytearray) -> None:
        data[self._below(len(data))] = _VALUES[self._below(len(_VALUES))]

    def _length(self, data: bytearray) -> None:
        """A byte that could be a length is made to end just before the end, at it or beyond it."""
        at = self._below(len(data))
        left = len(data) - at - 1
        choices = (left, left - 1, left + 1, left - 2, data[at] + 1, data[at] - 1, 0, 1, 255)
        data[at] = choices[self._below(len(choices))] & 0xFF

    def _word(self, data: bytearray) -> None:
        word = _WORDS[self._below(len(_WORDS))]
        at = self._below(len(data))
        data[at : at + len(word)] = word

    def _cut(self, data: bytearray) -> None:
        del data[self._below(len(data)) :]

    def _cut_front(self, data: bytearray) -> None:
        del data[: self._below(min(len(data), 40))]

    def _extend(self, data: bytearray) -> None:
        size = self._below(60)
        data += bytes(size) if self._random() < 0.5 else self._noise(size)

    def _splice(self, data: bytearray) -> None:
        other = self._seeds[self._below(len(self._seeds))]
        data[self._below(len(data)) :] = other[self._below(len(other) + 1) :]

    def _repeat(self, data: bytearray) -> None:
        at = self._below(len(data))
        piece = data[at : at + 1 + self._below(60)]
        data[at:at] = piece * (1 + self._below(3))

    def _remove(self, data: bytearray) -> None:
        at = self._below(len(data))
        del data[at : at + 1 + self._below(8)]
