"""Statistics of the frames between two aircraft, and of the age of the receiver's information."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


def information_age(rows: Sequence[Mapping[str, Any]]) -> str:
    """Describe the ages of information in rows of `PairStats.to_dict` as text."""
    means = [row["information_age_mean_s"] for row in rows if row["information_age_mean_s"] is not None]
    if not means:
        return "no aircraft received another"
    largest = max(row["information_age_max_s"] for row in rows if row["information_age_max_s"] is not None)
    mute = sum(row["first_heard_s"] is None for row in rows)
    words = f"age of information: mean {sum(means) / len(means):.2f} s, maximum {largest:.1f} s"
    return words + (f"; {mute} of {len(rows)} pairs received nothing" if mute else "")


@dataclass(slots=True)
class TransportCount:
    """Number of frames of one transport."""

    sent: int = 0
    delivered: int = 0


@dataclass(slots=True)
class PairStats:
    """Statistics of the frames from one sender to one receiver.

    There are two kinds of age. `age_*` is the age of a frame at its delivery. The age of information at any
    moment is that moment minus the time at which the freshest position delivered was sent.
    """

    sent: int = 0
    delivered: int = 0
    lost: int = 0
    """Frames lost in the channel, or because the receiver left while they were in transit."""
    overflowed: int = 0
    """Frames dropped because too many were in transit."""
    unknown_distance: int = 0
    """Frames sent while the distance was not known."""
    age_sum_s: float = 0.0
    age_min_s: float = math.inf
    age_max_s: float = 0.0
    transports: dict[str, TransportCount] = field(default_factory=dict)
    first_heard_s: float | None = None
    """Time of the first delivery of a position, since the air began.

    The age of information counts from then.
    """
    information_age_max_s: float = 0.0
    observed_s: float = 0.0
    """Time over which the age of information was counted."""
    _age_area_s2: float = 0.0
    _freshest_s: float | None = None
    _since_s: float = 0.0

    @property
    def age_mean_s(self) -> float | None:
        """Mean age of frames at delivery (s); None before the first delivery."""
        return self.age_sum_s / self.delivered if self.delivered else None

    @property
    def freshest_s(self) -> float | None:
        """Time at which the freshest known position was sent, since the air began; None if none is known."""
        return self._freshest_s

    @property
    def information_age_mean_s(self) -> float | None:
        """Time average of the age of information (s) up to the latest position or `end`; None before that."""
        return self._age_area_s2 / self.observed_s if self.observed_s > 0.0 else None

    def count_sent(self, transport: str) -> None:
        """Count one frame sent."""
        self.sent += 1
        self.transports.setdefault(transport, TransportCount()).sent += 1

    def count_delivery(self, transport: str, age_s: float) -> None:
        """Count one frame delivered at the age `age_s`."""
        self.delivered += 1
        self.transports.setdefault(transport, TransportCount()).delivered += 1
        self.age_sum_s += age_s
        self.age_min_s = min(self.age_min_s, age_s)
        self.age_max_s = max(self.age_max_s, age_s)

    def refresh(self, now_s: float, sent_s: float) -> None:
        """Record the delivery of a position sent at `sent_s`. An older one than is known changes nothing."""
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
        """Count the age of information up to `now_s`, because one aircraft left or the run is over."""
        if self._freshest_s is not None:
            self._grow_old(now_s, self._freshest_s)
            self._freshest_s = None

    def to_dict(self) -> dict[str, object]:
        """Convert to values for a JSON line. Ages are None before the first delivery."""
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
