"""What the tests of OPEN_DRONE_ID_* share."""

from __future__ import annotations

from pathlib import Path

REPOSITORY = Path(__file__).parents[3]
EPOCH = 1546300800.0
LAST_SECOND = 2**32 - 1546300800 - 1
"""Of a System or Authentication, counted from 2019."""
MAC = bytes.fromhex("c0ffee123456").ljust(20, b"\0")
