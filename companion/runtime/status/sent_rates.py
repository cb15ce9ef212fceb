"""How often our own position is really broadcast, beside what was chosen.

The region may ask for more than a policy or the configuration chooses, and a late loop sends less.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping

from companion.events import Broadcast, Command
from companion.remote_id.messages import Location

_WINDOW_S = 5.0
_SAME = 0.1
"""Up to this share, a measured rate counts as the chosen one: steps of the loop shift single broadcasts."""


class SentRates:
    """Locations that the core broadcasts per second, measured while the chosen rate stays the same."""

    def __init__(self) -> None:
        self._chosen: dict[str, tuple[int, float]] = {}
        """Rate of each transport, and since when it has been chosen."""
        self._sent_s: dict[str, deque[float]] = {}

    def take(self, commands: Iterable[Command], chosen: Mapping[str, int], now_s: float) -> None:
        """Take in the commands of one step, and the rates that are chosen now."""
        for transport in self._chosen.keys() - chosen.keys():
            del self._chosen[transport], self._sent_s[transport]
        for transport, rate in chosen.items():
            if self._chosen.get(transport, (None,))[0] != rate:
                self._chosen[transport], self._sent_s[transport] = (rate, now_s), deque()
        for command in commands:
            if isinstance(command, Broadcast) and any(isinstance(m, Location) for m in command.messages):
                self._sent_s.get(command.transport, deque()).append(now_s)
        for times_s in self._sent_s.values():
            while times_s and now_s - times_s[0] > _WINDOW_S:
                times_s.popleft()

    def per_s(self, now_s: float) -> dict[str, float]:
        """Measured rate of each transport whose rate has been the same for some seconds."""
        found = {}
        for transport, (_, since_s) in self._chosen.items():
            times_s = self._sent_s[transport]
            if now_s - since_s >= _WINDOW_S:
                rate = len(times_s) / _WINDOW_S
                if len(times_s) > 1 and times_s[-1] > times_s[0]:
                    rate = (len(times_s) - 1) / (times_s[-1] - times_s[0])
                found[transport] = round(rate, 2)
        return found


def in_words(chosen: Mapping[str, int], sent_per_s: Mapping[str, float]) -> str:
    """The chosen rates, each with the measured one where that differs; empty if nothing is chosen."""
    words = []
    for transport, rate in chosen.items():
        sent = sent_per_s.get(transport, rate)
        differs = abs(sent - rate) > _SAME * rate
        words.append(f"{transport} {rate}/s" + (f" chosen, {sent:.3g}/s sent" if differs else ""))
    return ", ".join(words)
