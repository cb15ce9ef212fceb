"""What a region's law asks of a broadcast: plain data, read from a profile file in `config/regions`."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

Seconds = Annotated[float, Meta(gt=0, le=60)]
TransportName = Literal["ble4", "ble5", "wifi", "nan"]


class Region(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One region's floor. The default asks for nothing."""

    name: str = "none"
    source: str = ""
    """Where the numbers stand (law, means of compliance)."""
    transport_sets: tuple[tuple[TransportName, ...], ...] = ()
    """Legal are these sets, and every larger one; the first is preferred. Empty: anything is legal."""
    location_period_s: Seconds | None = None
    """Longest time between two Locations on each transport of the legal set."""
    location_max_age_s: Seconds = 1.0
    """Oldest position that a Location may carry."""
    basic_id_period_s: Seconds | None = None
    system_period_s: Seconds | None = None
    other_period_s: Seconds | None = None
    """Self ID, Operator ID, Authentication, where they are configured."""
    beacon_channels: tuple[int, ...] = ()
    """Wi-Fi channels on which a beacon keeps the common floor."""
    beacon_period_elsewhere_s: Seconds | None = None
    """Longest time between two beacons on any other channel."""
    serial_number: Literal["cta-2063-a", "any"] = "any"
    """Form that a serial number must have."""
    operator_id: Literal["eu", "any"] = "any"
    """Form that an operator ID must have, with its checksum."""
    operator_id_required: bool = False
