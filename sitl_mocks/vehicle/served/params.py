"""The mock vehicle's parameters and their two encodings on the wire."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkMessage
from sitl_mocks.vehicle.firmware.behaviour import Manners
from sitl_mocks.vehicle.firmware.param_tables import REAL32

ECHO_INDEX = 65535
"""param_index with which ArduPilot sends the echo of a PARAM_SET."""


class ParamBook:
    """Named values in a fixed order. On the wire an integer is cast to float (ArduPilot) or its bytes fill
    the float (PX4)."""

    def __init__(
        self, manners: Manners, values: Mapping[str, float], *, system_id: int, legacy_names: bool
    ) -> None:
        """Set up the parameters. `values` replaces the firmware's defaults, by current parameter name."""
        renames = manners.legacy_names if legacy_names else {}
        self._bytewise = manners.param_bytewise
        self._types: dict[str, int] = {}
        self._values: dict[str, float] = {}
        for name, (value, kind) in sorted(manners.params.items()):
            shown = renames.get(name, name)
            self._types[shown] = kind
            own = float(system_id) if name in ("MAV_SYSID", "MAV_SYS_ID") else value
            self._values[shown] = values.get(name, own)
        self.names = tuple(self._values)

    def get(self, name: str) -> float:
        """Return the value of a parameter. Raises KeyError."""
        return self._values[name]

    def message(self, name: str, index: int | None = None) -> MavlinkMessage:
        """Build PARAM_VALUE of a known parameter."""
        shown = self.names.index(name) if index is None else index
        value = self._values[name]
        kind = self._types[name]
        if self._bytewise and kind != REAL32:
            value = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        return mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(self.names), shown)

    def answer(self, message: MavlinkMessage, due: deque[int]) -> MavlinkMessage | None:
        """Handle a message of the parameter protocol. Returns the answer for the same link, if there is one.

        Args:
            due: indices of the parameters that the link is still to send; a request for the list fills it.
        """
        match message.get_type():
            case "PARAM_REQUEST_LIST":
                due.clear()
                due.extend(range(len(self.names)))
            case "PARAM_REQUEST_READ":
                return self.read(message.param_id, message.param_index)
            case "PARAM_SET":
                return self.set(message.param_id, message.param_value)
        return None

    def read(self, name: str, index: int) -> MavlinkMessage | None:
        """Answer PARAM_REQUEST_READ, by index unless it is negative. None means no answer."""
        if index >= 0:
            return self.message(self.names[index]) if index < len(self.names) else None
        return self.message(name) if name in self._values else None

    def set(self, name: str, wire_value: float) -> MavlinkMessage | None:
        """Take a PARAM_SET and return its echo.

        None means no answer: unknown name, or not a finite number.
        """
        if name not in self._values:
            return None
        kind = self._types[name]
        if self._bytewise and kind != REAL32:
            self._values[name] = float(struct.unpack("<i", struct.pack("<f", wire_value))[0])
        elif wire_value != wire_value or abs(wire_value) == float("inf"):
            return None
        else:
            self._values[name] = wire_value if kind == REAL32 else float(round(wire_value))
        return self.message(name, None if self._bytewise else ECHO_INDEX)
