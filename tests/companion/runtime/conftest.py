"""What the tests of sockets and threads share."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest


@pytest.fixture
def until() -> Callable[[Callable[[], object]], None]:
    """Wait until something holds; generous, because machines are slow."""

    def wait(done: Callable[[], object]) -> None:
        end = time.monotonic() + 30.0
        while not done():
            assert time.monotonic() < end, "it never came"
            time.sleep(0.005)

    return wait
