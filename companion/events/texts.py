"""STATUSTEXT in both directions: what the vehicle says, and what we say to the ground station."""

from __future__ import annotations

import enum

from companion.events.base import Command, Event


class Severity(enum.IntEnum):
    """The values of MAV_SEVERITY that the companion uses."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class VehicleText(Event, frozen=True):
    """STATUSTEXT of the autopilot."""

    severity: int
    text: str


class Say(Command, frozen=True):
    """STATUSTEXT to the ground station."""

    severity: Severity
    text: str
