"""Own state as the autopilot reports it: position, velocity, clocks, quality, and whether it is usable.

Three clocks are related to each other. A position is dated by the autopilot's time since boot. That time is
related to our monotonic time by the least delayed message and, if the autopilot answers TIMESYNC, by its
answers. A link that is slow or becomes slow therefore shows as age. UTC comes only from the vehicle, because
a small computer has no clock of its own. It is related to the time since boot inside the autopilot, so that
neither link delay nor a corrected UTC changes any age.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from companion.autopilot.dialect import in_mode
from companion.autopilot.heard_vehicle import NewestTime
from companion.events import (
    SIGMA_UNKNOWN_M,
    AirPressure,
    ClockRead,
    CurrentMode,
    EstimatorState,
    Event,
    FlightMode,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    Landed,
    LandedState,
    LocalPosition,
    MissionCurrent,
    VehicleTime,
)
from companion.geometry import LocalFrame, Vec3

_HEARTBEAT_LOST_S = 2.5
_GNSS_LOST_S = 3.0
_LANDED_LOST_S = 3.0
_PRESSURE_LOST_S = 5.0
_MOST_WEATHER_M = 500.0
"""Largest believed difference between pressure altitude and altitude above mean sea level. It corresponds to
60 hPa off the standard atmosphere; weather causes up to 300 m."""
_WEATHER_S, _SUDDEN_M = 300.0, 50.0
"""Time constant of the mean of that difference, and the largest deviation from the mean that is believed in
flight, because weather changes slowly."""
_GROUNDED_S, _GROUNDED_MESSAGES = 1.5, 3
"""An armed vehicle is believed to be on the ground after this many consecutive messages over this time."""
_GROUNDED_HIGH_S = 10.0
"""The same time for a vehicle that is far from the height of its home and of its take-off."""
_HIGH_M = 10.0
_STANDING_MPS = 2.0
"""A vehicle on the ground is never faster than this, even if its estimate is bad."""
_ESTIMATOR_LOST_S = 5.0
_DRIFT_ARMED = 1e-3
"""Largest assumed rate at which the autopilot's clock falls behind ours, in seconds per second. A higher rate
could not be told from a link that becomes slow, and flying on old positions is worse than a lasting fault."""
_DRIFT_AHEAD = 1e-4
"""Largest assumed rate at which the autopilot's clock gains on ours: that of two quartz clocks."""
_FINE_S = 0.01
"""Possible error between the autopilot's time stamps. Messages count milliseconds. ArduPilot also dates a
TIMESYNC request back by the time that its bytes take on a serial line, even if there is none: 5 ms at 57600
baud."""
_DRIFT_DISARMED = 0.1
"""The same rate as `_DRIFT_ARMED` while disarmed: on the ground, a clock that slipped is soon accepted."""
_FRAME_REACH_M = 5_000.0
"""A disarmed vehicle farther than this from the local frame's origin gets a new one."""
_REBOOT_S = 1.0
_JUMP_M = 30.0
"""A position that moves by more than this beyond what the speed explains counts as a jump."""
_JUMP_RATE_MPS = 20.0
_FARTHEST_M = 1_000_000.0
"""Largest distance from the local frame's origin. A position beyond it is not believed."""
_EPSILON_S = 1e-6
MOST_SEPARATION_M = 150.0
"""Largest separation of geoid and ellipsoid that is believed. The true one is nowhere more than 110 m."""
_UNTRUSTED_S = 2.0
"""How long the own state must be steady after a jump or a reboot before it is usable."""


@dataclass(slots=True)
class _BootClock:
    """Our monotonic time minus the autopilot's time since boot, estimated between two bounds.

    No message arrives before it was stamped, so the least delayed one gives an upper bound. No TIMESYNC is
    answered before it was asked, which gives a lower bound. The middle is wrong by half the round trip at
    most, however that is divided between the two directions. Without answers there is only the upper bound,
    which is wrong by the whole delay of the downlink.
    """

    most_s: float | None = None
    least_s: float | None = None
    newest: NewestTime = field(default_factory=NewestTime)
    at_s: float = 0.0
    offset_s: float | None = None
    """Estimated offset; None before the first time stamp."""

    def add_stamp(
        self, time_boot_s: float, now_s: float, drift: float
    ) -> Literal["current", "overtaken", "restarted"]:
        """Take in one time stamp. Returns what it shows (see `NewestTime.take`)."""
        shown = self.newest.take(time_boot_s, now_s)
        most = now_s - time_boot_s
        if self.most_s is None or shown == "restarted":
            self.least_s = None
        else:
            # Delay only makes the offset appear too large: keep the smallest one, and allow for drift.
            most = min(most, self.most_s + drift * (now_s - self.at_s))
            if self.least_s is not None:
                self.least_s -= _DRIFT_AHEAD * (now_s - self.at_s)
        self.at_s = now_s
        self._bound(most)
        self._estimate()
        return shown

    def read(self, event: ClockRead) -> None:
        """Take in one answer to TIMESYNC."""
        most, least = event.heard_s - event.time_boot_s, event.asked_s - event.time_boot_s
        if self.most_s is None or abs(most - self.most_s) > _REBOOT_S:
            # This is not the clock of the messages but for instance Unix time, or the clock has just
            # restarted, which the messages will show.
            return
        # The answer proves that the clock fell behind, not that the link is slow: discard the old bound.
        self._bound(most if least > self.most_s + _FINE_S else min(most, self.most_s))
        self.least_s = least if self.least_s is None else max(least, self.least_s)
        self._estimate()

    def _bound(self, most_s: float) -> None:
        self.most_s = most_s
        if self.least_s is not None and most_s < self.least_s - _FINE_S:
            # The autopilot's clock ran ahead: discard the lower bound.
            self.least_s = None

    def _estimate(self) -> None:
        if self.most_s is None or self.least_s is None:
            self.offset_s = self.most_s
            return
        width = self.most_s - self.least_s
        # Bounds closer than _FINE_S are treated as equal; from twice that width on, the estimate is the
        # middle.
        self.offset_s = self.most_s - min(width / 2.0, max(0.0, width - _FINE_S))


@dataclass(slots=True)
class Ownship:
    """Everything known about the own aircraft."""

    heartbeat: Heartbeat | None = None
    """Last heartbeat, with the mode updated from any later CURRENT_MODE."""
    heartbeat_s: float = -math.inf
    position: GlobalPosition | None = None
    velocity_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    gnss: GnssFix | None = None
    mission_seq: int | None = None
    """Number of the mission's current item."""
    mission_complete: bool = False
    """The last item of the mission is done."""
    mission_mark: tuple[int, int] | None = None
    """Number of items and id of the mission. If they change, the vehicle has another mission."""
    takeoff: GlobalPosition | None = None
    """Last position of the aircraft on the ground."""
    separation_m: float | None = None
    """Height of the geoid above the ellipsoid (m), from the GNSS receiver's two altitudes."""
    pressure_above_m: float | None = None
    """Own pressure altitude minus altitude above mean sea level (m): the weather, and the errors of both."""
    frame: LocalFrame | None = None
    """Local NED frame: origin at the first position, altitude datum mean sea level. Kept while armed."""
    boot_to_utc_s: float | None = None
    """UTC minus the autopilot's time since boot."""
    _clock: _BootClock = field(default_factory=_BootClock)
    _landed: Landed = Landed.UNDEFINED
    _landed_s: float = -math.inf
    _grounded: int = 0
    """Number of consecutive messages that reported the vehicle on the ground."""
    _grounded_s: float = -math.inf
    """Time of the first of these messages."""
    _gnss_s: float = -math.inf
    _pressure_s: float = -math.inf
    _weather_m: float | None = None
    """Mean of the differences between pressure altitude and altitude that were believed (m)."""
    _estimator_lost_s: float = -math.inf
    """Time of the last report that the estimator has no position; minus infinity if it has one again."""
    _velocity_boot_s: float = -math.inf
    _position_heard_s: float = -math.inf
    _sample_ned_m: Vec3 = (0.0, 0.0, 0.0)
    _sample_s: float = -math.inf
    """What `sample_s` returns. It changes only with events, and is asked for seven times a step."""
    _upset_s: float = -math.inf
    _upset: str = ""

    def observe(self, event: Event, now_s: float, sent_s: float | None = None) -> None:
        """Take in one event that concerns the own aircraft. Other events are ignored.

        Args:
            sent_s: earliest time at which it can have been sent, used to date a message without its own time
                stamp; None for now.
        """
        sent_s = now_s if sent_s is None else sent_s
        match event:
            case GlobalPosition():
                self._take_position(event, now_s)
            case LocalPosition():
                # A velocity that is dated far ahead would block all later ones.
                if event.time_boot_s <= self._clock.newest.boot_s + _REBOOT_S:
                    self._take_velocity(event.velocity_ned_mps, event.time_boot_s)
            case Heartbeat():
                self.heartbeat, self.heartbeat_s = event, sent_s
            case CurrentMode():
                # This does not count as a sign of life; only the heartbeat does.
                if self.heartbeat is not None:
                    self.heartbeat = in_mode(self.heartbeat, event.custom_mode)
            case GnssFix():
                self.gnss, self._gnss_s = event, sent_s
                if event.alt_ellipsoid_m is not None and event.fix_type >= 3:
                    separation_m = event.alt_ellipsoid_m - event.alt_msl_m
                    # A wrong separation would place every other aircraft far above or below us.
                    self.separation_m = separation_m if abs(separation_m) <= MOST_SEPARATION_M else None
            case AirPressure():
                self._take_pressure(event, sent_s)
            case ClockRead():
                self._clock.read(event)
            case LandedState():
                self._take_landed(event.landed, sent_s)
            case EstimatorState():
                self._estimator_lost_s = -math.inf if event.usable else now_s
            case MissionCurrent():
                self.mission_seq, self.mission_complete = event.seq, event.complete
                self.mission_mark = event.total, event.mission_id
            case VehicleTime():
                self._tick(event.time_boot_s, now_s)
                if event.utc_s is not None:
                    self.boot_to_utc_s = event.utc_s - event.time_boot_s
            case _:
                pass
        if self.position is not None and self._clock.offset_s is not None:
            self._sample_s = min(self.position.time_boot_s + self._clock.offset_s, self._position_heard_s)

    def _take_pressure(self, event: AirPressure, now_s: float) -> None:
        if self.position is not None:
            above_m = pressure_altitude_m(event.pressure_hpa) - self.position.alt_msl_m
            mean_m, passed_s = self._weather_m, min(now_s - self._pressure_s, _PRESSURE_LOST_S)
            if mean_m is None or self.landed(now_s) is Landed.ON_GROUND:
                mean_m = above_m
            known = abs(above_m) <= _MOST_WEATHER_M and abs(above_m - mean_m) <= _SUDDEN_M
            if known:
                self._weather_m = mean_m + (1.0 - math.exp(-passed_s / _WEATHER_S)) * (above_m - mean_m)
            self.pressure_above_m = above_m if known else None
            self._pressure_s = now_s

    def _take_landed(self, landed: Landed, now_s: float) -> None:
        """Take in a landed state.

        A false landing in flight would end all collision avoidance. An armed vehicle is therefore believed to
        be on the ground only after several messages, and after a longer time far from the height of home and
        take-off, where it may stand on a hill. If it moves, no message counts. Until then the previous state
        holds.
        """
        self._landed, self._landed_s = self.landed(now_s), now_s
        if landed is not Landed.ON_GROUND or not self.armed:
            self._landed, self._grounded = landed, 0
            return
        if self._landed is landed:
            return
        if math.hypot(*self.velocity_ned_mps) > _STANDING_MPS:
            self._grounded = 0
            return
        if self._grounded == 0:
            self._grounded_s = now_s
        self._grounded += 1
        least_s = _GROUNDED_HIGH_S if self._high else _GROUNDED_S
        if self._grounded >= _GROUNDED_MESSAGES and now_s - self._grounded_s >= least_s - _EPSILON_S:
            self._landed, self._grounded = landed, 0

    @property
    def _high(self) -> bool:
        if self.position is None:
            return False
        heights = [self.position.height_above_home_m]
        if self.takeoff is not None:
            heights.append(self.position.alt_msl_m - self.takeoff.alt_msl_m)
        return all(abs(height) > _HIGH_M for height in heights)

    def _tick(self, time_boot_s: float, now_s: float) -> None:
        shown = self._clock.add_stamp(time_boot_s, now_s, _DRIFT_ARMED if self.armed else _DRIFT_DISARMED)
        if shown == "overtaken":
            self._trouble("old messages of the autopilot arrive after newer ones", now_s)
        elif shown == "restarted":
            # Earlier data were dated by another clock and must not count as fresh.
            self.position = None
            self._velocity_boot_s, self.boot_to_utc_s = -math.inf, None
            self._landed_s = -math.inf
            self._trouble("the autopilot's clock restarted", now_s)

    def _trouble(self, what: str, now_s: float) -> None:
        self._upset, self._upset_s = what, now_s

    def _take_velocity(self, velocity: Vec3, time_boot_s: float) -> None:
        if time_boot_s >= self._velocity_boot_s:
            self.velocity_ned_mps, self._velocity_boot_s = velocity, time_boot_s

    def _take_position(self, event: GlobalPosition, now_s: float) -> None:
        self._tick(event.time_boot_s, now_s)
        if self.position is not None and event.time_boot_s < self.position.time_boot_s:
            return  # A newer position has overtaken this one.
        if self.frame is None:
            self.frame = LocalFrame(event.lat_deg, event.lon_deg, event.alt_msl_m)
        sample = self.frame.to_ned(event.lat_deg, event.lon_deg, event.alt_msl_m)
        if not self.armed and math.hypot(sample[0], sample[1]) > _FRAME_REACH_M:
            self.frame = LocalFrame(event.lat_deg, event.lon_deg, event.alt_msl_m)
            sample, self.position = (0.0, 0.0, 0.0), None
        if self.position is not None:
            elapsed = max(0.0, event.time_boot_s - self.position.time_boot_s)
            speed = _JUMP_RATE_MPS + math.hypot(*self.velocity_ned_mps)
            if math.dist(sample, self._sample_ned_m) > _JUMP_M + speed * elapsed:
                self._trouble("own position jumped", now_s)
        if math.hypot(*sample) > _FARTHEST_M:
            self._trouble("own position is implausibly far from the first one", now_s)
        self.position, self._sample_ned_m, self._position_heard_s = event, sample, now_s
        self._take_velocity(event.velocity_ned_mps, event.time_boot_s)
        if self.landed(now_s) is Landed.ON_GROUND:
            self.takeoff = event

    @property
    def mode(self) -> FlightMode | None:
        """Mode from the last heartbeat or a later CURRENT_MODE; None before the first heartbeat."""
        return None if self.heartbeat is None else self.heartbeat.mode

    @property
    def armed(self) -> bool:
        """Whether the last heartbeat reported the vehicle as armed."""
        return self.heartbeat is not None and self.heartbeat.armed

    def landed(self, now_s: float) -> Landed:
        """Landed state; undefined if the vehicle has not reported it for a while."""
        return self._landed if now_s - self._landed_s <= _LANDED_LOST_S else Landed.UNDEFINED

    def sample_s(self) -> float:
        """Our monotonic time of the last position. Needs a position.

        It is never later than the reception, so that no later correction of the clock makes the position
        younger.
        """
        assert self.position is not None
        return self._sample_s

    @property
    def utc_offset_s(self) -> float | None:
        """UTC minus our monotonic time (s); None while the vehicle does not know UTC."""
        if self.boot_to_utc_s is None or self._clock.offset_s is None:
            return None
        return self.boot_to_utc_s - self._clock.offset_s

    def age_s(self, now_s: float) -> float:
        """Age of the last position (s); infinite if there is none."""
        return math.inf if self.position is None else now_s - self._sample_s

    def position_ned_m(self, now_s: float) -> Vec3:
        """Position extrapolated to `now_s` with the own velocity (local NED, m). Needs a position."""
        p, v = self._sample_ned_m, self.velocity_ned_mps
        age = now_s - self._sample_s
        return p[0] + age * v[0], p[1] + age * v[1], p[2] + age * v[2]

    def pressure_alt_m(self, now_s: float) -> float | None:
        """Own pressure altitude (m), as transponders send theirs; None while it is not known."""
        if self.position is None or self.pressure_above_m is None:
            return None
        if now_s - self._pressure_s > _PRESSURE_LOST_S:
            return None
        # Far from its origin, the frame's tangent plane lies above the ground: 126 m at 40 km.
        climbed_m = -(now_s - self._sample_s) * self.velocity_ned_mps[2]
        return self.position.alt_msl_m + climbed_m + self.pressure_above_m

    def gnss_now(self, now_s: float) -> GnssFix | None:
        """Last report of the GNSS receiver; None if it is too old."""
        return self.gnss if now_s - self._gnss_s <= _GNSS_LOST_S else None

    def estimator_lost(self, now_s: float) -> bool:
        """Whether the autopilot reported lately that its estimator has no position. It goes on reporting one
        all the same."""
        return now_s - self._estimator_lost_s <= _ESTIMATOR_LOST_S

    @property
    def sigma_m(self) -> float:
        """Own horizontal standard deviation per axis (m), as the receiver estimates it."""
        if self.gnss is None or self.gnss.horizontal_accuracy_m is None:
            return SIGMA_UNKNOWN_M
        return self.gnss.horizontal_accuracy_m

    @property
    def home_alt_msl_m(self) -> float | None:
        """Altitude of the vehicle's home above mean sea level; None without a position."""
        return None if self.position is None else self.position.alt_msl_m - self.position.height_above_home_m

    def unfit(self, now_s: float, stale_after_s: float) -> str | None:
        """Why the own state is not usable for flight, in words; None if it is usable."""
        if self.heartbeat is None or now_s - self.heartbeat_s > _HEARTBEAT_LOST_S:
            return f"no heartbeat from the autopilot for {_HEARTBEAT_LOST_S:g} s"
        if self.age_s(now_s) > stale_after_s:
            return f"own position older than {stale_after_s:g} s"
        if self.gnss is None or now_s - self._gnss_s > _GNSS_LOST_S:
            return f"no GNSS report for {_GNSS_LOST_S:g} s"
        if self.gnss.fix_type < 3:
            return f"GNSS without a 3D fix (fix type {self.gnss.fix_type})"
        if self.estimator_lost(now_s):
            return "the autopilot's estimator has no position"
        if now_s - self._upset_s < _UNTRUSTED_S:
            return self._upset
        return None


def pressure_altitude_m(pressure_hpa: float) -> float:
    """Altitude at which the standard atmosphere has a pressure (ICAO Doc 7488, below 11 km)."""
    return float(44_330.77 * (1.0 - (pressure_hpa / 1013.25) ** 0.190263))
