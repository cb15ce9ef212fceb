"""Checks whether our own broadcast is really on the air: our frames are heard back, or a radio reports it."""

from __future__ import annotations

from collections.abc import Set


class SelfMonitor:
    """Watches transports on which a receiver of ours can hear us, or whose radio reports its own state.

    A frame is recognised by its radio address. A stranger who sends from our address can hide a failed
    transmitter: the monitor finds faults, not attacks.

    Args:
        patience_s: a transport has failed if it was on the air for longer than this without being heard.
    """

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._since_s: dict[str, float] = {}
        """When each transport was last known to work, or went on the air."""

    def heard(self, transport: str, now_s: float) -> None:
        """One of our own frames was heard, or the radio reports that it is on the air."""
        if transport in self._since_s:
            self._since_s[transport] = now_s

    def silent(self, on_air: Set[str], monitored: frozenset[str], now_s: float) -> frozenset[str]:
        """Transports that should be heard and are not.

        Args:
            on_air: transports that are in use now.
            monitored: transports that could be heard.
        """
        if not monitored:
            self._since_s.clear()
            return frozenset()
        watched = on_air & monitored
        for transport in self._since_s.keys() - watched:
            del self._since_s[transport]
        for transport in watched - self._since_s.keys():
            self._since_s[transport] = now_s
        return frozenset(t for t, since_s in self._since_s.items() if now_s - since_s > self._patience_s)
