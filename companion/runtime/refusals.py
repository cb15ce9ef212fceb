"""Broadcasts that the radio refused: their number and the reasons, in bounded memory."""

from __future__ import annotations

_MAX_TEXTS = 20
"""Number of different reasons that are kept."""


class Refusals:
    """Refused broadcasts of one flight."""

    def __init__(self) -> None:
        self.count = 0
        self.texts: set[str] = set()

    def add(self, text: str) -> bool:
        """Count one refusal. Returns whether its reason is new and was kept."""
        self.count += 1
        if text in self.texts or len(self.texts) >= _MAX_TEXTS:
            return False
        self.texts.add(text)
        return True
