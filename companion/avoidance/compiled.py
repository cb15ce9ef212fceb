"""numba for the kernels: in double precision, without numba's memory runtime, and with a cache.

numba's cache looks only at the file of the function that is called, and the kernels stand in several files
that call each other: so there is a cache for each state of all of them together.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import config, njit

Function = TypeVar("Function")
SOURCES = tuple(
    Path(__file__).with_name(f"{name}.py")
    for name in ("compiled", "programs", "fence_planes", "hard_planes", "kernels")
)
"""All files of kernels."""
_STATE = hashlib.sha256(b"".join(path.read_bytes() for path in SOURCES)).hexdigest()[:12]
# Without numba's runtime what allocates does not compile, and references to arrays are not counted.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}


def compiled(function: Function) -> Function:
    """The function, compiled at its first call or loaded from the cache.

    The cache lies in the folder that NUMBA_CACHE_DIR names, else beside the source, else in the user's own.
    Where none of them takes it, everything is compiled anew at every start.
    """
    held = vars(config)["CACHE_DIR"]
    beside = [Path(held)] if held else [Path(__file__).with_name("__pycache__")]
    for folder in (*beside, Path("~/.cache/dmuca").expanduser()):
        vars(config)["CACHE_DIR"] = str(folder / _STATE)
        try:
            made: Any = njit(cache=True, **_OPTIONS)(function)
        except RuntimeError:  # no folder at all takes the cache
            break
        finally:
            vars(config)["CACHE_DIR"] = held
        stats = getattr(made, "stats", None)
        # Where the folder does not take it, numba turns to others that do not tell the states apart.
        if stats is None or Path(stats.cache_path).is_relative_to(folder):
            return cast(Function, made)
    return cast(Function, njit(cache=False, **_OPTIONS)(function))
