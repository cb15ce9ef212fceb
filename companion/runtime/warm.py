"""Compile the avoidance kernels before anything flies, and say how long it took.

`python -m companion.runtime.warm` does it in a process of its own: one that compiles keeps 50 MB more.
"""

from __future__ import annotations

import time
from typing import Any

from companion.avoidance import kernels


def warm_up() -> float:
    """Compile the kernels, or load them from the cache; seconds taken."""
    began = time.perf_counter()
    kernels.warm_up()
    return time.perf_counter() - began


def was_compiled() -> bool:
    """Whether they did not come from the cache: it did not hold them, or there is none."""
    stats: Any = getattr(kernels.decide, "stats", None)
    return not sum(stats.cache_hits.values())


if __name__ == "__main__":
    print(f"kernels ready in {warm_up():.1f} s{' (compiled)' if was_compiled() else ''}")
