"""The path of a vehicle that flies its own mission and is only guarded (`flight.use = "guard"`).

While the autopilot flies, the path extends the vehicle's current velocity, whichever mission item that
belongs to. When the companion takes over, the path is a straight line from there to the position of the
mission's current item, at the speed flown until then, so that the vehicle is handed back at the same item. If
the item has no position (a delay, a return, a landing), the path is the point where the vehicle was taken.
"""

from __future__ import annotations

import math

from companion.authority.course import Course
from companion.authority.downloads import RETRY_S, Downloads
from companion.authority.terms import Terms
from companion.autopilot.advice import restarting, too_fast
from companion.autopilot.lists.mission import NAV_RETURN_TO_LAUNCH, place_of, speeds_at
from companion.avoidance.law import new_law
from companion.avoidance.trajectory import Trajectory
from companion.avoidance.walls import walls_of
from companion.config import Config, LimitsConfig
from companion.errors import ConfigError
from companion.events import Command, GlobalPosition, MissionDownloaded, MissionItem
from companion.geometry import LocalFrame, Vec3
from companion.ownship import Ownship

_AHEAD_S = 60.0
"""Length in time of a path that extends the vehicle's current velocity."""
_BEFORE_S = 10.0
"""Least time before now at which a path begins (`_before_s`)."""
_LEAST_SPEED_MPS = 1.0
"""Lowest speed on the way to the item's position, for a vehicle that stood or had only begun to move."""
_REJOIN_S = 60.0
"""A vehicle that is taken again within this time may still be at the height to which traffic pushed it."""
_HERE_M = 0.5
_STAY_S = 1.0


class GuardPlan:
    """Path, law and path clock of a guarded mission.

    The mission is fetched when the vehicle begins to fly it. It is fetched again when its item number goes
    back or MISSION_CURRENT reports another mission. That is not enough: ArduPilot does not report a new
    mission with the same number of items that was uploaded on another link. So the mission is also fetched
    when the vehicle is taken and before it is handed back. A mission that changed in between is not resumed.
    """

    def __init__(self, config: Config) -> None:
        self.terms = Terms(config)
        self.downloads = Downloads(self.terms)
        self.course = Course()
        self.changed = False
        """Whether the mission differs from the one when the vehicle was taken."""
        self.ended = False
        """Whether the mission was complete when the vehicle was taken, or has been completed since."""
        self._flown: tuple[MissionItem, ...] = ()
        """Mission that the vehicle flies."""
        self._fetched = self._comparing = False
        self._compared_s = -math.inf
        """Time of the last comparison with the mission that the vehicle holds."""
        self._stale = False
        """Whether the mission must be fetched again, because the vehicle may fly another one by now."""
        self._judged: tuple[MissionItem, ...] | None = None
        """Mission whose speed was last compared with the limit."""
        self._seq = 0
        """Mission item at the last call of `watch`."""
        self._mark: tuple[int, int] | None = None
        """Mission mark (`Ownship.mission_mark`) at the last call of `watch`."""
        self._led: tuple[tuple[MissionItem, ...], int | None, float] | None = None
        """Mission, item number and home altitude to which the path leads; None if the mission was unknown."""
        self._speed_mps = 0.0
        """Speed of the vehicle when it was taken."""
        self._held_s, self._leg_m = -math.inf, (0.0, 0.0)
        """Time at which we last controlled the vehicle, and the lowest and highest point of its leg then (m
        above home)."""

    @property
    def ready(self) -> bool:
        """True if there is a law and the mission is known."""
        return self.course.law is not None and self._fetched

    def drop(self) -> None:
        """End the flight, or prepare for another mission."""
        self.course.end()
        self.downloads.forget()
        self._fetched = self._comparing = self.changed = self._stale = False
        self._mark, self._compared_s, self._held_s = None, -math.inf, -math.inf

    def mission_downloaded(self, event: MissionDownloaded, now_s: float) -> None:
        """Take in a downloaded mission: as the one that is flown, or for comparison with it."""
        self.downloads.mission_downloaded(event, now_s)
        if self._comparing:
            self.changed, self._compared_s = event.items != self._flown, now_s
        else:
            self._flown, self._stale = event.items, False
        self._fetched, self._comparing = True, False

    def check(self, own: Ownship, now_s: float) -> list[Command]:
        """Do nothing: any mission can be guarded."""
        return []

    def prepare(self, own: Ownship, now_s: float) -> list[Command]:
        """Make a law for a vehicle that could be watched now. A refused one is tried again later."""
        if self.course.law is not None and self._fetched:
            return []
        if not self.downloads.may_try(now_s):
            return []
        restart = None if self.terms.vehicle is None else restarting(self.terms.vehicle)
        if restart is not None:
            return self.terms.refuse(restart)
        asked = self.downloads.ask_fence(now_s)
        if asked is not None:
            return asked
        if not self._fetched:
            return self.downloads.ask_mission(now_s)
        try:
            walls = walls_of(self.downloads.areas(), self._frame(own), None, own.sigma_m)
        except ConfigError as error:
            return self.terms.refuse(str(error))
        home = own.home_alt_msl_m
        if home is None:
            return []
        here = own.position_ned_m(now_s)
        law = new_law(self.terms.config.avoidance, self.terms.limits, _standing(here), walls)
        self.course.begin(law, home, now_s)
        self.terms.accept()
        return []

    def watch(self, own: Ownship, now_s: float) -> list[Command]:
        """Update the path to the vehicle's current velocity, and detect a new mission. Needs a law.

        The mission is fetched again if its item number went back (another mission, or a jump) or if its mark
        changed (another mission). Returns requests and messages.
        """
        assert self.course.law is not None
        self._follow_home(own)
        here, v = own.position_ned_m(now_s), own.velocity_ned_mps
        before_s = _before_s(v, v, self.terms.limits)
        self.course.law.follow(
            Trajectory([-before_s, _AHEAD_S], [_moved(here, v, -before_s), _moved(here, v, _AHEAD_S)])
        )
        self.course.start_s = now_s
        self.course.lowest_height_m = self._height_m(own)
        back = own.mission_seq is not None and own.mission_seq < self._seq
        if back or (own.mission_mark != self._mark and self._mark is not None):
            self._renew()
        self._seq, self._mark = own.mission_seq or 0, own.mission_mark
        return [*self._tell_fast(), *self._fetch(now_s)]

    def _tell_fast(self) -> list[Command]:
        """Warn once if the mission is faster than our limit: taking the vehicle would slow it down."""
        if self.terms.vehicle is None or self._judged is self._flown:
            return []
        self._judged = self._flown
        text = too_fast(self.terms.config.limits, self.terms.vehicle, self._flown)
        return [] if text is None else self.terms.warn([text])

    def _renew(self) -> None:
        """Fetch the mission again at once, even if a download is in progress."""
        self._stale = True
        self.downloads.hurry()

    def _fetch(self, now_s: float) -> list[Command]:
        if not self._stale or not self.downloads.may_try(now_s):
            return []
        return self.downloads.ask_mission(now_s)

    def leave(self, own: Ownship, now_s: float) -> None:
        """Take the vehicle from its mission. Needs a law.

        The path leads to the mission's current item. If the mission is not known, the path stays at the
        vehicle's position.
        """
        self._speed_mps = math.hypot(*own.velocity_ned_mps)
        self._follow(own, now_s)
        self._comparing, self.changed, self._compared_s = False, False, -math.inf
        self.ended = own.mission_complete
        self._renew()

    def lead(self, own: Ownship, now_s: float) -> list[Command]:
        """While we control the vehicle, lead the path to the mission's current item if that has changed.

        Returns requests. Needs a law.
        """
        self._follow_home(own)
        if not self._stale and self._led != self._leads_to(own):
            self._follow(own, now_s)
        self._held_s, self._leg_m = now_s, self.course.leg_heights_m(now_s) or self._leg_m
        return self._fetch(now_s)

    def _follow_home(self, own: Ownship) -> None:
        """Take over a home that has moved: the autopilot's mission counts heights from it."""
        risen_m = self.course.follow_home(own)
        self._leg_m = self._leg_m[0] - risen_m, self._leg_m[1] - risen_m

    def _leads_to(self, own: Ownship) -> tuple[tuple[MissionItem, ...], int | None, float]:
        return self._flown, own.mission_seq, self.course.home_alt_msl_m

    def _follow(self, own: Ownship, now_s: float) -> None:
        assert self.course.law is not None
        here, item = own.position_ned_m(now_s), None if self._stale else self._item(own)
        height_m = self._height_m(own)
        if now_s - self._held_s <= _REJOIN_S:
            # Otherwise traffic that pushes the vehicle again and again would lower its leg each time.
            height_m = min(max(height_m, self._leg_m[0]), self._leg_m[1])
        lowest_m = height_m
        path = _standing(here)
        profile = [(path.start_s, height_m)]
        place = None if item is None else place_of(item, height_m, self.course.home_alt_msl_m)
        if place is not None:
            there = self._ned(place, own)
            path = _way(here, own.velocity_ned_mps, there, self._speed_mps, self.terms.limits)
            lowest_m = min(lowest_m, place[2])
            profile = [(0.0, height_m), (path.end_s, place[2])]
        self.course.law.follow(path)
        self.course.start_s, self.course.lowest_height_m = now_s, lowest_m
        places = [] if self._stale else self._places(own)
        around = [] if self._stale or own.takeoff is None else [self._ned(_takeoff(own.takeoff), own)]
        self.course.lead([*around, *(self._ned(p, own) for p in places)], [p[2] for p in places], profile)
        self._led = None if self._stale else self._leads_to(own)

    def near(self, own: Ownship, now_s: float) -> bool:
        """Return True: the path begins at the vehicle."""
        return True

    def remake(self, own: Ownship) -> bool:
        """Return False: the path is never too far away."""
        return False

    def engage(self, now_s: float) -> None:
        """Do nothing: the path's clock has run since the vehicle was taken."""

    def resume(self, own: Ownship, now_s: float) -> None:
        """Drop the plan when the pilot gives authority again, so that his mission is fetched again."""
        self.drop()

    def give_back(self, own: Ownship, now_s: float) -> tuple[bool | None, list[Command]]:
        """Decide whether the mission may be resumed, and request what that needs.

        Returns:
            True if it may be resumed, False if not (see `why_not`), None if not known yet; and requests.
        """
        self.ended = self.ended or own.mission_complete
        if self.why_not is not None:
            return False, []
        if now_s - self._compared_s <= RETRY_S:
            return True, []
        if self._stale or not self.downloads.may_try(now_s):
            return None, []
        self._comparing = True
        return None, self.downloads.ask_mission(now_s)

    @property
    def why_not(self) -> str | None:
        """Why the mission may not be resumed, in words; None if there is no known reason.

        ArduPilot would restart a complete mission, and with MIS_RESTART = 1 any mission, from its beginning.
        """
        if self.ended:
            return "the mission was already complete"
        if self.changed:
            return "the mission was changed in the meantime"
        return None if self.terms.vehicle is None else restarting(self.terms.vehicle)

    def mission_speed_mps(self, own: Ownship) -> float | None:
        """Speed that the mission has set; None if it has set none or the speed is ambiguous."""
        speeds = self._speeds(own)
        return next(iter(speeds)) if len(speeds) == 1 else None

    def speed_is_open(self, own: Ownship) -> bool:
        """Whether a jump in the mission makes it unknown which of its speeds applies."""
        return len(self._speeds(own)) > 1

    def _speeds(self, own: Ownship) -> frozenset[float | None]:
        """Mission speeds that may apply at the current item. ArduPilot returns home at its own speed."""
        item = self._item(own)
        if item is None or item.command == NAV_RETURN_TO_LAUNCH:
            return frozenset()
        return speeds_at(self._flown, item.seq)

    def _item(self, own: Ownship) -> MissionItem | None:
        return next((item for item in self._flown if item.seq == own.mission_seq), None)

    def _places(self, own: Ownship) -> list[Vec3]:
        """Places of the mission: latitude, longitude (deg), height above home (m)."""
        height_m, home_m = self._height_m(own), self.course.home_alt_msl_m
        places = (place_of(item, height_m, home_m) for item in self._flown)
        return [place for place in places if place is not None]

    def _ned(self, place: Vec3, own: Ownship) -> Vec3:
        """A place (latitude, longitude, height above home) in the local frame."""
        return self._frame(own).to_ned(place[0], place[1], self.course.home_alt_msl_m + place[2])

    def _frame(self, own: Ownship) -> LocalFrame:
        assert own.frame is not None
        return own.frame

    def _height_m(self, own: Ownship) -> float:
        return math.inf if own.position is None else self.course.own_height_m(own)


def _takeoff(position: GlobalPosition) -> Vec3:
    """Place of take-off, to which the vehicle returns: latitude, longitude (deg), height above home (m)."""
    return position.lat_deg, position.lon_deg, position.height_above_home_m


def _standing(here: Vec3) -> Trajectory:
    return Trajectory([0.0, _STAY_S], [here, here])


def _way(here: Vec3, velocity: Vec3, there: Vec3, speed_mps: float, limits: LimitsConfig) -> Trajectory:
    """Straight path to `there` that continues the current velocity, at `speed_mps` as far as limits allow."""
    length, down = math.dist(here, there), there[2] - here[2]
    if length < _HERE_M:
        return _standing(here)
    speed = min(max(speed_mps, _LEAST_SPEED_MPS), limits.max_speed_mps)
    vertical_mps = limits.max_descent_mps if down > 0.0 else limits.max_climb_mps
    arrival_s = max(length / speed, abs(down) / vertical_mps)
    north, east = (there[0] - here[0]) / arrival_s, (there[1] - here[1]) / arrival_s
    before_s = _before_s(velocity, (north, east, down / arrival_s), limits)
    return Trajectory([-before_s, 0.0, arrival_s], [_moved(here, velocity, -before_s), here, there])


def _before_s(velocity: Vec3, then: Vec3, limits: LimitsConfig) -> float:
    """How long before now a path begins that is extended backwards along the vehicle's velocity.

    The law averages a path's velocity over a window that grows with the path's largest turn
    (`kernels.Settings.turn_s`), and a path has no velocity before its beginning. A path that begins within
    the window would seem slower than the vehicle flies, and its conflicts would be seen late.

    Args:
        velocity, then: velocities before and from now on (NED, m/s).
    """
    turn_mps = max(math.hypot(*velocity), math.dist(velocity, then), math.hypot(*then))
    return max(_BEFORE_S, 0.5 * turn_mps / limits.max_acceleration_mps2)


def _moved(here: Vec3, velocity: Vec3, by_s: float) -> Vec3:
    return here[0] + by_s * velocity[0], here[1] + by_s * velocity[1], here[2] + by_s * velocity[2]
