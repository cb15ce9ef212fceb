"""One TOML file configures one companion; every key is checked before flight.

`load` resolves what the file points to (trajectory, fence, region), so that a resolved configuration stands
alone in a run folder.
"""

from companion.config.checks import check
from companion.config.identity_checks import check_identity
from companion.config.loading import dump, load, load_trajectory, public
from companion.config.sections import (
    CHOOSER_WORDS,
    ArduRemoteIdRadio,
    AtmcConfig,
    AvoidanceConfig,
    Config,
    EtherRadio,
    FlightConfig,
    HciRadio,
    IdentityConfig,
    LimitsConfig,
    NullRadio,
    RadioConfig,
    RecordConfig,
    RemoteIdConfig,
    TrafficConfig,
    TrajectoryFile,
    VehicleConfig,
    Waypoint,
    WifiRadio,
)

__all__ = [
    "CHOOSER_WORDS",
    "ArduRemoteIdRadio",
    "AtmcConfig",
    "AvoidanceConfig",
    "Config",
    "EtherRadio",
    "FlightConfig",
    "HciRadio",
    "IdentityConfig",
    "LimitsConfig",
    "NullRadio",
    "RadioConfig",
    "RecordConfig",
    "RemoteIdConfig",
    "TrafficConfig",
    "TrajectoryFile",
    "VehicleConfig",
    "Waypoint",
    "WifiRadio",
    "check",
    "check_identity",
    "dump",
    "load",
    "load_trajectory",
    "public",
]
