"""Reads what sensors aboard report of obstacles: OBSTACLE_DISTANCE, OBSTACLE_DISTANCE_3D, ADSB_VEHICLE and
DISTANCE_SENSOR.

They come from components of our own vehicle's system that the configuration names, or through the autopilot
(PX4 sends on the distances that it fuses). ADSB_VEHICLE counts as a measurement only from a named component:
from the autopilot it is what its receiver heard. The attitude comes from the autopilot alone.

DISTANCE_SENSOR is read from ArduPilot alone. ArduPilot sends what its own proximity sensors (AP_Proximity)
see in eight sectors, clockwise from the nose, as a burst of one message for each sector. A burst becomes one
scan (`Burst`), because neighbouring sectors may see the same object. Bursts are ignored while finer
measurements come (`FINER_S`): if ArduPilot also takes in the finer sensor's messages, a burst is only a
coarse copy of them. ArduPilot sends nothing while no sector sees anything, just as if the sensor had failed;
SYS_STATUS tells the two apart.

Everything here is untrusted. The number of messages a second that become events is bounded, so that a flood
costs neither time nor space in the record. The rest is counted and dropped.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, Literal, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.counts import LinkCounts
from companion.autopilot.encoders import AUTOPILOT_COMPONENT
from companion.autopilot.readers import Fields, adsb_vehicle, unpack
from companion.autopilot.wire import Frame
from companion.config import SensedConfig
from companion.errors import PeerDataError
from companion.events import Attitude, Event, Firmware, ObstaclePoint, ObstacleScan, SensedAircraft
from companion.events.sensed import NOTHING, UNKNOWN

SECTORS: Final = 72
"""Number of distances in one OBSTACLE_DISTANCE."""
LEAST_STEP_DEG: Final = 0.1
MOST_M: Final = 5000.0
"""Farthest obstacle that is believed."""
_UINT16_MAX: Final = 0xFFFF
_ATTITUDE: Final = mavlink.MAVLINK_MSG_ID_ATTITUDE
_SCAN: Final = mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE
_POINT: Final = mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE_3D
_AIRCRAFT: Final = mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE
_DISTANCE: Final = mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR
_STATUS: Final = mavlink.MAVLINK_MSG_ID_SYS_STATUS
_OF_AUTOPILOT: Final = {
    Firmware.ARDUPILOT: frozenset({_ATTITUDE, _SCAN, _POINT, _DISTANCE, _STATUS}),
    Firmware.PX4: frozenset({_ATTITUDE, _SCAN, _POINT}),
}
DIRECTIONS: Final = 8
FIRST_ID: Final = 10
"""PROXIMITY_SENSOR_ID_START: the id of the sector ahead. The others follow clockwise. Lower ids are single
rangefinders, and the one above is that of the distance upwards."""
SETTLED_S: Final = 0.02
"""A burst is over when no further message of it has come for this long."""
FINER_S: Final = 3.0
"""DISTANCE_SENSOR is not used for this long after an OBSTACLE_DISTANCE or OBSTACLE_DISTANCE_3D."""
QUIET_S: Final = 0.5
"""If the last burst is older than this and the autopilot reports the sensor as healthy, the sensor sees
nothing."""
RATES: Final = {
    _ATTITUDE: (100.0, 20.0),
    _DISTANCE: (20.0, 4.0),
    _STATUS: (10.0, 4.0),
    _SCAN: (40.0, 8.0),
    _POINT: (600.0, 100.0),
    _AIRCRAFT: (100.0, 40.0),
}
"""For each kind of message: how many a second, and how many at once, become events. Bursts of DISTANCE_SENSOR
are counted as a whole."""

_SCAN_AXES: dict[int, Literal["body", "nose", "north"]] = {
    mavlink.MAV_FRAME_GLOBAL: "north",
    mavlink.MAV_FRAME_LOCAL_NED: "north",
    mavlink.MAV_FRAME_GLOBAL_INT: "north",
    mavlink.MAV_FRAME_LOCAL_OFFSET_NED: "north",
    mavlink.MAV_FRAME_BODY_NED: "body",
    mavlink.MAV_FRAME_BODY_OFFSET_NED: "body",
    mavlink.MAV_FRAME_BODY_FRD: "body",
    mavlink.MAV_FRAME_LOCAL_FRD: "nose",
}
_POINT_AXES: dict[int, Literal["body", "offset", "local"]] = {
    mavlink.MAV_FRAME_LOCAL_NED: "local",
    mavlink.MAV_FRAME_LOCAL_OFFSET_NED: "offset",
    mavlink.MAV_FRAME_BODY_NED: "body",
    mavlink.MAV_FRAME_BODY_FRD: "body",
}


def attitude(fields: Fields) -> Attitude:
    """ATTITUDE.

    Raises:
        PeerDataError: an angle is not finite, or out of its range.
    """
    time_ms, roll, pitch, yaw = fields[:4]
    # NaN and infinity fail these comparisons too.
    if not (abs(roll) <= 3.2 and abs(pitch) <= 1.6 and abs(yaw) <= 6.3):
        raise PeerDataError(f"attitude {roll}, {pitch}, {yaw} rad is out of range")
    return Attitude(time_boot_s=time_ms / 1e3, roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw)


def obstacle_scan(component: int, fields: Fields) -> ObstacleScan | None:
    """OBSTACLE_DISTANCE; None if no sector is measured.

    A distance at `max_distance` or beyond means that nothing is there. One below `min_distance`, which the
    sensor cannot measure, and UINT16_MAX are unknown. Distances beyond a full circle are left out.

    Raises:
        PeerDataError: sectors without a width, an angle that is not finite, a frame in which angles have no
            meaning, or distances that are not ordered.
    """
    _usec, *distances = fields[: 1 + SECTORS]
    least, most, _kind, whole_deg, step_deg, first_deg, frame = fields[1 + SECTORS :]
    step = step_deg if step_deg != 0.0 else float(whole_deg)
    if not LEAST_STEP_DEG <= abs(step) <= 360.0:
        raise PeerDataError(f"OBSTACLE_DISTANCE: increment {step} deg; allowed: {LEAST_STEP_DEG} to 360")
    if not abs(first_deg) <= 360.0:
        raise PeerDataError(f"OBSTACLE_DISTANCE: angle_offset {first_deg} deg is beyond 360")
    axes = _SCAN_AXES.get(frame)
    if axes is None:
        raise PeerDataError(f"OBSTACLE_DISTANCE: MAV_FRAME {frame} is no frame of angles around the vehicle")
    if not least < most:
        raise PeerDataError(f"OBSTACLE_DISTANCE: min_distance {least} cm is not below max_distance {most} cm")
    count = min(SECTORS, max(1, int(360.0 / abs(step) + 1e-3)))
    found = tuple(
        UNKNOWN if cm == _UINT16_MAX or cm < max(least, 1) else NOTHING if cm >= most else cm
        for cm in distances[:count]
    )
    last = max((i for i, cm in enumerate(found) if cm != UNKNOWN), default=-1)
    if last < 0:
        return None
    return ObstacleScan(
        component=component,
        axes=axes,
        first_deg=first_deg,
        step_deg=step,
        distances_cm=found[: last + 1],
        max_cm=most,
    )


def obstacle_point(component: int, fields: Fields) -> ObstaclePoint | None:
    """OBSTACLE_DISTANCE_3D; None if the obstacle is out of the sensor's own range.

    Raises:
        PeerDataError: a place that is not finite or absurdly far, or a frame that is not supported.
    """
    _ms, x, y, z, least, most, number, _kind, frame = fields
    axes = _POINT_AXES.get(frame)
    if axes is None:
        raise PeerDataError(f"OBSTACLE_DISTANCE_3D: MAV_FRAME {frame} is not supported")
    away = math.hypot(x, y, z)
    if not away <= MOST_M and not (axes == "local" and away <= 100.0 * MOST_M):
        raise PeerDataError(f"OBSTACLE_DISTANCE_3D: {x}, {y}, {z} m is no place near the vehicle")
    if axes != "local" and not (least <= away < most and away > 0.0):
        return None
    return ObstaclePoint(
        component=component,
        axes=axes,
        position_m=(x, y, z),
        number=None if number == _UINT16_MAX else number,
    )


def sensed_aircraft(component: int, fields: Fields) -> SensedAircraft | None:
    """ADSB_VEHICLE of a radar or camera; None without a position.

    Raises:
        PeerDataError: see `readers.adsb_vehicle`.
    """
    report = adsb_vehicle(fields)
    return None if report is None else SensedAircraft(component=component, report=report)


SENSOR_READERS: Final[dict[int, Callable[[int, Fields], Event | None]]] = {
    _SCAN: obstacle_scan,
    _POINT: obstacle_point,
    _AIRCRAFT: sensed_aircraft,
}
"""Readers of messages of sensors, each with the component that sent it."""


class Sector(NamedTuple):
    """One DISTANCE_SENSOR of AP_Proximity."""

    number: int
    """Sectors of 45 degrees from the nose clockwise: 0 to 7."""
    cm: int
    """Distance, or UNKNOWN or NOTHING."""
    max_cm: int


def proximity_sector(fields: Fields) -> Sector | None:
    """DISTANCE_SENSOR of a horizontal sector; None if it is of another sensor.

    ArduPilot writes the greatest distance of its sensors where it measures nothing: out of range, in an area
    that it was told to ignore, or not measured for a second.

    Raises:
        PeerDataError: the direction does not belong to that id, or the distances are not ordered.
    """
    _ms, least, most, cm, _kind, number, orientation = fields[:7]
    sector = number - FIRST_ID
    if not 0 <= sector < DIRECTIONS:
        return None
    if orientation != sector:
        raise PeerDataError(
            f"DISTANCE_SENSOR: orientation {orientation} with id {number}; allowed: {sector}, which is "
            f"{45 * sector} deg"
        )
    if not least < most:
        raise PeerDataError(f"DISTANCE_SENSOR: min_distance {least} cm is not below max_distance {most} cm")
    found = NOTHING if cm >= most else UNKNOWN if cm < max(least, 1) else cm
    return Sector(sector, found, most)


class Burst:
    """Joins the sectors that ArduPilot sends one after the other to one scan. Times are monotonic."""

    def __init__(self) -> None:
        self._sectors: dict[int, Sector] = {}
        self._at_s = -math.inf

    def add(self, sector: Sector, now_s: float) -> ObstacleScan | None:
        """Take in a sector. Returns a completed scan, if any: that of this burst if the sector is its last
        one, or that of the previous burst if the sector begins a new one."""
        ended = self._finish() if sector.number in self._sectors else None
        self._sectors[sector.number], self._at_s = sector, now_s
        return self._finish() if sector.number == DIRECTIONS - 1 else ended

    def settled(self, now_s: float) -> ObstacleScan | None:
        """The scan of a burst that had no further message for `SETTLED_S`; None if there is none. Such a
        burst is complete, because ArduPilot leaves out sectors that never saw anything."""
        return self._finish() if self._sectors and not 0.0 <= now_s - self._at_s < SETTLED_S else None

    def _finish(self) -> ObstacleScan | None:
        """The scan of the sectors received so far; None if none of them is known."""
        sectors, self._sectors = self._sectors, {}
        if all(one.cm == UNKNOWN for one in sectors.values()):
            return None
        distances = [sectors[i].cm if i in sectors else UNKNOWN for i in range(DIRECTIONS)]
        return _around(tuple(distances), min(one.max_cm for one in sectors.values()))


def _around(distances_cm: tuple[int, ...], max_cm: int) -> ObstacleScan:
    return ObstacleScan(
        component=AUTOPILOT_COMPONENT,
        axes="body",
        first_deg=0.0,
        step_deg=360.0 / DIRECTIONS,
        distances_cm=distances_cm,
        max_cm=max_cm,
    )


def proximity_is_healthy(fields: Fields) -> bool:
    """Whether SYS_STATUS says that the proximity sensors of an ArduPilot are there and work."""
    return all(int(bits) & mavlink.MAV_SYS_STATUS_SENSOR_PROXIMITY for bits in fields[:3])


class Sensors:
    """Decides which frames are measurements of sensors aboard, and reads them.

    Args:
        config: None, or `use` false: nothing is read.
    """

    def __init__(self, config: SensedConfig | None, counts: LinkCounts) -> None:
        self.used = config is not None and config.use
        self._components = frozenset(config.components if config is not None and config.use else ())
        self._counts = counts
        self._burst = Burst()
        self._burst_s = self._finer_s = -math.inf
        self._left = {message_id: burst for message_id, (_, burst) in RATES.items()}
        self._filled_s = dict.fromkeys(RATES, -math.inf)

    def takes(self, frame: Frame, system_id: int | None, firmware: Firmware | None) -> bool:
        """Whether a frame is a measurement. `system_id` and `firmware` are our vehicle's; None while they are
        not known."""
        if not self.used or frame.system_id != system_id or firmware is None:
            return False
        if frame.component_id == AUTOPILOT_COMPONENT:
            return frame.message_id in _OF_AUTOPILOT[firmware]
        return frame.component_id in self._components and frame.message_id in SENSOR_READERS

    def event(self, frame: Frame, now_s: float) -> Event | None:
        """Read a frame that `takes` has accepted; None if it gives no event (yet), or if there are too many.

        Raises:
            PeerDataError: it holds values that no correct sensor sends.
        """
        message_id = frame.message_id
        if message_id == _DISTANCE:
            sector = proximity_sector(unpack(message_id, frame.payload))
            self._counts.sensed += sector is not None
            return None if sector is None else self._usable(self._burst.add(sector, now_s), now_s)
        if not self._admits(message_id, now_s):
            self._counts.sensed_dropped += 1
            return None
        self._counts.sensed += 1
        fields: tuple[Any, ...] = unpack(message_id, frame.payload)
        if message_id == _ATTITUDE:
            return attitude(fields)
        if message_id == _STATUS:
            quiet = now_s - max(self._burst_s, self._finer_s) > QUIET_S
            return _around((UNKNOWN,) * DIRECTIONS, 1) if quiet and proximity_is_healthy(fields) else None
        event = SENSOR_READERS[message_id](frame.component_id, fields)
        if message_id != _AIRCRAFT:
            self._finer_s = now_s
        return event

    def advance(self, now_s: float) -> Event | None:
        """The scan of a burst that has ended without its last sector; None if there is none."""
        return self._usable(self._burst.settled(now_s), now_s)

    def _usable(self, scan: ObstacleScan | None, now_s: float) -> Event | None:
        """Return a scan of ArduPilot's sectors, or None if finer measurements or the rate limit exclude
        it."""
        if scan is None or 0.0 <= now_s - self._finer_s < FINER_S:
            return None
        if not self._admits(_DISTANCE, now_s):
            self._counts.sensed_dropped += 1
            return None
        self._burst_s = now_s
        return scan

    def _admits(self, message_id: int, now_s: float) -> bool:
        rate, burst = RATES[message_id]
        passed_s = max(0.0, now_s - self._filled_s[message_id])
        left = min(burst, self._left[message_id] + rate * passed_s)
        self._filled_s[message_id] = now_s
        self._left[message_id] = left - 1.0 if left >= 1.0 else left
        return left >= 1.0
