"""The file of a frozen policy: safetensors, with one JSON object under the metadata key "dmuca".

It is written on the ground (`policy.encode`) and read on the aircraft (`policy.load`). A checksum covers the
metadata and the tensors, because a flipped bit in a list of actions would otherwise give another valid
policy.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from typing import Annotated, Any, Final, Literal

import msgspec
import numpy as np
import safetensors
import safetensors.numpy
from msgspec import Meta

from companion.arrays import Float32s
from companion.atmc.networks import PolicyError, Tensors
from companion.atmc.observation import NEIGHBOUR_COLUMNS, OWN_COLUMNS, SCHEMA
from companion.remote_id.transports import MAX_RATE

MAX_BYTES: Final = 4_000_000
"""Largest policy file. Ten of the paper's networks take 2.3 MB. Every event record also contains the file."""
_KEY: Final = "dmuca"
_LENGTH_BYTES: Final = 8
_TYPE: Final = "F32"
_WORDS: Final = 200
"""Most characters that a message quotes from a file, because a damaged file may hold very long strings."""

Rate = Annotated[int, Meta(ge=0, le=MAX_RATE)]
Count = Annotated[int, Meta(ge=1, le=10_000)]
Row = tuple[float, ...]


class _Part(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all parts of the metadata."""


class Bounds(_Part, frozen=True, kw_only=True):
    """Least and greatest value of each selected column in training."""

    neighbour_low: Row
    neighbour_high: Row
    own_low: Row
    own_high: Row


class Golden(_Part, frozen=True, kw_only=True):
    """An observation (whole rows, all columns of the schema) with the values that the policy must give for
    it."""

    own: Row
    rows: tuple[Row, ...]
    agent: Annotated[int, Meta(ge=0)] = 0
    q: Row


class Metadata(_Part, frozen=True, kw_only=True):
    """Everything about a policy except its weights."""

    schema: str = SCHEMA
    kind: Literal["set", "flat"]
    objective: Literal["paper", "awareness"]
    decisions: Literal["together", "phases"]
    """Whether all aircraft decided at the same time in training, or at random phases."""
    name: Annotated[str, Meta(min_length=1, max_length=80)]
    neighbours: Count
    """Largest number of neighbours in training; for kind "flat" the number of neighbours in the input."""
    agents: Count = 1
    """Number of networks: 1 that all aircraft share, or one for each aircraft."""
    neighbour_columns: Annotated[tuple[str, ...], Meta(min_length=1)]
    own_columns: tuple[str, ...]
    actions: Annotated[tuple[tuple[Rate, Rate, Rate], ...], Meta(min_length=1, max_length=10_000)]
    """Locations per second on each of `actions.TRANSPORTS`, for each action."""
    regions: tuple[str, ...] = ()
    """Regions that the policy was trained for. In flight, legality is checked for the configured region."""
    switch_price: Annotated[float, Meta(ge=0)] = 0.0
    """Bonus (s) that `policy.Policy.choose` adds to the value of the present action, to avoid switches."""
    bounds: Bounds
    training_config_sha256: str = ""
    results: dict[str, float] = {}
    """Measured results, for information only."""
    golden: Annotated[tuple[Golden, ...], Meta(min_length=1)]
    checksum: str = ""
    """CRC-32 of the rest of the metadata and of the tensors; filled in by `policy.encode`."""


def write(metadata: Metadata, tensors: Tensors) -> bytes:
    """Content of a policy file, with its checksum. Raises PolicyError for a tensor that is not float32."""
    arrays: dict[str, Float32s] = {}
    for key in sorted(tensors):
        if tensors[key].dtype != np.float32:
            raise PolicyError(f"{metadata.name}: tensor {key}: {tensors[key].dtype}, expected float32")
        arrays[key] = np.ascontiguousarray(tensors[key])
    metadata = msgspec.structs.replace(metadata, checksum=_checksum(metadata, arrays))
    return safetensors.numpy.save(arrays, {_KEY: msgspec.json.encode(metadata).decode()})


def read(data: bytes, name: str) -> tuple[Metadata, dict[str, Float32s]]:
    """Metadata and weights. Each is checked on its own; whether they fit together is not checked here.

    Raises:
        PolicyError: the file cannot be used; the message names the file and what is wrong with it.
    """
    if len(data) > MAX_BYTES:
        raise PolicyError(f"{name}: too large: a policy has at most {MAX_BYTES} bytes")
    try:
        found: Iterable[tuple[str, dict[str, Any]]] = safetensors.deserialize(data)  # type: ignore[no-untyped-call]
    except (safetensors.SafetensorError, ValueError, OverflowError) as error:
        words = f"not a safetensors file, or a damaged one: {error!s:.{_WORDS}}"
        raise PolicyError(f"{name}: {words}") from error
    metadata = _metadata(data, name)
    tensors = {key: _tensor(key, view, name) for key, view in found}
    if metadata.checksum != _checksum(metadata, tensors):
        raise PolicyError(f"{name}: checksum differs: the file is damaged")
    return metadata, tensors


def _tensor(key: str, view: dict[str, Any], name: str) -> Float32s:
    if view["dtype"] != _TYPE:
        raise PolicyError(f"{name}: tensor {key:.{_WORDS}}: type {view['dtype']}, expected F32")
    try:
        tensor: Float32s = np.frombuffer(view["data"], "<f4").reshape(view["shape"]).astype(np.float32)
    except (ValueError, OverflowError) as error:  # too many dimensions, or 2^62 next to 0
        raise PolicyError(f"{name}: tensor {key:.{_WORDS}}: shape: {error}") from error
    if not np.isfinite(tensor).all():
        raise PolicyError(f"{name}: tensor {key:.{_WORDS}}: holds values that are not finite")
    return tensor


def _metadata(data: bytes, name: str) -> Metadata:
    length = int.from_bytes(data[:_LENGTH_BYTES], "little")
    try:
        header = msgspec.json.decode(data[_LENGTH_BYTES : _LENGTH_BYTES + length])
        plain = msgspec.json.decode(header["__metadata__"][_KEY])
        schema = plain["schema"]
    except (msgspec.DecodeError, KeyError, TypeError, ValueError, RecursionError) as error:
        words = f'metadata "{_KEY}" is missing or damaged: {error!s:.{_WORDS}}'
        raise PolicyError(f"{name}: {words}") from error
    if schema != SCHEMA:
        raise PolicyError(
            f"{name}: made for observations of schema {schema!r:.{_WORDS}}; this version builds "
            f"{SCHEMA!r}: use a policy trained for it"
        )
    try:
        metadata = msgspec.convert(plain, Metadata)
    except (msgspec.ValidationError, ValueError) as error:
        raise PolicyError(f'{name}: metadata "{_KEY}": {error!s:.{_WORDS}}') from error
    _check(metadata, name)
    return metadata


def _check(m: Metadata, name: str) -> None:
    """Check conditions that involve several fields."""

    def need(fits: bool, words: str) -> None:
        if not fits:
            raise PolicyError(f"{name}: metadata: {words}")

    for key, columns, known, low, high in (
        (
            "neighbour",
            m.neighbour_columns,
            NEIGHBOUR_COLUMNS,
            m.bounds.neighbour_low,
            m.bounds.neighbour_high,
        ),
        ("own", m.own_columns, OWN_COLUMNS, m.bounds.own_low, m.bounds.own_high),
    ):
        need(len(set(columns)) == len(columns), f"{key}_columns: a name is listed twice")
        need(set(columns) <= set(known), f"{key}_columns: {columns!s:.{_WORDS}}: allowed: {', '.join(known)}")
        fits = len(columns) == len(low) == len(high)
        need(fits and all(a <= b for a, b in zip(low, high, strict=False)), f"bounds: {key}_low, {key}_high")
    need(all(map(any, m.actions)), "actions: an action uses no transport")
    need(len(set(m.actions)) == len(m.actions), "actions: an action is listed twice")
    need(m.kind == "flat" or m.agents == 1, 'agents: all aircraft share a "set" network; allowed: 1')
    for number, case in enumerate(m.golden):
        fits = len(case.own) == len(OWN_COLUMNS) and len(case.q) == len(m.actions) and case.agent < m.agents
        fits = fits and all(len(row) == len(NEIGHBOUR_COLUMNS) for row in case.rows)
        need(fits and len(case.rows) <= m.neighbours, f"golden[{number}]: its sizes do not match the policy")


def _checksum(metadata: Metadata, tensors: Tensors) -> str:
    crc = zlib.crc32(msgspec.json.encode(msgspec.structs.replace(metadata, checksum="")))
    for key in sorted(tensors):
        crc = zlib.crc32(f"{key}{tensors[key].shape}".encode(), crc)
        crc = zlib.crc32(np.ascontiguousarray(tensors[key], "<f4").tobytes(), crc)
    return f"{crc:08x}"
