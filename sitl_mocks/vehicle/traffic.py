"""ADSB_VEHICLE messages of the mock vehicle: crewed aircraft that its receiver hears, and reports of others.

Reports of other components are sent as the autopilot's own (`Traffic.receive`): PX4 takes them always,
ArduPilot only with a receiver (ADSB_TYPE is not 0). Every flight is straight, and the receiver reports it
once a second. The autopilots' behaviour was read in the firmwares' sources. ArduPilot keeps a list of
aircraft. It sends one aircraft per interval of the stream and restarts the list once a second. For 5 s it
repeats the last report of an aircraft that is no longer heard, with `tslc` unchanged. PX4 forwards each
report once, with only the first six flags.
"""

from __future__ import annotations

import math
from collections import deque
from copy import copy
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkMessage
from companion.errors import ConfigError
from companion.geometry import LocalFrame, Vec3

PERIOD_S = 1.0
"""Period of the receiver's reports and of ArduPilot's list."""
KEPT_S = 5.0
"""Time for which ArduPilot's list keeps an aircraft that is no longer heard."""
_PASSED_ON = 0x3F
"""Flags that PX4 forwards."""
_SQUAWK = 1200
_KEPT = 100
_EPSILON_S = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class CrewedFlight:
    """One aircraft in straight flight. NED is relative to the vehicle's home; times are the caller's now_s.

    Raises ConfigError for values that ADSB_VEHICLE cannot carry.
    """

    icao: int
    start_ned_m: Vec3
    """Position at now_s = 0."""
    velocity_ned_mps: Vec3
    heard_from_s: float = 0.0
    heard_until_s: float = math.inf
    callsign: str = ""
    emitter: int = mavlink.ADSB_EMITTER_TYPE_LIGHT
    geometric: bool = False
    """Whether the altitude is above the ellipsoid. If not, it is above mean sea level, from the altimeter."""

    def __post_init__(self) -> None:
        if not 0 <= self.icao <= 0xFFFFFF:
            raise ConfigError(f"icao {self.icao:#x} is out of range; allowed: 0 to 0xffffff")
        if not self.callsign.isascii() or len(self.callsign) > 8:
            raise ConfigError(f"callsign {self.callsign!r}; allowed: up to 8 ASCII characters")
        if not all(map(math.isfinite, (*self.start_ned_m, *self.velocity_ned_mps))):
            raise ConfigError(f"flight {self.icao:#x} holds a value that is not a finite number")
        if math.hypot(*self.velocity_ned_mps[:2]) > 600.0 or abs(self.velocity_ned_mps[2]) > 300.0:
            raise ConfigError(
                f"flight {self.icao:#x} is too fast; allowed: 600 m/s horizontally, 300 m/s vertically"
            )

    def reported_s(self, now_s: float) -> float | None:
        """Time of the receiver's last report up to `now_s`; None if there was none."""
        at_s = math.floor(min(now_s, self.heard_until_s) / PERIOD_S + _EPSILON_S) * PERIOD_S
        return at_s if at_s >= self.heard_from_s else None


class Traffic:
    """Builds the messages for each link of a vehicle when its ADSB_VEHICLE stream is due."""

    def __init__(
        self,
        flights: tuple[CrewedFlight, ...],
        home: LocalFrame,
        geoid_separation_m: float,
        *,
        listed: bool,
    ) -> None:
        """Set up the traffic of one vehicle.

        Args:
            home: frame with its altitude above mean sea level.
            listed: True reports aircraft from a list like ArduPilot, False forwards each report like PX4.
        """
        self._flights = flights
        self._home = home
        self._geoid_separation_m = geoid_separation_m
        self._listed = listed
        self._begun: dict[int, tuple[float, int]] = {}
        """Link -> time at which its list was begun, and number of aircraft already sent from it."""
        self.taken: deque[MavlinkMessage] = deque(maxlen=_KEPT)
        """The latest ADSB_VEHICLE messages of others that the autopilot used. It reports them as its own."""
        self._taken = 0
        self._echoed: dict[int, int] = {}
        """Link -> number of messages taken up to when it was last sent any."""
        self._passed: dict[tuple[int, int], float] = {}
        """Link and ICAO address -> time of the report that was forwarded last."""

    def receive(self, message: MavlinkMessage) -> None:
        """Keep a report of another component, to be sent as our own. The caller decides whether to use it."""
        self.taken.append(message)
        self._taken += 1

    def _echo(self, link: int) -> list[MavlinkMessage]:
        new = min(self._taken - self._echoed.get(link, 0), len(self.taken))
        if not new:
            return []
        self._echoed[link] = self._taken
        messages = [copy(message) for message in list(self.taken)[len(self.taken) - new :]]
        for message in messages:
            message.flags &= 0xFFFF if self._listed else _PASSED_ON
        return messages

    def due(self, link: int, now_s: float) -> list[MavlinkMessage]:
        """Return the messages to send on a link now."""
        return self._echo(link) + (self._own(link, now_s) if self._flights else [])

    def _own(self, link: int, now_s: float) -> list[MavlinkMessage]:
        heard = [(flight, at_s) for flight in self._flights if (at_s := flight.reported_s(now_s)) is not None]
        return self._next(link, heard, now_s) if self._listed else self._new(link, heard)

    def _next(self, link: int, heard: list[tuple[CrewedFlight, float]], now_s: float) -> list[MavlinkMessage]:
        kept = [entry for entry in heard if now_s - entry[1] <= KEPT_S]
        begun_s, sent = self._begun.get(link, (-math.inf, 0))
        if sent >= len(kept):
            if now_s - begun_s < PERIOD_S - _EPSILON_S:
                return []
            begun_s, sent = now_s, 0
        self._begun[link] = begun_s, sent + 1
        return [self._message(*entry) for entry in kept[sent : sent + 1]]

    def _new(self, link: int, heard: list[tuple[CrewedFlight, float]]) -> list[MavlinkMessage]:
        messages = []
        for flight, at_s in heard:
            if self._passed.get((link, flight.icao)) != at_s:
                self._passed[link, flight.icao] = at_s
                messages.append(self._message(flight, at_s))
        return messages

    def _message(self, flight: CrewedFlight, at_s: float) -> MavlinkMessage:
        velocity = flight.velocity_ned_mps
        place = [start + speed * at_s for start, speed in zip(flight.start_ned_m, velocity, strict=True)]
        lat, lon, alt = self._home.to_geodetic(*place)
        flags = (
            mavlink.ADSB_FLAGS_VALID_COORDS
            | mavlink.ADSB_FLAGS_VALID_ALTITUDE
            | mavlink.ADSB_FLAGS_VALID_HEADING
            | mavlink.ADSB_FLAGS_VALID_VELOCITY
            | mavlink.ADSB_FLAGS_VALID_SQUAWK
            | mavlink.ADSB_FLAGS_VERTICAL_VELOCITY_VALID
        )
        if flight.callsign:
            flags |= mavlink.ADSB_FLAGS_VALID_CALLSIGN
        north, east, down = velocity
        return mavlink.MAVLink_adsb_vehicle_message(
            flight.icao,
            round(lat * 1e7),
            round(lon * 1e7),
            mavlink.ADSB_ALTITUDE_TYPE_GEOMETRIC
            if flight.geometric
            else mavlink.ADSB_ALTITUDE_TYPE_PRESSURE_QNH,
            round((alt + (self._geoid_separation_m if flight.geometric else 0.0)) * 1e3),
            round(math.degrees(math.atan2(east, north)) % 360.0 * 100.0) % 36000,
            round(math.hypot(north, east) * 100.0),
            round(-down * 100.0),
            flight.callsign.encode(),
            flight.emitter,
            0,
            flags if self._listed else flags & _PASSED_ON,
            _SQUAWK,
        )
