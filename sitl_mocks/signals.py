"""Orderly shutdown of a server on a signal."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType


@contextlib.contextmanager
def end_signals() -> Iterator[list[int]]:
    """Yield a list that stays empty until SIGINT, SIGTERM or SIGHUP arrives.

    The previous handlers are restored on exit. SIGHUP (the terminal closes) is not handled if it is ignored,
    as under nohup.
    """
    ended: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        ended.append(number)

    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    before = {number: signal.signal(number, note) for number in numbers}
    try:
        yield ended
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
