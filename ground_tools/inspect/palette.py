"""Colours of aircraft and pairs, told apart with every common colour vision (Okabe and Ito, 2008)."""

from __future__ import annotations

COLOURS: tuple[tuple[int, int, int], ...] = (
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (160, 110, 40),
    (90, 90, 90),
)
"""Vermilion is left out: it stands for the separation that must hold."""
LIMIT = (213, 94, 0)


def colour(index: int) -> tuple[int, int, int]:
    """Red, green, blue (0-255) of the aircraft or pair of this number."""
    return COLOURS[index % len(COLOURS)]


def hexadecimal(rgb: tuple[int, int, int]) -> str:
    """The colour as "#rrggbb"."""
    return "#" + bytes(rgb).hex()
