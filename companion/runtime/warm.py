"""Compile the avoidance kernels before anything flies, and say how long it took.

`python -m companion.runtime.warm` does it in a process of its own: one that compiles keeps 50 MB more.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable
from typing import Any

from numba.core.caching import NullCache

from companion.avoidance import fence_planes, hard_planes, kernels, programs

_MODULES = (programs, fence_planes, hard_planes, kernels)


def warm_up() -> float:
    """Compile the kernels, or load them from the cache; seconds taken."""
    began = time.perf_counter()
    pieces = (value for module in _MODULES for value in vars(module).values())
    past_the_cache(kernels.warm_up, list(pieces))
    return time.perf_counter() - began


def past_the_cache(compile_all: Callable[[], None], functions: Iterable[object]) -> None:
    """Compile, without a cache that cannot be used: a disk is full, or a power cut has left half a file.

    numba raises whatever it meets there, and a companion that does not start avoids nobody.

    Args:
        compile_all: calls what is to be compiled.
        functions: among them all that it calls.

    Raises:
        Exception: what `compile_all` raises without a cache.
    """
    try:
        compile_all()
    except Exception:
        for function in functions:
            cache = getattr(function, "_cache", None)
            if cache is not None:
                with contextlib.suppress(Exception):
                    cache.flush()  # so that the next process begins with a sound one
                vars(function)["_cache"] = NullCache()
        compile_all()


def was_compiled() -> bool:
    """Whether they did not come from the cache: it did not hold them, or there is none."""
    stats: Any = getattr(kernels.decide, "stats", None)
    return not sum(stats.cache_hits.values())


if __name__ == "__main__":
    print(f"kernels ready in {warm_up():.1f} s{' (compiled)' if was_compiled() else ''}")
