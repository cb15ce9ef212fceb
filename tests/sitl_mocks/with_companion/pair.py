"""One companion on one mock vehicle, stepped together in virtual time and connected by real bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

import numpy as np

from companion.authority.table import State
from companion.config import Config
from companion.event_record import Step
from companion.events import Firmware, RemoteIdHeard
from companion.system import CompanionSystem
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from sitl_mocks.vehicle.mock_vehicle import MockVehicle
from sitl_mocks.vehicle.options import VehicleOptions

TICK_S = 0.05
UTC_AT_ZERO_S = 1_767_225_600.0


class Pair:
    """Vehicle and companion. The vehicle hovers 50 m above home unless `options` say otherwise."""

    def __init__(self, firmware: Firmware, config: Config, **options: Any) -> None:
        options = {"airborne": True, "start_position_ned_m": (0.0, 0.0, -50.0), **options}
        if options["airborne"] and firmware is Firmware.ARDUPILOT:
            # Taken off in GUIDED, as a ground station does it; LOITER is the pilot's.
            options.setdefault("start_mode", VehicleMode.EXTERNAL)
        self.options = VehicleOptions(firmware=firmware, utc_at_zero_s=UTC_AT_ZERO_S, **options)
        self.vehicle = MockVehicle(self.options, np.random.default_rng(1))
        self.config = config
        self.steps: list[Step] = []
        self.onboard = CompanionSystem(config, self.steps.append)
        self.tick = 0
        self.places: list[tuple[float, float, float]] = []
        """True position at each tick."""
        self.heard: Callable[[float], RemoteIdHeard | None] = lambda now_s: None
        """What the radio hears at a tick."""
        self.sent: list[bytes] = []
        """What left for the vehicle at each tick."""

    @property
    def state(self) -> State:
        return self.onboard.core.state

    @property
    def now_s(self) -> float:
        """Time of the next tick."""
        return self.tick * TICK_S

    def run(self, seconds: float) -> Self:
        """Let time pass."""
        for _ in range(round(seconds / TICK_S)):
            now_s = self.now_s
            self.tick += 1
            self.vehicle.advance(now_s)
            data = self.vehicle.drain()
            if data:
                self.onboard.receive(data, now_s)
            if (heard := self.heard(now_s)) is not None:
                self.onboard.hear(heard)
            self.onboard.tick(now_s)
            self.sent.append(self.onboard.drain(now_s))
            self.vehicle.receive(self.sent[-1], now_s)
            self.places.append(self.vehicle.position_ned_m)
        return self

    def commands(self, kind: Any, since: int = 0) -> list[Any]:
        """Commands of a kind from step `since` on."""
        return [c for step in self.steps[since:] for c in step.commands if isinstance(c, kind)]

    def timed(self, kind: Any) -> list[tuple[float, Any]]:
        """Commands of a kind with their times."""
        return [(step.now_s, c) for step in self.steps for c in step.commands if isinstance(c, kind)]

    def events(self, kind: Any) -> list[Any]:
        """Events of a kind."""
        return [e for step in self.steps for e in step.events if isinstance(e, kind)]
