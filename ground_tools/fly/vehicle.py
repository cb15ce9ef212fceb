"""One vehicle over MAVSDK: telemetry, commands with their answers, mission upload and download.

Commands are sent as COMMAND_LONG through MAVSDK's mavlink_direct plugin, which repeats them until they are
acknowledged. MAVSDK's action plugin is not used, for two reasons. On PX4 it takes the take-off height from
MIS_TAKEOFF_ALT and leaves that parameter changed. And an ACK of a mode change proves nothing, so the
heartbeat must be read anyway.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.dialect import (
    ARMED,
    CMD_DO_SET_MODE,
    CMD_SET_MESSAGE_INTERVAL,
    DIALECTS,
    FIRMWARES,
    refusal,
)
from companion.autopilot.dialects.definition import CUSTOM_MODE_ENABLED
from companion.autopilot.lists.mission import NAV_WAYPOINT
from companion.autopilot.wire import names_of
from companion.errors import ConfigError
from companion.events import Firmware, FlightMode, MissionItem
from companion.geometry import Vec3
from companion.shipped import how_to_install
from ground_tools.fly.missions import difference
from ground_tools.fly.modes import MODES

ARM_DISARM = int(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)
LANDED_ON_GROUND = int(mavlink.MAV_LANDED_STATE_ON_GROUND)
SILENT_S = 10.0
"""Age of the last heartbeat beyond which a vehicle counts as lost."""
_AUTOPILOT = int(mavlink.MAV_COMP_ID_AUTOPILOT1)
_ALONE_S = 2.5
"""Time within which all vehicles on a link are heard. A heartbeat comes once a second, one may be lost."""
_CONFIRM_S = 5.0
"""Time for a new mode to appear in the heartbeat, which may be sent only once a second."""
_NOT_OPENED = {
    "CONNECTION_URL_INVALID": "this is not an address; allowed: for example udpout://127.0.0.1:14550, "
    "udpin://0.0.0.0:14550, tcpout://127.0.0.1:5760 or serial:///dev/ttyACM0:57600",
    "BIND_ERROR": "cannot listen here: another program uses the port, or this computer has no such address",
    "CONNECTION_ERROR": "cannot be opened: check that it exists, is free, and that you may use it",
}
"""Messages for MAVSDK's ConnectionResult."""
_TEXT_S = 0.5
"""Time to wait for the text with the reason of a refusal, which arrives around the time of the ACK."""
_POLL_S = 0.05
_FRESH_S = 2.0
_OPEN = 0x7FFFFFFF
"""Value of x or y that leaves the coordinate open."""
# Requested interval (s) by message id. A firmware sends a message unrequested if it refuses the request (PX4:
# MISSION_CURRENT).
_RATES = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 0.2,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.2,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 0.2,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 0.2,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
}
_HEARD = (
    "HEARTBEAT", "GLOBAL_POSITION_INT", "EXTENDED_SYS_STATE", "MISSION_CURRENT", "MISSION_ITEM_REACHED",
    "HOME_POSITION", "SYS_STATUS",
)  # fmt: skip
_PREARM = int(mavlink.MAV_SYS_STATUS_PREARM_CHECK)
_COMMANDS = names_of("MAV_CMD", "MAV_CMD_")
_RESULTS = names_of("MAV_RESULT", "MAV_RESULT_")


class VehicleError(Exception):
    """A vehicle refused a command, did not do what it acknowledged, or was lost. The message names it."""


def load_mavsdk() -> ModuleType:
    """Import MAVSDK's native binding and suppress its log output. Raises ConfigError if it is missing."""
    try:
        import mavsdk
        import mavsdk.logging
        import mavsdk.plugins.mavlink_direct
        import mavsdk.plugins.mission_raw
        import mavsdk.plugins.telemetry
    except ImportError as error:
        raise ConfigError(how_to_install("mavsdk 4", "fly")) from error
    mavsdk.logging.log_subscribe(lambda *_: True)
    return mavsdk  # type: ignore[no-any-return]


class Vehicle:
    """One vehicle with its own connection, which `connect` opens and `close` ends."""

    def __init__(self, name: str, client: Any, system: Any, patience_s: float) -> None:
        from mavsdk.plugins.mavlink_direct import MavlinkDirect
        from mavsdk.plugins.mission_raw import MissionRaw
        from mavsdk.plugins.telemetry import Telemetry

        self.name = name
        self.system_id: int = system.get_system_id()
        self.ours: frozenset[str] = frozenset()
        """Modes that the vehicle may be in because of our commands; empty before the first command."""
        self.armed_by_us = False
        self._client = client
        self._direct = MavlinkDirect(system)
        self._missions = MissionRaw(system)
        self._telemetry = Telemetry(system)
        self._heard: dict[str, tuple[float, dict[str, Any]]] = {}
        self._texts: list[tuple[float, str]] = []
        # The callbacks run in MAVSDK's thread. Each does a single assignment or append, so no lock is needed.
        for message in _HEARD:
            self._direct.subscribe_message(message, self._hear)
        self._telemetry.subscribe_status_text(
            lambda said, _: self._texts.append((time.monotonic(), said.text))
        )
        began_s = time.monotonic()
        self.firmware = self._recognise(patience_s)
        self.modes = MODES[self.firmware]
        self._dialect = DIALECTS[self.firmware]
        self._ask_rates(patience_s)
        self._check_alone(began_s)

    @classmethod
    def connect(cls, name: str, address: str, patience_s: float) -> Vehicle:
        """Open a connection, find the vehicle on it, and request its telemetry.

        Args:
            name: Name of the vehicle, for messages.
            address: MAVSDK connection address.
            patience_s: Timeout of each step.

        Raises:
            ConfigError: The address is invalid, the vehicle is not supported, or several vehicles share it.
            VehicleError: There is no vehicle, or it sends no telemetry.
        """
        mavsdk = load_mavsdk()
        kind = mavsdk.ComponentType.GROUND_STATION
        client = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(kind))
        try:
            result = client.add_any_connection(address)
            if result != mavsdk.ConnectionResult.SUCCESS:
                raise ConfigError(f"{name}: {address}: {_NOT_OPENED.get(result.name, result.name)}")
            # Wait in slices of 1 s, because Ctrl-C has no effect during a call.
            end_s = time.monotonic() + patience_s
            system = client.first_autopilot(1.0)
            while system is None and time.monotonic() < end_s:
                system = client.first_autopilot(1.0)
            if system is None:
                raise VehicleError(
                    f"{name}: {address}: no autopilot was heard within {patience_s:g} s; check its power, "
                    "the address, and whether another program listens there"
                )
            return cls(name, client, system, patience_s)
        except BaseException:
            client.destroy()
            raise

    def close(self) -> None:
        """Close the connection; the vehicle flies on."""
        self._client.destroy()

    # ------------------------------------------------------------ telemetry

    def last(self, message: str, since_s: float = -math.inf) -> dict[str, Any]:
        """Fields of the last message of this name; empty if none was received since `since_s` (monotonic)."""
        at_s, fields = self._heard.get(message, (-math.inf, {}))
        return fields if at_s >= since_s else {}

    def age_s(self, message: str) -> float:
        """Time since the last message of this name."""
        return time.monotonic() - self._heard.get(message, (-math.inf, {}))[0]

    @property
    def armed(self) -> bool:
        """Whether the vehicle is armed, by its heartbeat."""
        return bool(self.last("HEARTBEAT").get("base_mode", 0) & ARMED)

    @property
    def mode(self) -> str:
        """The flight mode, with the autopilot's name for it."""
        return self._dialect.name(self.last("HEARTBEAT").get("custom_mode", -1))

    @property
    def on_ground(self) -> bool:
        """Whether a recent message of the autopilot's land detector reports the vehicle on the ground."""
        landed = self.last("EXTENDED_SYS_STATE", time.monotonic() - _FRESH_S).get("landed_state")
        return landed == LANDED_ON_GROUND

    @property
    def height_m(self) -> float:
        """Height above home."""
        return float(self.last("GLOBAL_POSITION_INT").get("relative_alt", math.nan)) * 1e-3

    @property
    def place(self) -> Vec3:
        """Position: latitude, longitude (deg), altitude above mean sea level (m)."""
        fields = self.last("GLOBAL_POSITION_INT")
        return fields["lat"] * 1e-7, fields["lon"] * 1e-7, fields["alt"] * 1e-3

    @property
    def home(self) -> Vec3:
        """Home position: latitude, longitude (deg), altitude above mean sea level (m)."""
        fields = self.last("HOME_POSITION")
        return fields["latitude"] * 1e-7, fields["longitude"] * 1e-7, fields["altitude"] * 1e-3

    @property
    def item(self) -> int:
        """Number of the current mission item, counted from 1."""
        return int(self.last("MISSION_CURRENT").get("seq", 0)) + 1 - self.first_seq

    def not_ready(self) -> str | None:
        """Reason why the vehicle cannot be armed yet, by its telemetry; None if there is none."""
        place = self.last("GLOBAL_POSITION_INT")
        if not place.get("lat") and not place.get("lon"):
            return "it has no position yet"
        if not self.last("HOME_POSITION"):
            return "it has no home position yet"
        status = self.last("SYS_STATUS")
        checked = status.get("onboard_control_sensors_present", 0) & _PREARM
        if checked and not status.get("onboard_control_sensors_health", 0) & _PREARM:
            return "its pre-arm checks have not passed yet"
        return None

    def said(self, since_s: float) -> str:
        """Status texts received since this time (`time.monotonic`), in one line without repetitions."""
        return "; ".join(dict.fromkeys(text for at_s, text in list(self._texts) if at_s >= since_s))

    # ------------------------------------------------------------ commands

    def command(self, number: int, *params: float | None) -> None:
        """Send a COMMAND_LONG and wait for its ACK. Omitted params are 0; None is sent as NaN.

        Raises:
            VehicleError: The command was refused (with the vehicle's reason) or not acknowledged.
        """
        sent_s = time.monotonic()
        result = self._acknowledged(number, params)
        if result != mavlink.MAV_RESULT_ACCEPTED:
            raise VehicleError(f"{self.name}: {self._refused(number, result, sent_s)}")

    def set_mode(self, mode: FlightMode) -> None:
        """Command a mode and wait until the heartbeat reports it. Raises VehicleError."""
        wanted = self._dialect.command(mode)
        sent_s = time.monotonic()
        self.command(CMD_DO_SET_MODE, CUSTOM_MODE_ENABLED, wanted.param2, wanted.param3)
        if not self._within(
            _CONFIRM_S, lambda: self.last("HEARTBEAT").get("custom_mode") == wanted.custom_mode
        ):
            name = self._dialect.name(wanted.custom_mode)
            raise VehicleError(
                f"{self.name}: it acknowledged {name} but stays in {self.mode}{_because(self.said(sent_s))}"
            )

    def arm(self) -> None:
        """Arm, and wait until the heartbeat reports it. Raises VehicleError."""
        sent_s = time.monotonic()
        # Without an answer the vehicle may still have armed; only a refusal proves that it has not.
        self.armed_by_us = True
        result = self._acknowledged(ARM_DISARM, (1.0,))
        if result != mavlink.MAV_RESULT_ACCEPTED:
            self.armed_by_us = False
            raise VehicleError(f"{self.name}: {self._refused(ARM_DISARM, result, sent_s)}")
        if not self._within(_CONFIRM_S, lambda: self.armed):
            raise VehicleError(
                f"{self.name}: it acknowledged arming but is disarmed{_because(self.said(sent_s))}"
            )

    def hear_again(self) -> None:
        """Wait for the next heartbeat. Raises VehicleError."""
        now_s = time.monotonic()
        if not self._within(_CONFIRM_S, lambda: bool(self.last("HEARTBEAT", now_s))):
            raise VehicleError(f"{self.name}: no heartbeat for {self.age_s('HEARTBEAT'):.0f} s")

    def upload(self, items: Sequence[MissionItem]) -> None:
        """Upload a mission, download it again and compare. Raises VehicleError."""
        from mavsdk.plugins.mission_raw import MissionRawError

        raw = [self._raw(item) for item in items]
        if self._dialect.home_is_item_zero:
            lat, lon, alt = self.home
            home = MissionItem(
                seq=0,
                command=NAV_WAYPOINT,
                frame=mavlink.MAV_FRAME_GLOBAL,
                lat_deg=lat,
                lon_deg=lon,
                alt_m=alt,
            )
            raw.insert(0, self._raw(home))
        for seq, item in enumerate(raw):
            item.seq, item.current = seq, int(seq == 0)
        sent_s = time.monotonic()
        try:
            self._missions.upload_mission(raw)
            back = self._missions.download_mission()
        except MissionRawError as error:
            raise VehicleError(
                f"{self.name}: {error.origin.removesuffix('()').replace('_', ' ')}: {error.result.name}"
                f"{_because(self._reason(sent_s))}; the mission aboard may be incomplete"
            ) from error
        wrong = difference(items, [_cooked(item) for item in back[self.first_seq :]])
        if wrong is not None:
            raise VehicleError(f"{self.name}: the mission aboard differs from the one that was sent: {wrong}")

    def go_on_with(self, number: int) -> None:
        """Send MISSION_SET_CURRENT with an item's number; `item` shows the effect. Raises VehicleError."""
        from mavsdk.plugins.mavlink_direct import MavlinkDirectError

        # MAVSDK's own call is not used: it never returns if the item (a change of speed) ends immediately.
        message = self._message("MISSION_SET_CURRENT", {"seq": number - 1 + self.first_seq})
        try:
            self._direct.send_message(message)
        except MavlinkDirectError as error:
            raise VehicleError(f"{self.name}: MISSION_SET_CURRENT: {error.result.name}") from error

    @property
    def first_seq(self) -> int:
        """Sequence number of item 1. ArduPilot stores home as sequence number 0."""
        return int(self._dialect.home_is_item_zero)

    # ------------------------------------------------------------ internals

    def _hear(self, message: Any, _: object) -> None:
        if (message.system_id, message.component_id) == (self.system_id, _AUTOPILOT):
            self._heard[message.message_name] = (time.monotonic(), json.loads(message.fields_json))

    def _recognise(self, patience_s: float) -> Firmware:
        """Firmware of the vehicle, from its heartbeat. Raises VehicleError, ConfigError."""
        if not self._within(patience_s, lambda: bool(self.last("HEARTBEAT"))):
            raise VehicleError(
                f"{self.name}: no heartbeat from component {_AUTOPILOT} within {patience_s:g} s"
            )
        heartbeat = self.last("HEARTBEAT")
        firmware = FIRMWARES.get(heartbeat["autopilot"])
        if firmware is None:
            raise ConfigError(
                f"{self.name}: MAV_AUTOPILOT {heartbeat['autopilot']} is not supported; "
                "allowed: ArduPilot and PX4"
            )
        why = refusal(firmware, heartbeat["type"])
        if why is not None:
            raise ConfigError(f"{self.name}: {why}")
        return firmware

    def _check_alone(self, since_s: float) -> None:
        """Raise ConfigError if other vehicles use the address too.

        Args:
            since_s: Time (monotonic) of the connection.
        """
        self._within(since_s + _ALONE_S - time.monotonic(), lambda: False)
        ids = sorted(
            system.get_system_id() for system in self._client.get_systems() if system.has_autopilot()
        )
        if len(ids) > 1:
            raise ConfigError(
                f"{self.name}: several vehicles use the address (systems {', '.join(map(str, ids))}); "
                "allowed: one vehicle on each address"
            )

    def _ask_rates(self, patience_s: float) -> None:
        """Request telemetry; without it ArduPilot sends only heartbeats. Raises VehicleError."""
        for message_id, interval_s in _RATES.items():
            self._acknowledged(CMD_SET_MESSAGE_INTERVAL, (message_id, interval_s * 1e6))
        needed = ("GLOBAL_POSITION_INT", "EXTENDED_SYS_STATE")
        if not self._within(patience_s, lambda: all(self.last(name) for name in needed)):
            missing = ", ".join(name for name in needed if not self.last(name))
            raise VehicleError(f"{self.name}: no {missing} arrived within {patience_s:g} s of the request")

    def _acknowledged(self, number: int, params: Sequence[float | None]) -> int:
        """Send a command. Returns its MAV_RESULT. Raises VehicleError if there is no ACK."""
        from mavsdk.plugins.mavlink_direct import MavlinkDirectError

        fields: dict[str, float | None] = {"command": number, "confirmation": 0}
        fields |= {f"param{n}": 0.0 for n in range(1, 8)}
        fields |= {f"param{n}": value for n, value in enumerate(params, start=1)}
        try:
            answer = self._direct.send_command(self._message("COMMAND_LONG", fields))
        except MavlinkDirectError as error:
            raise VehicleError(f"{self.name}: {_COMMANDS[number]}: {error.result.name}") from error
        return int(json.loads(answer.fields_json)["result"])

    def _message(self, name: str, fields: dict[str, float | None]) -> Any:
        """A message to the autopilot; None becomes JSON null, which stands for NaN."""
        from mavsdk.plugins.mavlink_direct import MavlinkMessage

        target = {"target_system": self.system_id, "target_component": _AUTOPILOT}
        return MavlinkMessage(
            message_name=name,
            target_system_id=self.system_id,
            target_component_id=_AUTOPILOT,
            fields_json=json.dumps(fields | target),
        )

    def _refused(self, number: int, result: int, sent_s: float) -> str:
        name = _RESULTS.get(result, f"MAV_RESULT {result}")
        return f"{_COMMANDS[number]} was refused ({name}){_because(self._reason(sent_s))}"

    def _reason(self, sent_s: float) -> str:
        """Status texts since the time of a refused command, which contain the reason."""
        self._within(_TEXT_S, lambda: bool(self.said(sent_s)))
        return self.said(sent_s)

    def _within(self, seconds: float, done: Callable[[], bool]) -> bool:
        """Wait until `done` is true. Returns False on timeout."""
        end_s = time.monotonic() + seconds
        while not done():
            if time.monotonic() > end_s:
                return False
            time.sleep(_POLL_S)
        return True

    def _raw(self, item: MissionItem) -> Any:
        from mavsdk.plugins.mission_raw import MissionItem as RawItem

        p1, p2, p3, p4 = (math.nan if value is None else value for value in item.params)
        scale = 1.0 if item.frame == mavlink.MAV_FRAME_MISSION else 1e7
        x, y = (_OPEN if value is None else round(value * scale) for value in (item.lat_deg, item.lon_deg))
        z = math.nan if item.alt_m is None else item.alt_m
        return RawItem(0, item.frame, item.command, 0, 1, p1, p2, p3, p4, x, y, z, 0)


def _cooked(raw: Any) -> MissionItem:
    """Convert a downloaded item; the result has coordinates in degrees."""
    params = (raw.param1, raw.param2, raw.param3, raw.param4)
    p1, p2, p3, p4 = (None if math.isnan(value) else value for value in params)
    return MissionItem(
        seq=raw.seq,
        command=raw.command,
        frame=raw.frame,
        params=(p1, p2, p3, p4),
        lat_deg=None if raw.x == _OPEN else raw.x * 1e-7,
        lon_deg=None if raw.y == _OPEN else raw.y * 1e-7,
        alt_m=None if math.isnan(raw.z) else raw.z,
    )


def _because(text: str) -> str:
    return f": {text}" if text else ""
