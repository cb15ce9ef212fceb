"""Firmware-specific data for the steps of a flight."""

from __future__ import annotations

from dataclasses import dataclass

from companion.events import Firmware, FlightMode


@dataclass(frozen=True, slots=True)
class Modes:
    """Data of one firmware: names of its flight modes (`Dialect.name`), and how it takes off."""

    climbing: frozenset[str]
    """Modes during a take-off and after it."""
    mission: str
    external: str
    """Mode in which the autopilot follows setpoints of a companion computer."""
    holding: str
    """Mode in which a vehicle is left after an interruption."""
    armed_in: FlightMode
    """Mode to enter before arming for a take-off."""
    takes_off_above_msl: bool
    """True: the altitude of a take-off command is above mean sea level. False: it is above home."""
    resumes: bool
    """Whether a mission that is started in flight begins with the item number at which the mission before was
    left, also if that was another mission (AP_Mission::resume)."""


MODES = {
    Firmware.ARDUPILOT: Modes(
        climbing=frozenset({"GUIDED"}),
        mission="AUTO",
        external="GUIDED",
        holding="BRAKE",
        armed_in=FlightMode.EXTERNAL,
        takes_off_above_msl=False,
        resumes=True,
    ),
    Firmware.PX4: Modes(
        climbing=frozenset({"AUTO.TAKEOFF", "AUTO.LOITER"}),
        mission="AUTO.MISSION",
        external="OFFBOARD",
        holding="AUTO.LOITER",
        armed_in=FlightMode.HOLD,
        takes_off_above_msl=True,
        resumes=False,
    ),
}
COMING_DOWN = frozenset({"LAND", "RTL", "SMART_RTL", "AUTO_RTL", "AUTO.LAND", "AUTO.RTL", "AUTO.PRECLAND"})
