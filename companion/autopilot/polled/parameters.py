"""Reads the few vehicle parameters that the companion needs, by name.

The exchange is PARAM_REQUEST_READ -> PARAM_VALUE. A vehicle does not answer for a name that it does not have,
and names change with the generations of a firmware. Every name of a parameter is therefore requested until
one of them is answered. After some tries the parameter is given up, and its value is unknown. A PARAM_VALUE
that was not requested (a ground station has set the parameter) counts as well.

ArduPilot casts every value to float. PX4 puts the bytes of an integer in place of the float; `param_type`
shows which it is.
"""

from __future__ import annotations

import math
import struct

import msgspec
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.dialects.definition import Dialect
from companion.errors import PeerDataError
from companion.events import Parameter, VehicleParameters

RETRY_S = 1.0
MAX_TRIES = 5

_REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
_INTEGERS = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<B",
    mavlink.MAV_PARAM_TYPE_INT8: "<b",
    mavlink.MAV_PARAM_TYPE_UINT16: "<H",
    mavlink.MAV_PARAM_TYPE_INT16: "<h",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}
"""Layout of the first bytes by type."""
_VALUE_BYTES = 4


class ParameterReader:
    """Reads the parameters of one vehicle. `restart` begins, and `due` returns what to ask for."""

    def __init__(self, dialect: Dialect) -> None:
        self.known = VehicleParameters(firmware=dialect.firmware)
        """Parameters received so far."""
        self._dialect = dialect
        self._wanted = {name: (w, scale) for w in dialect.wanted for name, scale in w.names}
        self._answered: set[str] = set()
        """Fields answered since the last restart, with a valid or an invalid value."""
        self._tries = MAX_TRIES
        self._next_s = math.inf

    def restart(self, now_s: float) -> None:
        """The vehicle is new or has rebooted: ask for everything. Values known before stay until they are
        replaced."""
        self._answered.clear()
        self._tries, self._next_s = 0, now_s

    def due(self, now_s: float) -> list[str]:
        """Names to ask for now."""
        if now_s < self._next_s:
            return []
        self._tries += 1
        self._next_s = now_s + RETRY_S if self._tries <= MAX_TRIES else math.inf
        return self._unanswered() if self._tries <= MAX_TRIES else []

    def finished(self) -> bool:
        """Whether nothing more is expected: every parameter is answered or given up."""
        return self._next_s == math.inf or not self._unanswered()

    def _unanswered(self) -> list[str]:
        return [name for name, (wanted, _) in self._wanted.items() if wanted.field not in self._answered]

    def on_value(self, payload: bytes, name_field: bytes, kind: int) -> None:
        """Take one PARAM_VALUE. A parameter that is not needed is ignored.

        Args:
            payload: the whole payload; the value comes first.
            name_field: `param_id`.
            kind: `param_type`.

        Raises:
            PeerDataError: a type that does not fit into the value's place, or a value that is not of its
                type, not finite or not plausible. The parameter is not requested again, and its earlier value
                stays.
        """
        name = name_field.split(b"\0", 1)[0].decode("ascii", "replace")
        if name not in self._wanted:
            return
        wanted, scale = self._wanted[name]
        self._answered.add(wanted.field)
        value = self._value(payload, kind, name) * scale
        # The comparison is false for NaN too.
        if not wanted.lowest <= value <= wanted.highest:
            raise PeerDataError(
                f"parameter {name}: {value:g} is outside {wanted.lowest:g} to {wanted.highest:g}"
            )
        told = Parameter(name=name, value=value)
        self.known = msgspec.structs.replace(self.known, **{wanted.field: told})

    def _value(self, payload: bytes, kind: int, name: str) -> float:
        data = payload[:_VALUE_BYTES].ljust(_VALUE_BYTES, b"\0")
        layout = "<f"
        if self._dialect.integers_bytewise and kind != _REAL32:
            if kind not in _INTEGERS:
                raise PeerDataError(f"parameter {name}: MAV_PARAM_TYPE {kind} does not fit into 4 bytes")
            layout = _INTEGERS[kind]
        value = float(struct.unpack_from(layout, data)[0])
        if kind != _REAL32 and not value.is_integer():
            raise PeerDataError(
                f"parameter {name}: {value:g} is not an integer, but its MAV_PARAM_TYPE is {kind}"
            )
        return value
