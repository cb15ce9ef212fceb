"""Waits for a condition that another thread or process fulfils."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, TypeVar

T = TypeVar("T")

PATIENCE_S: Final = 40.0
"""Time after which an event counts as missing; generous, because machines can be slow."""


def until(
    condition: Callable[[], T],
    what: str = "it",
    patience_s: float = PATIENCE_S,
    *,
    meanwhile: Callable[[], object] = lambda: None,
    pause_s: float = 0.005,
) -> T:
    """Wait until a condition is true. Returns its value.

    Args:
        what: description of the awaited event.
        meanwhile: called before each pause.
        pause_s: time between two checks.

    Raises:
        AssertionError: the condition is not true within `patience_s`. The text contains `what`.
    """
    end_s = time.monotonic() + patience_s
    while not (found := condition()):
        assert time.monotonic() < end_s, f"{what} never came"
        meanwhile()
        time.sleep(pause_s)
    return found
