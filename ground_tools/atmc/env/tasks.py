"""What training and measuring have in common: the channel of each objective, what the law allows, the
baselines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

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
MAX_BYTES: Final = 4_000_000
"""Of a policy file: ten of the paper's networks take 2.3 MB. They stay on the ground; what flies is held to
less by the one who loads it."""

AWARENESS_CHANNEL: Final = ChannelParameters(
    bluetooth_half_duplex=True,
    ble4=BleParameters(random_delay_ms=10.0, schedule="random"),
    ble5=Ble5Parameters(packet_ms=1.168, random_delay_ms=10.0, schedule="random", auxiliary_ms=8.336),
    wifi=WifiParameters(beacon_ms=1.52, access="carrier_sense"),
)
"""`config/channel/standard.toml`: airtimes of what is really sent, random phases, radios that do not
hear while they send, stations that listen first."""

REGIONS: Final = {
    "none": Region(),
    "us": Region(name="us", transport_sets=(("wifi",), ("ble4", "ble5"))),
    "eu": Region(name="eu", transport_sets=(("wifi",), ("ble5",), ("nan",))),
}
"""The transport sets of `config/regions`; nothing else of them matters here."""


def legal_sets(actions: Sequence[Action]) -> NDArray[np.bool_]:
    """Which actions each of `REGIONS` allows, (regions, actions)."""
    return np.stack([legal(actions, region) for region in REGIONS.values()])
