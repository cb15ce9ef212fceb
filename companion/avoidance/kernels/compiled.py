"""Compiles the kernels with numba: in double precision, without numba's memory runtime, and with a cache.

numba's cache checks only the file of the called function, but the kernels are in several files that call each
other. Therefore each state of all these files together has its own cache folder.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import config, njit
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys

Function = TypeVar("Function")
SOURCES = tuple(sorted(Path(__file__).parent.glob("*.py")))
"""All source files of kernels."""
FUNCTIONS: list[Any] = []
"""All compiled functions of the kernels, for code that manages their caches."""
_STATE = hashlib.sha256(b"".join(path.read_bytes() for path in SOURCES)).hexdigest()[:12]
# Without numba's memory runtime (NRT), functions that allocate do not compile, and array references are not
# counted.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}


def compiled(function: Function) -> Function:
    """The function, compiled at its first call or loaded from the cache.

    The cache is in the folder that NUMBA_CACHE_DIR names or else next to the source; if that is not usable,
    in ~/.cache/dmuca. If no folder is usable, everything is compiled again at every start.
    """
    made = _made(function)
    FUNCTIONS.append(made)
    return made


class LoadingCache(FunctionCache):
    """Cache that loads compiled code without numba's compiler.

    numba's own cache first imports the implementations of all of Python and numpy, which only compiling
    needs. That costs 50 MB and half a second at each start. If code has to be compiled after all, the
    compiler imports them itself. Use this cache only for functions without the memory runtime, because it
    does not initialise that.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled code for a signature; None if it is not in the cache."""
        itself: Any = self  # numba has no types
        with itself._guard_against_spurious_io_errors():
            return itself._load_overload(sig, target_context)


class CacheWithMemory(LoadingCache):
    """As `LoadingCache`, for functions with the memory runtime, which random generators need."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled code for a signature; None if it is not in the cache."""
        rtsys.initialize(target_context)
        return super().load_overload(sig, target_context)


def _made(function: Function) -> Function:
    held = vars(config)["CACHE_DIR"]
    beside = [Path(held)] if held else [Path(__file__).with_name("__pycache__")]
    for folder in (*beside, Path("~/.cache/dmuca").expanduser()):
        vars(config)["CACHE_DIR"] = str(folder / _STATE)
        try:
            made: Any = njit(cache=True, **_OPTIONS)(function)
            if hasattr(made, "_cache"):
                made._cache = LoadingCache(function)  # type: ignore[no-untyped-call]
        except RuntimeError:  # no folder is usable for the cache
            break
        finally:
            vars(config)["CACHE_DIR"] = held
        stats = getattr(made, "stats", None)
        # If the folder is not usable, numba falls back to others that do not distinguish the states.
        if stats is None or Path(stats.cache_path).is_relative_to(folder):
            return cast(Function, made)
    return cast(Function, njit(cache=False, **_OPTIONS)(function))
