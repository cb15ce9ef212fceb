"""A Remote ID module that behaves like the ArduRemoteID firmware: MAVLink bytes in, bytes out.

The behaviour was read in the source of firmware version 1.14 and includes its traps. The last data received
are broadcast for ever. PARAM_SET accepts any number and writes it to flash. The parameter count is one too
small. Text appears between the MAVLink frames. This module uses no socket or clock;
`sitl_mocks.remote_id_module.server` has them.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkMessage, MavlinkReader, MavlinkWriter
from companion.remote_id.codec import encode
from companion.remote_id.messages import Message
from sitl_mocks.remote_id_module.air import Air, OnAir
from sitl_mocks.remote_id_module.data import READERS

COMPONENT: int = mavlink.MAV_COMP_ID_ODID_TXRX_1
FORCE_ARM_OK = 1
DONT_SAVE_BASIC_ID = 2
PRINT_MESSAGES = 4
LOCATION_AGE_S = 3.0
"""Largest age of Location and System with which arming is allowed."""
OTHER_AGE_S = 22.0
"""Largest age of Self ID and Operator ID with which arming is allowed."""
BANNER = b"ArduRemoteID version 1.14 84d8bbf6\n"
_REAL32 = mavlink.MAV_PARAM_TYPE_REAL32
_STEP_S = 0.01
_HEARTBEAT_S = 1.0
_LIST_S = 0.05
_WAITING_S = 2.0
_NOISE_S = 0.3
_MAX_WAITING_BYTES = 1 << 16
_REPORT_BYTES = 50

_FLOAT, _UINT8, _INT8, _UINT32 = "float", "uint8", "int8", "uint32"
PARAMETERS: dict[str, tuple[str, float]] = {
    "LOCK_LEVEL": (_INT8, 0),
    "CAN_NODE": (_UINT8, 0),
    "UAS_TYPE": (_UINT8, 0),
    "UAS_ID_TYPE": (_UINT8, 0),
    "UAS_TYPE_2": (_UINT8, 0),
    "UAS_ID_TYPE_2": (_UINT8, 0),
    "BAUDRATE": (_UINT32, 57600),
    "WIFI_NAN_RATE": (_FLOAT, 0),
    "WIFI_BCN_RATE": (_FLOAT, 0),
    "WIFI_POWER": (_FLOAT, 20),
    "BT4_RATE": (_FLOAT, 1),
    "BT4_POWER": (_FLOAT, 18),
    "BT5_RATE": (_FLOAT, 1),
    "BT5_POWER": (_FLOAT, 18),
    "WEBSERVER_EN": (_UINT8, 1),
    "WIFI_CHANNEL": (_UINT8, 6),
    "BCAST_POWERUP": (_UINT8, 1),
    "MAVLINK_SYSID": (_UINT8, 0),
    "OPTIONS": (_UINT8, 0),
    "TO_DEFAULTS": (_UINT8, 0),
    "DONE_INIT": (_UINT8, 1),
}
"""Numeric parameters in the firmware's order, with type and default. Text parameters (UAS_ID, ...) cannot be
accessed by MAVLink."""
_HIDDEN = "DONE_INIT"


@dataclass(frozen=True, slots=True)
class ModuleOptions:
    """Configuration of a module, and faults of the module or its wiring."""

    params: Mapping[str, float] = field(default_factory=dict)
    """Parameter values stored in the module's flash."""
    uas_id: str = "ABCD123456789"
    boot_s: float = 1.0
    """Silence after each start."""
    noise: bool = False
    """Send log lines between the frames, and the boot loader's garbage at each start."""
    lose_every: int = 0
    """Every n-th frame that the module sends is lost. 0: no frame is lost."""
    deaf: bool = False
    """The module receives nothing: the wire to its receive pin is disconnected."""
    without: frozenset[str] = frozenset()
    """Parameters that are missing, as in an older firmware."""
    address: str = "c2:0a:0b:0c:0d:0e"


class RemoteIdModule:
    """One Remote ID module. The caller's `now_s` must never run backwards."""

    def __init__(self, options: ModuleOptions, now_s: float = 0.0) -> None:
        self.options = options
        self.flash = {name: float(default) for name, (_, default) in PARAMETERS.items()}
        self.flash.update(options.params)
        self.uas_id = options.uas_id
        self.param_sets: list[tuple[str, float]] = []
        """Every PARAM_SET received, accepted or not."""
        self.flash_writes: list[tuple[str, float | str]] = []
        self.catastrophes: list[str] = []
        """Commands received whose effect cannot be undone: fuses burnt, flash erased."""
        self.received: Counter[str] = Counter()
        """Number of MAVLink messages received by type."""
        self.starts = 0
        self._out = bytearray()
        self._sent = 0
        self._now_s = now_s
        self.reboot(now_s)

    # ------------------------------------------------------------ interface

    def reboot(self, now_s: float) -> None:
        """Switch the power off and on. Only the flash is kept."""
        self.starts += 1
        self._out.clear()
        self._reader = MavlinkReader()
        self._writer = MavlinkWriter(0, COMPONENT)
        self._params = dict(self.flash)
        self._air = Air(self.options.address)
        self._data: dict[str, MavlinkMessage] = {}
        self._data_s: dict[str, float] = {}
        self._messages: list[Message] = []
        self._parse_fail: str | None = "uninitialised"
        self._system_id = 0
        self._up_s = now_s + self.options.boot_s
        self._running = False
        self._heartbeat_s = self._waiting_s = self._noise_s = -math.inf
        self._listing: deque[str] = deque()
        self._listed_s = 0.0
        if self.options.noise:
            self._put_text(bytes(range(0xE0, 0x100)) + b"ESP-ROM:esp32s3-20210327\r\n\xfd\x00\xfe")

    def receive(self, data: bytes, now_s: float) -> None:
        """Process bytes that arrive on the receive pin."""
        self.advance(now_s)
        if not self._running or self.options.deaf:
            return
        for message in self._reader.feed(data):
            kind = message.get_type()
            self.received[kind] += 1
            handler = self._HANDLERS.get(kind)
            if handler is not None and self._running:
                handler(self, message, now_s)
        if self._running:
            self._set_data()

    def advance(self, now_s: float) -> None:
        """Run the module's loop up to `now_s`."""
        while self._now_s + _STEP_S <= now_s + 1e-9:
            self._now_s += _STEP_S
            self._step(self._now_s)

    def drain(self) -> bytes:
        """Return and remove the bytes that the module has sent."""
        data = bytes(self._out)
        self._out.clear()
        return data

    def on_air(self, now_s: float) -> list[OnAir]:
        """Return the transmissions that a receiver can hear now."""
        self.advance(now_s)
        return self._air.on_air(self._params, now_s) if self._running else []

    @property
    def wifi_channel(self) -> int | None:
        """Wi-Fi channel; None before Wi-Fi is first used."""
        return self._air.wifi_channel

    # ------------------------------------------------------------ main loop

    def _step(self, now_s: float) -> None:
        if not self._running:
            if now_s < self._up_s:
                return
            self._running = True
            self._put_text(BANNER)
            self._adopt(int(self._params["MAVLINK_SYSID"]))
            self._set_data()
        if self._system_id == 0:
            self._adopt(int(self._params["MAVLINK_SYSID"]))
            if now_s - self._waiting_s >= _WAITING_S:
                self._waiting_s = now_s
                self._put_text(b"Waiting for heartbeat\n")
        elif now_s - self._heartbeat_s >= _HEARTBEAT_S:
            self._heartbeat_s = now_s
            self._send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_ODID, 8, 0, 0, 0, 3))
            self._send(self._arm_status(now_s))
        if self.options.noise and now_s - self._noise_s >= _NOISE_S:
            self._noise_s = now_s
            self._put_text(f"[{now_s * 1000:8.0f}][W][WiFiGeneric.cpp:1062] event 12\r\n".encode())
        if self._listing and now_s - self._listed_s >= _LIST_S:
            self._listed_s = now_s
            self._send_param(self._listing.popleft())
        if self._transmits:
            self._air.advance(self._messages, self._params, now_s)

    @property
    def _transmits(self) -> bool:
        return self._params["BCAST_POWERUP"] > 0 or "OPEN_DRONE_ID_LOCATION" in self._data_s

    def _adopt(self, system_id: int) -> None:
        self._system_id = system_id
        self._writer.encoder.srcSystem = system_id

    def _arm_status(self, now_s: float) -> MavlinkMessage:
        reason = self.refusal(now_s)
        status = 1 if reason else 0
        return mavlink.MAVLink_open_drone_id_arm_status_message(status, reason.encode()[:_REPORT_BYTES])

    def refusal(self, now_s: float) -> str:
        """Return why the vehicle must not arm, in the firmware's words; empty if it may arm."""
        fail = self._parse_fail or ""
        if fail == "uninitialised" or int(self._params["OPTIONS"]) & FORCE_ARM_OK:
            return fail
        late = "".join(
            f"{word} "
            for word, bad in (
                ("LOC", self._older("LOCATION", LOCATION_AGE_S, now_s)),
                ("ID", not self._has_basic_id),
                ("SELF_ID", self._older("SELF_ID", OTHER_AGE_S, now_s)),
                ("OP_ID", self._older("OPERATOR_ID", OTHER_AGE_S, now_s)),
                ("SYS", self._older("SYSTEM", LOCATION_AGE_S, now_s)),
                ("LOC", self._nowhere("LOCATION", "")),
                ("OP_LOC", self._nowhere("SYSTEM", "operator_")),
            )
            if bad
        )
        return fail + late

    def _older(self, name: str, limit_s: float, now_s: float) -> bool:
        at_s = self._data_s.get(f"OPEN_DRONE_ID_{name}")
        return at_s is None or now_s - at_s > limit_s

    def _nowhere(self, name: str, prefix: str) -> bool:
        message = self._data.get(f"OPEN_DRONE_ID_{name}")
        return message is None or not (
            getattr(message, f"{prefix}latitude") or getattr(message, f"{prefix}longitude")
        )

    @property
    def _has_basic_id(self) -> bool:
        return bool(self.uas_id) and self._params["UAS_TYPE"] > 0 and self._params["UAS_ID_TYPE"] > 0

    # ------------------------------------------------------------ data to messages

    def _set_data(self) -> None:
        """Update the messages to broadcast, and note what the encoder refuses."""
        if not self._transmits:
            return
        id_type, ua_type, text = self._given_basic_id()
        save = not int(self._params["OPTIONS"]) & DONT_SAVE_BASIC_ID
        complete = bool(id_type and ua_type and text)
        if complete and save and not self._has_basic_id:
            # The firmware writes the identity to flash permanently, even if parameters are locked.
            self._write("UAS_TYPE", ua_type)
            self._write("UAS_ID_TYPE", id_type)
            self.uas_id = text
            self.flash_writes.append(("UAS_ID", text))
        identities = []
        if save and self._has_basic_id:
            stored = (int(self._params["UAS_ID_TYPE"]), int(self._params["UAS_TYPE"]), self.uas_id)
            identities.append(READERS["BASIC_ID"](*stored))
        if complete and (not save or (self._has_basic_id and text != self.uas_id)):
            identities.append(READERS["BASIC_ID"](id_type, ua_type, text))
        self._encode(identities)

    def _given_basic_id(self) -> tuple[int, int, str]:
        given = self._data.get("OPEN_DRONE_ID_BASIC_ID")
        if given is None:
            return 0, 0, ""
        return given.id_type, given.ua_type, bytes(given.uas_id).split(b"\0")[0].decode("latin-1")

    def _encode(self, identities: list[Callable[[], Message]]) -> None:
        makers: list[tuple[str, Callable[[], Message]]] = []
        for word, name in (("LOC", "LOCATION"), ("SYS", "SYSTEM")):
            message = self._data.get(f"OPEN_DRONE_ID_{name}")
            if message is not None and message.timestamp != 0:
                makers.append((word, READERS[name](message)))
        makers += [(f"ID_{number}", identity) for number, identity in enumerate(identities, start=1)]
        for word, name, text in (
            ("SELF_ID", "SELF_ID", "description"),
            ("OP_ID", "OPERATOR_ID", "operator_id"),
        ):
            message = self._data.get(f"OPEN_DRONE_ID_{name}")
            if message is not None and getattr(message, text):
                makers.append((word, READERS[name](message)))
        sound, refused = [], ""
        for word, make in makers:
            try:
                message = make()
                encode(message)
                sound.append(message)
            except ValueError:
                refused += f"{word} "
        self._messages = sound
        self._parse_fail = f"bad {refused} data" if refused else None

    # ------------------------------------------------------------ messages in

    def _take_heartbeat(self, message: MavlinkMessage, now_s: float) -> None:
        if self._system_id == 0 and message.get_srcSystem() > 0 and message.type != mavlink.MAV_TYPE_GCS:
            self._adopt(message.get_srcSystem())

    def _take_data(self, message: MavlinkMessage, now_s: float) -> None:
        kind = message.get_type()
        if int(self._params["OPTIONS"]) & PRINT_MESSAGES:
            self._put_text(f"MAVLink: got {kind}\n".encode())
        before = self._data.get(kind)
        if kind == "OPEN_DRONE_ID_BASIC_ID" and not (message.uas_id[0] and 0 < message.id_type <= 4):
            return
        self._data[kind] = message
        if kind == "OPEN_DRONE_ID_SYSTEM":
            # A System with a repeated timestamp does not count as fresh; one without a timestamp does.
            repeated = before is not None and before.timestamp == message.timestamp != 0
            if repeated:
                return
        self._data_s[kind] = now_s

    def _take_system_update(self, message: MavlinkMessage, now_s: float) -> None:
        system = self._data.get("OPEN_DRONE_ID_SYSTEM")
        if system is None:
            return
        for name in ("operator_latitude", "operator_longitude", "operator_altitude_geo", "timestamp"):
            setattr(system, name, getattr(message, name))
        self._data_s["OPEN_DRONE_ID_SYSTEM"] = now_s

    def _take_list(self, message: MavlinkMessage, now_s: float) -> None:
        # The hidden parameter is sent too, with an index of -1.
        self._listing = deque(name for name in self._params if name not in self.options.without)
        self._listed_s = now_s

    def _take_read(self, message: MavlinkMessage, now_s: float) -> None:
        names = [name for name in self._params if name != _HIDDEN]
        if message.param_index >= 0:
            name = names[message.param_index] if message.param_index < len(names) else None
        else:
            name = message.param_id
        if name in names and name not in self.options.without:
            self._send_param(name)

    def _take_set(self, message: MavlinkMessage, now_s: float) -> None:
        name, value = message.param_id, message.param_value
        self.param_sets.append((name, value))
        if name in ("LOCK_LEVEL", "TO_DEFAULTS"):
            self.catastrophes.append(f"PARAM_SET {name} = {value:g}")
        if message.param_type != _REAL32 or name not in self._params or name in self.options.without:
            return
        locked = self._params["LOCK_LEVEL"] > 0
        if locked and not (name == "LOCK_LEVEL" and _cast(_UINT8, value) > self._params[name]):
            self._send(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_ERROR, b"Parameters locked"))
        else:
            self._write(name, value)
            if name == "TO_DEFAULTS" and self._params[name] == 1:
                self.flash = {n: float(default) for n, (_, default) in PARAMETERS.items()}
                self.reboot(now_s)
                return
        self._send_param(name)

    _HANDLERS: Mapping[str, Callable[[RemoteIdModule, Any, float], None]] = {
        "HEARTBEAT": _take_heartbeat,
        "PARAM_REQUEST_LIST": _take_list,
        "PARAM_REQUEST_READ": _take_read,
        "PARAM_SET": _take_set,
        "OPEN_DRONE_ID_BASIC_ID": _take_data,
        "OPEN_DRONE_ID_LOCATION": _take_data,
        "OPEN_DRONE_ID_AUTHENTICATION": _take_data,
        "OPEN_DRONE_ID_SELF_ID": _take_data,
        "OPEN_DRONE_ID_SYSTEM": _take_data,
        "OPEN_DRONE_ID_SYSTEM_UPDATE": _take_system_update,
        "OPEN_DRONE_ID_OPERATOR_ID": _take_data,
    }
    """Handlers by message type. Authentication is stored but never broadcast. MESSAGE_PACK is ignored."""

    # ------------------------------------------------------------ out

    def _write(self, name: str, value: float) -> None:
        self._params[name] = self.flash[name] = _cast(PARAMETERS[name][0], value)
        self.flash_writes.append((name, self.flash[name]))

    def _send_param(self, name: str) -> None:
        names = [n for n in self._params if n != _HIDDEN]
        index = names.index(name) if name in names else 65535
        self._send(
            mavlink.MAVLink_param_value_message(
                name.encode(), self._params[name], _REAL32, len(names) - 1, index
            )
        )

    def _send(self, message: MavlinkMessage) -> None:
        frame = self._writer.pack(message)
        self._sent += 1
        if not self.options.lose_every or self._sent % self.options.lose_every:
            self._put_text(frame)

    def _put_text(self, data: bytes) -> None:
        if len(self._out) + len(data) <= _MAX_WAITING_BYTES:
            self._out += data


def _cast(kind: str, value: float) -> float:
    """Cast a float like the firmware's C code, as far as C defines the result."""
    if kind == _FLOAT:
        return value
    whole = int(value) if math.isfinite(value) else 0
    if kind == _UINT32:
        return float(whole & 0xFFFF_FFFF)
    byte = whole & 0xFF
    return float(byte - 256 if kind == _INT8 and byte > 127 else byte)
