"""Fixtures for all tests of ground_tools."""

from __future__ import annotations

import sys

import pytest


@pytest.fixture(autouse=True, scope="module")
def denormal_numbers_stay_with_those_who_drop_them():
    """Training and measuring flush denormal numbers for the whole process. Restore the setting for other
    tests."""
    yield
    torch = sys.modules.get("torch")
    if torch is not None:
        torch.set_flush_denormal(False)
