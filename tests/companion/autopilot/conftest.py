"""A scripted vehicle: what it says is written in the test, what it is told is decoded by pymavlink."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.link import AutopilotLink
from companion.autopilot.wire import CURRENT_MODE, MavlinkReader, MavlinkWriter
from companion.config import VehicleConfig
from companion.events import Event
from tests.support.place import LAT_E7, LON_E7

ARDUPILOT, PX4 = 3, 12
QUAD = 2


class Scripted:
    """One link and one scripted vehicle at its other end."""

    def __init__(self, *, autopilot: int = ARDUPILOT, config: VehicleConfig | None = None) -> None:
        self.link = AutopilotLink(config or VehicleConfig())
        self.autopilot = autopilot
        self.now_s = 100.0
        self._writers: dict[tuple[int, int], MavlinkWriter] = {}
        self._reader = MavlinkReader()

    def bytes(self, message: Any, system: int = 1, component: int = 1) -> bytes:
        writer = self._writers.setdefault((system, component), MavlinkWriter(system, component))
        return writer.pack(message)

    def says(self, *messages: Any, system: int = 1, component: int = 1) -> list[Event]:
        data = b"".join(self.bytes(m, system, component) for m in messages)
        return self.link.receive(data, self.now_s)

    def heartbeat(
        self, mode: int = 0, vehicle_type: int = QUAD, system: int = 1, base_mode: int = 1
    ) -> list[Event]:
        message = mavlink.MAVLink_heartbeat_message(vehicle_type, self.autopilot, base_mode, mode, 4, 3)
        return self.says(message, system=system)

    def transmitter(self, system: int = 1, component: int = 236) -> list[Event]:
        """The heartbeat of a Remote ID transmitter."""
        message = mavlink.MAVLink_heartbeat_message(34, 8, 0, 0, 4, 3)
        return self.says(message, system=system, component=component)

    def current_mode(
        self, mode: int, system: int = 1, component: int = 1, damaged: bool = False
    ) -> list[Event]:
        writer = self._writers.setdefault((system, component), MavlinkWriter(system, component))
        frame = writer.pack_payload(CURRENT_MODE, struct.pack("<IIB", mode, mode, 0))
        return self.link.receive(frame[:-1] + bytes([frame[-1] ^ damaged]), self.now_s)

    def after(self, seconds: float) -> list[Event]:
        self.now_s += seconds
        return self.link.advance(self.now_s)

    def told(self, kind: str | None = None) -> list[Any]:
        """What the link has sent since the last look, of one kind."""
        messages = self._reader.feed(self.link.drain())
        assert self._reader.counts.corrupt == 0
        return [m for m in messages if kind is None or m.get_type() == kind]

    def position(self, boot_ms: int, lat: int = LAT_E7, lon: int = LON_E7, **over: int) -> Any:
        values = {"alt": 430000, "relative_alt": 30000, "vx": 120, "vy": -30, "vz": 5, "hdg": 0, **over}
        return mavlink.MAVLink_global_position_int_message(boot_ms, lat, lon, **values)


@pytest.fixture
def ardupilot() -> Scripted:
    """A Copter that has been heard, in mode STABILIZE, with everything said so far looked at."""
    scripted = Scripted()
    scripted.heartbeat()
    scripted.after(0.0)
    scripted.told()
    return scripted


@pytest.fixture
def px4() -> Scripted:
    """A PX4 quad that has been heard, in HOLD."""
    scripted = Scripted(autopilot=PX4)
    scripted.heartbeat(0x03040000)
    scripted.after(0.0)
    scripted.told()
    return scripted
