"""Definitions shared by training and evaluation: the awareness channel, legal transport sets, size limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from companion.arrays import Bools
from companion.atmc.actions import Action, legal
from companion.remote_id.region import Region
from sitl_mocks.channel.parameters import (
    Ble5Parameters,
    BleParameters,
    ChannelParameters,
    WifiParameters,
)

ObjectiveName = Literal["paper", "awareness"]
RegionName = Literal["none", "us", "eu"]

AWARENESS_CHANNEL: Final = ChannelParameters(
    bluetooth_half_duplex=True,
    ble4=BleParameters(random_delay_ms=10.0, schedule="random"),
    ble5=Ble5Parameters(packet_ms=1.168, random_delay_ms=10.0, schedule="random", auxiliary_ms=8.336),
    wifi=WifiParameters(beacon_ms=1.52, access="carrier_sense"),
)
"""The channel of `config/channel/standard.toml`: airtimes of the real packets, random phases, half-duplex
Bluetooth radios, and Wi-Fi stations with carrier sense."""

REGIONS: Final = {
    "none": Region(),
    "us": Region(name="us", transport_sets=(("wifi",), ("ble4", "ble5"))),
    "eu": Region(name="eu", transport_sets=(("wifi",), ("ble5",), ("nan",))),
}
"""Regions with the transport sets of `config/regions`; their other settings are not needed here."""


def legal_sets(actions: Sequence[Action]) -> Bools:
    """Which actions are legal in each of `REGIONS`, (regions, actions)."""
    return np.stack([legal(actions, region) for region in REGIONS.values()])
