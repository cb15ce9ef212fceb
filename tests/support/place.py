"""Where the tests fly."""

from __future__ import annotations

from typing import Final

from companion.geometry import LocalFrame

HOME: Final = LocalFrame(47.397, 8.545, 400.0)
"""Home of every vehicle that is not said to be elsewhere. The mock vehicle has the same by default."""
