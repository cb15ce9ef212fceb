"""The findings of `companion check`: one for each thing that a flight needs, with advice where needed."""

from __future__ import annotations

import enum

import msgspec


class Light(enum.StrEnum):
    """Severity of a finding. Red means that the aircraft is not ready."""

    GREEN = "green"
    YELLOW = "yellow"
    RED = "red"


class Finding(msgspec.Struct, frozen=True):
    """One finding of the preflight list."""

    light: Light
    what: str
    """Subject: link, rates, clock, ..."""
    text: str
    do: str = ""
    """What to do about the finding; empty if nothing."""

    def line(self) -> str:
        """Text for a terminal; a second line is added if there is something to do."""
        todo = f"\n        -> {self.do}" if self.do else ""
        return f"{self.light.value:6}  {self.what}: {self.text}{todo}"


class Preflight:
    """The findings so far."""

    def __init__(self) -> None:
        self.findings: list[Finding] = []

    @property
    def ready(self) -> bool:
        """Whether no finding is red."""
        return all(finding.light is not Light.RED for finding in self.findings)

    def green(self, what: str, text: str) -> None:
        """Add a finding that is as it should be."""
        self.findings.append(Finding(Light.GREEN, what, text))

    def yellow(self, what: str, text: str, do: str) -> None:
        """Add a finding with which a flight is possible, but of which the user should know."""
        self.findings.append(Finding(Light.YELLOW, what, text, do))

    def red(self, what: str, text: str, do: str) -> None:
        """Add a finding that must be corrected before a flight."""
        self.findings.append(Finding(Light.RED, what, text, do))
