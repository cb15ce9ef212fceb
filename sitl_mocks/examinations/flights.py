"""Successive flights in a `World`, with a simulated pilot who starts each of them, and their results.

The vehicle takes off, flies its mission, returns home and takes off again. A companion guards or flies it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.authority.table import HOLDING, State
from companion.events import Firmware, Landed
from sitl_mocks.examinations.faults import Fault
from sitl_mocks.examinations.modelled_link import ModelledLink
from sitl_mocks.examinations.world import Use, World
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode

PATIENCE_S = 1800.0
"""A flight that lasts longer than this counts as stuck."""
SETTLED_S = 30.0
"""Time after the last trouble within which `Flights.at_work` must hold again."""
_ON_GROUND_S = 5.0
_PILOT_PERIOD_S = 1.0
_FLOWN_S = 600.0
"""Flight time after which the pilot returns a vehicle that the companion flies: its path ends in the air."""


class BrokenRuleError(Exception):
    """A rule was broken.

    Args:
        rule: name of the rule.
        at_s: time of the breach.
    """

    def __init__(self, rule: str, at_s: float, words: str) -> None:
        super().__init__(f"at {at_s:.2f} s: {rule}: {words}")
        self.rule, self.at_s, self.words = rule, at_s, words
        self.flight_s = 0.0
        """Time at which the flight with the breach began."""


@dataclass(slots=True)
class Told:
    """Counts over all flights."""

    flights: int = 0
    taken: int = 0
    given_back: int = 0
    yielded: int = 0
    faults: int = 0
    setpoints: int = 0
    troubles: dict[str, int] = field(default_factory=dict)


class Flights(World):
    """Flights one after another. `step` raises BrokenRuleError for the first rule that is broken."""

    def __init__(self, firmware: Firmware, use: Use, seed: int, link: ModelledLink | None = None) -> None:
        super().__init__(firmware, use, seed, link)
        self.told = Told()
        self.quiet_from_s = 0.0
        """End of the last trouble."""
        self.flight_s = 0.0
        """Start time of the current flight."""
        self._armed_s = 0.0
        self._on_mission_s = 0.0
        """Time since which the vehicle flies its mission in the air."""
        self._pilot_s = 0.0
        """Time at which the pilot checks the vehicle next."""
        self._state = State.STANDBY
        self._authority = True
        """Whether the companion has not lost authority in this flight."""

    def step(self) -> None:
        """Step the world with its pilot and its judge.

        Raises:
            BrokenRuleError: a rule was broken.
        """
        self._pilot()
        super().step()
        self._count()
        self.told.setpoints = self.judge.setpoints
        for breach in self.judge.breaches:
            raise BrokenRuleError(breach.rule, breach.at_s, breach.words)

    def began(self, fault: Fault) -> None:
        """See `World.began`. The router delivers delayed frames after the fault has ended."""
        held_s = fault.numbers[0] if fault.kind == "late" else 0.0
        self.quiet_from_s = max(self.quiet_from_s, self.now_s + fault.lasts_s + held_s)
        self.told.troubles[fault.kind] = self.told.troubles.get(fault.kind, 0) + 1

    def restart_companion(self) -> None:
        """See `World.restart_companion`. The last known state of the companion is reset."""
        super().restart_companion()
        self._state = State.STANDBY
        self._authority = self._authority and not self.vehicle.armed

    def _count(self) -> None:
        """Update the report and the state that the pilot knows, as from a ground station. The judge uses
        neither.
        """
        state = self.onboard.core.state
        if not self.vehicle.armed:
            # During a fault the companion may not notice that the vehicle is disarmed, and then it does not
            # regain authority for the next flight.
            self._authority = self._authority or self.now_s > self.quiet_from_s
        elif self.onboard.gate.lost is not None:
            # The companion reports "cannot take control" to the ground station. A mode that the pilot selects
            # while the vehicle is still in the mode that we requested ends authority like any other.
            self._authority = False
        if state is self._state:
            return
        before, self._state = self._state, state
        told = self.told
        told.taken += state in HOLDING and before not in HOLDING
        told.given_back += state is State.WATCHING and before in HOLDING
        told.faults += state is State.FAULT
        if state is State.YIELDED:
            told.yielded += 1
            self._authority = False

    @property
    def at_work(self) -> bool:
        """Whether the companion flies the vehicle, or watches it fly its mission."""
        on_mission = self.vehicle.mode is VehicleMode.MISSION
        return self._state in HOLDING | ({State.WATCHING} if on_mission else set())

    # ------------------------------------------------------------ the pilot

    def _pilot(self) -> None:
        """Start the next flight from the ground, and recover a vehicle that makes no progress."""
        now_s, vehicle = self.now_s, self.vehicle
        if now_s < self._pilot_s:
            return
        self._pilot_s = now_s + _PILOT_PERIOD_S
        if not vehicle.armed:
            if now_s - self._armed_s > _ON_GROUND_S:
                self._begin_flight()
            return
        self._armed_s = now_s
        if now_s - self.flight_s > PATIENCE_S:
            raise BrokenRuleError(
                "stuck", now_s, f"the flight has lasted more than {PATIENCE_S:g} s: {self._words()}"
            )
        if vehicle.mode is not VehicleMode.MISSION or vehicle.landed is not Landed.IN_AIR:
            self._on_mission_s = now_s
        quiet_s = now_s - self.quiet_from_s
        if quiet_s > SETTLED_S and vehicle.landed is Landed.IN_AIR and not self.at_work:
            self._recover(quiet_s)
        if self.use == "fly" and now_s - self.flight_s > _FLOWN_S:
            self._go_home()

    def _recover(self, quiet_s: float) -> None:
        if not self._authority:
            self._go_home()
        elif self.vehicle.mode is not VehicleMode.MISSION:
            self.pilot_selects(VehicleMode.MISSION)
        elif self.now_s - self._on_mission_s > SETTLED_S:
            words = f"no fault for {quiet_s:.0f} s, but the companion is idle: {self._words()}"
            raise BrokenRuleError("idle", self.now_s, words)

    def _go_home(self) -> None:
        if self.vehicle.mode not in (VehicleMode.RTL, VehicleMode.LAND):
            self.pilot_selects(VehicleMode.RTL)

    def _begin_flight(self) -> None:
        self.told.flights += 1
        self.flight_s = self.now_s
        self._pilot_s = self.now_s + 5.0
        self.pilot_selects(VehicleMode.HOLD)
        self.station_says(
            "command_long", 1, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1.0, 0, 0, 0, 0, 0, 0
        )
        if self.vehicle.armed:
            self.station_says("mission_set_current", 1, 1, 0)
            self.pilot_selects(VehicleMode.MISSION)
            self.station_says("command_long", 1, 1, mavlink.MAV_CMD_MISSION_START, 0, 0, 0, 0, 0, 0, 0, 0)

    def _words(self) -> str:
        core = self.onboard.core
        return (
            f"state {core.state.value}, vehicle mode {self.vehicle.mode.value}, armed "
            f"{self.vehicle.armed}, waiting for: {core.waits_for(self.now_s)}, position "
            f"{[round(x) for x in self.vehicle.position_ned_m]}"
        )
