"""What the tests of sockets and threads share."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

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


@pytest.fixture(autouse=True)
def no_service_manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Status sockets of the test's own, and no service manager but one that it makes itself."""
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    for name in ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"):
        monkeypatch.delenv(name, raising=False)
