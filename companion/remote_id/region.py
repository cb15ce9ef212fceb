"""Legal requirements of a region for Remote ID broadcasts, read from a profile file in `config/regions`."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

Seconds = Annotated[float, Meta(gt=0, le=60)]
TransportName = Literal["ble4", "ble5", "wifi", "nan"]


class Region(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Minimum requirements of one region. The default requires nothing."""

    name: str = "none"
    source: str = ""
    """Source of the numbers (law, means of compliance)."""
    transport_sets: tuple[tuple[TransportName, ...], ...] = ()
    """Legal transport sets. A superset of any of them is legal too. The first is preferred. Empty: all are
    legal."""
    location_period_s: Seconds | None = None
    """Longest time between two Locations on each transport of the legal set."""
    location_max_age_s: Seconds = 1.0
    """Oldest position that a Location may carry."""
    basic_id_period_s: Seconds | None = None
    system_period_s: Seconds | None = None
    other_period_s: Seconds | None = None
    """Longest time between two Self IDs, Operator IDs or Authentications, where they are configured."""
    beacon_channels: tuple[int, ...] = ()
    """Wi-Fi channels on which the periods above apply to beacons."""
    beacon_period_elsewhere_s: Seconds | None = None
    """Longest time between two beacons on any other channel."""
    serial_number: Literal["cta-2063-a", "any"] = "any"
    """Required form of a serial number."""
    operator_id: Literal["eu", "any"] = "any"
    """Required form of an operator ID, including its checksum."""
    operator_id_required: bool = False
