"""Troubles of the mock vehicle, which the caller sets, and the firmware's failsafe reactions to them.

The causes are the battery, the estimator, GNSS, the pilot's sticks, the ground station's silence and the
fence. Every failsafe acts once, when its cause begins. The parameters select the action, and the firmware
behaviour (`Manners`) says which mode it leads to. The reactions were read in the firmwares' sources.
ArduPilot's landing from more than 100 m outside a fence is not imitated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkMessage
from companion.errors import ConfigError
from companion.geometry import LocalFrame
from sitl_mocks.vehicle.firmware.behaviour import Failsafe, Manners, VehicleMode
from sitl_mocks.vehicle.motion.flight import MANUAL_CONTROL_OFF, Flight
from sitl_mocks.vehicle.served.mission import CIRCLES, VERTICES, MissionBook
from sitl_mocks.vehicle.served.params import ParamBook

PERIOD_S = 0.1
_MAX_HEIGHT, _CIRCLE, _POLYGON = (
    mavlink.FENCE_TYPE_ALT_MAX,
    mavlink.FENCE_TYPE_CIRCLE,
    mavlink.FENCE_TYPE_POLYGON,
)
_NAMES = {_MAX_HEIGHT: "Max Alt", _CIRCLE: "Circle", _POLYGON: "Polygon"}
_WARNING = int(mavlink.MAV_SEVERITY_WARNING)
_NOTICE = int(mavlink.MAV_SEVERITY_NOTICE)
_NEEDS_NO_POSITION = frozenset({VehicleMode.MANUAL, VehicleMode.LAND})
_OWN_MODES = frozenset(VehicleMode) - {VehicleMode.MANUAL, VehicleMode.EXTERNAL}
_OVERRIDES_OWN, _OVERRIDES_EXTERNAL = 1, 2
_ALL_FENCES = _MAX_HEIGHT | _CIRCLE | _POLYGON
Answers = Literal["right", "disobeyed", "unanswered", "denied"]
"""How the vehicle handles mode requests of a companion computer, which has the vehicle's system id.
"right": carried out and acknowledged. "disobeyed": acknowledged but not carried out. "unanswered": carried
out but not acknowledged. "denied": carried out but answered with a refusal.
"""
_ANSWERS: tuple[Answers, ...] = ("right", "disobeyed", "unanswered", "denied")


class Troubles:
    """Troubles and failsafes of one vehicle.

    The caller may set `answers`, `battery_remaining`, `estimator_bad`, `gnss_lost`, `proximity_lost`,
    `rc_connected` and `sticks` at any time. They keep their values until they are set again, also across a
    reboot.
    """

    def __init__(
        self, manners: Manners, params: ParamBook, fence: MissionBook, home: LocalFrame, *, rc_connected: bool
    ) -> None:
        self.answers: Answers = "right"
        self.battery_remaining = 1.0
        """Remaining share of the charge, 0 to 1."""
        self.estimator_bad = False
        self.gnss_lost = False
        self.proximity_lost = False
        """The sensor that is wired to the autopilot (`sensing.SensorOptions.message`) has failed."""
        self.rc_connected = rc_connected
        self.sticks = (0.0, 0.0, 0.0, 0.0)
        """Roll, pitch, throttle, yaw, each -1 to 1; 0 is centred."""
        self.breaches = 0
        """Bits of the breached fences: 1 height, 2 circle around home, 4 uploaded polygons and circles."""
        self.breach_count = 0
        self.breached_s = 0.0
        self.position_lost = False
        """The estimator no longer has a position."""
        self._manners = manners
        self._params = params
        self._fence = fence
        self._home = home
        self._areas: list[tuple[bool, float, list[tuple[float, float]]]] = []
        self._areas_revision: int | None = None
        self._station_s: float | None = None
        self._bad_since_s = math.inf
        self._lost_since_s = math.inf
        self._active: set[Failsafe] = set()
        self._deferred: tuple[float, VehicleMode] | None = None

    @property
    def fence_enabled(self) -> bool:
        """Whether the firmware watches its fence."""
        name = self._manners.fence_enable_param
        return name is None or self._params.get(name) >= 1.0

    def set(self, name: str, value: Any) -> None:
        """Set a trouble by its name, with a value that JSON can hold.

        Raises:
            ConfigError: there is no such trouble, or it cannot have this value.
        """
        switches = ("estimator_bad", "gnss_lost", "proximity_lost", "rc_connected")
        if name == "answers" and value in _ANSWERS:
            self.answers = value
        elif name in switches and isinstance(value, bool):
            setattr(self, name, value)
        elif name == "battery_remaining" and _is_number(value) and 0.0 <= value <= 1.0:
            self.battery_remaining = float(value)
        elif name == "sticks" and isinstance(value, list | tuple) and _are_sticks(value):
            roll, pitch, throttle, yaw = map(float, value)
            self.sticks = (roll, pitch, throttle, yaw)
        else:
            raise ConfigError(
                f"trouble {name!r}: {value!r}; allowed: answers ({', '.join(_ANSWERS)}), "
                f"{', '.join(switches)} (true, false), battery_remaining (0 to 1), sticks (four from -1 to 1)"
            )

    def reboot(self) -> None:
        """Forget ground station heartbeats and active failsafes, as a restart does. The troubles stay."""
        self._station_s = self._deferred = None
        self._bad_since_s = self._lost_since_s = math.inf
        self._active.clear()
        self.breaches = self.breach_count = 0
        self.position_lost = False

    def hear(self, heartbeat: MavlinkMessage, now_s: float) -> None:
        """Take a received HEARTBEAT; those of the ground station feed its failsafe timer."""
        if self._manners.gcs_by_system:
            station = heartbeat.get_srcSystem() == self._params.get("MAV_GCS_SYSID")
        else:
            station = heartbeat.type == mavlink.MAV_TYPE_GCS
        if station:
            self._station_s = now_s

    def step(self, flight: Flight, now_s: float) -> None:
        """Check all causes once. The vehicle calls this every PERIOD_S."""
        manners = self._manners
        self._watch_estimator(flight, now_s)
        self._watch_fence(flight, now_s)
        silent_s = 0.0 if self._station_s is None else now_s - self._station_s
        self._act(manners.gcs_failsafe, silent_s > self._params.get(manners.gcs_timeout_param), flight, now_s)
        self._act(manners.battery_failsafe, self._battery_low, flight, now_s)
        self._follow_sticks(flight)
        if self._deferred is not None:
            due_s, mode = self._deferred
            if not flight.failsafe or flight.mode is not VehicleMode.HOLD:
                # Another mode was selected in the meantime.
                self._deferred = None
            elif now_s >= due_s:
                self._deferred = None
                flight.fail_over(mode)

    @property
    def _battery_low(self) -> bool:
        if self._manners.battery_failsafe.deferred:
            return self.battery_remaining < self._params.get("BAT_CRIT_THR")
        left_mah = self.battery_remaining * self._params.get("BATT_CAPACITY")
        return left_mah < self._params.get("BATT_LOW_MAH")

    def _act(self, failsafe: Failsafe, bad: bool, flight: Flight, now_s: float) -> None:
        if not bad:
            self._active.discard(failsafe)
            return
        if failsafe in self._active or not flight.armed or flight.on_ground:
            return
        self._active.add(failsafe)
        action = 0 if failsafe.param is None else int(self._params.get(failsafe.param))
        mode = failsafe.modes.get(action)
        if mode is None:
            return
        if failsafe.text is not None:
            flight.texts.append((_WARNING, failsafe.text))
        if flight.mode is VehicleMode.LAND:
            return
        wait_s = self._params.get("COM_FAIL_ACT_T") if failsafe.deferred else 0.0
        if wait_s > 0.0 and mode is not VehicleMode.HOLD:
            self._deferred = now_s + wait_s, mode
            mode = VehicleMode.HOLD
        flight.fail_over(mode)

    # ------------------------------------------------------------ estimator

    def _watch_estimator(self, flight: Flight, now_s: float) -> None:
        manners = self._manners
        self._bad_since_s = min(self._bad_since_s, now_s) if self.estimator_bad else math.inf
        self._lost_since_s = min(self._lost_since_s, now_s) if self.gnss_lost else math.inf
        bad = now_s - self._bad_since_s >= manners.estimator_grace_s
        lost = now_s - self._lost_since_s >= manners.gnss_grace_s
        was_lost, self.position_lost = self.position_lost, bad or lost
        flight.position_lost = self.position_lost
        if flight.mode not in _NEEDS_NO_POSITION or not self.position_lost:
            self._act(manners.estimator_failsafe, self.position_lost, flight, now_s)
        if was_lost and not self.position_lost and manners.estimator_recovers and flight.failsafe:
            flight.recover(now_s)

    # ------------------------------------------------------------ fence

    def _watch_fence(self, flight: Flight, now_s: float) -> None:
        breaches = self._breaches(flight) if self.fence_enabled and not flight.on_ground else 0
        new = breaches & ~self.breaches
        if new:
            self.breach_count += 1
            self.breached_s = now_s
            names = ", ".join(name for bit, name in _NAMES.items() if new & bit)
            flight.texts.append((_NOTICE, f"{names} fence breached"))
        elif self.breaches and not breaches:
            flight.texts.append((_NOTICE, "Fence breach cleared"))
        self.breaches = breaches
        if new:
            self._active.discard(self._manners.fence_failsafe)
        self._act(self._manners.fence_failsafe, bool(breaches), flight, now_s)

    def _breaches(self, flight: Flight) -> int:
        body, params, manners = flight.body, self._params, self._manners
        distance_m = params.get(manners.fence_distance_param)
        height_m = params.get(manners.fence_height_param)
        found = _MAX_HEIGHT if 0.0 < height_m < -body.down else 0
        found |= _CIRCLE if 0.0 < distance_m < math.hypot(body.north, body.east) else 0
        found |= _POLYGON if self._outside(body.north, body.east) else 0
        kinds = int(params.get("FENCE_TYPE")) if manners.tells_fence else _ALL_FENCES
        return found & kinds

    def _outside(self, north: float, east: float) -> bool:
        if self._areas_revision != self._fence.revision:
            self._areas_revision = self._fence.revision
            self._areas = self._read_areas()
        inclusions = []
        for inclusion, radius_m, points in self._areas:
            if radius_m > 0.0:
                inside = math.hypot(north - points[0][0], east - points[0][1]) <= radius_m
            else:
                inside = _inside(north, east, points)
            if inclusion:
                inclusions.append(inside)
            elif inside:
                return True
        if not inclusions:
            return False
        return not (any(inclusions) if self._manners.fence_union else all(inclusions))

    def _read_areas(self) -> list[tuple[bool, float, list[tuple[float, float]]]]:
        """Read the stored fence: inclusion, radius (m; 0: a polygon), corners (north and east in m)."""
        areas: list[tuple[bool, float, list[tuple[float, float]]]] = []
        items = self._fence.items
        at = 0
        while at < len(items):
            command, size = items[at].command, items[at].params[0]
            polygon = command in VERTICES.values()
            members = items[at : at + (int(size) if polygon else 1)]
            at += len(members)
            points = [self._home.to_ned(i.x * 1e-7, i.y * 1e-7, self._home.alt_m)[:2] for i in members]
            if polygon:
                areas.append((command == VERTICES[True], 0.0, points))
            elif command in CIRCLES.values():
                areas.append((command == CIRCLES[True], size, points))
        return areas

    # ------------------------------------------------------------ the pilot

    def _follow_sticks(self, flight: Flight) -> None:
        """Give control to the pilot when the sticks move, as PX4 does."""
        if not self._manners.sticks_take_over or not self.rc_connected or not any(self.sticks):
            return
        if self._params.get("COM_RC_IN_MODE") == MANUAL_CONTROL_OFF:
            return
        allowed = int(self._params.get("COM_RC_OVERRIDE"))
        if max(map(abs, self.sticks)) * 100.0 <= self._params.get("COM_RC_STICK_OV"):
            return
        own = flight.mode in _OWN_MODES and allowed & _OVERRIDES_OWN
        if own or (flight.mode is VehicleMode.EXTERNAL and allowed & _OVERRIDES_EXTERNAL):
            flight.take_over()


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _are_sticks(values: Sequence[object]) -> bool:
    return len(values) == 4 and all(_is_number(v) and -1.0 <= v <= 1.0 for v in values)  # type: ignore[operator]


def _inside(north: float, east: float, corners: list[tuple[float, float]]) -> bool:
    """Whether a point lies in a polygon, by the even-odd rule."""
    inside = False
    for (n1, e1), (n2, e2) in pairwise([*corners, corners[0]]):
        if (e1 > east) != (e2 > east) and north < n1 + (east - e1) / (e2 - e1) * (n2 - n1):
            inside = not inside
    return inside
