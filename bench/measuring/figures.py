"""How figures are measured on a shared machine, and how they are shown beside their targets.

Other work on the machine makes a piece of work take more CPU time, because caches and execution units are
shared, but never less. Work is therefore measured in pieces of a millisecond or so, each is repeated, and the
least CPU time of each piece counts. Figures of two machines can be compared as multiples of `reference_s`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence

_REFERENCE_PIECES, _REFERENCE_LOOPS = 500, 5_000


def least_cpu_s(call: Callable[[], object], rounds: int) -> float:
    """The least CPU time (s) of a call of a function that is called `rounds` times."""
    least = float("inf")
    for _ in range(rounds):
        began = time.process_time()
        call()
        least = min(least, time.process_time() - began)
    return least


def least_of_each(rounds: Iterable[Sequence[float]]) -> list[float]:
    """The least time of each piece of work, of rounds that do the same pieces."""
    return [min(times) for times in zip(*rounds, strict=True)]


def reference_s() -> float:
    """CPU time (s) of a million turns of a fixed loop of plain Python, here and now."""

    def loop() -> None:
        total = 0
        for i in range(_REFERENCE_LOOPS):
            total += i * i % 7

    return least_cpu_s(loop, _REFERENCE_PIECES) / _REFERENCE_LOOPS * 1e6


def target(
    what: str, measured: float, unit: str, *, most: float | None = None, least: float | None = None
) -> None:
    """Print a line with a figure and its target: at most `most`, or at least `least`."""
    if most is not None:
        asked, met = f"at most {most:,g}", measured <= most
    else:
        assert least is not None
        asked, met = f"at least {least:,g}", measured >= least
    shown = f"{measured:,.0f}" if measured >= 1000.0 else f"{measured:.3g}"
    print(f"target: {what}: {asked} {unit}; measured {shown}: {'met' if met else 'NOT MET'}")
