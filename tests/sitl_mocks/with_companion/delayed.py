"""A companion and a mock vehicle over a link that is slow in one or both directions, in virtual time."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.readers import unpack
from companion.autopilot.statustext import TextAssembler
from companion.autopilot.wire import FrameScanner
from companion.config import Config, IdentityConfig
from companion.events import Firmware
from companion.system import CompanionSystem
from sitl_mocks.vehicle.mock_vehicle import MockVehicle
from sitl_mocks.vehicle.options import VehicleOptions

STEP_S = 0.01
TICK = 5
WATCHING = Config(identity=IdentityConfig(uas_id="CLOCK"))


class Delayed:
    """A companion and a vehicle with a slow link.

    Args:
        rate: seconds of the vehicle's clock, and of its whole world, in one of ours.
    """

    def __init__(
        self,
        firmware: Firmware,
        down_s: float,
        up_s: float,
        *,
        rate: float = 1.0,
        config: Config = WATCHING,
        **options: Any,
    ) -> None:
        self.rate = rate
        self.vehicle = MockVehicle(VehicleOptions(firmware=firmware, **options), np.random.default_rng(1))
        self.onboard = CompanionSystem(config)
        self.down_s, self.up_s = down_s, up_s
        self._down: deque[tuple[float, bytes]] = deque()
        self._up: deque[tuple[float, bytes]] = deque()
        self.inject = b""
        self.said: list[tuple[float, str]] = []
        """Texts for ground stations, and when they left."""
        self._scanner, self._texts = FrameScanner(), TextAssembler()
        self.step = 0

    @property
    def now_s(self):
        return self.step * STEP_S

    def run(self, seconds):
        for _ in range(round(seconds / STEP_S)):
            now_s = self.now_s
            self.vehicle.advance(now_s * self.rate)
            self._down.append((now_s + self.down_s, self.vehicle.drain()))
            while self._down and self._down[0][0] <= now_s + 1e-9:
                self.onboard.receive(self._down.popleft()[1] + self.inject, now_s)
            if self.step % TICK == 0:
                self.onboard.tick(now_s)
            sent = self.onboard.drain(now_s)
            self._note_texts(sent)
            self._up.append((now_s + self.up_s, sent))
            while self._up and self._up[0][0] <= now_s + 1e-9:
                self.vehicle.receive(self._up.popleft()[1], now_s * self.rate)
            self.step += 1

    def _note_texts(self, sent: bytes) -> None:
        for frame in self._scanner.frames(sent):
            if frame.message_id == mavlink.MAVLINK_MSG_ID_STATUSTEXT:
                fields = unpack(frame.message_id, frame.payload)
                self.said += [(self.now_s, text.text) for text in self._texts.feed(fields, self.now_s)]

    @property
    def error_s(self):
        """Estimated age of the position minus its true age."""
        own = self.onboard.core.own
        stamped_s = own.position.time_boot_s + self.vehicle._telemetry.boot_s
        return stamped_s - own.sample_s()

    @property
    def half_s(self):
        return (self.down_s + self.up_s) / 2
