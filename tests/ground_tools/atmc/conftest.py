"""Fixtures for the tests of training."""

from __future__ import annotations

import pytest
import torch

from ground_tools.atmc.commands import evaluate


@pytest.fixture(autouse=True)
def _one_thread():
    """Use one PyTorch thread, as in training; several are slower on networks of this size."""
    torch.set_num_threads(1)


@pytest.fixture
def brief(monkeypatch):
    """Shorten evaluations: they time twenty decisions, and count switches over one second in each square."""
    monkeypatch.setattr(evaluate, "_TIMED", 20)
    monkeypatch.setattr(evaluate, "_FLIGHT_STEPS", 6)
