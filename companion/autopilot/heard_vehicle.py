"""Which vehicle is ours, and what its heartbeats and its clock say of it.

It is component 1 of one system, the configured one or the first that sends an autopilot's HEARTBEAT. That one
may be a neighbour's, which some router or radio forwards: where none was configured, a second autopilot makes
it `unclear` which is ours, for as long as this link lives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.counts import LinkCounts
from companion.autopilot.dialect import AUTOPILOT_INVALID, refusal
from companion.autopilot.encoders import AUTOPILOT_COMPONENT
from companion.autopilot.readers import Fields, unpack
from companion.autopilot.wire import Frame
from companion.config import VehicleConfig
from companion.events import Firmware, Heartbeat, TwoAutopilots

LOST_AFTER_S = 3.0
"""Heartbeats further apart than this: the link dropped, or the vehicle restarted."""
REBOOT_STEP_S = 1.0
"""The vehicle's clock going back by more than this is a reboot; less is messages that overtook each other."""
_GROUND_STATION = 6
_HEARTBEAT_ID = mavlink.MAVLINK_MSG_ID_HEARTBEAT


@dataclass(frozen=True, slots=True)
class Vehicle:
    """The vehicle at the other end."""

    system_id: int
    firmware: Firmware
    vehicle_type: int
    """MAV_TYPE."""
    refusal: str | None
    """Why it cannot be commanded, in words; None when it can. Telemetry is read either way."""

    def __str__(self) -> str:
        """For a status line."""
        words = f"{self.firmware.value}, system {self.system_id}, MAV_TYPE {self.vehicle_type}"
        return words if self.refusal is None else f"{words}: {self.refusal}"


class HeardVehicle:
    """Knows nothing until the first heartbeat."""

    def __init__(self, config: VehicleConfig, counts: LinkCounts) -> None:
        self.vehicle: Vehicle | None = None
        self.unclear: str | None = None
        """Why it is not known which vehicle is ours, in words; None when it is."""
        self._config = config
        self._counts = counts
        self._heartbeat_s = -math.inf
        self._boot_s: float | None = None
        self._boot_heard_s = 0.0

    # ------------------------------------------------------------ whose a frame is

    def is_ours(self, frame: Frame) -> bool:
        """Whether a frame is the vehicle's; before one is known, whether it may tell which it is."""
        if frame.component_id != AUTOPILOT_COMPONENT:
            return False
        if self.vehicle is not None:
            return frame.system_id == self.vehicle.system_id
        return frame.message_id == _HEARTBEAT_ID and self._config.system_id in (0, frame.system_id)

    def may_be_ours(self, frame: Frame) -> bool:
        """Whether a frame, of whatever message, comes from where the vehicle is or is awaited."""
        wanted = self._config.system_id if self.vehicle is None else self.vehicle.system_id
        return frame.component_id == AUTOPILOT_COMPONENT and wanted in (0, frame.system_id)

    def is_for_us(self, target_system: int, target_component: int) -> bool:
        """Whether an answer of the vehicle is meant for us; 0 is everybody, and what MAVLink 1 has no field
        for. Others' are counted."""
        ours = (
            self.vehicle is not None
            and target_system in (0, self.vehicle.system_id)
            and target_component in (0, self._config.component_id)
        )
        if not ours:
            self._counts.foreign += 1
        return ours

    # ------------------------------------------------------------ what it says

    def on_heartbeat(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """Its HEARTBEAT. Returns whether the vehicle is new, or was away."""
        known = self.vehicle
        dropped = known is not None and not self.is_connected(now_s)
        self._heartbeat_s = now_s
        self._counts.drops += dropped
        if known is None or known.vehicle_type != heartbeat.vehicle_type:
            self.vehicle = Vehicle(
                system_id=heartbeat.system_id,
                firmware=heartbeat.firmware,
                vehicle_type=heartbeat.vehicle_type,
                refusal=refusal(heartbeat.firmware, heartbeat.vehicle_type),
            )
        return known is None or dropped

    def is_connected(self, now_s: float) -> bool:
        """Whether its last heartbeat is not older than `LOST_AFTER_S`."""
        return now_s - self._heartbeat_s <= LOST_AFTER_S

    def on_boot_time(self, time_boot_s: float, now_s: float) -> bool:
        """Its clock, as some message tells it. Returns whether it has begun anew."""
        rebooted = self._boot_s is not None and time_boot_s < self._boot_s - REBOOT_STEP_S
        self._counts.reboots += rebooted
        self._boot_s, self._boot_heard_s = time_boot_s, now_s
        return rebooted

    def boot_ms(self, now_s: float) -> int:
        """What its clock must be by now; 0 while it has not told."""
        if self._boot_s is None:
            return 0
        return round((self._boot_s + max(0.0, now_s - self._boot_heard_s)) * 1e3)

    def second_autopilot(self, frame: Frame) -> TwoAutopilots | None:
        """HEARTBEAT of another system or component: where it makes it unclear which vehicle is ours, once."""
        vehicle = self.vehicle
        if self._config.system_id != 0 or self.unclear is not None or vehicle is None:
            return None
        if frame.component_id != AUTOPILOT_COMPONENT:
            return None
        if not from_autopilot(unpack(frame.message_id, frame.payload)):
            return None
        first, second = sorted((vehicle.system_id, frame.system_id))
        self.unclear = f"two autopilots on this link (systems {first} and {second}): set vehicle.system_id"
        return TwoAutopilots(reason=self.unclear)


def from_autopilot(fields: Fields) -> bool:
    """Whether a HEARTBEAT of component 1 is an autopilot's: some ground stations call themselves that too."""
    return bool(fields[1] != _GROUND_STATION and fields[2] != AUTOPILOT_INVALID)
