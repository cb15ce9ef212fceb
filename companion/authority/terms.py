"""What a plan is made within: the configuration, what the vehicle itself allows, and what of it was told."""

from __future__ import annotations

from collections.abc import Iterable

from companion.autopilot.advice import remarks
from companion.avoidance.limits import effective
from companion.config import Config, LimitsConfig
from companion.events import Command, Say, Severity, VehicleParameters


class Terms:
    """Of all plans of one vehicle."""

    def __init__(self, config: Config) -> None:
        self.config = config
        """Of the next plan: to be replaced only while there is no law, which keeps its own."""
        self.vehicle: VehicleParameters | None = None
        """What the vehicle has told of itself."""
        self._refused: str | None = None
        self._warned: set[str] = set()

    @property
    def limits(self) -> LimitsConfig:
        """The lower of what is configured and what the vehicle itself may."""
        return effective(self.config.limits, self.vehicle)

    def take_parameters(self, event: VehicleParameters) -> list[Command]:
        """Keep the vehicle's own limits for the next plan; say what the operator should know."""
        self.vehicle = event
        return self.warn(remarks(self.config, event))

    def warn(self, texts: Iterable[str]) -> list[Command]:
        """Say each of them once in the life of the companion."""
        new = [text for text in texts if text not in self._warned]
        self._warned.update(new)
        return [Say(severity=Severity.WARNING, text=f"DMUCA: {text}") for text in new]

    def refuse(self, reason: str) -> list[Command]:
        """Say why there is no path, once for each reason in a row."""
        if reason == self._refused:
            return []
        self._refused = reason
        return [Say(severity=Severity.ERROR, text=f"DMUCA: path refused: {reason}")]

    def accept(self) -> None:
        """There is a path: the next refusal is said, whatever its reason."""
        self._refused = None
