"""The path that the companion flies (`flight.use = "fly"`): its source, clock and reference points.

A plan is made in the air, when the vehicle is ready to be taken in all other respects. Home, UTC and the
start position of a mission are those of that moment. They stay fixed for the flight, even if the autopilot
corrects them later; floor and ceiling then also count from the vehicle's present home, as in the gate.
Landing ends the plan.
"""

from __future__ import annotations

import math

from companion.authority.course import Course
from companion.authority.downloads import RETRY_S, Downloads
from companion.authority.terms import Terms
from companion.autopilot.lists.mission import path_from_mission
from companion.avoidance.law import new_law
from companion.avoidance.path import local_path
from companion.avoidance.trajectory import check_speeds
from companion.avoidance.walls import walls_of
from companion.config import Config, TrajectoryFile, level
from companion.errors import ConfigError
from companion.events import Command, FlightMode, MissionDownloaded, MissionItem
from companion.ownship import Ownship

_CHANGED = "the mission was changed while the pilot flew; select AUTO or MISSION to fly it, or land first"


class FlownPlan:
    """The path that the companion flies: a trajectory file, or the vehicle's mission as one."""

    def __init__(self, config: Config) -> None:
        self.terms = Terms(config)
        self.downloads = Downloads(self.terms)
        self.course = Course()
        self._flown: tuple[MissionItem, ...] = ()
        """Mission from which the path was made."""
        self._given_back = False
        """Whether the pilot gave the vehicle back, so that the mission must be compared before it
        continues."""
        self._changed: tuple[MissionItem, ...] = ()
        """Mission that was changed while the pilot flew. It must not be started from GUIDED or HOLD."""
        self._checked: bool | None = None
        """Whether the vehicle was armed when its mission was last checked on the ground; None if never."""
        self._check_s = -math.inf
        """Time of the last request for a mission to check on the ground."""

    @property
    def ready(self) -> bool:
        """True if there is a path and no comparison of the mission is pending."""
        return self.course.law is not None and not self._given_back

    def mission_downloaded(self, event: MissionDownloaded, now_s: float) -> None:
        """Keep the downloaded mission for the plan that is made next."""
        self.downloads.mission_downloaded(event, now_s)

    def drop(self) -> None:
        """End the flight. The next one begins with a new plan."""
        self.course.end()
        self.downloads.forget()
        self._given_back, self._changed = False, ()

    def check(self, own: Ownship, now_s: float) -> list[Command]:
        """On the ground, report what in the vehicle's mission cannot be flown.

        This is done when the vehicle is found and again when it is armed. The flight fetches the mission
        again.
        """
        flight = self.terms.config.flight
        if flight.use != "fly" or flight.trajectory != "mission" or self._checked == own.armed:
            return []
        if not self.downloads.mission_is_fresh(now_s):
            if own.frame is None or now_s - self._check_s < RETRY_S:
                return []
            self._check_s = now_s
            return self.downloads.ask_mission(now_s)
        speed, position, home = flight.mission_speed_mps, own.position, own.home_alt_msl_m
        if own.frame is None or position is None or home is None or speed is None:
            return []
        self._checked = own.armed
        start = position.lat_deg, position.lon_deg, position.height_above_home_m
        try:
            path = path_from_mission(
                self.downloads.items,
                speed_mps=speed,
                max_climb_mps=self.terms.limits.max_climb_mps,
                max_descent_mps=self.terms.limits.max_descent_mps,
                start=start,
                home_alt_msl_m=home,
            )
            if len(path.waypoint) > 2:
                # Leave out the first leg: it begins where the vehicle is taken, which is not known yet.
                rest = TrajectoryFile(altitude=path.altitude, waypoint=path.waypoint[1:])
                flown = local_path(level(rest), own.frame, home)
                check_speeds(flown, self.terms.config.limits, vehicle=self.terms.vehicle)
                walls_of(self.downloads.areas(), own.frame, flown, own.sigma_m)
        except ConfigError as error:
            return self.terms.refuse(str(error))
        return []

    def prepare(self, own: Ownship, now_s: float) -> list[Command]:
        """Make the plan for a vehicle that could be taken now. A refused plan is tried again later."""
        if self.course.law is not None:
            return self._compare(own, now_s) if self._given_back else []
        if not self.downloads.may_try(now_s):
            return []
        asked = self.downloads.ask_fence(now_s)
        if asked is not None:
            return asked
        try:
            path = self.terms.config.path
            if path is None:
                if not self.downloads.mission_is_fresh(now_s):
                    return self.downloads.ask_mission(now_s)
                path = self._from_mission(own)
            return [] if path is None else self._make(path, own, now_s)
        except ConfigError as error:
            return self.terms.refuse(str(error))

    def _compare(self, own: Ownship, now_s: float) -> list[Command]:
        """Continue the mission if it is unchanged. A changed mission is not resumed."""
        if not self.downloads.mission_is_fresh(now_s):
            return self.downloads.ask_mission(now_s) if self.downloads.may_try(now_s) else []
        items = self.downloads.items
        if items == self._flown:
            self._go_on(own, now_s)
            return []
        self.drop()
        self._changed = items
        return self.terms.refuse(_CHANGED)

    def _from_mission(self, own: Ownship) -> TrajectoryFile | None:
        """Path of the downloaded mission from the vehicle's position; None while the current item is unknown.

        Raises:
            ConfigError: the mission cannot be flown.
        """
        speed, position, home = self.terms.config.flight.mission_speed_mps, own.position, own.home_alt_msl_m
        flying = own.mode is FlightMode.MISSION
        if self.downloads.items == self._changed != () and not flying:
            raise ConfigError(_CHANGED)
        if speed is None or position is None or (flying and own.mission_seq is None):
            return None
        path = path_from_mission(
            self.downloads.items,
            speed_mps=speed,
            max_climb_mps=self.terms.limits.max_climb_mps,
            max_descent_mps=self.terms.limits.max_descent_mps,
            start=(position.lat_deg, position.lon_deg, position.height_above_home_m),
            home_alt_msl_m=home,
            # A mission in progress continues at its current item; any other starts at its beginning.
            first_seq=own.mission_seq if flying else None,
        )
        return level(path)

    def _make(self, path: TrajectoryFile, own: Ownship, now_s: float) -> list[Command]:
        flight, limits = self.terms.config.flight, self.terms.config.limits
        home, separation = own.home_alt_msl_m, own.separation_m
        if own.frame is None or home is None:
            return []
        datum = {"msl": 0.0, "home": home, "geodetic": None if separation is None else -separation}
        above_msl = datum[path.altitude]
        if above_msl is None:
            return self.terms.refuse(
                "its altitudes are geodetic, but the GNSS reports no height above the ellipsoid"
            )
        trajectory = local_path(path, own.frame, above_msl)
        check_speeds(trajectory, limits, vehicle=self.terms.vehicle)
        start_s = None
        if flight.start == "utc" and flight.start_utc_s is not None:
            if own.utc_offset_s is None:
                return self.terms.refuse("it starts at a UTC time, but the vehicle does not know UTC yet")
            start_s = flight.start_utc_s - own.utc_offset_s
        walls = walls_of(self.downloads.areas(), own.frame, trajectory, own.sigma_m)
        self._flown = self.downloads.items
        law = new_law(self.terms.config.avoidance, self.terms.limits, trajectory, walls)
        self.course.begin(law, home, start_s)
        heights_m = [w.alt_m + above_msl - home for w in path.waypoint]
        self.course.lowest_height_m = min(heights_m)
        profile = zip(trajectory.times_s, heights_m, strict=True)
        self.course.lead(trajectory.points_ned_m, heights_m, tuple(profile))
        self.terms.accept()
        return []

    def lead(self, own: Ownship, now_s: float) -> list[Command]:
        """Take a home that was set in flight. Returns no requests."""
        self.course.note_home(own)
        return []

    def engage(self, now_s: float) -> None:
        """Start the path's clock, unless it runs already: the vehicle now flies our setpoints."""
        self.course.engage(now_s)

    def resume(self, own: Ownship, now_s: float) -> None:
        """Continue from the nearest point of the path after the pilot gave the vehicle back in flight.

        A path that was made from the vehicle's mission continues only if the mission is unchanged.
        """
        if self.course.law is None:
            return
        if self.terms.config.path is None:
            self._given_back = True
            self.downloads.outdate_mission()
        else:
            self._go_on(own, now_s)

    def _go_on(self, own: Ownship, now_s: float) -> None:
        self._given_back = False
        if self.course.law is not None and self.terms.config.flight.start == "engage":
            nearest_s, _ = self.course.law.trajectory.nearest(own.position_ned_m(now_s))
            self.course.start_s = now_s - nearest_s

    def near(self, own: Ownship, now_s: float) -> bool:
        """Whether the aircraft is near enough to the path's point to be taken. Needs a law."""
        return self.course.distance_m(own, now_s) <= self.terms.config.flight.start_within_m

    def remake(self, own: Ownship) -> bool:
        """Drop the path if the vehicle flies its mission itself, so that a new one starts at its position.

        Returns whether the path was dropped.
        """
        if self.terms.config.path is not None or own.mode is not FlightMode.MISSION:
            return False
        self.drop()
        return True
