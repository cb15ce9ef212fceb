"""Remote ID on the autopilot's link: which OPEN_DRONE_ID_* messages are accepted, and what they mean.

- A message with an `id_or_mac` is accepted from any sender. It is the Remote ID of another aircraft, heard by
  a receiver on the link.
- A message without an `id_or_mac` is about the operator (SYSTEM, SYSTEM_UPDATE, OPERATOR_ID, SELF_ID). It
  must target our vehicle or all systems, and come from one of these senders:
  - Another system that is a ground station. A system is one if it has declared itself one in a HEARTBEAT. A
    system that has sent no HEARTBEAT yet is one if its id is 240 or more (QGroundControl and Mission Planner
    use 255). A message that targets our vehicle by its id is accepted from any other system, because only a
    ground station has a reason to send it. A broadcast of another vehicle is not accepted: PX4 and ArduPilot
    send their own SYSTEM to all.
  - Our autopilot. ArduPilot relays what it has received, but goes on relaying it, with the old timestamp,
    when the ground station has gone. A relayed SYSTEM therefore counts only if its timestamp is known and
    differs from the previous one (the first one only sets the reference), and only while no ground station is
    heard directly. A relayed SYSTEM_UPDATE does not count: ArduPilot takes a SYSTEM of another aircraft,
    heard by a receiver, for its own, and only the SYSTEM that it sends on afterwards shows whose it is. A
    relayed SYSTEM that gives the take-off point is ignored: PX4 fills in its own home, ArduPilot sends an
    empty one, and the companion knows the take-off point better. Relayed identities do not become outdated
    and are accepted.
- ARM_STATUS of another component of our vehicle, whose HEARTBEAT says that it is a Remote ID transmitter, is
  a report of the vehicle's own module. This includes our own id as the Remote ID component (236), unless we
  have sent that very frame: one aircraft must have one identity.

A SYSTEM_UPDATE becomes a System: the sender's last System with the updated fields. Without an earlier System
only the position and time are known. The location type is then live, because updates are sent for an operator
who moves.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot import encoders
from companion.autopilot.wire import Frame, MavlinkWriter, without_signature
from companion.errors import PeerDataError
from companion.events import ArmStatus, Event, OperatorData, RemoteIdHeard, RemoteIdModule
from companion.remote_id.identity import public_operator_id
from companion.remote_id.mavlink import (
    ARM_STATUS,
    COMPONENT_ID,
    MAV_TYPE,
    NO_ID,
    READABLE,
    Odid,
    decode_arm_status,
    decode_odid,
    encode_arm_status,
    encode_odid,
    updated,
)
from companion.remote_id.messages import (
    BasicId,
    IdType,
    Message,
    OperatorId,
    OperatorLocationType,
    SelfId,
    System,
)

MESSAGE_IDS = READABLE | {ARM_STATUS}
MAX_HEARD = 256
"""Largest number of events of heard Remote ID per piece of input. The rest is dropped as a flood."""
ARM_STATUS_PERIOD_S = 0.7
"""Ground stations declare a module dead after 2.5 s and check for 1 Hz. A rate of exactly 1 Hz fails that
check through jitter."""
HEARTBEAT_PERIOD_S = 1.0
BASIC_ID_PERIOD_S = 3.0
_ECHOES = 32
"""Number of our latest ARM_STATUS frames that are remembered, to recognise late echoes of them."""
_EPSILON_S = 1e-6
_STATION_FROM_ID = 240
_STATION_SPEAKS_S = 5.0
_TYPE_STATION = mavlink.MAV_TYPE_GCS
_UNKNOWN = System(operator_location_type=OperatorLocationType.LIVE_GNSS)


@dataclass(slots=True)
class RemoteIdCounts:
    """Counters of Remote ID messages on the link."""

    remote_id_heard: int = 0
    """Frames about other aircraft, from a receiver on the link."""
    remote_id_dropped: int = 0
    """Such frames beyond `MAX_HEARD`."""
    remote_id_faults: int = 0
    """Parts of a MESSAGE_PACK that could not be read."""
    operator_data: int = 0
    """Accepted frames about the operator."""
    module_reports: int = 0
    """ARM_STATUS frames of the vehicle's own transmitter."""


class RemoteIdListener:
    """Converts frames to events. Stores at most one flag and one message per system id."""

    def __init__(
        self, counts: RemoteIdCounts, own_components: frozenset[int], component: RemoteIdComponent | None
    ) -> None:
        """`component` is our own Remote ID component, in addition to `own_components`. Any other sender with
        its component id is a second transmitter."""
        self._counts = counts
        self._own_components = own_components
        self._component = component
        self._stations: dict[int, bool] = {}
        """Systems that have sent a HEARTBEAT -> whether one of their components is a ground station."""
        self._transmitters: set[int] = set()
        """Components of our vehicle that have declared themselves Remote ID transmitters in a HEARTBEAT."""
        self._last_system: dict[int, System] = {}
        self._relayed_utc_s: float | None = None
        self._station_heard_s: float | None = None
        """When a ground station last sent the operator's position directly."""
        self._room = MAX_HEARD

    def begin(self) -> None:
        """Start a new piece of input."""
        self._room = MAX_HEARD

    def note_heartbeat(self, frame: Frame, vehicle_system: int | None) -> None:
        """Take a HEARTBEAT of another system or component.

        Args:
            vehicle_system: system id of our vehicle; None until it is known.
        """
        kind = frame.payload[4] if len(frame.payload) > 4 else None
        station = kind == _TYPE_STATION
        self._stations[frame.system_id] = station or self._stations.get(frame.system_id, False)
        if kind == MAV_TYPE and frame.system_id == vehicle_system:
            self._transmitters.add(frame.component_id)

    def event(self, frame: Frame, vehicle_system: int | None, now_s: float) -> Event | None:
        """Event for a message of `MESSAGE_IDS`; None when the message is not accepted.

        Args:
            vehicle_system: system id of our vehicle. Until it is known, only Remote ID of other aircraft is
                accepted.

        Raises:
            PeerDataError: values that are impossible.
        """
        if frame.message_id == ARM_STATUS:
            return self._module(frame, vehicle_system)
        odid = decode_odid(frame.message_id, frame.payload)
        if odid.id_or_mac != NO_ID:
            return self._heard(odid)
        if vehicle_system is None or odid.target_system not in (0, vehicle_system):
            return None
        return self._operator(frame, odid, vehicle_system, now_s)

    def _module(self, frame: Frame, vehicle_system: int | None) -> RemoteIdModule | None:
        component = frame.component_id
        if frame.system_id != vehicle_system or component not in self._transmitters - self._own_components:
            return None
        if component == COMPONENT_ID and self._component is not None and self._component.has_sent(frame):
            return None
        self._counts.module_reports += 1
        ready, text = decode_arm_status(frame.payload)
        return RemoteIdModule(component_id=component, ready=ready, text=text)

    def _heard(self, odid: Odid) -> RemoteIdHeard | None:
        self._counts.remote_id_faults += len(odid.faults)
        if not odid.messages:
            if odid.faults:
                raise PeerDataError(odid.faults[0])
            return None
        if self._room == 0:
            self._counts.remote_id_dropped += 1
            return None
        self._room -= 1
        self._counts.remote_id_heard += 1
        return RemoteIdHeard(transport="mavlink", address=odid.address, messages=odid.messages)

    def _operator(self, frame: Frame, odid: Odid, vehicle_system: int, now_s: float) -> OperatorData | None:
        sender = frame.system_id
        relayed = sender == vehicle_system
        if relayed:
            if frame.component_id != encoders.AUTOPILOT_COMPONENT or odid.system_update is not None:
                return None
        elif not self._is_station(sender, odid):
            return None
        said: tuple[Message, ...] = odid.messages
        if odid.system_update is not None:
            said = (updated(self._last_system.get(sender, _UNKNOWN), odid.system_update),)
        kept: list[Message] = []
        for message in said:
            if isinstance(message, System):
                self._last_system[sender] = message
                if not relayed:
                    self._station_heard_s = now_s
                elif not self._renewed(message, now_s):
                    continue
                kept.append(message)
            elif isinstance(message, OperatorId):
                # A ground station may send the whole operator number. Its secret part is neither recorded nor
                # broadcast.
                public = public_operator_id(message.operator_id)
                kept.append(OperatorId(operator_id_type=message.operator_id_type, operator_id=public))
            elif isinstance(message, SelfId):
                kept.append(message)
        if not kept:
            return None
        self._counts.operator_data += 1
        return OperatorData(messages=tuple(kept))

    def _is_station(self, sender: int, odid: Odid) -> bool:
        if odid.target_system != 0:
            return True
        return self._stations.get(sender, sender >= _STATION_FROM_ID)

    def _renewed(self, system: System, now_s: float) -> bool:
        """Whether a System relayed by the autopilot carries new data about the operator."""
        before, self._relayed_utc_s = self._relayed_utc_s, system.timestamp_utc_s
        direct_s = self._station_heard_s
        return (
            before is not None
            and system.timestamp_utc_s not in (None, before)
            and system.operator_location_type is not OperatorLocationType.TAKEOFF
            and (direct_s is None or now_s - direct_s > _STATION_SPEAKS_S)
        )


class RemoteIdComponent:
    """Messages that we send as the vehicle's Remote ID component, with a sequence number of their own.

    Nothing is sent before the first report, because a component that does not broadcast must not look like
    one that does.

    The autopilot receives the identity too: with DID_OPTIONS = 1, ArduPilot does not arm before it has one.
    """

    def __init__(self, identity: BasicId | None = None) -> None:
        named = identity is not None and identity.id_type is not IdType.NONE
        self._identity = identity if named else None
        self._identity_sent_s: float | None = None
        self._writer: MavlinkWriter | None = None
        self._status: ArmStatus | None = None
        self._status_sent_s: float | None = None
        self._statuses: deque[bytes] = deque(maxlen=_ECHOES)
        self._beat_sent_s: float | None = None

    def report(self, status: ArmStatus) -> None:
        """Set the status that is sent from now on; it is due at once."""
        self._status = status
        self._status_sent_s = None

    def has_sent(self, status: Frame) -> bool:
        """Whether this frame is, byte for byte, a status of ours that the link echoes. Signatures are
        ignored."""
        return without_signature(status.raw) in self._statuses

    def due(self, system_id: int, now_s: float) -> list[bytes]:
        """Frames to send now."""
        status = self._status
        if status is None:
            return []
        writer = self._writer = self._writer or MavlinkWriter(system_id, COMPONENT_ID)
        frames = []
        if _is_due(self._beat_sent_s, HEARTBEAT_PERIOD_S, now_s):
            self._beat_sent_s = now_s
            frames.append(writer.pack_payload(*encoders.heartbeat(MAV_TYPE)))
        if _is_due(self._status_sent_s, ARM_STATUS_PERIOD_S, now_s):
            self._status_sent_s = now_s
            frames.append(writer.pack_payload(*encode_arm_status(status.ready, status.text)))
            self._statuses.append(frames[-1])
        if self._identity is not None and _is_due(self._identity_sent_s, BASIC_ID_PERIOD_S, now_s):
            self._identity_sent_s = now_s
            told = encode_odid(self._identity, system_id, encoders.AUTOPILOT_COMPONENT)
            frames.append(writer.pack_payload(*told))
        return frames


def _is_due(sent_s: float | None, period_s: float, now_s: float) -> bool:
    return sent_s is None or now_s - sent_s >= period_s - _EPSILON_S
