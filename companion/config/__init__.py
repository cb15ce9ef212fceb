"""Configuration of one companion from one TOML file. Every key is checked before flight.

`load` reads the files that the configuration names (trajectory, fence, region) into it, so that the resolved
configuration in a run folder is complete. Start reading with `sections.py`, which defines all keys but those
of radios (`companion.radio.registry`).
"""

from companion.config.checks import check
from companion.config.identity_checks import check_identity
from companion.config.legs import level
from companion.config.loading import dump, load, load_trajectory, public
from companion.config.sections import (
    CHOOSER_WORDS,
    EXAMPLE_ID,
    AtmcConfig,
    AvoidanceConfig,
    Config,
    ContainmentConfig,
    FlightConfig,
    IdentityConfig,
    LimitsConfig,
    RecordConfig,
    RemoteIdConfig,
    SensedConfig,
    SigningConfig,
    TrafficConfig,
    TrajectoryFile,
    VehicleConfig,
    Waypoint,
    names_file,
    policy_plugin,
)

__all__ = [
    "CHOOSER_WORDS",
    "EXAMPLE_ID",
    "AtmcConfig",
    "AvoidanceConfig",
    "Config",
    "ContainmentConfig",
    "FlightConfig",
    "IdentityConfig",
    "LimitsConfig",
    "RecordConfig",
    "RemoteIdConfig",
    "SensedConfig",
    "SigningConfig",
    "TrafficConfig",
    "TrajectoryFile",
    "VehicleConfig",
    "Waypoint",
    "check",
    "check_identity",
    "dump",
    "level",
    "load",
    "load_trajectory",
    "names_file",
    "policy_plugin",
    "public",
]
