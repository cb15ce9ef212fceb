"""Where the benchmarks fly."""

from __future__ import annotations

from typing import Final

from companion.geometry import LocalFrame

FRAME: Final = LocalFrame(47.397, 8.545, 450.0)
"""Local frame of the aircraft, 50 m above the home of the simulated vehicles."""
