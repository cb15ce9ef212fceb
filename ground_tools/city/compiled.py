"""numba compilation of the city's functions, which call those of the campaign and of the law.

The name of the cache folder contains a digest of all files whose functions are compiled into them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from companion.avoidance.kernels.compiled import CacheWithMemory
from ground_tools.campaign import compiled as campaign

Function = TypeVar("Function")
_COMPILED = (
    "compiled", "flights", "tables", "links", "draws", "tracks", "judging", "loop", "measure", "energy",
)  # fmt: skip
_OF_RADIO = ("chances", "reception", "network", "choosing", "awareness")
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


def _fetch(_: Any, array: Any, index: Any) -> Any:
    tools: Any = cgutils  # numba has no types

    def generate(target: Any, builder: Any, signature: Any, values: Any) -> Any:
        kind, numbers = signature.args
        parts = zip(tools.unpack_tuple(builder, values[1]), numbers, strict=True)
        at = [target.cast(builder, part, number, types.intp) for part, number in parts]
        held = target.make_array(kind)(target, builder, values[0])
        entry = tools.get_item_pointer(target, builder, kind, held, at)
        place, number = builder.bitcast(entry, ir.IntType(8).as_pointer()), ir.IntType(32)
        what = ir.FunctionType(ir.VoidType(), [place.type, number, number, number])
        prefetch = tools.get_or_insert_function(builder.module, what, "llvm.prefetch.p0")
        builder.call(prefetch, [place, number(0), number(3), number(1)])  # to read, into all caches, data
        return target.get_dummy_value()

    return types.void(array, index), generate


fetch: Callable[[NDArray[Any], tuple[int, ...]], None] = cast(Any, intrinsic(_fetch))
"""Ask for the cache line that holds an entry of an array, in compiled code. The index has to be valid.

The tables of many aircraft are larger than the processor's caches. Rows that are asked for before they are
needed arrive together, instead of one after the other."""


def _lowest_bit(_: Any, word: Any) -> Any:
    def generate(target: Any, builder: Any, signature: Any, values: Any) -> Any:
        number = builder.cttz(values[0], ir.Constant(ir.IntType(1), 1))
        return target.cast(builder, number, signature.args[0], types.int64)

    return types.int64(types.uint64), generate


lowest_bit: Callable[[Any], int] = cast(Any, intrinsic(_lowest_bit))
"""Position of the lowest bit that is 1, in compiled code. The word must not be 0."""
