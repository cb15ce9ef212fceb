"""Compile the avoidance kernels before flight, and report how long it took.

`python -m companion.runtime.warm` compiles in a separate process, because a process that compiles keeps 50 MB
more memory.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable
from typing import Any

from numba.core.caching import NullCache

from companion.avoidance import kernels


def warm_up() -> float:
    """Compile the kernels, or load them from the cache. Returns the seconds that this took."""
    began = time.perf_counter()
    past_the_cache(kernels.warm_up, kernels.FUNCTIONS)
    return time.perf_counter() - began


def past_the_cache(compile_all: Callable[[], None], functions: Iterable[object]) -> None:
    """Compile; if that fails, compile again without the cache.

    The cache may be unusable: the disk is full, or a power cut has left half a file. numba raises any
    exception that occurs there, and a companion that does not start cannot avoid anything.

    Args:
        compile_all: calls every function that has to be compiled.
        functions: objects among which are all functions that `compile_all` calls.

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
                    cache.flush()  # so that the next process starts with an intact cache
                vars(function)["_cache"] = NullCache()
        compile_all()


def was_compiled() -> bool:
    """Whether the kernels were compiled in this process: the cache is missing or did not hold them."""
    stats: Any = getattr(kernels.decide_plain, "stats", None)
    return not sum(stats.cache_hits.values())


if __name__ == "__main__":
    print(f"kernels ready in {warm_up():.1f} s{' (compiled)' if was_compiled() else ''}")
