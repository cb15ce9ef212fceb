"""Finds the shortest schedule that still breaks a rule: delta debugging on entries, then on times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from sitl_mocks.examinations.faults import Fault
from sitl_mocks.examinations.flights import BrokenRuleError

Breaks = Callable[[tuple[Fault, ...], float], BrokenRuleError | None]
"""Flies entries until a time (s). Returns the error if the same rule is broken."""
_TRIES: Final = 80
_AFTER_S = 1.0
_EARLIEST_S: Final = (60.0, 120.0)
"""Times tried for the first trouble of a short schedule. The vehicle is in the air by then."""
_SHARES: Final = (0.1, 0.5, 0.8)


class _Search:
    """Shortest schedule so far. The search stops after a number of flights."""

    def __init__(
        self,
        faults: tuple[Fault, ...],
        error: BrokenRuleError,
        breaks: Breaks,
        tries: int,
        earliest_s: tuple[float, ...],
    ) -> None:
        self.faults = tuple(fault for fault in faults if fault.at_s <= error.at_s)
        self.error = error
        self._breaks = breaks
        self._left = tries
        self._earliest_s = earliest_s

    @property
    def until_s(self) -> float:
        return round(self.error.at_s + _AFTER_S, 3)

    def keeps(self, faults: tuple[Fault, ...], until_s: float | None = None) -> bool:
        """Use these entries instead of the current ones if they break the rule."""
        if self._left <= 0 or not faults:
            return False
        self._left -= 1
        error = self._breaks(faults, self.until_s if until_s is None else until_s)
        if error is None:
            return False
        self.faults, self.error = tuple(f for f in faults if f.at_s <= error.at_s), error
        return True

    def earlier(self) -> None:
        """Shorten the time before the first trouble."""
        first_s = min(fault.at_s for fault in self.faults)
        for start_s in (*self._earliest_s, first_s - self.error.flight_s):
            if 0.0 < start_s < first_s and self.keeps(moved(self.faults, start_s - first_s)):
                return

    def last_few(self) -> None:
        """Try the last few entries alone, because they mostly suffice."""
        for count in (1, 2, 4, 8):
            last = sorted(self.faults, key=lambda fault: fault.at_s)[-count:]
            if len(last) < len(self.faults) and self.keeps(tuple(last)):
                return

    def fewer(self) -> None:
        """Leave out parts of decreasing size."""
        size = max(1, len(self.faults) // 2)
        while size >= 1:
            at = 0
            while at < len(self.faults) and len(self.faults) > 1:
                if not self.keeps(self.faults[:at] + self.faults[at + size :]):
                    at += size
            size //= 2

    def briefer(self) -> None:
        """Shorten each trouble as far as possible."""
        for number, fault in enumerate(self.faults):
            for share in _SHARES:
                brief = replace(fault, lasts_s=round(share * fault.lasts_s, 3))
                if fault.lasts_s > 0.0 and self.keeps(
                    (*self.faults[:number], brief, *self.faults[number + 1 :])
                ):
                    break


def moved(faults: tuple[Fault, ...], by_s: float) -> tuple[Fault, ...]:
    """The same faults, all earlier or later."""
    return tuple(replace(fault, at_s=round(fault.at_s + by_s, 3)) for fault in faults)


def shortest(
    faults: tuple[Fault, ...],
    error: BrokenRuleError,
    breaks: Breaks,
    *,
    tries: int = _TRIES,
    earliest_s: tuple[float, ...] = _EARLIEST_S,
) -> tuple[tuple[Fault, ...], float]:
    """The fewest and shortest entries found, and the time until which they must be flown (s).

    Args:
        tries: largest number of flights.
        earliest_s: times tried for the first trouble of a short schedule.
    """
    search = _Search(faults, error, breaks, tries, earliest_s)
    if search.faults:
        search.last_few()
        search.earlier()
        search.fewer()
        search.earlier()
        search.briefer()
    return search.faults, search.until_s
