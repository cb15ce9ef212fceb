"""Encounters that the command flies."""

from __future__ import annotations

import multiprocessing

import pytest

from sitl_mocks.encounters import demo


@pytest.fixture
def one_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    """`demo` starts one worker process instead of two. It is a fork of this process, because a new one takes
    more CPU time to start than a short encounter to fly."""
    monkeypatch.setattr(demo, "_workers", lambda seeds: 1)
    forked = multiprocessing.get_context("fork")
    monkeypatch.setattr(multiprocessing, "get_context", lambda _method: forked)
