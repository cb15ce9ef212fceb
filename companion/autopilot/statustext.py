"""Makes STATUSTEXT readable: joins its chunks and replaces control characters."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.readers import Fields
from companion.errors import PeerDataError
from companion.events import VehicleText

MAX_CHUNKS = 10
"""Largest number of parts of one text. A vehicle that never ends its text is cut off here."""
CHUNK_WAIT_S = 2.0
_GAP = "[...]"
_MAX_SEVERITY: int = mavlink.MAV_SEVERITY_DEBUG


def _readable(data: bytes) -> str:
    text = data.decode("utf-8", "replace")
    return "".join(c if c.isprintable() else " " for c in text).strip()


class TextAssembler:
    """Joins the chunks of one text. A missing chunk appears as [...]."""

    def __init__(self) -> None:
        self._id = 0
        self._severity = 0
        self._parts: list[bytes] = []
        self._next_chunk = 0
        self._last_s = 0.0

    def feed(self, fields: Fields, now_s: float) -> list[VehicleText]:
        """Texts completed by one STATUSTEXT (fields in wire order).

        Raises:
            PeerDataError: the severity is not defined.
        """
        severity, data, text_id, chunk = fields
        if severity > _MAX_SEVERITY:
            raise PeerDataError(f"MAV_SEVERITY {severity} is not defined")
        text, zero, _ = data.partition(b"\0")
        if text_id == 0:
            return [VehicleText(severity=severity, text=_readable(text))]
        done = self.flush() if self._parts and text_id != self._id else []
        if not self._parts:
            self._id, self._severity, self._next_chunk = text_id, severity, 0
        elif chunk < self._next_chunk:
            return done
        if chunk > self._next_chunk:
            self._parts.append(_GAP.encode())
        self._parts.append(text)
        self._next_chunk = chunk + 1
        self._last_s = now_s
        if zero or len(self._parts) >= MAX_CHUNKS:
            done += self.flush(complete=True)
        return done

    def overdue(self, now_s: float) -> list[VehicleText]:
        """The unfinished text, if its next chunk has not come within `CHUNK_WAIT_S`."""
        return self.flush() if self._parts and now_s - self._last_s > CHUNK_WAIT_S else []

    def flush(self, *, complete: bool = False) -> list[VehicleText]:
        """Return the collected text and begin a new one."""
        data = b"".join(self._parts) + (b"" if complete else _GAP.encode())
        self._parts = []
        return [VehicleText(severity=self._severity, text=_readable(data))]
