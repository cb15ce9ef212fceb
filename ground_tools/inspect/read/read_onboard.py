"""Reads the logs that autopilots write on board: ArduPilot's DataFlash (.bin) and PX4's ULog (.ulg).

Each log is one aircraft. It is streamed, and only `Facts` are kept. Times are the vehicle's own, since it
started; its GNSS receiver gives UTC.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO

import numpy as np

from companion.arrays import Floats
from companion.event_record import Step
from companion.flight_logs import KINDS, About
from ground_tools.inspect.read.facts import Facts, gather
from ground_tools.inspect.read.modes import mode_name

ReadSteps = Callable[[BinaryIO, str, About], Iterator[Step]]
SUFFIXES = (".bin", ".ulg")


@dataclass(frozen=True, slots=True)
class OnboardLog:
    """Content of one log."""

    about: About
    facts: Facts
    wind: Floats
    """(n, 3) time (s), and the wind towards north and east (m/s)."""
    steps: Callable[[], Iterator[Step]]
    """Yields one step for each relevant message. Each call reads the file again."""

    @property
    def words(self) -> str:
        """The vehicle and the flight modes used, as text."""
        modes = ", ".join(mode_name(beat) for beat in self.about.modes.values())
        origin = f"; positions from {self.about.position_from}" if self.about.position_from else ""
        return f"{self.about.kind} of {self.about.firmware}" + (f"; modes {modes}" if modes else "") + origin


def reader_of(head: bytes) -> ReadSteps | None:
    """Return the reader for a file with these first bytes; None if it is no log of this kind."""
    return next((reader for magic, reader in KINDS.items() if head.startswith(magic)), None)


def read(path: Path, reader: ReadSteps) -> OnboardLog:
    """Read a log.

    Raises:
        PeerDataError: The file is not a log of the reader's kind.
        OSError: The file cannot be read.
    """
    about = About()
    facts = gather(_steps(path, reader, about))
    return OnboardLog(
        about, facts, np.asarray(about.wind).reshape(-1, 3), partial(_steps, path, reader, None)
    )


def _steps(path: Path, reader: ReadSteps, about: About | None) -> Iterator[Step]:
    with path.open("rb") as stream:
        yield from reader(stream, path.name, About() if about is None else about)
