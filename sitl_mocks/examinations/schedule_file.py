"""Schedules of examinations as JSON files. --schedule flies a schedule that broke a rule again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from companion.errors import ConfigError


def write_schedule(path: Path, schedule: dict[str, Any]) -> None:
    """Write a schedule. Raises ConfigError if the file cannot be written."""
    try:
        path.write_text(json.dumps(schedule, indent=1) + "\n")
    except OSError as error:
        raise ConfigError(f"--out: {path}: cannot be written: {error.strerror}") from error


def read_schedule(path: Path) -> dict[str, Any]:
    """Read a schedule. Raises ConfigError if the file cannot be read or holds no JSON object."""
    try:
        value = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"--schedule: {path}: {error}") from error
    if not isinstance(value, dict):
        raise ConfigError(f"--schedule: {path}: the file is not a JSON object")
    return value
