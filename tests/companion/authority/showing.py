"""Makes the heartbeats that a vehicle reports in succession."""

from __future__ import annotations

from companion.events import Firmware, FlightMode, Heartbeat


def beat(mode, *, firmware=Firmware.PX4, armed=True, custom_mode=None):
    """One heartbeat. With `custom_mode` None, the number is the one that the bench uses for the mode."""
    custom = list(FlightMode).index(mode) if custom_mode is None else custom_mode
    return Heartbeat(
        system_id=1, firmware=firmware, vehicle_type=2, custom_mode=custom, mode=mode, armed=armed
    )


def beats(*modes, firmware=Firmware.PX4):
    return [beat(mode, firmware=firmware) for mode in modes]
