"""Names of flight modes, as the autopilot's firmware calls them."""

from __future__ import annotations

from pymavlink import mavutil

from companion.autopilot.dialect import DIALECTS, refusal
from companion.events import Firmware, Heartbeat


def mode_name(beat: Heartbeat) -> str:
    """Return the firmware's name for the flight mode, or "mode N" if the number is unknown."""
    if beat.firmware is Firmware.PX4 or refusal(beat.firmware, beat.vehicle_type) is None:
        names = DIALECTS[beat.firmware].names
    else:
        # ArduPilot's fixed-wing aircraft, rovers, boats, submarines.
        names = mavutil.mode_mapping_bynumber(beat.vehicle_type) or {}
    return names.get(beat.custom_mode, f"mode {beat.custom_mode}")
