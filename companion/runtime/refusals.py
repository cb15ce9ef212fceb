"""Broadcasts that a radio refused: their number and reasons, and the transports that nothing is sent on."""

from __future__ import annotations

REFUSES_S = 0.7
"""A transport on which a radio refuses everything for this long counts as unable to send. At one broadcast a
second, the lowest rate, that is its second refusal."""
AGAIN_S = 2.0
"""It is tried again after this time. While it counts as unable to send, nothing is broadcast on it, and no
success could show that it works."""
_FORGOTTEN_S = 5.0
"""A refusal this long after the last one is the first of others."""
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


class Refusing:
    """Transports of one radio on which it refuses all broadcasts."""

    def __init__(self) -> None:
        self._spans_s: dict[str, tuple[float, float]] = {}
        """Times of the first and the last refusal, for each transport on which nothing was sent since."""

    def refused(self, transport: str, now_s: float) -> None:
        """Note a broadcast that was refused."""
        first_s, last_s = self._spans_s.get(transport, (now_s, now_s))
        self._spans_s[transport] = (first_s if now_s - last_s < _FORGOTTEN_S else now_s, now_s)

    def sent(self, transport: str) -> None:
        """Note a broadcast that was accepted."""
        self._spans_s.pop(transport, None)

    def unable(self, now_s: float) -> frozenset[str]:
        """Transports that count as unable to send."""
        return frozenset(
            transport
            for transport, (first_s, last_s) in self._spans_s.items()
            if last_s - first_s >= REFUSES_S and now_s - last_s < AGAIN_S
        )
