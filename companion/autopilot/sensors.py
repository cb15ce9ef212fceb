"""Reads what sensors aboard report of obstacles: OBSTACLE_DISTANCE, OBSTACLE_DISTANCE_3D and ADSB_VEHICLE.

They come from components of our own vehicle's system that the configuration names, or through the autopilot
(PX4 sends on the distances that it fuses). ADSB_VEHICLE counts as a measurement only from a named component:
from the autopilot it is what its receiver heard. The attitude comes from the autopilot alone.

Everything here is untrusted. How many messages a second become events is bounded, so that a flood costs
neither time nor space in the record; more are counted and dropped.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.counts import LinkCounts
from companion.autopilot.encoders import AUTOPILOT_COMPONENT
from companion.autopilot.readers import Fields, adsb_vehicle, unpack
from companion.autopilot.wire import Frame
from companion.config import SensedConfig
from companion.errors import PeerDataError
from companion.events import Attitude, Event, ObstaclePoint, ObstacleScan, SensedAircraft
from companion.events.sensed import NOTHING, UNKNOWN

SECTORS: Final = 72
"""Distances in one OBSTACLE_DISTANCE."""
LEAST_STEP_DEG: Final = 0.1
MOST_M: Final = 5000.0
"""Farthest obstacle that is believed."""
_UINT16_MAX: Final = 0xFFFF
_ATTITUDE: Final = mavlink.MAVLINK_MSG_ID_ATTITUDE
_SCAN: Final = mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE
_POINT: Final = mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE_3D
_AIRCRAFT: Final = mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE
RATES: Final = {
    _ATTITUDE: (100.0, 20.0),
    _SCAN: (40.0, 8.0),
    _POINT: (600.0, 100.0),
    _AIRCRAFT: (100.0, 40.0),
}
"""Most messages of each kind that are read in a second, and at once."""

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


class Sensors:
    """Decides which frames are measurements of sensors aboard, and reads them.

    Args:
        config: None, or `use` false: nothing is read.
    """

    def __init__(self, config: SensedConfig | None, counts: LinkCounts) -> None:
        self.used = config is not None and config.use
        self._components = frozenset(config.components if config is not None and config.use else ())
        self._counts = counts
        self._left = {message_id: burst for message_id, (_, burst) in RATES.items()}
        self._filled_s = dict.fromkeys(RATES, -math.inf)

    def takes(self, frame: Frame, system_id: int | None) -> bool:
        """Whether a frame is a measurement. `system_id` is our vehicle's; None while it is not known."""
        if not self.used or frame.system_id != system_id:
            return False
        if frame.component_id == AUTOPILOT_COMPONENT:
            return frame.message_id in (_ATTITUDE, _SCAN, _POINT)
        return frame.component_id in self._components and frame.message_id in SENSOR_READERS

    def event(self, frame: Frame, now_s: float) -> Event | None:
        """Read a frame that `takes` has accepted; None if it says nothing, or if there are too many.

        Raises:
            PeerDataError: it holds values that no correct sensor sends.
        """
        message_id = frame.message_id
        if not self._admits(message_id, now_s):
            self._counts.sensed_dropped += 1
            return None
        self._counts.sensed += 1
        fields: tuple[Any, ...] = unpack(message_id, frame.payload)
        if message_id == _ATTITUDE:
            return attitude(fields)
        return SENSOR_READERS[message_id](frame.component_id, fields)

    def _admits(self, message_id: int, now_s: float) -> bool:
        rate, burst = RATES[message_id]
        passed_s = max(0.0, now_s - self._filled_s[message_id])
        left = min(burst, self._left[message_id] + rate * passed_s)
        self._filled_s[message_id] = now_s
        self._left[message_id] = left - 1.0 if left >= 1.0 else left
        return left >= 1.0
