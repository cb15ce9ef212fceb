"""Waits for what another thread or process does."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, TypeVar

T = TypeVar("T")

PATIENCE_S: Final = 40.0
"""Time after which something will never happen; generous, because machines are slow."""


def until(
    condition: Callable[[], T],
    what: str = "it",
    patience_s: float = PATIENCE_S,
    *,
    meanwhile: Callable[[], object] = lambda: None,
    pause_s: float = 0.005,
) -> T:
    """Wait until a condition holds, and return what it gives then.

    Args:
        what: name of what is waited for.
        meanwhile: what is done before each pause.
        pause_s: time between two looks.

    Raises:
        AssertionError: it does not hold within `patience_s`. The text names `what`.
    """
    end_s = time.monotonic() + patience_s
    while not (found := condition()):
        assert time.monotonic() < end_s, f"{what} never came"
        meanwhile()
        time.sleep(pause_s)
    return found
