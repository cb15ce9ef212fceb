"""Measurement of CPU times on a shared machine, and output of figures beside their targets.

Other work on the machine makes a piece of work take more CPU time, because caches and execution units are
shared, but never less. Work is therefore split into pieces of about a millisecond, each piece is repeated,
and its least CPU time counts. To compare figures of two machines, divide them by `reference_s`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence

_REFERENCE_PIECES, _REFERENCE_LOOPS = 500, 5_000


def least_cpu_s(call: Callable[[], object], rounds: int) -> float:
    """Least CPU time (s) of a call, over `rounds` calls of a function."""
    least = float("inf")
    for _ in range(rounds):
        began = time.process_time()
        call()
        least = min(least, time.process_time() - began)
    return least


def least_of_each(rounds: Iterable[Sequence[float]]) -> list[float]:
    """Least time of each piece of work, over rounds that do the same pieces."""
    return [min(times) for times in zip(*rounds, strict=True)]


def reference_s() -> float:
    """CPU time (s) of a million iterations of a fixed loop of plain Python, measured now on this machine."""

    def loop() -> None:
        total = 0
        for i in range(_REFERENCE_LOOPS):
            total += i * i % 7

    return least_cpu_s(loop, _REFERENCE_PIECES) / _REFERENCE_LOOPS * 1e6


class Missed:
    """Number of targets that this process has missed."""

    count = 0


def target(
    what: str, measured: float, unit: str, *, most: float | None = None, least: float | None = None
) -> None:
    """Print a line with a figure and its target: at most `most`, or at least `least`. Count a missed one."""
    if most is not None:
        asked, met = f"at most {most:,g}", measured <= most
    else:
        assert least is not None
        asked, met = f"at least {least:,g}", measured >= least
    Missed.count += not met
    shown = f"{measured:,.0f}" if measured >= 1000.0 else f"{measured:.3g}"
    print(f"target: {what}: {asked} {unit}; measured {shown}: {'met' if met else 'NOT MET'}")
