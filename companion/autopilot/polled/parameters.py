"""Reading the few parameters that the companion needs, by name.

PARAM_REQUEST_READ -> PARAM_VALUE. A name that the vehicle does not have is answered by silence, and names
change with the generations of a firmware: every name of a parameter is asked for until one of them is
answered, and given up after some tries; the value is then unknown. A PARAM_VALUE that was not asked for (a
ground station has set it) counts as well.

ArduPilot casts every value to float. PX4 puts the bytes of an integer into the float's place; `param_type`
says which it is.
"""

from __future__ import annotations

import math
import struct

import msgspec

from companion.autopilot.dialect import Dialect
from companion.errors import PeerDataError
from companion.events import Parameter, VehicleParameters

RETRY_S = 1.0
MAX_TRIES = 5

_REAL32 = 9
_INTEGERS = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}
"""MAV_PARAM_TYPE -> layout of the first bytes."""
_VALUE_BYTES = 4


class ParameterReader:
    """Asks one vehicle for its parameters; `restart` begins, `due` says what to ask for."""

    def __init__(self, dialect: Dialect) -> None:
        self.known = VehicleParameters(firmware=dialect.firmware)
        """What has been told so far."""
        self._dialect = dialect
        self._wanted = {name: (w, scale) for w in dialect.wanted for name, scale in w.names}
        self._answered: set[str] = set()
        """Fields told since the last restart, well or badly."""
        self._tries = MAX_TRIES
        self._next_s = math.inf

    def restart(self, now_s: float) -> None:
        """The vehicle is new or has begun anew: ask for everything; what was known counts until then."""
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
        """Nothing more is to be expected: all is told, or given up."""
        return self._next_s == math.inf or not self._unanswered()

    def _unanswered(self) -> list[str]:
        return [name for name, (wanted, _) in self._wanted.items() if wanted.field not in self._answered]

    def take(self, payload: bytes, name_field: bytes, kind: int) -> None:
        """One PARAM_VALUE; a parameter that nobody wants is left out.

        Args:
            payload: the whole of it; the value stands first.
            name_field: `param_id`.
            kind: `param_type`.

        Raises:
            PeerDataError: a type that does not fit into the value's place, a value that is not of its type,
                not finite or not plausible. It is not asked for again, and what was known before stays.
        """
        name = name_field.split(b"\0", 1)[0].decode("ascii", "replace")
        if name not in self._wanted:
            return
        wanted, scale = self._wanted[name]
        self._answered.add(wanted.field)
        value = self._value(payload, kind, name) * scale
        # NaN fails too.
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
                f"parameter {name}: {value:g} is no integer, as its MAV_PARAM_TYPE {kind} says"
            )
        return value
