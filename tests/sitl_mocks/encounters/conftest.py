"""Encounters that the command flies."""

from __future__ import annotations

import pytest

from sitl_mocks.encounters import demo


@pytest.fixture
def one_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    """`demo` starts one worker process instead of two, because each takes seconds of CPU time to start."""
    monkeypatch.setattr(demo, "_workers", lambda seeds: 1)
