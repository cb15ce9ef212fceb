"""The path that is flown: where it comes from, when its clock starts, what it is anchored to.

A plan is made when the vehicle is otherwise ready to be taken, in the air: home, UTC and the place where a
mission begins are those of that moment and stay for the flight, whatever the autopilot corrects later.
Landing ends it.
"""

from __future__ import annotations

import math

from companion.autopilot.mission import path_from_mission
from companion.avoidance.law import Law, make_law
from companion.avoidance.path import local_path
from companion.avoidance.trajectory import check_speeds
from companion.config import Config, TrajectoryFile
from companion.errors import ConfigError
from companion.events import (
    Command,
    DownloadMission,
    FlightMode,
    MissionDownloaded,
    Say,
    Severity,
    Vec3,
)
from companion.ownship import Ownship

_RETRY_S = 10.0
"""Between two requests for the mission, and two tries of a path that was refused."""


class Plan:
    """Path, law and path clock of one flight."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._mission: TrajectoryFile | None = None
        self._tried_s = -math.inf
        self._said: str | None = None
        self.law: Law | None = None
        self.home_alt_msl_m = 0.0
        self._start_s: float | None = None
        """Monotonic time of the path's time 0."""

    def drop(self) -> None:
        """The flight is over: the next one begins with a new plan."""
        self._mission = self.law = self._start_s = None
        self._tried_s = -math.inf

    def take_mission(self, event: MissionDownloaded, own: Ownship) -> list[Command]:
        """Make the downloaded mission the path, from where the vehicle is now."""
        speed, position = self._config.flight.mission_speed_mps, own.position
        if self.law is not None or speed is None or position is None:
            return []
        try:
            self._mission = path_from_mission(
                event.items,
                speed_mps=speed,
                # A mission that is being flown goes on; one that is not begins at its beginning.
                first_seq=own.mission_seq if own.mode is FlightMode.MISSION else None,
                start=(position.lat_deg, position.lon_deg, position.height_above_home_m),
                home_alt_msl_m=own.home_alt_msl_m,
            )
        except ConfigError as error:
            return self.refuse(str(error))
        self._tried_s = -math.inf
        return []

    def refuse(self, reason: str) -> list[Command]:
        """Say why there is no path, once for each reason."""
        if reason == self._said:
            return []
        self._said = reason
        return [Say(severity=Severity.ERROR, text=f"DMUCA: path refused: {reason}")]

    def prepare(self, own: Ownship, now_s: float) -> list[Command]:
        """Make the plan for a vehicle that could be taken now; a refused one is tried again later."""
        if self.law is not None or now_s - self._tried_s < _RETRY_S:
            return []
        self._tried_s = now_s
        from_mission = self._config.flight.trajectory == "mission" and self._config.path is None
        path = self._mission if from_mission else self._config.path
        if path is None:
            return [DownloadMission()]
        try:
            return self._make(path, own, now_s)
        except ConfigError as error:
            self._mission = None
            return self.refuse(str(error))

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
        check_speeds(trajectory, limits)
        if flight.start == "utc" and flight.start_utc_s is not None:
            if own.utc_offset_s is None:
                return self.refuse("it starts at a UTC and the vehicle does not know UTC yet")
            self._start_s = flight.start_utc_s - own.utc_offset_s
        self.law = make_law(self._config.avoidance, limits, trajectory)
        self.home_alt_msl_m = home
        self._said = None
        return []

    def engage(self, now_s: float) -> None:
        """The vehicle is taken: the path's clock starts, unless it runs already."""
        if self._start_s is None:
            self._start_s = now_s

    def path_time_s(self, now_s: float) -> float:
        """Time on the path's clock; 0 before it starts."""
        return 0.0 if self._start_s is None else now_s - self._start_s

    def point(self, now_s: float) -> Vec3:
        """The timed path's point for now (local NED, m). Needs a law."""
        assert self.law is not None
        return self.law.trajectory.position(self.path_time_s(now_s))

    def distance_m(self, own: Ownship, now_s: float) -> float:
        """How far the aircraft is from that point."""
        return math.dist(self.point(now_s), own.position_ned_m(now_s))

    def boundary_down_m(self, height_m: float | None, own: Ownship, now_s: float) -> float | None:
        """NED down of a height above home, at the aircraft's own place: the plane of the frame is not level
        with it far from the origin."""
        if height_m is None or own.position is None:
            return None
        down_of_sample = own.position_ned_m(own.sample_s())[2]
        return down_of_sample + own.position.alt_msl_m - self.home_alt_msl_m - height_m
