"""Broadcasts that the radio refused: how many, and why, in bounded memory."""

from __future__ import annotations

_MAX_TEXTS = 20
"""Different reasons that are kept."""


class Refusals:
    """Of one flight."""

    def __init__(self) -> None:
        self.count = 0
        self.texts: set[str] = set()

    def add(self, text: str) -> bool:
        """One more; whether its reason is new and was kept."""
        self.count += 1
        if text in self.texts or len(self.texts) >= _MAX_TEXTS:
            return False
        self.texts.add(text)
        return True
