"""An aircraft whose broadcast is looked at."""

from __future__ import annotations

import pytest


@pytest.fixture
def bench(make_bench):
    """An aircraft that watches, with a radio on Wi-Fi."""
    made = make_bench(use="watch")
    made.step(20)
    return made
