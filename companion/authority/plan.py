"""What the heart needs of a plan, be it flown by the companion or by the autopilot."""

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
    """Where the path comes from, and whether it may be flown now."""

    terms: Terms
    downloads: Downloads
    course: Course

    @property
    def ready(self) -> bool:
        """There is a path, and nothing is to be asked about it."""

    def take_mission(self, event: MissionDownloaded, now_s: float) -> None:
        """The vehicle's mission has come."""

    def check(self, own: Ownship, now_s: float) -> list[Command]:
        """On the ground: what of the vehicle's mission cannot be flown. Returns what is to be asked, said."""

    def prepare(self, own: Ownship, now_s: float) -> list[Command]:
        """Make the path for a vehicle that could be taken now. Returns what is to be asked and said."""

    def near(self, own: Ownship, now_s: float) -> bool:
        """The aircraft is near enough to the path to be taken. Needs a law."""

    def remake(self, own: Ownship) -> bool:
        """Drop a path that is too far away, where another one can be made; whether that was done."""

    def engage(self, now_s: float) -> None:
        """The vehicle flies what we command."""

    def resume(self, own: Ownship, now_s: float) -> None:
        """The pilot gives authority anew."""

    def drop(self) -> None:
        """The flight is over, or another path is to be flown: the next one is planned anew."""


def plan_of(config: Config) -> FlownPlan | GuardPlan:
    """The plan that `flight.use` asks for."""
    return GuardPlan(config) if config.flight.use == "guard" else FlownPlan(config)
