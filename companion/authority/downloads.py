"""Downloads of the vehicle's mission and geofence."""

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
"""Pause between two requests for the mission, and between two attempts at a path that was refused."""
_MISSION_FRESH_S = 1.0
_FENCE_FRESH_S = 90.0
"""How long a downloaded fence counts as fresh. The fence is requested first, so it must stay fresh while the
mission downloads."""
_NO_AREAS = (
    'limits.fence "vehicle": the vehicle holds no polygon and no circle, so no fence is kept '
    "(FENCE_RADIUS and height fences are not read)"
)
_ANSWER_S = 75.0
"""A requested download is answered within this time, or never."""


class Downloads:
    """Requests downloads no more often than they can be answered, and keeps the results for the next plan."""

    def __init__(self, terms: Terms) -> None:
        self.items: tuple[MissionItem, ...] = ()
        """Mission of the latest download."""
        self._terms = terms
        self._areas: tuple[FenceArea, ...] = terms.config.fence
        self._items_s = self._areas_s = -math.inf
        """Times of the downloads. They are valid only for a short time, because the vehicle flies on and the
        mission may change."""
        self._asked_s = -math.inf
        """Time of a request that has not been answered yet."""
        self._tried_s = -math.inf

    def mission_downloaded(self, event: MissionDownloaded, now_s: float) -> None:
        """Keep a downloaded mission."""
        self.items, self._items_s = event.items, now_s
        self.hurry()

    def fence_downloaded(self, event: FenceDownloaded, now_s: float) -> list[Command]:
        """Keep a downloaded geofence. Returns a warning if it is empty: who asks for the vehicle's fence
        expects one, and ArduPilot's circle around home is not among the items that a vehicle holds."""
        self._areas, self._areas_s = event.areas, now_s
        self.hurry()
        return [] if event.areas else self._terms.warn([_NO_AREAS])

    def refused(self, reason: str) -> list[Command]:
        """Handle a failed download; it is requested again later. Returns messages for the pilot."""
        self._asked_s = -math.inf
        return self._terms.refuse(reason)

    def forget(self) -> None:
        """Discard all downloads, so that the next plan fetches them again."""
        self.items = ()
        self._items_s = self._areas_s = self._tried_s = -math.inf

    def outdate_mission(self) -> None:
        """Fetch the mission again without a pause. The last one is kept until the new one arrives."""
        self._items_s = self._tried_s = -math.inf

    def hurry(self) -> None:
        """Allow the next request without a pause, even if an answer is still due."""
        self._asked_s = self._tried_s = -math.inf

    def may_try(self, now_s: float) -> bool:
        """Whether the pause since the last attempt is over. If so, this call counts as an attempt and starts
        the next pause."""
        if now_s - self._tried_s < RETRY_S:
            return False
        self._tried_s = now_s
        return True

    def mission_is_fresh(self, now_s: float) -> bool:
        """Whether the mission was downloaded within the last second."""
        return now_s - self._items_s <= _MISSION_FRESH_S

    def ask_mission(self, now_s: float) -> list[Command]:
        """Request the mission."""
        return self._ask(DownloadMission(), now_s)

    def ask_fence(self, now_s: float) -> list[Command] | None:
        """Request the vehicle's fence. Returns None if it is not configured to be used, or is still fresh."""
        if self._terms.config.limits.fence != "vehicle" or now_s - self._areas_s <= _FENCE_FRESH_S:
            return None
        return self._ask(DownloadFence(), now_s)

    def _ask(self, command: Command, now_s: float) -> list[Command]:
        """Request a download, unless one may still be in progress: the link would start it again."""
        if now_s - self._asked_s < _ANSWER_S:
            return []
        self._asked_s = now_s
        return [command]

    def areas(self) -> tuple[FenceArea, ...]:
        """Areas of the fence that applies.

        Raises:
            ConfigError: an area is invalid.
        """
        check_areas(self._areas)
        return self._areas
