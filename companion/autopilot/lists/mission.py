"""Builds a timed path from the vehicle's own mission.

The path flies NAV_WAYPOINT with its hold time, NAV_LOITER_TIME as a waypoint that is held, and NAV_DELAY of
some seconds, at the speed of the last DO_CHANGE_SPEED. A leg that is too steep for that speed is flown as
slowly as climb and descent allow, the way autopilots fly it. The clock starts at the place where the
companion takes the vehicle, and every leg is straight at constant speed. The companion takes over in the air,
so a NAV_TAKEOFF before the first waypoint belongs to the pilot or the autopilot and is left out. NAV_LAND and
NAV_RETURN_TO_LAUNCH end the path and are not flown. Every other item is refused, because a mission flown in
part is a different mission.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import names_of
from companion.config import TrajectoryFile, Waypoint
from companion.errors import ConfigError
from companion.events import MissionItem
from companion.geometry import LocalFrame, Vec3

NAV_WAYPOINT: int = mavlink.MAV_CMD_NAV_WAYPOINT
NAV_LOITER_UNLIM: int = mavlink.MAV_CMD_NAV_LOITER_UNLIM
NAV_LOITER_TURNS: int = mavlink.MAV_CMD_NAV_LOITER_TURNS
NAV_LOITER_TIME: int = mavlink.MAV_CMD_NAV_LOITER_TIME
NAV_RETURN_TO_LAUNCH: int = mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH
NAV_LAND: int = mavlink.MAV_CMD_NAV_LAND
NAV_TAKEOFF: int = mavlink.MAV_CMD_NAV_TAKEOFF
NAV_SPLINE_WAYPOINT: int = mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT
NAV_DELAY: int = mavlink.MAV_CMD_NAV_DELAY
DO_CHANGE_SPEED: int = mavlink.MAV_CMD_DO_CHANGE_SPEED
_JUMPS = frozenset({mavlink.MAV_CMD_DO_JUMP, mavlink.MAV_CMD_DO_JUMP_TAG})

MAX_SPEED_MPS = 100.0
MAX_HOLD_S = 3600.0
MAX_LEG_M = 100_000.0
STEEPEST = 0.9
"""Share of the allowed climb and descent that a leg is planned with. The rest is a reserve for closing
gaps."""
SAME_PLACE_M = 0.01
"""Points closer than this count as one, because times on a path must rise strictly."""

_PLACES = frozenset({NAV_WAYPOINT, NAV_LOITER_UNLIM, NAV_LOITER_TURNS, NAV_LOITER_TIME, NAV_SPLINE_WAYPOINT})
"""Commands that lead to a place and stay in the air."""
_MSL_FRAMES = frozenset({mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT})
_HOME_FRAMES = frozenset({mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT})
_SPEED_KINDS = (mavlink.SPEED_TYPE_AIRSPEED, mavlink.SPEED_TYPE_GROUNDSPEED)
"""DO_CHANGE_SPEED param 1: airspeed and ground speed. For a multirotor both are the same."""
_ALLOWED = (
    "NAV_WAYPOINT, NAV_LOITER_TIME, NAV_DELAY, DO_CHANGE_SPEED, NAV_TAKEOFF before the first waypoint, "
    "and NAV_LAND or NAV_RETURN_TO_LAUNCH as the end"
)
_NAMES = names_of("MAV_CMD", "MAV_CMD_")


def path_from_mission(
    items: Sequence[MissionItem],
    *,
    speed_mps: float,
    max_climb_mps: float,
    max_descent_mps: float,
    start: Vec3,
    home_alt_msl_m: float | None,
    first_seq: int | None = None,
) -> TrajectoryFile:
    """Return the mission as a timed path with altitudes above home.

    Args:
        items: As downloaded, without ArduPilot's home item.
        speed_mps: Speed along the legs until a DO_CHANGE_SPEED.
        max_climb_mps: Steep legs are flown more slowly, so that they stay below it and `max_descent_mps`.
        start: Latitude (deg), longitude (deg), height above home (m) where the clock starts.
        first_seq: Item that the vehicle is at. Waypoints before it are passed; speeds before it still apply.
        home_alt_msl_m: Home above mean sea level; needed by items that give altitudes above mean sea level.

    Raises:
        ConfigError: an item cannot be flown (the error names its number, its command and what is allowed), or
            there is no waypoint at all.
    """
    builder = _Builder(speed_mps, max_climb_mps, max_descent_mps, start, home_alt_msl_m)
    for item in items:
        if first_seq is not None and item.seq < first_seq and item.command != DO_CHANGE_SPEED:
            continue
        if item.command in (NAV_LAND, NAV_RETURN_TO_LAUNCH):
            break
        if item.command == NAV_TAKEOFF and len(builder.waypoints) == 1:
            continue
        if item.command in (NAV_WAYPOINT, NAV_LOITER_TIME):
            builder.waypoint(item)
        elif item.command == NAV_DELAY:
            builder.delay(item)
        elif item.command == DO_CHANGE_SPEED:
            builder.change_speed(item)
        else:
            raise _refused(item, f"cannot be flown; allowed: {_ALLOWED}")
    if len(builder.waypoints) < 2:
        raise ConfigError(f"mission: no waypoint to fly in its {len(items)} items; allowed: {_ALLOWED}")
    return TrajectoryFile(altitude="home", waypoint=tuple(builder.waypoints))


def speeds_at(items: Sequence[MissionItem], seq: int) -> frozenset[float | None]:
    """Speeds (m/s) that the mission may have set by the time the vehicle is at an item; None: it has set
    none.

    Without jumps there is one such speed. With jumps any speed of the mission may apply, because the vehicle
    does not report how often it has jumped. None is then among them if the item or a jump stands before the
    first change of speed.
    """
    changes, _ = speed_changes(items)
    jumps = [i.seq for i in items if i.command in _JUMPS]
    if not jumps or not changes:
        return frozenset([None, *(speed for at, speed in changes if at <= seq)][-1:])
    first = changes[0][0]
    unset = {None} if seq < first or jumps[0] < first else set()
    return frozenset(speed for _, speed in changes) | unset


def speed_changes(items: Sequence[MissionItem]) -> tuple[list[tuple[int, float]], bool]:
    """Items that set a speed (number, m/s), and whether the vehicle's own speed may be flown too. It may if a
    place or a jump stands before the first of these items, or if there is none."""
    changes = []
    for item in items:
        kind, speed_mps = item.params[:2]
        if item.command != DO_CHANGE_SPEED or kind not in _SPEED_KINDS or speed_mps is None:
            continue
        if 0 < speed_mps <= MAX_SPEED_MPS:
            changes.append((item.seq, speed_mps))
    own = not changes or any(i.seq < changes[0][0] for i in items if i.command in _PLACES | _JUMPS)
    return changes, own


def place_of(item: MissionItem, height_m: float, home_alt_msl_m: float) -> Vec3 | None:
    """Where an item leads: latitude (deg), longitude (deg), height above home (m); None: it has no place of
    its own.

    Args:
        height_m: present height above home. It is used if the item's altitude is left open, 0 (ArduPilot then
            keeps its altitude) or measured from terrain.
    """
    if item.command not in _PLACES or item.lat_deg is None or item.lon_deg is None:
        return None
    if item.lat_deg == 0 and item.lon_deg == 0:
        return None
    if item.alt_m == 0:
        return item.lat_deg, item.lon_deg, height_m
    if item.alt_m is not None and item.frame in _HOME_FRAMES:
        height_m = item.alt_m
    elif item.alt_m is not None and item.frame in _MSL_FRAMES:
        height_m = item.alt_m - home_alt_msl_m
    return item.lat_deg, item.lon_deg, height_m


def _refused(item: MissionItem, why: str) -> ConfigError:
    name = _NAMES.get(item.command, "unknown command")
    return ConfigError(f"mission item {item.seq}: {name} ({item.command}): {why}")


class _Builder:
    """The path so far and the speed that applies."""

    def __init__(
        self,
        speed_mps: float,
        max_climb_mps: float,
        max_descent_mps: float,
        start: Vec3,
        home_alt_msl_m: float | None,
    ) -> None:
        if not 0 < speed_mps <= MAX_SPEED_MPS:
            raise ConfigError(f"mission speed {speed_mps} m/s: allowed: above 0 to {MAX_SPEED_MPS}")
        self._speed_mps = speed_mps
        self._climb_mps = STEEPEST * max_climb_mps
        self._descent_mps = STEEPEST * max_descent_mps
        self._home_alt_msl_m = home_alt_msl_m
        self.waypoints = [Waypoint(t_s=0.0, lat_deg=start[0], lon_deg=start[1], alt_m=start[2])]

    def change_speed(self, item: MissionItem) -> None:
        kind, speed_mps = item.params[0], item.params[1]
        if kind not in _SPEED_KINDS:
            raise _refused(item, f"speed type {kind}; allowed: 0 (airspeed) and 1 (ground speed)")
        if speed_mps == -1.0:
            return
        if speed_mps is None or not 0 < speed_mps <= MAX_SPEED_MPS:
            raise _refused(
                item, f"speed {speed_mps} m/s; allowed: above 0 to {MAX_SPEED_MPS}, or -1 for no change"
            )
        self._speed_mps = speed_mps

    def waypoint(self, item: MissionItem) -> None:
        lat_deg, lon_deg, alt_m = self._position(item)
        hold_s = self._hold_s(item)
        last = self.waypoints[-1]
        north, east, down = LocalFrame(last.lat_deg, last.lon_deg, last.alt_m).to_ned(lat_deg, lon_deg, alt_m)
        length_m = math.hypot(north, east, down)
        if length_m > MAX_LEG_M:
            raise _refused(
                item, f"{length_m / 1e3:.0f} km from the point before; allowed: {MAX_LEG_M / 1e3:.0f}"
            )
        if length_m > SAME_PLACE_M:
            # The first leg starts at the vehicle's present position and may be straight up.
            steep_s = max(-down / self._climb_mps, down / self._descent_mps)
            self._add(max(length_m / self._speed_mps, steep_s), lat_deg, lon_deg, alt_m)
        if hold_s > 0:
            self._add(hold_s, lat_deg, lon_deg, alt_m)

    def delay(self, item: MissionItem) -> None:
        last, hold_s = self.waypoints[-1], self._hold_s(item)
        if hold_s > 0:
            self._add(hold_s, last.lat_deg, last.lon_deg, last.alt_m)

    @staticmethod
    def _hold_s(item: MissionItem) -> float:
        hold_s = item.params[0]
        if hold_s is None:
            return 0.0
        if not 0 <= hold_s <= MAX_HOLD_S:
            raise _refused(item, f"hold time {hold_s} s; allowed: 0 to {MAX_HOLD_S}")
        return hold_s

    def _add(self, after_s: float, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        t_s = self.waypoints[-1].t_s + after_s
        self.waypoints.append(Waypoint(t_s=t_s, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m))

    def _position(self, item: MissionItem) -> Vec3:
        """Latitude (deg), longitude (deg) and height above home (m) of a waypoint."""
        if item.frame not in _MSL_FRAMES | _HOME_FRAMES:
            raise _refused(
                item,
                f"MAV_FRAME {item.frame}; allowed: 0 and 5 (above mean sea level), 3 and 6 (above home)",
            )
        lat_deg, lon_deg, alt_m = item.lat_deg, item.lon_deg, item.alt_m
        if lat_deg is None or lon_deg is None or alt_m is None:
            raise _refused(item, "latitude, longitude or altitude left open; all three are needed")
        if lat_deg == 0 and lon_deg == 0:
            raise _refused(
                item, "0, 0 stands for the current position; a latitude and a longitude are needed"
            )
        if alt_m == 0:
            raise _refused(
                item, "altitude 0 stands for the present one on ArduPilot; one other than 0 is needed"
            )
        if item.frame in _HOME_FRAMES:
            return lat_deg, lon_deg, alt_m
        if self._home_alt_msl_m is None:
            raise _refused(item, "altitude above mean sea level, and home's is not known; allowed: 3 and 6")
        return lat_deg, lon_deg, alt_m - self._home_alt_msl_m
