"""A ULog file's messages as events: what a companion's link would make of the same vehicle's MAVLink.

Topics and fields are those of PX4's message definitions (https://docs.px4.io/main/en/msg_docs/). Where
versions of PX4 differ, the names of all of them are read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import BinaryIO

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.dialect import flight_mode
from companion.autopilot.dialects.definition import CUSTOM_MODE_ENABLED
from companion.autopilot.encoders import MAX_SETPOINT_MPS
from companion.autopilot.readers import finite_or_none
from companion.event_record import Step
from companion.events import (
    AdsbVehicle,
    AnyCommand,
    AnyEvent,
    EstimatorState,
    Firmware,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    Landed,
    LandedState,
    RemoteIdModule,
    VehicleText,
    VehicleTime,
    VelocitySetpoint,
)
from companion.flight_logs.logged import About, LogCounts, TimeOrder, is_utc, on_earth
from companion.flight_logs.ulog import Fields, Logged, UlogReader
from companion.geometry import LocalFrame, Vec3

KIND = "PX4 log (ULog)"
_POSITIONS = ("vehicle_global_position", "vehicle_local_position", "vehicle_gps_position")
"""Topics with positions, the preferred one first: the estimator's, relative to its origin, the receiver's."""
_WANTED = {
    "vehicle_global_position": "timestamp lat lon alt vel_n vel_e vel_d lat_lon_valid alt_valid",
    "vehicle_local_position": "timestamp x y z vx vy vz xy_valid v_xy_valid xy_global z_global ref_lat"
    " ref_lon ref_alt",
    "vehicle_gps_position": "timestamp fix_type lat lon alt alt_ellipsoid latitude_deg longitude_deg"
    " altitude_msl_m altitude_ellipsoid_m eph epv s_variance_m_s satellites_used vel_n_m_s vel_e_m_s"
    " vel_d_m_s time_utc_usec timestamp_time_relative",
    "vehicle_status": "timestamp nav_state arming_state system_type system_id nav_state_user_intention",
    "vehicle_land_detected": "timestamp landed freefall",
    "home_position": "timestamp alt valid_alt",
    "trajectory_setpoint": "timestamp velocity vx vy vz",
    "wind": "timestamp windspeed_north windspeed_east",
    "wind_estimate": "timestamp windspeed_north windspeed_east",
    "transponder_report": "timestamp icao_address lat lon altitude_type altitude heading hor_velocity"
    " ver_velocity callsign emitter_type tslc flags",
    "open_drone_id_arm_status": "timestamp status error",
}
_ARMED = 2
_OFFBOARD = 14
_MODES = {
    0: (1, 0), 1: (2, 0), 2: (3, 0), 3: (4, 4), 4: (4, 3), 5: (4, 5), 10: (5, 0), 12: (4, 6), 13: (10, 0),
    14: (6, 0), 15: (7, 0), 17: (4, 2), 18: (4, 6), 19: (4, 8), 20: (4, 9), 21: (3, 1), 22: (4, 10),
    **{23 + n: (4, 11 + n) for n in range(8)},
}  # fmt: skip
"""Main and sub mode by navigation state, as `get_px4_custom_mode` gives them (px4_custom_mode.h)."""
_NEW_MODES = {6: (3, 2), 8: (11, 0)}
"""Modes of the states that had another meaning before release 1.14."""
_ALL_SPEEDS = ("vx", "vy", "vz")
_FLAG_COORDS, _FLAG_ALTITUDE, _FLAG_HEADING, _FLAG_VELOCITY, _FLAG_CALLSIGN = 1, 2, 4, 8, 16
_VELOCITY_AGE_S = 1.0
_GEOMETRIC = 1
_GOOD_TO_ARM = mavlink.MAV_ODID_ARM_STATUS_GOOD_TO_ARM
_MODULE = mavlink.MAV_COMP_ID_ODID_TXRX_1


def read_steps(stream: BinaryIO, name: str, about: About) -> Iterator[Step]:
    """Yield a step for each message that makes an event, in order of time.

    Times are the vehicle's own, since it started. UTC is that of its GNSS receiver.

    Args:
        stream: the file, which can be read again from its beginning.
        name: what to call it in errors.
        about: filled in while reading.

    Raises:
        PeerDataError: this is no ULog file, or one of a kind that is not known.
    """
    about.kind, about.firmware = KIND, "PX4"
    about.position_from = _position_source(stream, name)
    stream.seek(0)
    wanted = {topic: frozenset(names.split()) for topic, names in _WANTED.items()}
    reader = UlogReader(stream, name, wanted, about.counts)
    vehicle = _Vehicle(about, reader)
    order = TimeOrder(about, may_restart=False, start_s=reader.told.start_s)
    for message in reader.messages():
        try:
            if isinstance(message, Logged):
                text = VehicleText(severity=message.severity, text=message.text)
                yield from order.add(message.time_s, text)
                continue
            topic, instance, fields = message
            time_s = _number(fields, "timestamp") / 1e6
            for item in vehicle.readers[topic](time_s, fields) if instance == 0 else ():
                yield from order.add(time_s, item)
        except (KeyError, ValueError, TypeError, OverflowError):
            about.counts.bad_values += 1
    yield from order.rest()


def _number(fields: Fields, name: str) -> float:
    value = fields[name]
    if isinstance(value, str | tuple):
        raise ValueError(f"{name} is no number")
    return value


def _vector(fields: Fields, first: str, second: str, third: str) -> Vec3:
    return _number(fields, first), _number(fields, second), _number(fields, third)


def _position_source(stream: BinaryIO, name: str) -> str:
    """The first of `_POSITIONS` with a place on Earth; empty if there is none."""
    stream.seek(0)
    wanted = {topic: frozenset(_WANTED[topic].split()) for topic in _POSITIONS}
    about = About()
    reader = UlogReader(stream, name, wanted, LogCounts())
    best = len(_POSITIONS)
    for message in reader.messages():
        if isinstance(message, Logged) or message[1] != 0:
            continue
        topic, _, fields = message
        rank = _POSITIONS.index(topic)
        if rank >= best:
            continue
        about.position_from = topic
        try:
            items = _Vehicle(about, reader).readers[topic](0.0, fields)
        except (KeyError, ValueError, TypeError):
            continue
        if any(isinstance(item, GlobalPosition) for item in items):
            best = rank
            if best == 0:
                break
    return _POSITIONS[best] if best < len(_POSITIONS) else ""


Reader = Callable[[float, Fields], "list[AnyEvent | AnyCommand]"]


class _Vehicle:
    """Turns messages into events."""

    def __init__(self, about: About, reader: UlogReader) -> None:
        self._about = about
        self._told = reader.told
        self._velocity: Vec3 | None = None
        self._velocity_s = -math.inf
        self._home_m: float | None = None
        self._frame: LocalFrame | None = None
        self._nav_state = 0
        self._armed = False
        self.readers: dict[str, Reader] = {
            "vehicle_global_position": self._global,
            "vehicle_local_position": self._local,
            "vehicle_gps_position": self._gps,
            "vehicle_status": self._status,
            "vehicle_land_detected": self._landed,
            "home_position": self._home,
            "trajectory_setpoint": self._setpoint,
            "wind": self._wind,
            "wind_estimate": self._wind,
            "transponder_report": self._adsb,
            "open_drone_id_arm_status": self._module,
        }

    def _global(self, time_s: float, fields: Fields) -> list[AnyEvent | AnyCommand]:
        if not fields.get("lat_lon_valid", True) or not fields.get("alt_valid", True):
            return []
        if "vel_n" in fields:  # before 1.13
            velocity: Vec3 | None = _vector(fields, "vel_n", "vel_e", "vel_d")
        else:
            velocity = self._velocity if time_s - self._velocity_s <= _VELOCITY_AGE_S else None
        place = _number(fields, "lat"), _number(fields, "lon"), _number(fields, "alt")
        return self._at("vehicle_global_position", time_s, place, velocity)

    def _at(
        self, topic: str, time_s: float, place: Vec3, velocity: Vec3 | None
    ) -> list[AnyEvent | AnyCommand]:
        if self._about.position_from != topic or not on_earth(*place, *(velocity or ())):
            return []
        home_m = self._about.home(self._home_m, place[2])
        return [
            GlobalPosition(
                time_boot_s=time_s,
                lat_deg=place[0],
                lon_deg=place[1],
                alt_msl_m=place[2],
                height_above_home_m=place[2] - home_m,
                velocity_ned_mps=velocity or (0.0, 0.0, 0.0),
            )
        ]

    def _local(self, time_s: float, fields: Fields) -> list[AnyEvent | AnyCommand]:
        x, y, z, *velocity = (_number(fields, name) for name in ("x", "y", "z", *_ALL_SPEEDS))
        usable = bool(fields["v_xy_valid"] and fields["xy_global"])
        # Before it is armed a vehicle has yet to find its position, which is no fault.
        found: list[AnyEvent | AnyCommand] = [EstimatorState(usable=usable)] if usable or self._armed else []
        if fields["v_xy_valid"] and all(map(math.isfinite, velocity)):
            self._velocity, self._velocity_s = (velocity[0], velocity[1], velocity[2]), time_s
        placed = fields["xy_global"] and fields["z_global"]
        if self._about.position_from == "vehicle_local_position" and placed:
            origin = tuple(_number(fields, f"ref_{name}") for name in ("lat", "lon", "alt"))
            if self._frame is None or (self._frame.lat_deg, self._frame.lon_deg, self._frame.alt_m) != origin:
                self._frame = LocalFrame(*origin)
            place = self._frame.to_geodetic(x, y, z)
            found += self._at("vehicle_local_position", time_s, place, self._velocity)
        return found

    def _gps(self, time_s: float, fields: Fields) -> list[AnyEvent | AnyCommand]:
        if "latitude_deg" in fields:  # since 1.14
            place = _vector(fields, "latitude_deg", "longitude_deg", "altitude_msl_m")
            ellipsoid_m = _number(fields, "altitude_ellipsoid_m")
        else:
            place = (
                _number(fields, "lat") / 1e7,
                _number(fields, "lon") / 1e7,
                _number(fields, "alt") / 1e3,
            )
            ellipsoid_m = _number(fields, "alt_ellipsoid") / 1e3
        found: list[AnyEvent | AnyCommand] = []
        fix_type = int(_number(fields, "fix_type"))
        if on_earth(*place):
            found.append(
                GnssFix(
                    fix_type=fix_type,
                    lat_deg=place[0],
                    lon_deg=place[1],
                    alt_msl_m=place[2],
                    alt_ellipsoid_m=finite_or_none(ellipsoid_m) or None,
                    horizontal_accuracy_m=finite_or_none(_number(fields, "eph")),
                    vertical_accuracy_m=finite_or_none(_number(fields, "epv")),
                    speed_accuracy_mps=finite_or_none(_number(fields, "s_variance_m_s")),
                    satellites=int(_number(fields, "satellites_used")),
                )
            )
        utc_s = _number(fields, "time_utc_usec") / 1e6
        if is_utc(utc_s):
            # The time that UTC belongs to may be a little before the time of the message.
            utc_s -= float(_number(fields, "timestamp_time_relative")) / 1e6
            found.append(VehicleTime(time_boot_s=time_s, utc_s=utc_s))
        if fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX:
            velocity = _vector(fields, "vel_n_m_s", "vel_e_m_s", "vel_d_m_s")
            found += self._at("vehicle_gps_position", time_s, place, velocity)
        return found

    def _status(self, _s: float, fields: Fields) -> list[AnyEvent | AnyCommand]:
        about, told = self._about, self._told
        if about.firmware == "PX4":
            release = _release(told.info.get("ver_sw_release"))
            about.firmware = " ".join(
                ["PX4", *(str(part) for part in (release, told.info.get("ver_hw", "")) if part)]
            )
        for name, parameter in (("system_id", "MAV_SYS_ID"), ("system_type", "MAV_TYPE")):
            fields.setdefault(name, told.parameters.get(parameter, 0))
        about.system_id, kind = int(_number(fields, "system_id")) or 1, int(_number(fields, "system_type"))
        self._nav_state = int(_number(fields, "nav_state"))
        self._armed = _number(fields, "arming_state") == _ARMED
        modes = _MODES | (_NEW_MODES if "nav_state_user_intention" in fields else {})
        main, sub = modes.get(self._nav_state, (0, 0))
        mode = main << 16 | sub << 24 if main else self._nav_state
        return [
            Heartbeat(
                system_id=about.system_id,
                firmware=Firmware.PX4,
                vehicle_type=kind,
                custom_mode=mode,
                mode=flight_mode(Firmware.PX4, kind, CUSTOM_MODE_ENABLED, mode),
                armed=self._armed,
            )
        ]

    def _landed(self, _s: float, fields: Fields) -> list[AnyEvent | AnyCommand]:
        return [LandedState(landed=Landed.ON_GROUND if fields["landed"] else Landed.IN_AIR)]

    def _home(self, _s: float, fields: Fields) -> list[AnyEvent | AnyCommand]:
        if fields.get("valid_alt", True) and math.isfinite(_number(fields, "alt")):
            self._home_m = _number(fields, "alt")
        return []

    def _setpoint(self, _s: float, fields: Fields) -> list[AnyEvent | AnyCommand]:
        """Take in a setpoint in offboard mode. In other modes the autopilot makes its setpoints itself."""
        if self._nav_state != _OFFBOARD:
            return []
        velocity = fields["velocity"] if "velocity" in fields else [fields[name] for name in _ALL_SPEEDS]
        # What is not three numbers raises here, and `read_steps` counts it.
        north, east, down = map(float, velocity)  # type: ignore[arg-type]
        # NaN fails the comparison.
        if not math.hypot(north, east, down) <= MAX_SETPOINT_MPS:
            self._about.other_setpoints += 1
            return []
        return [VelocitySetpoint(velocity_ned_mps=(north, east, down))]

    def _wind(self, time_s: float, fields: Fields) -> list[AnyEvent | AnyCommand]:
        north, east = _number(fields, "windspeed_north"), _number(fields, "windspeed_east")
        self._about.blown(time_s, north, east)
        return []

    def _adsb(self, _s: float, fields: Fields) -> list[AnyEvent | AnyCommand]:
        flags, icao = int(_number(fields, "flags")), int(_number(fields, "icao_address"))
        lat, lon = _number(fields, "lat"), _number(fields, "lon")
        if not flags & _FLAG_COORDS or not on_earth(lat, lon):
            return []
        if not 0 <= icao <= 0xFFFFFF:
            raise ValueError("no ICAO address")
        course, speed, climb = _vector(fields, "heading", "hor_velocity", "ver_velocity")
        velocity: Vec3 | None = None
        known = flags & _FLAG_HEADING and flags & _FLAG_VELOCITY
        if known and all(map(math.isfinite, (course, speed, climb))):
            velocity = speed * math.cos(course), speed * math.sin(course), -climb
        return [
            AdsbVehicle(
                icao=icao,
                lat_deg=lat,
                lon_deg=lon,
                alt_m=finite_or_none(_number(fields, "altitude")) if flags & _FLAG_ALTITUDE else None,
                alt_geometric=_number(fields, "altitude_type") == _GEOMETRIC,
                velocity_ned_mps=velocity,
                age_s=_number(fields, "tslc"),
                callsign=str(fields["callsign"]) if flags & _FLAG_CALLSIGN else "",
                emitter=int(_number(fields, "emitter_type")),
            )
        ]

    def _module(self, _s: float, fields: Fields) -> list[AnyEvent | AnyCommand]:
        ready = _number(fields, "status") == _GOOD_TO_ARM
        return [RemoteIdModule(component_id=_MODULE, ready=ready, text=str(fields["error"]))]


def _release(number: object) -> str:
    """A release like 1.17.0 from its number, which has a byte for each part."""
    if not isinstance(number, int):
        return ""
    return ".".join(str(number >> shift & 0xFF) for shift in (24, 16, 8))
