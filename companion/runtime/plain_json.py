"""JSON of values whose texts may hold names of files.

A name of a file is bytes, and Python keeps those that are no UTF-8 as surrogates, which JSON cannot hold.
"""

from __future__ import annotations

from typing import Any

import msgspec


def encode(value: object) -> bytes:
    """Encode a value. Characters that cannot be encoded become "?"."""
    try:
        return msgspec.json.encode(value)
    except UnicodeEncodeError:
        return msgspec.json.encode(_cleaned(msgspec.to_builtins(value)))


def _cleaned(value: Any) -> Any:
    match value:
        case str():
            return value.encode("utf-8", "replace").decode("utf-8")
        case dict():
            return {_cleaned(key): _cleaned(one) for key, one in value.items()}
        case list() | tuple():
            return [_cleaned(one) for one in value]
        case _:
            return value
