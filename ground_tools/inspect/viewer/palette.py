"""Colours that can be distinguished with every common type of colour vision (Okabe and Ito, 2008)."""

from __future__ import annotations

Rgb = tuple[int, int, int]

COLOURS: tuple[Rgb, ...] = (
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (160, 110, 40),
    (90, 90, 90),
)
"""Colours of aircraft. Vermilion is left out, because it stands for the required separation."""
LIMIT = (213, 94, 0)
PAIR = (150, 150, 150)
WANTED = (120, 120, 120)

LEVELS: dict[str, Rgb] = {
    "INFO": (86, 180, 233),
    "WARN": (230, 159, 0),
    "ERROR": LIMIT,
    "CRITICAL": (180, 0, 30),
}
"""Colours of markers, by log level."""

AUTHORITY: dict[str, Rgb] = {
    "standby": (150, 150, 150),
    "watching": (86, 180, 233),
    "guarding": (0, 158, 115),
    "avoiding": LIMIT,
    "recovering": (230, 159, 0),
    "yielded": (204, 121, 167),
    "fault": (180, 0, 30),
}
"""Colours of the states of `companion.authority.table.State`."""
ALERTS: dict[str, Rgb] = {"advisory": (86, 180, 233), "caution": (230, 159, 0), "warning": LIMIT}
"""Colours of the levels of `companion.avoidance.alerts.Level`."""


def colour(index: int) -> Rgb:
    """Return red, green, blue (0-255) of the aircraft or pair with this index."""
    return COLOURS[index % len(COLOURS)]


def hexadecimal(rgb: Rgb) -> str:
    """Format a colour as "#rrggbb"."""
    return "#" + bytes(rgb).hex()


def faded(rgb: Rgb, share: float) -> Rgb:
    """Blend a colour towards grey; a share of 1 or more is grey."""
    part = min(max(share, 0.0), 1.0)
    red, green, blue = (round(c + part * (165 - c)) for c in rgb)
    return red, green, blue


def pale(rgb: Rgb) -> Rgb:
    """Blend a colour half way to white."""
    red, green, blue = ((c + 255) // 2 for c in rgb)
    return red, green, blue
