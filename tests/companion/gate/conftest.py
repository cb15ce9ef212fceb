"""Fixtures of the gate's tests."""

from __future__ import annotations

import pytest

from tests.companion.gate.flying import Flying


@pytest.fixture
def taken() -> Flying:
    """A vehicle in flight that the companion controls."""
    return Flying().taken()
