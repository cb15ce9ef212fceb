"""Interface of a flight plan, whether the companion or the autopilot flies it."""

from __future__ import annotations

from typing import Protocol

from companion.authority.course import Course
from companion.authority.downloads import Downloads
from companion.authority.flown import FlownPlan
from companion.authority.guard import GuardPlan
from companion.authority.terms import Terms
from companion.config import Config
from companion.events import Command, MissionDownloaded
from companion.ownship import Ownship


class Plan(Protocol):
    """Source of the path, and whether it may be flown now."""

    terms: Terms
    downloads: Downloads
    course: Course

    @property
    def ready(self) -> bool:
        """True if there is a path and nothing about it needs to be requested."""

    def mission_downloaded(self, event: MissionDownloaded, now_s: float) -> None:
        """Take in the vehicle's downloaded mission."""

    def check(self, own: Ownship, now_s: float) -> list[Command]:
        """On the ground, check whether the vehicle's mission can be flown. Returns requests and messages."""

    def prepare(self, own: Ownship, now_s: float) -> list[Command]:
        """Make the path for a vehicle that could be taken now. Returns requests and messages."""

    def near(self, own: Ownship, now_s: float) -> bool:
        """Whether the aircraft is near enough to the path to be taken. Needs a law."""

    def remake(self, own: Ownship) -> bool:
        """Drop a path that is too far away if another one can be made. Returns whether it was dropped."""

    def lead(self, own: Ownship, now_s: float) -> list[Command]:
        """Keep path and bounds current while we control the vehicle. Returns requests. Needs a law."""

    def engage(self, now_s: float) -> None:
        """Note that the vehicle now flies our setpoints."""

    def resume(self, own: Ownship, now_s: float) -> None:
        """Continue after the pilot has given authority again."""

    def drop(self) -> None:
        """Drop the path at the end of a flight, or before another one is planned."""


def plan_of(config: Config) -> FlownPlan | GuardPlan:
    """Plan of the kind that `flight.use` selects."""
    return GuardPlan(config) if config.flight.use == "guard" else FlownPlan(config)
