"""Is the own broadcast really on the air? Own frames heard back, or a radio's own word."""

from __future__ import annotations


class SelfMonitor:
    """Watches transports that something of ours can hear, or that report on themselves.

    A frame counts by its radio address. A stranger who sends from our address can make a dead transmitter
    look alive: this finds faults, not attacks.

    Args:
        patience_s: sent for so long without being heard is a failure.
    """

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._since_s: dict[str, float] = {}
        """When each transport was last known to work, or came on the air."""

    def heard(self, transport: str, now_s: float) -> None:
        """An own frame came back, or the radio says that it is on the air."""
        if transport in self._since_s:
            self._since_s[transport] = now_s

    def silent(self, on_air: frozenset[str], monitored: frozenset[str], now_s: float) -> frozenset[str]:
        """Transports that should be heard and are not.

        Args:
            on_air: transports that are being sent on now.
            monitored: transports that could be heard.
        """
        watched = on_air & monitored
        for transport in self._since_s.keys() - watched:
            del self._since_s[transport]
        for transport in watched - self._since_s.keys():
            self._since_s[transport] = now_s
        return frozenset(t for t, since_s in self._since_s.items() if now_s - since_s > self._patience_s)
