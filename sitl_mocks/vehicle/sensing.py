"""A sensor aboard the mock vehicle that sees poles, walls and aircraft, and reports them over MAVLink.

The sensor is either a MAVLink component of the vehicle's system, whose frames the autopilot forwards, or it
is wired to an ArduPilot, which reports its distances in eight sectors. It sees within a range and a field of
view, with errors, and misses some obstacles at random. It is not stabilised: when the vehicle leans, its
plane leans too and meets the ground. Obstacles do not hide each other, except in the sectors of a scan.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Final, Literal

import msgspec
import numpy
from msgspec import Meta
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkMessage, MavlinkWriter
from companion.geometry import LocalFrame, Vec3

COMPONENT: Final = 196
"""MAV_COMP_ID_OBSTACLE_AVOIDANCE."""
AUTOPILOT: Final = 1
SECTORS: Final = 72
WIRED_SECTORS: Final = 8
"""Number of sectors of 45 degrees in which ArduPilot reports a sensor that is wired to it."""
_WALL_STEP_M: Final = 1.0
_POINTS_APART_M: Final = 3.0
_POINT_HEIGHTS_M: Final = (-4.0, -2.0, 0.0, 2.0, 4.0)
_MOST_POINTS: Final = 40
_EPSILON_S: Final = 1e-9
_KEPT_FLAGS: Final = (
    mavlink.ADSB_FLAGS_VALID_COORDS
    | mavlink.ADSB_FLAGS_VALID_ALTITUDE
    | mavlink.ADSB_FLAGS_VALID_HEADING
    | mavlink.ADSB_FLAGS_VALID_VELOCITY
)
Attitude = tuple[float, float, float]
"""Roll, pitch and yaw, rad."""


class Obstacle(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An obstacle or aircraft that transmits nothing. NED is relative to home."""

    kind: Literal["pole", "wall", "aircraft"]
    at_ned_m: Vec3
    """Position of a pole, of one end of a wall, or of an aircraft at 0 s. The height of poles and walls is
    `top_m`."""
    to_ned_m: Vec3 | None = None
    """Other end of a wall; None for everything else."""
    velocity_ned_mps: Vec3 = (0.0, 0.0, 0.0)
    """Velocity of an aircraft, which flies straight."""
    radius_m: Annotated[float, Meta(gt=0, le=50)] = 0.5
    top_m: Annotated[float, Meta(gt=0, le=1000)] = 200.0
    """Height above home of the top of a pole or wall."""

    def __post_init__(self) -> None:
        """Check that the fields fit the kind, and that all numbers are finite.

        Raises:
            ValueError: with the field and what is allowed.
        """
        if (self.kind == "wall") != (self.to_ned_m is not None):
            raise ValueError(f"to_ned_m: needed by a wall, and by nothing else; this is a {self.kind}")
        if self.kind != "aircraft" and any(self.velocity_ned_mps):
            raise ValueError(f"velocity_ned_mps: allowed only for an aircraft; this is a {self.kind}")
        numbers = (*self.at_ned_m, *(self.to_ned_m or ()), *self.velocity_ned_mps)
        if not all(map(math.isfinite, numbers)):
            raise ValueError("holds a value that is not finite")

    def place(self, now_s: float) -> Vec3:
        """Position of a pole, of the first end of a wall, or of an aircraft at a time."""
        (n, e, d), (vn, ve, vd) = self.at_ned_m, self.velocity_ned_mps
        return n + vn * now_s, e + ve * now_s, d + vd * now_s

    def distance_m(self, position: Vec3, now_s: float) -> float:
        """Distance of a position from the middle of an aircraft or pole, or from a wall."""
        n, e, d = self.place(now_s)
        if self.kind == "aircraft":
            return math.dist(position, (n, e, d))
        if self.to_ned_m is not None:
            dn, de = self.to_ned_m[0] - n, self.to_ned_m[1] - e
            size2 = dn * dn + de * de
            share = ((position[0] - n) * dn + (position[1] - e) * de) / size2 if size2 > 0.0 else 0.0
            share = min(max(share, 0.0), 1.0)
            n, e = n + share * dn, e + share * de
        above = max(0.0, -position[2] - self.top_m)
        return math.hypot(position[0] - n, position[1] - e, above)


class SensorOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the sensor sees and how it reports it."""

    message: Literal["scan", "points", "tracks", "proximity"] = "scan"
    """scan: OBSTACLE_DISTANCE. points: OBSTACLE_DISTANCE_3D. tracks: ADSB_VEHICLE, with velocities.
    proximity: DISTANCE_SENSOR of an ArduPilot to which the sensor is wired; `step_deg` is not used."""
    range_m: Annotated[float, Meta(ge=1, le=600)] = 40.0
    fov_deg: Annotated[float, Meta(gt=0, le=360)] = 360.0
    """Horizontal field of view, centred on the nose."""
    vertical_deg: Annotated[float, Meta(gt=0, le=180)] = 40.0
    """Vertical field of view, centred on the plane of the sensor."""
    step_deg: Annotated[float, Meta(ge=5, le=90)] = 5.0
    """Width of a sector of a scan."""
    rate_hz: Annotated[float, Meta(ge=0.5, le=50)] = 10.0
    range_sigma_m: Annotated[float, Meta(ge=0, le=10)] = 0.1
    bearing_sigma_deg: Annotated[float, Meta(ge=0, le=20)] = 0.5
    """Standard deviation of the error of its mounting, which is drawn once."""
    miss: Annotated[float, Meta(ge=0, le=1)] = 0.02
    """Share of measurements in which an obstacle is missed."""


class Sensor:
    """The sensor of one vehicle.

    Args:
        home: frame with its altitude above mean sea level.
    """

    def __init__(
        self,
        options: SensorOptions,
        obstacles: Sequence[Obstacle],
        home: LocalFrame,
        rng: numpy.random.Generator,
        system_id: int,
    ) -> None:
        self.others: list[tuple[Vec3, Vec3]] = []
        """Positions (m) and velocities (m/s), NED, of other aircraft that it may see."""
        self._options = options
        self._obstacles = tuple(obstacles)
        self._home = home
        self._rng = rng
        self._mounting_error_rad = math.radians(options.bearing_sigma_deg) * float(rng.standard_normal())
        self._most_sine = math.sin(math.radians(0.5 * options.vertical_deg))
        self._most_angle = math.radians(0.5 * options.fov_deg)
        self._next_s = -math.inf
        self._seen_sectors: set[int] = set()
        """Sectors of DISTANCE_SENSOR that have seen something."""
        self._writer = MavlinkWriter(system_id, AUTOPILOT if options.message == "proximity" else COMPONENT)

    def due(self, now_s: float, position: Vec3, believed: Vec3, attitude: Attitude) -> list[bytes]:
        """The frames that the sensor's own component sends now: none if it is wired to the autopilot.

        Args:
            position: true position (NED, m), from which it sees.
            believed: estimated position (NED, m), relative to which tracks are reported.
        """
        if self._options.message == "proximity" or now_s < self._next_s - _EPSILON_S:
            return []
        self._next_s = now_s + 1.0 / self._options.rate_hz
        roll, pitch, yaw = attitude
        rows = _rows(roll, pitch, yaw + self._mounting_error_rad)
        if self._options.message == "scan":
            messages = [self._scan(now_s, position, rows)]
        elif self._options.message == "points":
            messages = self._points(now_s, position, rows)
        else:
            messages = self._tracks(now_s, position, believed, rows, _rows(*attitude))
        return [self._writer.pack(message) for message in messages]

    def sectors(self, now_s: float, position: Vec3, attitude: Attitude) -> list[MavlinkMessage]:
        """The DISTANCE_SENSOR messages by which ArduPilot reports a sensor that is wired to it: the nearest
        distance in each sector. A sector that sees nothing has the greatest distance if it ever saw
        something, and is left out otherwise. While no sector sees anything, there is no message.

        Args:
            position: true position (NED, m), from which it sees.
        """
        options = self._options
        if options.message != "proximity":
            return []
        roll, pitch, yaw = attitude
        rows = _rows(roll, pitch, yaw + self._mounting_error_rad)
        nearest = self._nearest(now_s, position, rows, WIRED_SECTORS)
        valid = {number for number, distance in enumerate(nearest) if distance <= options.range_m}
        self._seen_sectors |= valid
        most = round(100.0 * options.range_m)
        return [
            mavlink.MAVLink_distance_sensor_message(
                round(1e3 * max(now_s, 0.0)), 20, most,
                max(1, round(100.0 * (nearest[number] + self._noise()))) if number in valid else most,
                mavlink.MAV_DISTANCE_SENSOR_LASER, 10 + number, number, 0,
            )
            for number in sorted(self._seen_sectors)
            if valid
        ]  # fmt: skip

    def burst(self, now_s: float, position: Vec3, attitude: Attitude) -> list[bytes]:
        """The frames of `sectors`, as often as the sensor measures."""
        if now_s < self._next_s - _EPSILON_S:
            return []
        self._next_s = now_s + 1.0 / self._options.rate_hz
        return [self._writer.pack(message) for message in self.sectors(now_s, position, attitude)]

    def _noise(self) -> float:
        return self._options.range_sigma_m * float(self._rng.standard_normal())

    def _missed(self) -> bool:
        return float(self._rng.random()) < self._options.miss

    def _shapes(self, now_s: float, position: Vec3, rows: _Rows) -> Iterator[tuple[list[Vec3], float, Vec3]]:
        """For each obstacle and aircraft: points that represent it (NED, m), their radius, its velocity."""
        for one in self._obstacles:
            n, e, d = one.place(now_s)
            if one.kind == "aircraft":
                yield [(n, e, d)], one.radius_m, one.velocity_ned_mps
                continue
            ends = [(n, e), (n, e) if one.to_ned_m is None else (one.to_ned_m[0], one.to_ned_m[1])]
            count = math.ceil(math.dist(*ends) / _WALL_STEP_M) + 1
            feet = [
                (ends[0][0] + s * (ends[1][0] - ends[0][0]), ends[0][1] + s * (ends[1][1] - ends[0][1]))
                for s in numpy.linspace(0.0, 1.0, count).tolist()
            ]
            radius = one.radius_m if one.kind == "pole" else 0.6 * _WALL_STEP_M
            yield (
                [(*foot, _meets(foot, position, rows, -one.top_m)) for foot in feet],
                radius,
                (0.0, 0.0, 0.0),
            )
        for place, velocity in self.others:
            yield [place], 0.5, velocity

    def _sees(
        self, place: Vec3, position: Vec3, rows: _Rows, radius: float
    ) -> tuple[float, float, Vec3] | None:
        """Distance to the surface (m), bearing (rad), body-frame position (m) of a point; None: not seen."""
        n, e, d = place[0] - position[0], place[1] - position[1], place[2] - position[2]
        distance = math.sqrt(n * n + e * e + d * d)
        if not radius < distance <= self._options.range_m + radius:
            return None
        a, b, c = rows
        x, y, z = (
            a[0] * n + b[0] * e + c[0] * d,
            a[1] * n + b[1] * e + c[1] * d,
            a[2] * n + b[2] * e + c[2] * d,
        )
        if abs(z) > self._most_sine * distance:
            return None
        angle = math.atan2(y, x)
        if abs(angle) > self._most_angle:
            return None
        return distance - radius, angle, (x, y, z)

    def _scan(self, now_s: float, position: Vec3, rows: _Rows) -> MavlinkMessage:
        options, step = self._options, math.radians(self._options.step_deg)
        count = min(SECTORS, round(math.tau / step))
        half = math.radians(0.5 * options.fov_deg)
        nearest = self._nearest(now_s, position, rows, count, step)
        cm = []
        for number, distance in enumerate(nearest):
            if abs(math.remainder(number * step, math.tau)) > half:
                cm.append(0xFFFF)
            elif distance > options.range_m:
                cm.append(round(100.0 * options.range_m) + 1)
            else:
                cm.append(max(1, round(100.0 * (distance + self._noise()))))
        cm += [0xFFFF] * (SECTORS - count)
        return mavlink.MAVLink_obstacle_distance_message(
            round(1e6 * max(now_s, 0.0)), mavlink.MAV_DISTANCE_SENSOR_LASER, cm, round(options.step_deg), 20,
            round(100.0 * options.range_m), options.step_deg, 0.0, mavlink.MAV_FRAME_BODY_FRD,
        )  # fmt: skip

    def _nearest(
        self, now_s: float, position: Vec3, rows: _Rows, count: int, step: float = math.tau / WIRED_SECTORS
    ) -> list[float]:
        """Distance to the nearest surface in each of `count` sectors that are `step` rad wide."""
        nearest = [self._ground(number * step, position, rows) for number in range(count)]
        for places, radius, _ in self._shapes(now_s, position, rows):
            if self._missed():
                continue
            for place in places:
                seen = self._sees(place, position, rows, radius)
                if seen is None:
                    continue
                distance, angle, _ = seen
                wide = math.asin(min(1.0, radius / (distance + radius)))
                for number in range(round((angle - wide) / step), round((angle + wide) / step) + 1):
                    nearest[number % count] = min(nearest[number % count], distance)
        return nearest

    @staticmethod
    def _ground(angle: float, position: Vec3, rows: _Rows) -> float:
        """Distance to the ground along the middle of a sector; infinite if it does not point down."""
        sinks = rows[2][0] * math.cos(angle) + rows[2][1] * math.sin(angle)
        return -position[2] / sinks if sinks > 1e-3 and position[2] < 0.0 else math.inf

    def _points(self, now_s: float, position: Vec3, rows: _Rows) -> list[MavlinkMessage]:
        found: list[tuple[float, Vec3]] = []
        for places, _, _ in self._shapes(now_s, position, rows):
            if self._missed():
                continue
            every = max(1, round(_POINTS_APART_M / _WALL_STEP_M))
            for n, e, d in places[::every]:
                for high in _POINT_HEIGHTS_M if len(places) > 1 else (0.0,):
                    seen = self._sees((n, e, d + high), position, rows, 0.0)
                    if seen is not None:
                        found.append((seen[0], seen[2]))
        found.sort()
        return [
            mavlink.MAVLink_obstacle_distance_3d_message(
                round(1e3 * max(now_s, 0.0)), mavlink.MAV_DISTANCE_SENSOR_RADAR, mavlink.MAV_FRAME_BODY_FRD,
                0xFFFF, *self._scattered(distance, place), 0.2, self._options.range_m + 1.0,
            )
            for distance, place in found[:_MOST_POINTS]
        ]  # fmt: skip

    def _scattered(self, distance: float, place: Vec3) -> Vec3:
        scale = 1.0 + self._noise() / max(distance, 1.0)
        x, y, z = (scale * part for part in place)
        return x, y, z

    def _tracks(
        self, now_s: float, position: Vec3, believed: Vec3, rows: _Rows, believed_rows: _Rows
    ) -> list[MavlinkMessage]:
        messages = []
        number = 0
        for places, radius, velocity in self._shapes(now_s, position, rows):
            missed = self._missed()
            for place in places[:: max(1, round(2.0 * _POINTS_APART_M / _WALL_STEP_M))]:
                number += 1
                seen = self._sees(place, position, rows, radius)
                if seen is None or missed:
                    continue
                x, y, z = self._scattered(seen[0], seen[2])
                away = [row[0] * x + row[1] * y + row[2] * z for row in believed_rows]
                there = [p + a for p, a in zip(believed, away, strict=True)]
                lat, lon, alt = self._home.to_geodetic(*there)
                vn, ve, vd = velocity
                messages.append(
                    mavlink.MAVLink_adsb_vehicle_message(
                        number, round(lat * 1e7), round(lon * 1e7), mavlink.ADSB_ALTITUDE_TYPE_GEOMETRIC,
                        round(alt * 1e3), round(math.degrees(math.atan2(ve, vn)) % 360.0 * 100.0) % 36000,
                        round(100.0 * math.hypot(vn, ve)), round(-100.0 * vd), b"",
                        mavlink.ADSB_EMITTER_TYPE_UAV if any(velocity) else
                        mavlink.ADSB_EMITTER_TYPE_POINT_OBSTACLE, 0, _KEPT_FLAGS, 0,
                    )
                )  # fmt: skip
        return messages


_Rows = tuple[Vec3, Vec3, Vec3]


def _rows(roll: float, pitch: float, yaw: float) -> _Rows:
    """Rows of the rotation from body axes to NED."""
    sr, cr, sp, cp, sy, cy = (
        math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch), math.sin(yaw), math.cos(yaw),
    )  # fmt: skip
    return (
        (cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy),
        (cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy),
        (-sp, sr * cp, cr * cp),
    )


def _meets(foot: tuple[float, float], position: Vec3, rows: _Rows, top: float) -> float:
    """NED down of the point of an upright obstacle that the sensor's plane meets, or that is nearest to it.

    Args:
        top: NED down of its top. Its foot is on the ground, at 0.
    """
    a, b = foot[0] - position[0], foot[1] - position[1]
    normal = (rows[0][2], rows[1][2], rows[2][2])  # the body's down axis
    down = -(normal[0] * a + normal[1] * b) / normal[2] if abs(normal[2]) > 1e-3 else 0.0
    return min(max(position[2] + down, top), 0.0)
