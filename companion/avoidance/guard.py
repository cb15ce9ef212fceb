"""The path of a vehicle that flies its own mission and is only guarded.

While the autopilot flies, the path is the velocity that it flies, whatever item that is of. When the
companion takes over, it is the straight way from there to the place of the mission's item, at the speed flown
until then, so that what is given back is the same item; where the item has no place (a delay, a return, a
landing), it is the point where the vehicle was taken.
"""

from __future__ import annotations

import math

from companion.autopilot.advice import restarting
from companion.autopilot.mission import NAV_RETURN_TO_LAUNCH, place_of, speed_at
from companion.avoidance.law import Law
from companion.avoidance.plan import RETRY_S, Plan
from companion.avoidance.trajectory import Trajectory
from companion.avoidance.walls import walls_of
from companion.config import LimitsConfig
from companion.errors import ConfigError
from companion.events import Command, MissionDownloaded, MissionItem, Vec3
from companion.ownship import Ownship

_AHEAD_S = 60.0
"""How long a path is that goes on as the vehicle flies now; what the law wants is its beginning."""
_LEAST_SPEED_MPS = 1.0
"""On the way back to the item's place, of a vehicle that stood or had only begun to move."""
_HERE_M = 0.5
_STAY_S = 1.0


class GuardPlan(Plan):
    """Path, law and path clock of a guarded mission. The mission is fetched when the vehicle begins to fly it
    and once more before it is given back: one that was changed meanwhile is not resumed."""

    _fetched = False
    _comparing = False
    _changed_mission = False
    _seq = 0
    """Item that the vehicle was at."""
    ended = False
    """The mission was complete when the vehicle was taken."""

    @property
    def ready(self) -> bool:
        """There is a law, and what the mission is is known."""
        return self.law is not None and self._fetched

    def drop(self) -> None:
        """The flight is over, or another mission is to be flown."""
        super().drop()
        self._fetched = self._comparing = self._changed_mission = False

    def take_mission(self, event: MissionDownloaded, now_s: float) -> None:
        """What the vehicle flies, or whether it is still that."""
        super().take_mission(event, now_s)
        if self._comparing:
            self._changed_mission = self._items != self._flown
        else:
            self._flown = self._items
        self._fetched, self._comparing = True, False

    def prepare(self, own: Ownship, now_s: float) -> list[Command]:
        """Make a law for a vehicle that could be watched now; a refused one is tried again later."""
        if self.law is not None and self._fetched:
            return []
        if now_s - self._tried_s < RETRY_S:
            return []
        self._tried_s = now_s
        restart = None if self._vehicle is None else restarting(self._vehicle)
        if restart is not None:
            return self.refuse(restart)
        asked = self._ask_fence(now_s)
        if asked is not None:
            return asked
        if not self._fetched:
            return self._ask_mission(now_s)
        try:
            walls = walls_of(self._checked_areas(), self._frame(own), None, own.sigma_m)
        except ConfigError as error:
            return self.refuse(str(error))
        home = own.home_alt_msl_m
        if home is None:
            return []
        here = own.position_ned_m(now_s)
        self.law = Law(self._config.avoidance, self.limits, _standing(here), walls)
        self.home_alt_msl_m, self._start_s, self._said = home, now_s, None
        return []

    def watch(self, own: Ownship, now_s: float) -> list[Command]:
        """The path is what the vehicle flies. Needs a law. Returns what is to be asked: an item number that
        went back is that of another mission, or of a jump."""
        assert self.law is not None
        here, v = own.position_ned_m(now_s), own.velocity_ned_mps
        there = (here[0] + _AHEAD_S * v[0], here[1] + _AHEAD_S * v[1], here[2] + _AHEAD_S * v[2])
        self.law.follow(Trajectory([0.0, _AHEAD_S], [here, there]))
        self._start_s = now_s
        self.lowest_height_m = self._height_m(own)
        back = own.mission_seq is not None and own.mission_seq < self._seq
        self._seq = own.mission_seq or 0
        return self._ask_mission(now_s) if back else []

    def leave(self, own: Ownship, now_s: float) -> None:
        """The vehicle is taken: its path is the way to its mission's item. Needs a law."""
        assert self.law is not None
        here, item = own.position_ned_m(now_s), self._item(own)
        path, lowest_m = _standing(here), self._height_m(own)
        place = None if item is None else place_of(item, self._height_m(own), self.home_alt_msl_m)
        if place is not None:
            lat_deg, lon_deg, height_m = place
            there = self._frame(own).to_ned(lat_deg, lon_deg, self.home_alt_msl_m + height_m)
            path = _way(here, there, math.hypot(*own.velocity_ned_mps), self.limits)
            lowest_m = min(lowest_m, height_m)
        self.law.follow(path)
        self._start_s, self.lowest_height_m = now_s, lowest_m
        self._items_s, self._comparing, self._changed_mission = -math.inf, False, False
        self.ended = own.mission_complete

    def near(self, own: Ownship, now_s: float) -> bool:
        """The way begins where the vehicle is."""
        return True

    def engage(self, now_s: float) -> None:
        """The clock runs since the vehicle was taken: it is flying."""

    def resume(self, own: Ownship, now_s: float) -> None:
        """The pilot gives authority anew: what he flies is fetched anew."""
        self.drop()

    def give_back(self, own: Ownship, now_s: float) -> tuple[bool | None, list[Command]]:
        """Whether the mission may be resumed: True; False: it was changed, or is complete (ArduPilot would
        fly it again from its beginning); None: not known yet, with what is to be asked."""
        self.ended = self.ended or own.mission_complete
        if self._changed_mission or self.ended:
            return False, []
        if now_s - self._items_s <= RETRY_S:
            return True, []
        if now_s - self._tried_s < RETRY_S:
            return None, []
        self._comparing, self._tried_s = True, now_s
        return None, self._ask_mission(now_s)

    def mission_speed_mps(self, own: Ownship) -> float | None:
        """What the mission has asked for; None: the vehicle's own speed. ArduPilot returns home at that,
        whatever was asked for before."""
        item = self._item(own)
        if item is None or item.command == NAV_RETURN_TO_LAUNCH:
            return None
        return speed_at(self._flown, item.seq)

    def _item(self, own: Ownship) -> MissionItem | None:
        return next((item for item in self._flown if item.seq == own.mission_seq), None)

    def _height_m(self, own: Ownship) -> float:
        return math.inf if own.position is None else own.position.height_above_home_m


def _standing(here: Vec3) -> Trajectory:
    return Trajectory([0.0, _STAY_S], [here, here])


def _way(here: Vec3, there: Vec3, speed_mps: float, limits: LimitsConfig) -> Trajectory:
    """Straight there, at the speed as far as the limits allow."""
    length, down = math.dist(here, there), there[2] - here[2]
    if length < _HERE_M:
        return _standing(here)
    speed = min(max(speed_mps, _LEAST_SPEED_MPS), limits.max_speed_mps)
    vertical_mps = limits.max_descent_mps if down > 0.0 else limits.max_climb_mps
    return Trajectory([0.0, max(length / speed, abs(down) / vertical_mps)], [here, there])
