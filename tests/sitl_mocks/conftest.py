"""A client of the mock vehicle in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from companion.events import Firmware
from sitl_mocks.vehicle.mock_vehicle import MockVehicle, VehicleMode, VehicleOptions

VELOCITY = 0xDC7


class Bench:
    """Talks to one mock vehicle as component 1/191 and records all that it sends."""

    def __init__(self, options: VehicleOptions, seed: int = 1) -> None:
        self.vehicle = MockVehicle(options, numpy.random.default_rng(seed))
        self.firmware = options.firmware
        self.now_s = 0.0
        self.seen: list[tuple[float, Any]] = []
        self._writer = MavlinkWriter(1, 191)
        self._readers: dict[int, MavlinkReader] = {}

    def send(self, message: Any, link: int = 0) -> list[Any]:
        """Send one message; return the immediate answers on the link."""
        self.vehicle.receive(self._writer.pack(message), self.now_s, link)
        return self.collect(link)

    def collect(self, link: int = 0) -> list[Any]:
        """Read all waiting messages of a link."""
        reader = self._readers.setdefault(link, MavlinkReader())
        messages = reader.feed(self.vehicle.drain(link))
        self.seen += [(self.now_s, message) for message in messages]
        return messages

    def run(self, seconds: float, *setpoint: float, rate_hz: float = 20.0, **fields: Any) -> list[Any]:
        """Let time pass, streaming a velocity if one is given; return the messages received on link 0."""
        found: list[Any] = []
        ticks = round(seconds / 0.02)
        sent = 0
        for tick in range(ticks):
            if setpoint and tick * 0.02 >= sent / rate_hz - 1e-9:
                found += self.setpoint(*setpoint, **fields)
                sent += 1
            self.now_s = round(self.now_s + 0.02, 6)
            self.vehicle.advance(self.now_s)
            found += self.collect()
        return found

    def setpoint(
        self,
        north: float,
        east: float,
        down: float,
        *,
        mask: int = VELOCITY,
        frame: int = 1,
        target: tuple[int, int] = (1, 1),
        place: tuple[float, float, float] = (0.0, 0.0, 0.0),
        yaw: float = 0.0,
        yaw_rate: float = 0.0,
    ) -> list[Any]:
        """One SET_POSITION_TARGET_LOCAL_NED."""
        return self.send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, *target, frame, mask, *place, north, east, down, 0, 0, 0, yaw, yaw_rate
            )
        )

    def command(
        self, number: int, *params: float, target: tuple[int, int] = (1, 1), link: int = 0
    ) -> list[int]:
        """COMMAND_LONG; return the results acknowledged."""
        filled = (*params, *([0.0] * (7 - len(params))))
        answers = self.send(mavlink.MAVLink_command_long_message(*target, number, 0, *filled), link)
        return [m.result for m in answers if m.get_type() == "COMMAND_ACK" and m.command == number]

    def set_mode(self, mode: VehicleMode) -> list[int]:
        """DO_SET_MODE in the firmware's own way; return the results acknowledged."""
        number = self.vehicle._manners.custom_modes[mode]
        if self.firmware is Firmware.PX4:
            return self.command(176, 1.0, float(number >> 16 & 0xFF), float(number >> 24))
        return self.command(176, 1.0, float(number))

    def interval(self, message_id: int, hertz: float, link: int = 0) -> list[int]:
        """SET_MESSAGE_INTERVAL."""
        return self.command(511, float(message_id), 1e6 / hertz, link=link)

    def texts(self) -> list[str]:
        """All STATUSTEXT so far."""
        return [m.text for _, m in self.seen if m.get_type() == "STATUSTEXT"]

    @property
    def speed(self) -> float:
        """True horizontal speed (m/s)."""
        north, east, _ = self.vehicle.velocity_ned_mps
        return float(numpy.hypot(north, east))

    def in_external(self) -> Bench:
        """Bring an airborne vehicle into GUIDED or OFFBOARD, hovering."""
        self.run(0.5, 0.0, 0.0, 0.0)
        self.set_mode(VehicleMode.EXTERNAL)
        self.run(0.5, 0.0, 0.0, 0.0)
        assert self.vehicle.mode is VehicleMode.EXTERNAL
        return self


@pytest.fixture
def bench() -> Callable[..., Bench]:
    """Make a client of a vehicle on the ground.

    It follows its setpoints plainly, so that what is tested shows; `velocity_lag_s=None` gives it the
    firmware's own response.
    """

    def make(firmware: Firmware = Firmware.ARDUPILOT, **options: Any) -> Bench:
        return Bench(VehicleOptions(firmware=firmware, **{"velocity_lag_s": 0.5, **options}))

    return make


@pytest.fixture
def airborne(bench: Callable[..., Bench]) -> Callable[..., Bench]:
    """Make a client of a vehicle that hovers 50 m over home in HOLD."""

    def make(firmware: Firmware = Firmware.ARDUPILOT, **options: Any) -> Bench:
        given = {"airborne": True, "start_position_ned_m": (0.0, 0.0, -50.0), **options}
        return bench(firmware, **given)

    return make
