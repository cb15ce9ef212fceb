"""A DataFlash log's messages as events: what a companion's link would make of the same vehicle's MAVLink.

Message and field names are those of ArduPilot's log documentation
(https://ardupilot.org/copter/docs/logmessages.html).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from typing import BinaryIO

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.dialect import flight_mode
from companion.autopilot.dialects.definition import CUSTOM_MODE_ENABLED
from companion.autopilot.encoders import MAX_SETPOINT_MPS
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
    Severity,
    VehicleText,
    VehicleTime,
    VelocitySetpoint,
)
from companion.flight_logs.dataflash import DataFlashReader, Fields
from companion.flight_logs.logged import About, LogCounts, TimeOrder, is_utc, on_earth
from companion.geometry import Vec3

KIND = "ArduPilot DataFlash log"
_POSITIONS = ("POS", "GPS")
"""Messages with positions, the preferred one first: the estimator's, the GNSS receiver's."""
_EVENTS = {
    15: "ready to take off (auto-armed)", 19: "GPS lost", 25: "home set", 30: "autotune started",
    33: "autotune succeeded", 34: "autotune failed", 41: "fence enabled", 42: "fence disabled",
    49: "parachute disabled", 50: "parachute enabled", 51: "parachute released",
    54: "motors stopped in an emergency",
    55: "emergency stop of the motors cleared", 56: "motor interlock disabled", 57: "motor interlock enabled",
    60: "EKF altitude reset", 61: "landing cancelled by the pilot", 62: "EKF yaw reset",
    63: "ADS-B avoidance enabled", 64: "ADS-B avoidance disabled", 65: "proximity avoidance enabled",
    66: "proximity avoidance disabled", 67: "primary GPS changed",
}  # fmt: skip
_ALARMING_EVENTS = frozenset({19, 34, 51, 54})
_ARMED, _DISARMED, _LANDED, _FLYING = 10, 11, 18, 28
_SUBSYSTEMS = {
    1: "main", 2: "radio", 3: "compass", 5: "radio failsafe", 6: "battery failsafe",
    8: "ground station failsafe", 9: "fence failsafe", 10: "flight mode", 11: "GPS",
    12: "crash check", 13: "flip", 15: "parachute", 16: "EKF check", 17: "EKF failsafe", 18: "barometer",
    19: "CPU", 20: "ADS-B failsafe", 21: "terrain",
    22: "navigation", 23: "terrain failsafe", 24: "EKF primary", 25: "thrust loss", 26: "sensor failsafe",
    27: "leak failsafe", 28: "pilot input", 29: "vibration failsafe", 30: "internal error",
    31: "dead reckoning failsafe",
}  # fmt: skip
_FLIGHT_MODE, _EKF_PRIMARY = 10, 24
"""Subsystems whose error code is a number: of the refused mode, of the new core."""
_ALARMING = re.compile(
    r"\b(pre)?arm: |fail|error|\bbad\b|lost|glitch|variance|unhealthy|not healthy|crash|emergency|breach"
    r"|\blow (battery|voltage)|inconsistent|timeout|refused|thrust loss|stopped aiding|disarming(?! motors)",
    re.IGNORECASE,
)
"""Texts have no severity in the log. Those that contain one of these words count as warnings. "Disarming
motors" is how an ordinary flight ends."""
_VEHICLES = {
    1: mavlink.MAV_TYPE_GROUND_ROVER,
    2: mavlink.MAV_TYPE_QUADROTOR,
    3: mavlink.MAV_TYPE_FIXED_WING,
    4: mavlink.MAV_TYPE_ANTENNA_TRACKER,
    7: mavlink.MAV_TYPE_SUBMARINE,
    13: mavlink.MAV_TYPE_HELICOPTER,
}
"""MAV_TYPE by the build type in VER, as AP_Vehicle_Type.h numbers them."""
_NAMED = (
    (re.compile(r"ArduCopter|APM:Copter"), 2),
    (re.compile(r"ArduPlane"), 3),
    (re.compile(r"ArduRover|APMrover"), 1),
    (re.compile(r"ArduSub"), 7),
    (re.compile(r"AntennaTracker"), 4),
)
"""Build types by the beginning of the first text."""
_FRAMES = {
    "QUAD": mavlink.MAV_TYPE_QUADROTOR, "HEXA": mavlink.MAV_TYPE_HEXAROTOR,
    "OCTA": mavlink.MAV_TYPE_OCTOROTOR, "Y6": mavlink.MAV_TYPE_HEXAROTOR, "TRI": mavlink.MAV_TYPE_TRICOPTER,
    "HELI": mavlink.MAV_TYPE_HELICOPTER, "DODECA": mavlink.MAV_TYPE_DODECAROTOR,
    "DECA": mavlink.MAV_TYPE_DECAROTOR,
}  # fmt: skip
_GUIDED_WITH_VELOCITY = (3, 4)
"""Types of guided targets (ModeGuided::SubMode) with a velocity."""
_ESTIMATES = mavlink.ESTIMATOR_VELOCITY_HORIZ | mavlink.ESTIMATOR_POS_HORIZ_ABS
_CONSTANT_POSITION = mavlink.ESTIMATOR_CONST_POS_MODE
_GPS_EPOCH_S, _WEEK_S = 315_964_800, 604_800
"""GPS time began on 6 January 1980."""
_LEAPS = ((1_483_228_800, 18), (1_435_708_800, 17), (1_341_100_800, 16), (0, 15))
"""UTC (Unix seconds) of the last leap seconds, and how far GPS time is ahead of UTC since then (s)."""
_VELOCITY_AGE_S = 1.0


def read_steps(stream: BinaryIO, name: str, about: About) -> Iterator[Step]:
    """Yield a step for each message that makes an event, in order of time.

    Times are the vehicle's own, since it started. UTC is that of its GNSS receiver.

    Args:
        stream: the file, which can be read again from its beginning.
        name: what to call it in errors.
        about: filled in while reading.

    Raises:
        PeerDataError: this is no DataFlash log.
    """
    about.kind, about.firmware = KIND, "ArduPilot"
    about.position_from = _position_source(stream, name)
    stream.seek(0)
    vehicle = _Vehicle(about)
    reader = DataFlashReader(stream, name, frozenset(vehicle.readers), about.counts)
    order = TimeOrder(about, may_restart=True)
    for kind, fields in reader.messages():
        try:
            time_s = float(fields["TimeUS"]) / 1e6
            for item in vehicle.readers[kind](order.shifted(time_s), fields, reader):
                yield from order.add(time_s, item)
        except (KeyError, ValueError, TypeError, OverflowError):
            about.counts.bad_values += 1
    yield from order.rest()


def _position_source(stream: BinaryIO, name: str) -> str:
    """The first of `_POSITIONS` with a place on Earth; empty if there is none."""
    stream.seek(0)
    found = ""
    for kind, fields in DataFlashReader(stream, name, frozenset(_POSITIONS), LogCounts()).messages():
        if kind in _POSITIONS and _has_place(fields):
            if kind == _POSITIONS[0]:
                return kind
            found = kind
    return found


def _utc_s(week: int, milliseconds: int) -> float:
    """UTC of a GPS week and the time in it."""
    gps_s = _GPS_EPOCH_S + week * _WEEK_S + milliseconds / 1e3
    return next(gps_s - ahead_s for since_s, ahead_s in _LEAPS if gps_s - ahead_s >= since_s)


def _has_place(fields: Fields) -> bool:
    try:
        return on_earth(float(fields["Lat"]), float(fields["Lng"]))
    except (KeyError, ValueError):
        return False


Reader = Callable[[float, Fields, DataFlashReader], "list[AnyEvent | AnyCommand]"]


class _Vehicle:
    """Turns messages into events."""

    def __init__(self, about: About) -> None:
        self._about = about
        self._kind = 0
        self._mode: int | None = None
        self._armed = False
        self._core = 0
        self._velocity: Vec3 = (0.0, 0.0, 0.0)
        self._velocity_s = -math.inf
        self._gps_velocity: Vec3 = (0.0, 0.0, 0.0)
        """Used as long as no estimator's velocity is logged."""
        self._home_m: float | None = None
        self._accuracy: tuple[float | None, ...] = (None, None, None, None)
        self.readers: dict[str, Reader] = {
            "POS": self._position, "GPS": self._gps, "GPA": self._gps_accuracy, "MODE": self._flight_mode,
            "ARM": self._arm, "EV": self._event, "ERR": self._error, "MSG": self._text, "VER": self._version,
            "PARM": self._parameter, "ORGN": self._origin, "GUIP": self._guided, "ADSB": self._adsb,
            **dict.fromkeys(("XKF1", "NKF1"), self._estimate),
            **dict.fromkeys(("XKF2", "NKF2"), self._wind),
            **dict.fromkeys(("XKF4", "NKF4"), self._estimator),
        }  # fmt: skip

    def _position(self, time_s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        if self._about.position_from != "POS":
            return []
        velocity = self._velocity if time_s - self._velocity_s <= _VELOCITY_AGE_S else self._gps_velocity
        return self._at(time_s, fields, float(fields["RelHomeAlt"]), velocity)

    def _at(
        self, time_s: float, fields: Fields, height_m: float, velocity: Vec3
    ) -> list[AnyEvent | AnyCommand]:
        lat, lng, alt = float(fields["Lat"]), float(fields["Lng"]), float(fields["Alt"])
        if not on_earth(lat, lng, alt, height_m, *velocity):
            self._about.counts.bad_values += (lat, lng) != (0.0, 0.0)
            return []
        return [
            GlobalPosition(
                time_boot_s=time_s,
                lat_deg=lat,
                lon_deg=lng,
                alt_msl_m=alt,
                height_above_home_m=height_m,
                velocity_ned_mps=velocity,
            )
        ]

    def _estimate(self, time_s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        """Velocity of the primary core of EKF3 or EKF2."""
        velocity = float(fields["VN"]), float(fields["VE"]), float(fields["VD"])
        if int(fields.get("C", self._core)) == self._core and all(map(math.isfinite, velocity)):
            self._velocity, self._velocity_s = velocity, time_s
        return []

    def _wind(self, time_s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        if int(fields.get("C", self._core)) == self._core:
            self._about.blown(time_s, float(fields["VWN"]), float(fields["VWE"]))
        return []

    def _estimator(self, _s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        self._core = int(fields.get("PI", self._core))
        if int(fields.get("C", self._core)) != self._core:
            return []
        flags = int(fields["SS"])
        usable = flags & _ESTIMATES == _ESTIMATES and not flags & _CONSTANT_POSITION
        # Before it is armed a vehicle has yet to find its position, which is no fault.
        return [EstimatorState(usable=usable)] if usable or self._armed else []

    def _gps(self, time_s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        if not int(fields.get("U", 1)):  # another receiver is in use
            return []
        found: list[AnyEvent | AnyCommand] = []
        status = int(fields["Status"])
        lat, lng, alt = float(fields["Lat"]), float(fields["Lng"]), float(fields["Alt"])
        if on_earth(lat, lng, alt):
            ellipsoid_m, horizontal_m, vertical_m, speed_mps = self._accuracy
            found.append(
                GnssFix(
                    fix_type=status,
                    lat_deg=lat,
                    lon_deg=lng,
                    alt_msl_m=alt,
                    alt_ellipsoid_m=ellipsoid_m,
                    horizontal_accuracy_m=horizontal_m,
                    vertical_accuracy_m=vertical_m,
                    speed_accuracy_mps=speed_mps,
                    satellites=int(fields["NSats"]),
                )
            )
        utc_s = _utc_s(int(fields["GWk"]), int(fields["GMS"]))
        if status >= mavlink.GPS_FIX_TYPE_3D_FIX and is_utc(utc_s):
            found.append(VehicleTime(time_boot_s=time_s, utc_s=utc_s))
        if status >= mavlink.GPS_FIX_TYPE_3D_FIX:
            course, speed = math.radians(float(fields["GCrs"])), float(fields["Spd"])
            velocity = speed * math.cos(course), speed * math.sin(course), float(fields.get("VZ", 0.0))
            self._gps_velocity = velocity
            if self._about.position_from == "GPS":
                found += self._at(time_s, fields, alt - self._about.home(self._home_m, alt), velocity)
        return found

    def _gps_accuracy(self, _s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        """Take in GPA. It follows the GPS message, so its accuracies are used for the next GPS message."""
        if int(fields.get("I", 0)) == 0:
            values = [float(fields[name]) if name in fields else 0.0 for name in ("HAcc", "VAcc", "SAcc")]
            ellipsoid_m = float(fields["AEl"]) if "AEl" in fields else None
            # The driver gives 0 where the receiver reports no accuracy.
            self._accuracy = ellipsoid_m, *(value or None for value in values)
        return []

    def _origin(self, _s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        if int(fields["Type"]) == 1:  # home
            self._home_m = float(fields["Alt"])
        return []

    def _flight_mode(self, _s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        self._mode = int(fields["ModeNum"] if "ModeNum" in fields else fields["Mode"])
        return self._beat()

    def _arm(self, _s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        self._armed = bool(fields["ArmState"])
        return self._beat()

    def _beat(self) -> list[AnyEvent | AnyCommand]:
        if self._mode is None:
            return []
        vehicle = self._kind
        return [
            Heartbeat(
                system_id=self._about.system_id,
                firmware=Firmware.ARDUPILOT,
                vehicle_type=vehicle,
                custom_mode=self._mode,
                mode=flight_mode(Firmware.ARDUPILOT, vehicle, CUSTOM_MODE_ENABLED, self._mode),
                armed=self._armed,
            )
        ]

    def _event(self, _s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        number = int(fields["Id"])
        if number in (_ARMED, _DISARMED):
            self._armed = number == _ARMED
            return self._beat()
        if number in (_LANDED, _FLYING):
            return [LandedState(landed=Landed.ON_GROUND if number == _LANDED else Landed.IN_AIR)]
        severity = Severity.WARNING if number in _ALARMING_EVENTS else Severity.INFO
        return [VehicleText(severity=severity, text=f"event: {_EVENTS.get(number, f'number {number}')}")]

    def _error(self, _s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        number, code = int(fields["Subsys"]), int(fields["ECode"])
        words = _SUBSYSTEMS.get(number, f"subsystem {number}")
        if number == _FLIGHT_MODE:
            words, severity = f"{words} {code} refused", Severity.WARNING
        elif number == _EKF_PRIMARY:
            words, severity = f"{words} is now {code}", Severity.WARNING
        elif code == 0:
            words, severity = f"{words} resolved", Severity.INFO
        else:
            words, severity = f"{words}, code {code}", Severity.ERROR
        return [VehicleText(severity=severity, text=f"error: {words}")]

    def _text(self, _s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        text = str(fields["Message"])
        for pattern, build in _NAMED:
            if pattern.match(text):
                self._named(text, build)
        if text.startswith("Frame: ") and self._kind == mavlink.MAV_TYPE_QUADROTOR:
            self._kind = _FRAMES.get(text.removeprefix("Frame: ").partition("/")[0], self._kind)
        severity = Severity.WARNING if _ALARMING.search(text) else Severity.INFO
        return [VehicleText(severity=severity, text=text)] if text else []

    def _version(self, _s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        self._named(str(fields["FWS"]), int(fields["BU"]))
        return []

    def _named(self, text: str, build: int) -> None:
        if self._about.firmware == "ArduPilot":
            self._about.firmware = text
            self._kind = _VEHICLES.get(build, 0)

    def _parameter(self, _s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        if fields["Name"] in ("MAV_SYSID", "SYSID_THISMAV") and 1 <= float(fields["Value"]) <= 255:
            self._about.system_id = int(fields["Value"])
        return []

    def _guided(self, _s: float, fields: Fields, reader: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        """Target of Copter's guided mode. Rover's velocity is not in north, east, down.

        Up to 4.6 the numbers are in cm, later in m; the log says which. The third axis points up.
        """
        factor = reader.factor("GUIP", "vX")
        is_copter = self._kind in _FRAMES.values()
        if int(fields["Type"]) not in _GUIDED_WITH_VELOCITY or factor is None or not is_copter:
            self._about.other_setpoints += 1
            return []
        north, east, up = (float(fields[name]) * factor for name in ("vX", "vY", "vZ"))
        if not math.hypot(north, east, up) <= MAX_SETPOINT_MPS:
            raise ValueError("no velocity")
        return [VelocitySetpoint(velocity_ned_mps=(north, east, -up))]

    def _adsb(self, _s: float, fields: Fields, _: DataFlashReader) -> list[AnyEvent | AnyCommand]:
        """Take in ADSB. Its fields have the units of ADSB_VEHICLE; the log does not say which are valid."""
        lat, lng = float(fields["Lat"]) / 1e7, float(fields["Lng"]) / 1e7
        icao = int(fields["ICAO_address"])
        if not on_earth(lat, lng) or not 0 <= icao <= 0xFFFFFF:
            raise ValueError("no aircraft")
        course = math.radians(float(fields["Heading"]) / 1e2)
        speed, climb = float(fields["Hor_vel"]) / 1e2, float(fields["Ver_vel"]) / 1e2
        return [
            AdsbVehicle(
                icao=icao,
                lat_deg=lat,
                lon_deg=lng,
                alt_m=float(fields["Alt"]) / 1e3,
                velocity_ned_mps=(speed * math.cos(course), speed * math.sin(course), -climb),
            )
        ]
