"""Reading a run folder: `manifest.json`, `summary.json` where there is one, every aircraft's event record.

A run that was killed is read as far as it was written. What could not be read is said in `problems`, and what
was read stands beside it. A folder `unavoided` inside holds the same encounter flown without avoidance. In a
swarm's run folder, each companion made a run folder of its own inside; they are read as one run.
"""

from __future__ import annotations

import glob
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion import record
from companion.errors import ConfigError, PeerDataError
from companion.record import Header, Step
from ground_tools.inspect.facts import Facts, gather
from ground_tools.inspect.truth import read_truth


@dataclass(frozen=True, slots=True)
class AircraftRecord:
    """What entered and left one heart."""

    name: str
    header: Header | None
    """None where the file was cut off before it."""
    facts: Facts
    steps: Callable[[], Iterator[Step]]
    """Every step in order, read from the file anew: a long record does not fit into memory. Damage ends it,
    as it did when the facts were gathered."""
    truth: NDArray[np.float64] | None = None
    """(n, 4) of utc_s, north_m, east_m, down_m; None where its true positions are not known."""


@dataclass(frozen=True, slots=True)
class Run:
    """One run folder."""

    folder: Path
    manifest: dict[str, Any] | None
    """None where there is none, or none that can be read."""
    summary: dict[str, Any] | None
    """Like `manifest`."""
    aircraft: tuple[AircraftRecord, ...]
    problems: tuple[str, ...]
    """What is damaged or missing, one line each."""

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.resolve().name


def read_unavoided(folder: Path) -> Run | None:
    """The run without avoidance that belongs to a run folder; None where there is none."""
    inner = folder / "unavoided"
    return read_run(inner) if inner.is_dir() else None


def read_run(folder: Path) -> Run:
    """Read a run folder.

    Raises:
        ConfigError: there is no such folder, or no event record in it.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such run folder")
    problems: list[str] = []
    manifest = _json(folder / "manifest.json", problems)
    summary = _json(folder / "summary.json", problems)
    files = sorted(folder.glob("*.events")) or _nested(folder, manifest, problems)
    aircraft = [_aircraft(path, folder, problems) for path in files]
    if not aircraft:
        raise ConfigError(f"{folder}: no event record (*.events) in this folder")
    return Run(folder, manifest, summary, tuple(aircraft), tuple(problems))


def _nested(folder: Path, manifest: dict[str, Any] | None, problems: list[str]) -> list[Path]:
    """The event records of a swarm: `<utc>-<name>/<name>.events` of every aircraft in its manifest."""
    names = (manifest or {}).get("aircraft")
    found = []
    for name in names if isinstance(names, list) else []:
        # Names of run folders begin with their time: the last is the latest.
        files = sorted(folder.glob(f"*-{glob.escape(str(name))}/{glob.escape(str(name))}.events"))
        found += files[-1:]
        if not files:
            problems.append(f"{name}: no event record")
        elif len(files) > 1:
            problems.append(f"{name}: {len(files)} event records; the last is taken")
    return found


def _json(path: Path, problems: list[str]) -> dict[str, Any] | None:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        problems.append(f"{path.name}: {error}")
        return None
    if not isinstance(value, dict):
        problems.append(f"{path.name}: not a JSON object")
        return None
    return value


def _aircraft(path: Path, folder: Path, problems: list[str]) -> AircraftRecord:
    name = path.name.removesuffix(".events")
    headers: list[Header] = []
    facts = gather(_steps(path, headers, problems))
    if not headers:
        problems.append(f"{path.name}: no header")
    truth = None
    try:
        truth = read_truth(folder / f"{name}.truth.csv")
    except PeerDataError as error:
        problems.append(str(error))

    def steps() -> Iterator[Step]:
        return _steps(path, [], [])

    return AircraftRecord(name, headers[0] if headers else None, facts, steps, truth)


def _steps(path: Path, headers: list[Header], problems: list[str]) -> Iterator[Step]:
    """The steps of a file, its headers and what is damaged put aside."""
    with path.open("rb") as stream:
        try:
            for entry in record.read(stream, path.name):
                if isinstance(entry, Header):
                    headers.append(entry)
                else:
                    yield entry
        except PeerDataError as error:
            problems.append(f"{error}; read up to there")
