"""Identifies our vehicle and tracks its heartbeats and its clock.

Our vehicle is component 1 of one system: the configured system, or the first one that sends an autopilot's
HEARTBEAT. That first one may be a neighbour's vehicle that a router or a radio forwards. If no system is
configured, a second autopilot therefore makes it `unclear` which vehicle is ours, for the lifetime of this
link. So does a second autopilot with our vehicle's own id, configured or not.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.counts import LinkCounts
from companion.autopilot.dialect import AUTOPILOT_INVALID, refusal
from companion.autopilot.encoders import AUTOPILOT_COMPONENT
from companion.autopilot.readers import Fields, unpack
from companion.autopilot.wire import Frame, FrameScanner
from companion.config import VehicleConfig
from companion.events import Firmware, Heartbeat, SecondCompanion, TwoAutopilots

LOST_AFTER_S = 3.0
"""A longer gap between two heartbeats means that the link dropped or the vehicle restarted."""
REBOOT_STEP_S, _QUIET_S = 1.0, 1.0
"""A step back of the vehicle's clock of up to `REBOOT_STEP_S` means nothing. A larger one, up to
`_OTHER_CLOCK_S`, is a restart only if no newer time has arrived for `_QUIET_S`, because every restart takes
longer. Otherwise it is that of an old message that newer ones have overtaken, on a link with several paths or
queues."""
_OTHER_CLOCK_S, _OTHER_WITHIN_S, _OTHERS = 10.0, 10.0, 3
"""A clock that goes back by more than `_OTHER_CLOCK_S` so often within `_OTHER_WITHIN_S` belongs to two
autopilots. No vehicle restarts so often, and no link delivers messages that are so old."""
_OWN_KEPT = 5
"""Number of our latest heartbeats that are recognised when a router sends them back to us. Those of a second
companion that sends as many messages as we do may have the same numbers, but never as seen from both."""
_SECOND_HEARTBEATS, _SECOND_APART_S, _SECOND_GONE_S = 3, 0.5, 5.0
"""So many heartbeats under our own id, this far apart, are those of a second companion. A companion that was
restarted may hear the last one of its own former process. It is gone after this time without any."""
_ALL = "its system id is 0, which addresses every vehicle on the link: give it another"
_GROUND_STATION = mavlink.MAV_TYPE_GCS
_GENERIC = mavlink.MAV_TYPE_GENERIC
_HEARTBEAT_ID = mavlink.MAVLINK_MSG_ID_HEARTBEAT


@dataclass(frozen=True, slots=True)
class Vehicle:
    """The vehicle at the other end of the link."""

    system_id: int
    firmware: Firmware
    vehicle_type: int
    """MAV_TYPE."""
    refusal: str | None
    """Why the vehicle cannot be commanded, in words; None when it can. Telemetry is read in either case."""

    def __str__(self) -> str:
        """Text for a status line."""
        words = f"{self.firmware.value}, system {self.system_id}, MAV_TYPE {self.vehicle_type}"
        return words if self.refusal is None else f"{words}: {self.refusal}"


@dataclass(slots=True)
class NewestTime:
    """The newest time since boot that a vehicle's messages have shown."""

    boot_s: float = -math.inf
    """That time; minus infinity before the first message."""
    heard_s: float = -math.inf
    """Our monotonic time at which it arrived."""

    def take(self, time_boot_s: float, now_s: float) -> Literal["current", "overtaken", "restarted"]:
        """Take a message with the vehicle's time since boot. "overtaken": the message is far older than one
        that arrived before it. "restarted": its clock has restarted since the last newer one."""
        back_s, quiet_s = self.boot_s - time_boot_s, now_s - self.heard_s
        restarted = back_s > _OTHER_CLOCK_S or (back_s > REBOOT_STEP_S and quiet_s > _QUIET_S)
        if restarted or back_s <= 0.0:
            self.boot_s, self.heard_s = time_boot_s, now_s
        if restarted:
            return "restarted"
        return "overtaken" if back_s > REBOOT_STEP_S else "current"


class HeardVehicle:
    """The vehicle on the link. It is unknown until the first heartbeat."""

    def __init__(self, config: VehicleConfig, counts: LinkCounts) -> None:
        self.vehicle: Vehicle | None = None
        self.unclear: str | None = None
        """Why it is not known which vehicle is ours, in words; None when it is."""
        self._config = config
        self._counts = counts
        self._heartbeat_s = -math.inf
        self._armed = False
        self._clock = NewestTime()
        self._back_s: deque[float] = deque(maxlen=_OTHERS)
        """When the vehicle's clock last went far back."""
        self._sent: deque[int] = deque(maxlen=_OWN_KEPT)
        """Sequence numbers of our latest heartbeats."""
        self._second_s, self._second_count = -math.inf, 0
        """Time of the last heartbeat of another companion under our own id, and how many came."""

    # ------------------------------------------------------------ sender and target of frames

    def is_ours(self, frame: Frame) -> bool:
        """Whether a frame comes from our vehicle. While no vehicle is known: whether the frame may identify
        it."""
        if frame.component_id != AUTOPILOT_COMPONENT:
            return False
        if self.vehicle is not None:
            return frame.system_id == self.vehicle.system_id
        return frame.message_id == _HEARTBEAT_ID and self._config.system_id in (0, frame.system_id)

    def may_be_ours(self, frame: Frame) -> bool:
        """Whether a frame of any message comes from our vehicle, or from a system that may turn out to be
        it."""
        wanted = self._config.system_id if self.vehicle is None else self.vehicle.system_id
        return frame.component_id == AUTOPILOT_COMPONENT and wanted in (0, frame.system_id)

    def is_for_us(self, target_system: int, target_component: int) -> bool:
        """Whether an answer of the vehicle is addressed to us. Target 0 addresses everybody; it is also read
        where MAVLink 1 has no target field. Answers to others are counted as foreign."""
        ours = (
            self.vehicle is not None
            and target_system in (0, self.vehicle.system_id)
            and target_component in (0, self._config.component_id)
        )
        if not ours:
            self._counts.foreign += 1
        return ours

    # ------------------------------------------------------------ heartbeat and clock

    def on_heartbeat(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """Take the vehicle's HEARTBEAT. Returns whether the vehicle is new or was away."""
        known = self.vehicle
        dropped = known is not None and not self.is_connected(now_s)
        self._heartbeat_s, self._armed = now_s, heartbeat.armed
        self._counts.drops += dropped
        if known is None or known.vehicle_type != heartbeat.vehicle_type:
            self.vehicle = Vehicle(
                system_id=heartbeat.system_id,
                firmware=heartbeat.firmware,
                vehicle_type=heartbeat.vehicle_type,
                refusal=refusal(heartbeat.firmware, heartbeat.vehicle_type) if heartbeat.system_id else _ALL,
            )
        return known is None or dropped

    def is_of_another(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """Whether a HEARTBEAT with our vehicle's id is that of another vehicle, and says nothing about ours.

        The firmware never changes, and MAV_TYPE does not change while the vehicle is armed, except from and
        to the generic type, which ArduPilot has while it starts. A vehicle that was away may be another one
        now. If the vehicle itself has changed without a pause, its own heartbeats cease, and that ends
        authority.
        """
        known = self.vehicle
        if known is None or heartbeat.firmware is not known.firmware:
            return known is not None
        kinds = {known.vehicle_type, heartbeat.vehicle_type}
        return self._armed and self.is_connected(now_s) and len(kinds) > 1 and _GENERIC not in kinds

    def is_connected(self, now_s: float) -> bool:
        """Whether the vehicle's last heartbeat is not older than `LOST_AFTER_S`."""
        return now_s - self._heartbeat_s <= LOST_AFTER_S

    def on_boot_time(self, time_boot_s: float, now_s: float) -> bool:
        """Take the vehicle's time since boot from a message. Returns whether the vehicle has rebooted."""
        if self._clock.boot_s - time_boot_s > _OTHER_CLOCK_S:
            self._back_s.append(now_s)
        rebooted = self._clock.take(time_boot_s, now_s) == "restarted"
        self._counts.reboots += rebooted
        return rebooted

    def boot_ms(self, now_s: float) -> int:
        """Estimated time since the vehicle's boot, milliseconds; 0 while it is unknown."""
        clock = self._clock
        if clock.boot_s == -math.inf:
            return 0
        return round((clock.boot_s + max(0.0, now_s - clock.heard_s)) * 1e3)

    def second_clock(self, now_s: float) -> TwoAutopilots | None:
        """Event if two autopilots with our vehicle's system id are on the link; reported once. Both firmwares
        have the id 1 unless it was changed, and whatever is sent to one of them reaches both."""
        if len(self._back_s) < _OTHERS or now_s - self._back_s[0] > _OTHER_WITHIN_S:
            return None
        return self.second_with_our_id()

    def second_with_our_id(self) -> TwoAutopilots | None:
        """Event that another autopilot has our vehicle's id; None if the vehicle is unclear already."""
        if self.unclear is not None or self.vehicle is None:
            return None
        own_id = self.vehicle.system_id
        self.unclear = f"two autopilots with system id {own_id} on this link: give each its own"
        return TwoAutopilots(reason=self.unclear)

    def second_autopilot(self, frame: Frame) -> TwoAutopilots | None:
        """Event if a HEARTBEAT of another system or component makes it unclear which vehicle is ours;
        reported once."""
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

    # ------------------------------------------------------------ our own id

    def heartbeat_sent(self, sequence: int) -> None:
        """Note the sequence number of our own HEARTBEAT."""
        self._sent.append(sequence)

    def second_companion(self, frame: Frame, now_s: float) -> SecondCompanion | None:
        """Event if a HEARTBEAT shows that another companion has our own id; reported once until it is gone.

        A router may send our own frames back to us. Their sequence numbers show that they are ours.
        """
        vehicle, own_id = self.vehicle, self._config.component_id
        if vehicle is None or (frame.system_id, frame.component_id) != (vehicle.system_id, own_id):
            return None
        if frame.sequence in self._sent or now_s - self._second_s < _SECOND_APART_S:
            return None
        self._second_s, self._second_count = now_s, self._second_count + 1
        if self._second_count != _SECOND_HEARTBEATS:
            return None
        ours = f"system id {vehicle.system_id} and component id {own_id}"
        return SecondCompanion(
            reason=f"another companion on this link has our {ours}: stop one, or set its vehicle.component_id"
        )

    def second_companion_gone(self, now_s: float) -> SecondCompanion | None:
        """Event if the second companion has not been heard for a while; reported once."""
        if now_s - self._second_s <= _SECOND_GONE_S or not self._second_count:
            return None
        told, self._second_count = self._second_count >= _SECOND_HEARTBEATS, 0
        return SecondCompanion() if told else None


def from_autopilot(fields: Fields) -> bool:
    """Whether a HEARTBEAT of component 1 is an autopilot's. Some ground stations also use component 1."""
    return bool(fields[1] != _GROUND_STATION and fields[2] != AUTOPILOT_INVALID)


def shows_autopilot(data: bytes) -> bool:
    """Whether some bytes hold a whole HEARTBEAT of an autopilot, as component 1."""
    return any(
        frame.message_id == _HEARTBEAT_ID
        and frame.component_id == AUTOPILOT_COMPONENT
        and from_autopilot(unpack(frame.message_id, frame.payload))
        for frame in FrameScanner().frames(data)
    )
