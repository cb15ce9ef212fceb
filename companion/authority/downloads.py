"""What the vehicle itself holds of its flight, fetched: its mission and its geofence."""

from __future__ import annotations

import math

from companion.authority.terms import Terms
from companion.events import (
    Command,
    DownloadFence,
    DownloadMission,
    FenceArea,
    FenceDownloaded,
    MissionDownloaded,
    MissionItem,
)
from companion.geofence import check_areas

RETRY_S = 10.0
"""Between two requests for the mission, and two tries of a path that was refused."""
_MISSION_FRESH_S = 1.0
_FENCE_FRESH_S = 90.0
"""The vehicle's fence is asked for first; the mission may take its time."""
_ANSWER_S = 75.0
"""A download that was asked for is answered within this time, or never."""


class Downloads:
    """Asks for them, not more often than they can be answered, and keeps what came for the plan that is made
    at once."""

    def __init__(self, terms: Terms) -> None:
        self.items: tuple[MissionItem, ...] = ()
        """The mission as it came last."""
        self._terms = terms
        self._areas: tuple[FenceArea, ...] = terms.config.fence
        self._items_s = self._areas_s = -math.inf
        """When they were downloaded: soon after, vehicle and mission may have moved on."""
        self._asked_s = -math.inf
        """When a download was asked for that has not been answered."""
        self._tried_s = -math.inf

    def take_mission(self, event: MissionDownloaded, now_s: float) -> None:
        """Keep the mission that came."""
        self.items, self._items_s = event.items, now_s
        self.hurry()

    def take_fence(self, event: FenceDownloaded, now_s: float) -> None:
        """Keep the geofence that came."""
        self._areas, self._areas_s = event.areas, now_s
        self.hurry()

    def refused(self, reason: str) -> list[Command]:
        """What was asked for will not come; it is asked for again later. Returns what is to be said."""
        self._asked_s = -math.inf
        return self._terms.refuse(reason)

    def forget(self) -> None:
        """The next plan begins with what is fetched anew."""
        self.items = ()
        self._items_s = self._areas_s = self._tried_s = -math.inf

    def outdate_mission(self) -> None:
        """The mission is fetched anew, without a pause; until then the last one is kept."""
        self._items_s = self._tried_s = -math.inf

    def hurry(self) -> None:
        """The next request needs no pause, also where an answer is still due."""
        self._asked_s = self._tried_s = -math.inf

    def may_try(self, now_s: float) -> bool:
        """The pause since the last try is over; this is one, and the next pause begins."""
        if now_s - self._tried_s < RETRY_S:
            return False
        self._tried_s = now_s
        return True

    def mission_is_fresh(self, now_s: float) -> bool:
        """The mission came just now."""
        return now_s - self._items_s <= _MISSION_FRESH_S

    def ask_mission(self, now_s: float) -> list[Command]:
        """Ask for the mission."""
        return self._ask(DownloadMission(), now_s)

    def ask_fence(self, now_s: float) -> list[Command] | None:
        """Ask for the fence; None: there is none to ask for, or it has just come."""
        if self._terms.config.limits.fence != "vehicle" or now_s - self._areas_s <= _FENCE_FRESH_S:
            return None
        return self._ask(DownloadFence(), now_s)

    def _ask(self, command: Command, now_s: float) -> list[Command]:
        """Not again while it may be under way: the link would begin anew."""
        if now_s - self._asked_s < _ANSWER_S:
            return []
        self._asked_s = now_s
        return [command]

    def areas(self) -> tuple[FenceArea, ...]:
        """The fence that is to be kept.

        Raises:
            ConfigError: it cannot be kept.
        """
        check_areas(self._areas)
        return self._areas
