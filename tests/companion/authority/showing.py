"""Heartbeats of a vehicle, one after the other."""

from __future__ import annotations

from companion.events import Firmware, FlightMode, Heartbeat


def beat(mode, *, firmware=Firmware.PX4, armed=True, custom_mode=None):
    """One heartbeat; `custom_mode`: None for one number for each mode, as the bench has it."""
    custom = list(FlightMode).index(mode) if custom_mode is None else custom_mode
    return Heartbeat(
        system_id=1, firmware=firmware, vehicle_type=2, custom_mode=custom, mode=mode, armed=armed
    )


def beats(*modes, firmware=Firmware.PX4):
    return [beat(mode, firmware=firmware) for mode in modes]
