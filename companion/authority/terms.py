"""Conditions of a plan: the configuration, the vehicle's own limits, and what was already reported."""

from __future__ import annotations

from collections.abc import Iterable

from companion.autopilot.advice import remarks
from companion.avoidance.limits import effective
from companion.config import Config, LimitsConfig
from companion.events import Command, Say, Severity, VehicleParameters


class Terms:
    """Conditions shared by all plans of one vehicle."""

    def __init__(self, config: Config) -> None:
        self.config = config
        """Configuration of the next plan. Replace it only while there is no law: a law keeps its own copy."""
        self.vehicle: VehicleParameters | None = None
        """Parameters that the vehicle has reported; None until then."""
        self._refused: str | None = None
        self._warned: set[str] = set()

    @property
    def limits(self) -> LimitsConfig:
        """The configured limits, each lowered to the vehicle's own limit where that is lower."""
        return effective(self.config.limits, self.vehicle)

    def set_vehicle_parameters(self, event: VehicleParameters) -> list[Command]:
        """Keep the vehicle's own limits for the next plan. Returns remarks for the operator."""
        self.vehicle = event
        return self.warn(remarks(self.config, event))

    def warn(self, texts: Iterable[str]) -> list[Command]:
        """Report each text once in the lifetime of the companion process."""
        new = [text for text in texts if text not in self._warned]
        self._warned.update(new)
        return [Say(severity=Severity.WARNING, text=f"DMUCA: {text}") for text in new]

    def refuse(self, reason: str) -> list[Command]:
        """Report why there is no path, unless the last refusal had the same reason."""
        if reason == self._refused:
            return []
        self._refused = reason
        return [Say(severity=Severity.ERROR, text=f"DMUCA: path refused: {reason}")]

    def accept(self) -> None:
        """Note that there is a path, so that the next refusal is reported whatever its reason."""
        self._refused = None
