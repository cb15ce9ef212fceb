"""MAVLink exchange with an ArduRemoteID module over a byte link: reads its reports and its parameters.

The facts are those of firmware version 1.14. Parameters are requested by name, because in a list their count
is one too small. All values are 32-bit floats; texts (UAS_ID) cannot be read. This module uses neither socket
nor clock.
"""

from __future__ import annotations

import math
import struct
from typing import Any, Final

from companion.autopilot.wire import MAGIC_V2, Frame, FrameScanner, MavlinkWriter
from companion.radio.radio import ByteLink
from companion.remote_id.mavlink import ARM_STATUS, COMPONENT_ID, MAV_TYPE, decode_arm_status

OWN_COMPONENT: Final = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER."""
SILENT_AFTER_S: Final = 3.0
PARAMETERS: Final = (
    "LOCK_LEVEL",
    "OPTIONS",
    "UAS_TYPE",
    "UAS_ID_TYPE",
    "WIFI_CHANNEL",
    "WIFI_BCN_RATE",
    "WIFI_NAN_RATE",
    "BT4_RATE",
    "BT5_RATE",
)
"""Parameters that are read. All others are ignored."""
SETTABLE: Final = frozenset(name for name in PARAMETERS if name.endswith("_RATE"))

_HEARTBEAT_PERIOD_S: Final = 1.0
_ASK_PERIOD_S: Final = 0.25
_ASK_TIMES: Final = 12
_HEARTBEAT_ID: Final = 0
_PARAM_REQUEST_READ_ID: Final = 20
_PARAM_VALUE_ID: Final = 22
_PARAM_SET_ID: Final = 23
_STATUSTEXT_ID: Final = 253
_HEARTBEAT: Final = struct.Struct("<IBBBBB")
_PARAM_REQUEST_READ: Final = struct.Struct("<hBB16s")
_PARAM_VALUE: Final = struct.Struct("<fHH16sB")
_PARAM_SET: Final = struct.Struct("<fBB16sB")
_OWN_TYPE: Final = 18
"""MAV_TYPE_ONBOARD_CONTROLLER."""
_AUTOPILOT_INVALID: Final = 8
_ACTIVE: Final = 4
_REAL32: Final = 9
_BANNER: Final = b"ArduRemoteID version"
_TEXT_BYTES: Final = 50
_RAW_KEPT: Final = 512
_LOST_FRAMES: Final = 8
"""Frames that may be lost at once. A greater step of the sequence number counts as a restart."""
_FRAMES_PER_S: Final = 4
_REORDERED: Final = 248
ARM_STATUS_WORDS: Final = {
    "LOC": "Location",
    "SYS": "System",
    "ID": "Basic ID",
    "ID_1": "Basic ID",
    "ID_2": "second Basic ID",
    "SELF_ID": "Self ID",
    "OP_ID": "Operator ID",
    "OP_LOC": "operator position",
}
"""Meaning of the words in the firmware's ARM_STATUS."""


class Module:
    """The module at the far end of the link.

    Args:
        link: Link that only this object uses.
        system_id: System ID of the vehicle. The module adopts that of the first heartbeat it receives.
    """

    def __init__(self, link: ByteLink, system_id: int) -> None:
        self.params: dict[str, float] = {}
        """Last received values of `PARAMETERS`."""
        self.heard_s: float | None = None
        """Time of the last heartbeat."""
        self.arm: tuple[float, bool, str] | None = None
        """Last ARM_STATUS: time, good to arm, reason if not."""
        self.said = ""
        """Text of the last STATUSTEXT."""
        self.restarts = 0
        self.others: set[int] = set()
        """IDs of other components that send on the link."""
        self.raw = b""
        """Last bytes received."""
        self._link = link
        self._system_id = system_id
        self._scanner = FrameScanner()
        self._writer = MavlinkWriter(system_id, OWN_COMPONENT)
        self._beat_s: float | None = None
        self._asked: dict[str, int] = {}
        self._ask_s = -math.inf
        self._last: tuple[float, int] | None = None

    @property
    def corrupt(self) -> int:
        """Number of damaged frames."""
        return self._scanner.counts.corrupt

    @property
    def asking(self) -> bool:
        """Whether answers are still expected. Each parameter is requested at most `_ASK_TIMES` times."""
        return bool(self._asked)

    def alive(self, now_s: float) -> bool:
        """Whether a heartbeat was received recently."""
        return self.heard_s is not None and now_s - self.heard_s <= SILENT_AFTER_S

    def exchange(self, now_s: float) -> None:
        """Read what arrived and send what is due. Never blocks."""
        data = self._link.receive(now_s)
        if data:
            seen = len(self.raw)
            text = self.raw + data
            # The banner may arrive in two pieces. The search start prevents finding the same banner twice.
            if text.find(_BANNER, max(seen - len(_BANNER) + 1, 0)) >= 0:
                self._restarted()
            self.raw = text[-_RAW_KEPT:]
            for frame in self._scanner.frames(data):
                self._take(frame, now_s)
        out = b""
        if self._beat_s is None or now_s - self._beat_s >= _HEARTBEAT_PERIOD_S:
            self._beat_s = now_s
            beat = _HEARTBEAT.pack(0, _OWN_TYPE, _AUTOPILOT_INVALID, 0, _ACTIVE, 3)
            out += self._writer.pack_payload(_HEARTBEAT_ID, beat)
        if self._asked and now_s - self._ask_s >= _ASK_PERIOD_S:
            self._ask_s = now_s
            out += self._questions()
        if out:
            self._link.send(out)

    def ask(self, *names: str) -> None:
        """Request these parameters, starting with the next exchange."""
        self._asked.update(dict.fromkeys(names, _ASK_TIMES))
        self._ask_s = -math.inf

    def set(self, name: str, value: float) -> None:
        """Set a rate above zero, once, because every set wears the module's flash. `params` shows the answer.

        Raises:
            ValueError: another parameter (some of them ruin the module), or a rate of zero (it leaves the
                last payload on the air for ever).
        """
        if name not in SETTABLE or not 0.0 < value < math.inf:
            raise ValueError(f"parameter {name} = {value}: allowed: only rates, above 0")
        payload = _PARAM_SET.pack(value, self._system_id, COMPONENT_ID, name.encode(), _REAL32)
        self._link.send(self._writer.pack_payload(_PARAM_SET_ID, payload))

    def send(self, payloads: list[tuple[int, bytes]]) -> None:
        """Send several payloads at once."""
        self._link.send(b"".join(self._writer.pack_payload(*payload) for payload in payloads))

    def close(self) -> None:
        """Release the link."""
        self._link.close()

    def _questions(self) -> bytes:
        out = b""
        for name, left in list(self._asked.items()):
            if left == 0:
                del self._asked[name]
                continue
            self._asked[name] = left - 1
            payload = _PARAM_REQUEST_READ.pack(-1, self._system_id, COMPONENT_ID, name.encode())
            out += self._writer.pack_payload(_PARAM_REQUEST_READ_ID, payload)
        return out

    def _take(self, frame: Frame, now_s: float) -> None:
        if frame.component_id != COMPONENT_ID:
            if frame.component_id != OWN_COMPONENT:
                self.others.add(frame.component_id)
            return
        self._follow(frame, now_s)
        if frame.message_id == _HEARTBEAT_ID:
            if _fields(_HEARTBEAT, frame.payload)[1] == MAV_TYPE:
                if self.heard_s is not None and not self.alive(now_s):
                    self.ask(*PARAMETERS)
                self.heard_s = now_s
        elif frame.message_id == ARM_STATUS:
            ready, text = decode_arm_status(frame.payload)
            self.arm = (now_s, ready, _printable(text))
        elif frame.message_id == _PARAM_VALUE_ID:
            self._take_value(frame.payload)
        elif frame.message_id == _STATUSTEXT_ID:
            text = frame.payload[1 : 1 + _TEXT_BYTES].split(b"\0")[0].decode("latin-1")
            self.said = _printable(text)

    def _take_value(self, payload: bytes) -> None:
        value, _, _, raw, _ = _fields(_PARAM_VALUE, payload)
        name = raw.split(b"\0")[0].decode("latin-1")
        if name in PARAMETERS and math.isfinite(value):
            self.params[name] = value
            self._asked.pop(name, None)

    def _follow(self, frame: Frame, now_s: float) -> None:
        """Detect a restart from the sequence numbers, in case the banner was lost."""
        number = frame.raw[4] if frame.raw[0] == MAGIC_V2 else frame.raw[2]
        if self._last is not None:
            at_s, last = self._last
            gap = (number - last - 1) & 0xFF
            if _LOST_FRAMES + _FRAMES_PER_S * (now_s - at_s) < gap < _REORDERED:
                self._restarted()
        self._last = (now_s, number)

    def _restarted(self) -> None:
        self._last = None
        if self.heard_s is not None:
            self.restarts += 1
            self.arm = None
            self.ask(*PARAMETERS)


def _fields(layout: struct.Struct, payload: bytes) -> tuple[Any, ...]:
    """Unpack a payload. MAVLink cuts zeros from the end, and newer dialects append fields."""
    return layout.unpack(payload.ljust(layout.size, b"\0")[: layout.size])


def _printable(text: str) -> str:
    """Make a text of the module safe for a log."""
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in text).strip()
