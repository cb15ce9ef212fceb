"""Common to the tests of the desk tools."""

from __future__ import annotations

import sys

import pytest


@pytest.fixture(autouse=True, scope="module")
def denormal_numbers_stay_with_those_who_drop_them():
    """Training and measuring drop denormal numbers for the whole process, which other tests look at."""
    yield
    torch = sys.modules.get("torch")
    if torch is not None:
        torch.set_flush_denormal(False)
