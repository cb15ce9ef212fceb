"""What became of the frames between two aircraft, and how old the receiver's knowledge of the sender was."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


def information_age(rows: Sequence[Mapping[str, Any]]) -> str:
    """The ages of information in rows of `PairStats.to_dict`, in words."""
    means = [row["information_age_mean_s"] for row in rows if row["information_age_mean_s"] is not None]
    if not means:
        return "nobody heard anybody"
    largest = max(row["information_age_max_s"] for row in rows if row["information_age_max_s"] is not None)
    mute = sum(row["first_heard_s"] is None for row in rows)
    words = f"age of information {sum(means) / len(means):.2f} s on average, {largest:.1f} s at most"
    return words + (f"; {mute} of {len(rows)} pairs heard nothing" if mute else "")


@dataclass(slots=True)
class TransportCount:
    """Frames of one transport."""

    sent: int = 0
    delivered: int = 0


@dataclass(slots=True)
class PairStats:
    """What became of the frames of one sender on their way to one receiver.

    Two kinds of age: a frame's when it is handed over (`age_*`), and the age of information at every moment:
    now minus the time when the freshest position that was delivered had been sent.
    """

    sent: int = 0
    delivered: int = 0
    lost: int = 0
    """By the channel, or because the receiver left while they were under way."""
    overflowed: int = 0
    """Dropped because too many messages were under way."""
    unknown_distance: int = 0
    """Sent while the distance was not known."""
    age_sum_s: float = 0.0
    age_min_s: float = math.inf
    age_max_s: float = 0.0
    transports: dict[str, TransportCount] = field(default_factory=dict)
    first_heard_s: float | None = None
    """When the first position was delivered, since the air began; the age of information counts from it."""
    information_age_max_s: float = 0.0
    observed_s: float = 0.0
    """How long it was counted."""
    _age_area_s2: float = 0.0
    _freshest_s: float | None = None
    _since_s: float = 0.0

    @property
    def age_mean_s(self) -> float | None:
        """Mean age at delivery (s); None before the first."""
        return self.age_sum_s / self.delivered if self.delivered else None

    @property
    def freshest_s(self) -> float | None:
        """When the freshest position that is known was sent, since the air began; None while none is."""
        return self._freshest_s

    @property
    def information_age_mean_s(self) -> float | None:
        """Time average of the age of information (s), up to the last position or `end`; None before that."""
        return self._age_area_s2 / self.observed_s if self.observed_s > 0.0 else None

    def count_sent(self, transport: str) -> None:
        """One frame more on its way."""
        self.sent += 1
        self.transports.setdefault(transport, TransportCount()).sent += 1

    def count_delivery(self, transport: str, age_s: float) -> None:
        """One frame handed over."""
        self.delivered += 1
        self.transports.setdefault(transport, TransportCount()).delivered += 1
        self.age_sum_s += age_s
        self.age_min_s = min(self.age_min_s, age_s)
        self.age_max_s = max(self.age_max_s, age_s)

    def refresh(self, now_s: float, sent_s: float) -> None:
        """A position sent at `sent_s` is handed over; one older than what is known changes nothing."""
        if self._freshest_s is None:
            self._since_s = now_s
            if self.first_heard_s is None:
                self.first_heard_s = now_s
        elif sent_s <= self._freshest_s:
            return
        else:
            self._grow_old(now_s, self._freshest_s)
        self._freshest_s = sent_s
        self.information_age_max_s = max(self.information_age_max_s, now_s - sent_s)

    def end(self, now_s: float) -> None:
        """One of the two left, or the run is over: the age of information is counted up to now."""
        if self._freshest_s is not None:
            self._grow_old(now_s, self._freshest_s)
            self._freshest_s = None

    def to_dict(self) -> dict[str, object]:
        """For a JSON line; ages are None before the first delivery."""
        heard = self.delivered > 0
        known = self.first_heard_s is not None
        return {
            "sent": self.sent,
            "delivered": self.delivered,
            "lost": self.lost,
            "overflowed": self.overflowed,
            "unknown_distance": self.unknown_distance,
            "age_min_s": self.age_min_s if heard else None,
            "age_mean_s": self.age_mean_s,
            "age_max_s": self.age_max_s if heard else None,
            "first_heard_s": self.first_heard_s,
            "information_age_mean_s": self.information_age_mean_s,
            "information_age_max_s": self.information_age_max_s if known else None,
            "transports": {
                name: {"sent": count.sent, "delivered": count.delivered}
                for name, count in self.transports.items()
            },
        }

    def _grow_old(self, now_s: float, freshest_s: float) -> None:
        passed_s, age_s = now_s - self._since_s, now_s - freshest_s
        self._age_area_s2 += passed_s * (age_s - passed_s / 2.0)
        self.observed_s += passed_s
        self.information_age_max_s = max(self.information_age_max_s, age_s)
        self._since_s = now_s
