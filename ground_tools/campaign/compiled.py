"""numba compilation of the campaign's functions that call the law's kernels."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import config, njit

from companion.avoidance import kernels, law
from companion.avoidance.kernels.compiled import CacheWithMemory
from companion.traffic import adsb, right_of_way, signal_strength
from sitl_mocks.channel import parameters as channel

Function = TypeVar("Function")
_COMPILED = ("world", "vehicles", "outcome", "powers", "flight")
SOURCES = (
    *kernels.SOURCES,
    *(Path(str(module.__file__)) for module in (law, adsb, right_of_way, signal_strength, channel)),
    *(Path(__file__).with_name(f"{name}.py") for name in _COMPILED),
    *(Path(__file__).parent / "peers" / f"{name}.py" for name in ("common", "orca", "mvp", "fly_away")),
)
"""Source files whose functions and constants are compiled into functions of other files."""
_STATE = hashlib.sha256(b"".join(path.read_bytes() for path in SOURCES)).hexdigest()[:12]
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False, "cache": True}


def compiled(**options: Any) -> Callable[[Function], Function]:
    """numba's `njit` with a separate cache folder for each state of the law and the world.

    As in the kernels, numba's memory runtime is off, unless the option `_nrt` enables it. While it is off,
    functions that allocate do not compile, and no time is spent on counting references to arrays.

    numba's own cache checks only the file of the function that is called, but the code compiled here also
    contains functions and constants of other files.
    """

    def decorate(function: Function) -> Function:
        held = vars(config)["CACHE_DIR"]
        vars(config)["CACHE_DIR"] = str(Path(__file__).parent / "__pycache__" / _STATE)
        try:
            made: Any = njit(**(_OPTIONS | options))(function)
            if options.get("cache", True) and hasattr(made, "_cache"):
                made._cache = CacheWithMemory(function)  # type: ignore[no-untyped-call]
            return cast(Function, made)
        finally:
            vars(config)["CACHE_DIR"] = held

    return decorate
