"""Files of MAVLink's component metadata protocol: they describe the companion and its parameters.

They follow general.schema.json and parameter.schema.json (mavlink.io, services/component_metadata).
"""

from __future__ import annotations

from typing import Any

import msgspec

from companion import __version__
from companion.adjustable_parameters import ENABLE, NAMES, allowed, value_of
from companion.autopilot.served.ftp import crc32
from companion.config import Config
from companion.events import Settings

VENDOR = "DMUCA"
MODEL = "companion"
GENERAL = "general.json"
_PARAMETER = "parameter.json"
_TYPE_PARAMETER = 1
"""COMP_METADATA_TYPE_PARAMETER, which pymavlink's dialect lacks."""
_NEXT_PATH = (
    "Applies from the next path on, not to the path being flown. The default is the configured value."
)
_TEXTS = {
    ENABLE: (
        "",
        "Command the vehicle",
        "0: the companion broadcasts, receives and warns, but does not command the vehicle. 1: it flies or "
        "guards the vehicle as configured. Applies at once: 0 in flight makes the vehicle hold.",
    ),
    "DMUCA_RADIUS": (
        "m",
        "Conflict radius",
        f"Minimum distance that is kept from other drones. {_NEXT_PATH}",
    ),
    "DMUCA_HORIZON": (
        "s",
        "Look-ahead time",
        f"Conflicts with other drones within this time are avoided. {_NEXT_PATH}",
    ),
    "DMUCA_SPD_MAX": (
        "m/s",
        "Maximum horizontal speed",
        "The companion commands no higher speed. A value too low for the path to be flown is refused. "
        f"{_NEXT_PATH}",
    ),
}
"""Parameter name -> unit, short and long description."""


def uri(path: str) -> str:
    """MAVLink FTP address of one of the files."""
    return f"mftp:///{path}"


def metadata_files(config: Config) -> dict[str, bytes]:
    """Path -> content of each file. The content depends only on the configuration.

    Args:
        config: as configured, without settings.
    """
    parameters = _json({"version": 3, "parameters": [_parameter(name, config) for name in NAMES]})
    general = _json(
        {
            "version": 1,
            "vendorName": VENDOR,
            "modelName": MODEL,
            "firmwareVersion": __version__,
            "metadataTypes": [
                {"type": _TYPE_PARAMETER, "uri": uri(_PARAMETER), "fileCrc": crc32(parameters)}
            ],
        }
    )
    return {GENERAL: general, _PARAMETER: parameters}


def _parameter(name: str, config: Config) -> dict[str, Any]:
    lowest, highest = allowed(name, config)
    unit, short, long = _TEXTS[name]
    found: dict[str, Any] = {
        "name": name,
        "type": "Float",
        "shortDesc": short,
        "longDesc": long,
        "units": unit,
        "min": lowest,
        "max": highest,
        "default": value_of(name, config, Settings()),
        "decimalPlaces": 1,
        "group": "DMUCA",
    }
    if name == ENABLE:
        found |= {
            "decimalPlaces": 0,
            "increment": 1,
            "values": [
                {"value": 0, "description": "Watch only"},
                {"value": 1, "description": "As configured"},
            ],
        }
    return found


def _json(content: dict[str, Any]) -> bytes:
    return msgspec.json.encode(content) + b"\n"
