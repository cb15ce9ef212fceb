"""Compile the avoidance kernels before anything flies, and say how long it took."""

from __future__ import annotations

import time

from companion.avoidance import kernels


def warm_up() -> float:
    """Compile the kernels, or load them from the cache; seconds taken."""
    began = time.perf_counter()
    kernels.warm_up()
    return time.perf_counter() - began
