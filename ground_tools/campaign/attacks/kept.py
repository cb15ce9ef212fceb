"""Attacks kept as files that are flown again as tests: the worst cases that searches found."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import msgspec

from companion.errors import ConfigError
from ground_tools.campaign.attacks import flight
from ground_tools.campaign.attacks.kinds import Attack
from ground_tools.campaign.attacks.outcome import Row
from ground_tools.campaign.attacks.scene import Cell
from ground_tools.common import sources


class Case(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One kept attack."""

    about: str
    """Description of the attack."""
    cell: Cell
    seed: int
    attack: Attack
    found: Row
    """Outcome of the flight when the attack was found."""
    found_with: str
    """Digest of the software with which it was found (`software`)."""
    at_least_m: float | None = None
    """Least separation that the flight must keep; None: no requirement yet."""
    most_aside_m: float | None = None
    """Largest allowed horizontal distance from the path; None: no requirement yet."""


@cache
def software() -> str:
    """Digest of the code on which the flights depend."""
    return sources.digest(["ground_tools.campaign.attacks.flight"])


def read(path: Path) -> Case:
    """Read a case.

    Raises:
        ConfigError: the file cannot be read, or does not hold a case whose attack its kind allows.
    """
    try:
        case = msgspec.json.decode(path.read_bytes(), type=Case)
    except (OSError, msgspec.DecodeError) as error:
        raise ConfigError(f"{path}: {error}") from error
    case.attack.check()
    return case


def write(path: Path, case: Case) -> None:
    """Write a case.

    Raises:
        ConfigError: the file cannot be written.
    """
    try:
        path.write_bytes(msgspec.json.format(msgspec.json.encode(case), indent=1) + b"\n")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error


def fly(case: Case) -> Row:
    """Fly a case again."""
    return flight.fly(case.cell, case.seed, case.attack)


def broken(case: Case, row: Row) -> list[str]:
    """The requirements of a case that a flight did not keep, as text."""
    found = []
    if case.at_least_m is not None and row.separation_m is not None and row.separation_m < case.at_least_m:
        found.append(f"separation {row.separation_m:g} m, promised {case.at_least_m:g} m")
    if case.most_aside_m is not None and row.aside_m > case.most_aside_m:
        found.append(f"{row.aside_m:g} m aside, promised at most {case.most_aside_m:g} m")
    return found
