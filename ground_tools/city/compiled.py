"""numba compilation of the city's functions, which call those of the campaign and of the law.

The name of the cache folder contains a digest of all files whose functions are compiled into them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import config

from companion.avoidance.kernels.compiled import CacheWithMemory
from ground_tools.campaign import compiled as campaign

Function = TypeVar("Function")
_COMPILED = ("flights", "tables", "links", "draws", "tracks", "judging", "loop", "measure", "energy")
_OF_RADIO = ("chances", "reception", "choosing", "awareness")
SOURCES = (
    *campaign.SOURCES,
    *(Path(__file__).with_name(f"{name}.py") for name in _COMPILED),
    *(Path(__file__).parent / "radio" / f"{name}.py" for name in _OF_RADIO),
)
"""Source files whose functions and constants are compiled into the city's functions."""
_STATE = hashlib.sha256(b"".join(path.read_bytes() for path in SOURCES)).hexdigest()[:12]


def compiled(**options: Any) -> Callable[[Function], Function]:
    """`ground_tools.campaign.compiled.compiled` with a separate cache for each state of the city's files."""

    def decorate(function: Function) -> Function:
        made: Any = campaign.compiled(cache=False, **options)(function)
        held = vars(config)["CACHE_DIR"]
        vars(config)["CACHE_DIR"] = str(Path(__file__).parent / "__pycache__" / _STATE)
        try:
            if hasattr(made, "enable_caching"):
                made.enable_caching()
                made._cache = CacheWithMemory(function)  # type: ignore[no-untyped-call]
            return cast(Function, made)
        finally:
            vars(config)["CACHE_DIR"] = held

    return decorate
