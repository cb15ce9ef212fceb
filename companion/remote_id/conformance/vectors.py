"""Checks the codec and the frames against a file of reference vectors (`companion remote-id check`).

The file comes from the public reference implementation (opendroneid-core-c). It is JSON with groups of
vectors. Each vector has an `id`, a `type`, whether the reference accepted it, and the bytes. If `on_grid` is
false, the values of a vector lie between the steps of the wire format. Then the fields that the reference
truncates and we round may differ by one step. Everything else must agree to the bit. Both directions are
checked, and also that the file's bytes agree with its own decoding of them.
"""

from __future__ import annotations

import gzip
import json
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from companion.errors import ConfigError
from companion.remote_id.conformance.check_frames import (
    check_beacon,
    check_ble4,
    check_ble5,
    check_nan_action,
    check_nan_sync_beacon,
)
from companion.remote_id.conformance.check_messages import check_message
from companion.remote_id.conformance.check_packs import check_decode, check_pack
from companion.remote_id.conformance.vector_fields import Fields, fields_of, text_of


@dataclass
class Report:
    """Result of a check."""

    checked: Counter[str] = field(default_factory=Counter)
    """Number of vectors checked, by type."""
    differences: list[str] = field(default_factory=list)
    """One line per difference, naming the vector."""


def check_file(path: Path) -> Report:
    """Check every vector of a file (plain or gzip). Raises ConfigError if it is not a vector file."""
    try:
        data = path.read_bytes()
        content = json.loads(gzip.decompress(data) if path.suffix == ".gz" else data, parse_int=_integer)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from error
    except (ValueError, EOFError, RecursionError, zlib.error) as error:
        raise ConfigError(f"{path}: not JSON: {error}") from error
    try:
        return check_vectors(content)
    except ConfigError as error:
        raise ConfigError(f"{path}: not a vector file: {error}") from error


def _integer(digits: str) -> int | float:
    """Convert a JSON integer; too large ones become float, so that comparisons cannot overflow."""
    return int(digits) if len(digits) < 20 else float(digits)


def check_vectors(content: object) -> Report:
    """Check the parsed content of a vector file. Raises ConfigError if it is none."""
    groups = content.get("vectors") if isinstance(content, dict) else None
    if not isinstance(groups, dict) or not all(isinstance(group, list) for group in groups.values()):
        raise ConfigError("no 'vectors' with lists of vectors in it")
    report = Report()
    for name, group in groups.items():
        for index, vector in enumerate(group):
            try:
                _check_into(report, fields_of(vector))
            except ConfigError as error:
                label = vector.get("id") if isinstance(vector, dict) else None
                raise ConfigError(f"vector {label or f'{index} of {name!r}'}: {error}") from error
    if not report.checked:
        raise ConfigError("it holds no vectors")
    return report


def _check_into(report: Report, vector: Fields) -> None:
    name, kind = text_of(vector, "id"), text_of(vector, "type")
    checker = _CHECKERS.get(kind)
    report.checked[kind] += 1
    if checker is None:
        report.differences.append(f"{name}: vector type {kind!r} is not known")
        return
    report.differences.extend(f"{name}: {difference}" for difference in checker(vector))


_CHECKERS: Final[Mapping[str, Callable[[Fields], Iterator[str]]]] = {
    "basic_id": check_message,
    "location": check_message,
    "auth": check_message,
    "self_id": check_message,
    "system": check_message,
    "operator_id": check_message,
    "message_pack": check_pack,
    "decode": check_decode,
    "ble_legacy_adv_data": check_ble4,
    "ble_extended_adv_data": check_ble5,
    "wifi_beacon_frame": check_beacon,
    "wifi_nan_action_frame": check_nan_action,
    "wifi_nan_sync_beacon_frame": check_nan_sync_beacon,
}
