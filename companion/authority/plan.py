"""The path that is flown: where it comes from, when its clock starts, what it is anchored to.

A plan is made when the vehicle is otherwise ready to be taken, in the air: home, UTC and the place where a
mission begins are those of that moment and stay for the flight, whatever the autopilot corrects later.
Landing ends it.
"""

from __future__ import annotations

import math

from companion.autopilot.advice import remarks
from companion.autopilot.mission import path_from_mission
from companion.avoidance.fence import check_areas
from companion.avoidance.law import Law
from companion.avoidance.limits import effective
from companion.avoidance.path import local_path
from companion.avoidance.trajectory import Trajectory, check_speeds
from companion.avoidance.walls import walls_of
from companion.config import Config, LimitsConfig, TrajectoryFile
from companion.errors import ConfigError
from companion.events import (
    Command,
    DownloadFence,
    DownloadMission,
    FenceArea,
    FenceDownloaded,
    FlightMode,
    MissionDownloaded,
    MissionItem,
    Say,
    Severity,
    Vec3,
    VehicleParameters,
)
from companion.geometry import LocalFrame
from companion.ownship import Ownship

_MISSION_FRESH_S = 1.0
_FENCE_FRESH_S = 90.0
"""The vehicle's fence is asked for first; the mission may take its time."""
_ANSWER_S = 75.0
"""A download that was asked for is answered within this time, or never."""
LEAST_HEIGHT_M = 15.0
"""Above home: where no floor is given, avoidance goes no lower than this or the path's lowest point."""
_CHANGED = (
    "the mission was changed while the pilot flew: it is flown from AUTO or MISSION, or after a landing"
)
RETRY_S = 10.0
"""Between two requests for the mission, and two tries of a path that was refused."""
LEAST_LAYER_M = 5.0
"""Between floor and ceiling, as a configuration must leave."""


class Plan:
    """Path, law and path clock of one flight."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._items: tuple[MissionItem, ...] = ()
        self._areas: tuple[FenceArea, ...] = config.fence
        self._areas_s = -math.inf
        self._items_s = -math.inf
        """When they were downloaded: soon after, vehicle and mission may have moved on."""
        self._flown: tuple[MissionItem, ...] = ()
        """The mission that the path was made of."""
        self._given_back = False
        """The pilot gave the vehicle back: the mission is to be compared before it is flown on."""
        self._changed: tuple[MissionItem, ...] = ()
        """A mission that the pilot changed in flight: not to be begun from GUIDED or HOLD."""
        self._asked_s = -math.inf
        """When a download was asked for that has not been answered."""
        self._tried_s = -math.inf
        self._said: str | None = None
        self._checked: bool | None = None
        """Whether it was armed when its mission was last checked on the ground."""
        self._check_s = -math.inf
        """When it was last asked for to be checked."""
        self._vehicle: VehicleParameters | None = None
        self._remarked: set[str] = set()
        self.law: Law | None = None
        self.home_alt_msl_m = self.lowest_height_m = 0.0
        self._start_s: float | None = None
        """Monotonic time of the path's time 0."""

    @property
    def ready(self) -> bool:
        """There is a path, and nothing is to be asked about it."""
        return self.law is not None and not self._given_back

    @property
    def limits(self) -> LimitsConfig:
        """The lower of what is configured and what the vehicle itself may."""
        return effective(self._config.limits, self._vehicle)

    def configure(self, config: Config) -> None:
        """Make the next plan with other numbers. Not while there is a law, which keeps its own."""
        assert self.law is None
        self._config = config

    def drop(self) -> None:
        """The flight is over: the next one begins with a new plan."""
        self.law = self._start_s = None
        self._given_back = False
        self._items, self._changed = (), ()
        self._items_s = self._areas_s = self._tried_s = -math.inf

    def check(self, own: Ownship, now_s: float) -> list[Command]:
        """On the ground: say what of the vehicle's mission cannot be flown, once it is found and once more
        when it is armed. The flight itself fetches it anew."""
        flight = self._config.flight
        if flight.use != "fly" or flight.trajectory != "mission" or self._checked == own.armed:
            return []
        if now_s - self._items_s > _MISSION_FRESH_S:
            if own.frame is None or now_s - self._check_s < RETRY_S:
                return []
            self._check_s = now_s
            return self._ask_mission(now_s)
        speed, position, home = flight.mission_speed_mps, own.position, own.home_alt_msl_m
        if own.frame is None or position is None or home is None or speed is None:
            return []
        self._checked = own.armed
        start = position.lat_deg, position.lon_deg, position.height_above_home_m
        try:
            path = path_from_mission(
                self._items,
                speed_mps=speed,
                max_climb_mps=self.limits.max_climb_mps,
                max_descent_mps=self.limits.max_descent_mps,
                start=start,
                home_alt_msl_m=home,
            )
            whole = local_path(path, own.frame, home)
            if len(whole.times_s) > 2:
                # The first leg begins where the vehicle is taken, which is not here.
                flown = Trajectory(whole.times_s[1:], whole.points_ned_m[1:])
                check_speeds(flown, self._config.limits, vehicle=self._vehicle)
                walls_of(self._checked_areas(), own.frame, flown, own.sigma_m)
        except ConfigError as error:
            return self.refuse(str(error))
        return []

    def take_mission(self, event: MissionDownloaded, now_s: float) -> None:
        """Keep the downloaded mission for the plan that is made at once."""
        self._items, self._items_s = event.items, now_s
        self._asked_s = self._tried_s = -math.inf

    def take_fence(self, event: FenceDownloaded, now_s: float) -> None:
        """Keep the downloaded geofence for the plan that is made at once."""
        self._areas, self._areas_s = event.areas, now_s
        self._asked_s = self._tried_s = -math.inf

    def take_parameters(self, event: VehicleParameters) -> list[Command]:
        """Keep the vehicle's own limits for the next plan; say once what the operator should know."""
        self._vehicle = event
        new = [text for text in remarks(self._config, event) if text not in self._remarked]
        self._remarked.update(new)
        return [Say(severity=Severity.WARNING, text=f"DMUCA: {text}") for text in new]

    def download_refused(self, reason: str) -> list[Command]:
        """What was asked for will not come; it is asked for again later."""
        self._asked_s = -math.inf
        return self.refuse(reason)

    def refuse(self, reason: str) -> list[Command]:
        """Say why there is no path, once for each reason."""
        if reason == self._said:
            return []
        self._said = reason
        return [Say(severity=Severity.ERROR, text=f"DMUCA: path refused: {reason}")]

    def prepare(self, own: Ownship, now_s: float) -> list[Command]:
        """Make the plan for a vehicle that could be taken now; a refused one is tried again later."""
        if self.law is not None:
            return self._compare(own, now_s) if self._given_back else []
        if now_s - self._tried_s < RETRY_S:
            return []
        self._tried_s = now_s
        asked = self._ask_fence(now_s)
        if asked is not None:
            return asked
        try:
            path = self._config.path
            if path is None:
                if now_s - self._items_s > _MISSION_FRESH_S:
                    return self._ask_mission(now_s)
                path = self._from_mission(own)
            return [] if path is None else self._make(path, own, now_s)
        except ConfigError as error:
            return self.refuse(str(error))

    def _ask_fence(self, now_s: float) -> list[Command] | None:
        """None: there is none to ask for, or it has just come."""
        if self._config.limits.fence != "vehicle" or now_s - self._areas_s <= _FENCE_FRESH_S:
            return None
        return self._ask(DownloadFence(), now_s)

    def _ask_mission(self, now_s: float) -> list[Command]:
        return self._ask(DownloadMission(), now_s)

    def _ask(self, command: Command, now_s: float) -> list[Command]:
        """Not again while it may be under way: the link would begin anew."""
        if now_s - self._asked_s < _ANSWER_S:
            return []
        self._asked_s = now_s
        return [command]

    def _compare(self, own: Ownship, now_s: float) -> list[Command]:
        """Fly the mission on if it is still the same; a changed one is not resumed."""
        if now_s - self._items_s > _MISSION_FRESH_S:
            if now_s - self._tried_s < RETRY_S:
                return []
            self._tried_s = now_s
            return self._ask_mission(now_s)
        items = self._items
        if items == self._flown:
            self._go_on(own, now_s)
            return []
        self.drop()
        self._changed = items
        return self.refuse(_CHANGED)

    def _from_mission(self, own: Ownship) -> TrajectoryFile | None:
        """The downloaded mission from where the vehicle is; None while it is not known where that is in it.

        Raises:
            ConfigError: the mission cannot be flown.
        """
        speed, position, home = self._config.flight.mission_speed_mps, own.position, own.home_alt_msl_m
        flying = own.mode is FlightMode.MISSION
        if self._items == self._changed != () and not flying:
            raise ConfigError(_CHANGED)
        if speed is None or position is None or (flying and own.mission_seq is None):
            return None
        return path_from_mission(
            self._items,
            speed_mps=speed,
            max_climb_mps=self.limits.max_climb_mps,
            max_descent_mps=self.limits.max_descent_mps,
            start=(position.lat_deg, position.lon_deg, position.height_above_home_m),
            home_alt_msl_m=home,
            # A mission that is being flown goes on; one that is not begins at its beginning.
            first_seq=own.mission_seq if flying else None,
        )

    def _make(self, path: TrajectoryFile, own: Ownship, now_s: float) -> list[Command]:
        flight, limits = self._config.flight, self._config.limits
        home, separation = own.home_alt_msl_m, own.separation_m
        if own.frame is None or home is None:
            return []
        datum = {"msl": 0.0, "home": home, "geodetic": None if separation is None else -separation}
        above_msl = datum[path.altitude]
        if above_msl is None:
            return self.refuse("its altitudes are geodetic and the GNSS gives no height above the ellipsoid")
        trajectory = local_path(path, own.frame, above_msl)
        check_speeds(trajectory, limits, vehicle=self._vehicle)
        if flight.start == "utc" and flight.start_utc_s is not None:
            if own.utc_offset_s is None:
                return self.refuse("it starts at a UTC and the vehicle does not know UTC yet")
            self._start_s = flight.start_utc_s - own.utc_offset_s
        walls = walls_of(self._checked_areas(), own.frame, trajectory, own.sigma_m)
        self._flown = self._items
        self.law = Law(self._config.avoidance, self.limits, trajectory, walls)
        self.home_alt_msl_m = home
        self.lowest_height_m = min(w.alt_m + above_msl - home for w in path.waypoint)
        self._said = None
        return []

    def _checked_areas(self) -> tuple[FenceArea, ...]:
        """Raises ConfigError for a fence that cannot be kept."""
        check_areas(self._areas)
        return self._areas

    def _frame(self, own: Ownship) -> LocalFrame:
        assert own.frame is not None
        return own.frame

    def engage(self, now_s: float) -> None:
        """The vehicle flies what we command: the path's clock starts, unless it runs already."""
        if self._start_s is None:
            self._start_s = now_s

    def resume(self, own: Ownship, now_s: float) -> None:
        """The pilot gives the vehicle back in flight: go on from the nearest point of the path; of the
        vehicle's mission only when that is still the same."""
        if self.law is None:
            return
        if self._config.path is None:
            self._given_back, self._items_s, self._tried_s = True, -math.inf, -math.inf
        else:
            self._go_on(own, now_s)

    def _go_on(self, own: Ownship, now_s: float) -> None:
        self._given_back = False
        if self.law is not None and self._config.flight.start == "engage":
            nearest_s, _ = self.law.trajectory.nearest(own.position_ned_m(now_s))
            self._start_s = now_s - nearest_s

    def path_time_s(self, now_s: float) -> float:
        """Time on the path's clock; 0 before it starts."""
        return 0.0 if self._start_s is None else now_s - self._start_s

    @property
    def late_s(self) -> float:
        """By how much the path has waited for the aircraft. Needs a law."""
        assert self.law is not None
        return self.law.late_s

    def point(self, now_s: float) -> Vec3:
        """The timed path's point for now (local NED, m). Needs a law."""
        assert self.law is not None
        return self.law.trajectory.position(self.path_time_s(now_s))

    def near(self, own: Ownship, now_s: float) -> bool:
        """Near enough to that point to be taken. Needs a law."""
        return self.distance_m(own, now_s) <= self._config.flight.start_within_m

    def remake(self, own: Ownship) -> bool:
        """A mission that the vehicle itself has flown on meanwhile is planned anew from where it is."""
        if self._config.path is not None or own.mode is not FlightMode.MISSION:
            return False
        self.drop()
        return True

    def distance_m(self, own: Ownship, now_s: float) -> float:
        """How far the aircraft is from that point."""
        return math.dist(self.point(now_s), own.position_ned_m(now_s))

    @property
    def floor_height_m(self) -> float:
        """Above home."""
        limits = self._config.limits
        if limits.floor_height_m is not None:
            return limits.floor_height_m
        ceiling = math.inf if limits.ceiling_height_m is None else limits.ceiling_height_m
        return min(LEAST_HEIGHT_M, self.lowest_height_m, ceiling - LEAST_LAYER_M)

    def boundary_down_m(self, height_m: float | None, own: Ownship, now_s: float) -> float | None:
        """NED down of a height above home, at the aircraft's own place: the plane of the frame is not level
        with it far from the origin."""
        if height_m is None or own.position is None:
            return None
        down_of_sample = own.position_ned_m(own.sample_s())[2]
        return down_of_sample + own.position.alt_msl_m - self.home_alt_msl_m - height_m
