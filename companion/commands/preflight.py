"""What `companion check` says: a line for each thing that a flight needs, and what to do about a red one."""

from __future__ import annotations

import enum

import msgspec


class Light(enum.StrEnum):
    """Of a finding. Red: the aircraft is not ready."""

    GREEN = "green"
    YELLOW = "yellow"
    RED = "red"


class Finding(msgspec.Struct, frozen=True):
    """One line of the list."""

    light: Light
    what: str
    """Subject: link, rates, clock, ..."""
    text: str
    do: str = ""
    """What to do about it."""

    def line(self) -> str:
        """For a terminal, two lines where there is something to do."""
        todo = f"\n        -> {self.do}" if self.do else ""
        return f"{self.light.value:6}  {self.what}: {self.text}{todo}"


class Preflight:
    """The findings so far."""

    def __init__(self) -> None:
        self.findings: list[Finding] = []

    @property
    def ready(self) -> bool:
        """Nothing is red."""
        return all(finding.light is not Light.RED for finding in self.findings)

    def green(self, what: str, text: str) -> None:
        """As it should be."""
        self.findings.append(Finding(Light.GREEN, what, text))

    def yellow(self, what: str, text: str, do: str) -> None:
        """A flight can be flown with it; somebody should know."""
        self.findings.append(Finding(Light.YELLOW, what, text, do))

    def red(self, what: str, text: str, do: str) -> None:
        """No flight before it is put right."""
        self.findings.append(Finding(Light.RED, what, text, do))
