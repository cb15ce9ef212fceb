"""What the tests of sockets, threads and flights share."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from companion.runtime.flight import Flight
from tests.companion.runtime.flying import (
    Autopilot,
    Radio,
    configured,
)
from tests.support import waiting


@pytest.fixture
def until() -> Callable[[Callable[[], object]], None]:
    """Wait until something holds."""
    return waiting.until


@pytest.fixture(autouse=True)
def no_service_manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Status sockets of the test's own, and no service manager but one that it makes itself."""
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    for name in ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def autopilot():
    served = Autopilot()
    yield served
    served.end()


@pytest.fixture
def said():
    return []


@pytest.fixture
def kept_signals():
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    handlers = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.fixture
def watchdog(monkeypatch):
    """What is done with the watchdog; the real one would end the tests on a slow machine."""
    calls = []

    class Recorded:
        def start(self):
            calls.append("start")

        def report(self):
            calls.append("report")

        def stop(self):
            calls.append("stop")

    monkeypatch.setattr("companion.runtime.flight.Watchdog", Recorded)
    return calls


@pytest.fixture
def flight(autopilot, said, make_config, tmp_path, kept_signals, watchdog, monkeypatch):
    """A flight that watches, not yet running."""
    monkeypatch.setattr("companion.runtime.links.kept_link._PAUSE_S", 0.01)
    monkeypatch.setattr("companion.runtime.flight._STATUS_S", 0.1)
    made = Flight(configured(make_config, tmp_path, autopilot.port), said.append, dry_run=False)
    made.radio = Radio()
    return made
