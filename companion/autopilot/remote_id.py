"""Remote ID on the autopilot's link: whose OPEN_DRONE_ID_* messages are believed, and as what.

- With an `id_or_mac`, from anybody: somebody else's Remote ID, heard by a receiver on the link.
- Without one, about the operator (SYSTEM, SYSTEM_UPDATE, OPERATOR_ID, SELF_ID), for our vehicle or for all:
  - From another system that is a ground station. It is one when it has said so in a HEARTBEAT; until a system
    has sent any, when its id is 240 or more (QGroundControl and Mission Planner are 255). What names our
    vehicle as its target is taken from any system: nobody else has a reason to. A broadcast of another
    vehicle is not: PX4 and ArduPilot send their own SYSTEM to all.
  - From our autopilot, which relays what it was told (ArduPilot) but goes on with it, old timestamp and all,
    when the ground station has gone. So a relayed SYSTEM counts only when its timestamp is known and has
    moved on since the one before it (the first only sets the mark), and not while a ground station is heard
    itself. A relayed SYSTEM_UPDATE does not count: ArduPilot takes a SYSTEM that a receiver has heard of
    somebody else for its own, and only the SYSTEM that it sends on then still says whose it is. One that
    tells the take-off point is left out: PX4 fills in its home by itself, ArduPilot sends an empty one, and
    the companion knows the take-off point better. Identities do not grow old: they are taken.
- ARM_STATUS of another component of our vehicle: a Remote ID transmitter of its own. Also under our own id as
  the Remote ID component (236), unless it is one that we have sent: one aircraft, one identity.

A SYSTEM_UPDATE becomes a System: its sender's last one, brought up to date. Without one before it nothing but
the place and time are known, and the type is live, since an update is sent for an operator who moves.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

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
"""Events of heard Remote ID out of one piece of input; more is a flood, and is dropped."""
ARM_STATUS_PERIOD_S = 0.7
"""Ground stations call a module dead after 2.5 s and check for 1 Hz, which exactly 1 Hz fails by jitter."""
HEARTBEAT_PERIOD_S = 1.0
BASIC_ID_PERIOD_S = 3.0
_ECHOES = 32
"""Latest own statuses: as many can come back late and are known."""
_EPSILON_S = 1e-6
_STATION_FROM_ID = 240
_STATION_SPEAKS_S = 5.0
_TYPE_STATION = 6
_UNKNOWN = System(operator_location_type=OperatorLocationType.LIVE_GNSS)


@dataclass(slots=True)
class RemoteIdCounts:
    """What came."""

    remote_id_heard: int = 0
    """Frames of other aircraft, from a receiver on the link."""
    remote_id_dropped: int = 0
    """Such frames beyond `MAX_HEARD`."""
    remote_id_faults: int = 0
    """Parts of a MESSAGE_PACK that could not be read."""
    operator_data: int = 0
    """Frames about the operator that were taken."""
    module_reports: int = 0
    """ARM_STATUS of a transmitter that the vehicle has."""


class RemoteIdListener:
    """Frames to events. Remembers one number or message for each system id at most."""

    def __init__(
        self, counts: RemoteIdCounts, own_components: frozenset[int], component: RemoteIdComponent | None
    ) -> None:
        """`component` is what we are beside `own_components`; whoever else says to be it is a second one."""
        self._counts = counts
        self._own_components = own_components
        self._component = component
        self._stations: dict[int, bool] = {}
        """Systems that have sent a HEARTBEAT: whether one of their components is a ground station."""
        self._last_system: dict[int, System] = {}
        self._relayed_utc_s: float | None = None
        self._station_heard_s: float | None = None
        """When a ground station last told the operator's place itself."""
        self._room = MAX_HEARD

    def begin(self) -> None:
        """A new piece of input."""
        self._room = MAX_HEARD

    def note_heartbeat(self, frame: Frame) -> None:
        """HEARTBEAT of another system or component."""
        station = len(frame.payload) > 4 and frame.payload[4] == _TYPE_STATION
        self._stations[frame.system_id] = station or self._stations.get(frame.system_id, False)

    def event(self, frame: Frame, vehicle_system: int | None, now_s: float) -> Event | None:
        """What a message of `MESSAGE_IDS` tells; None when it is none of ours.

        Args:
            vehicle_system: our vehicle's id; until it is known only heard Remote ID is taken.

        Raises:
            PeerDataError: values that cannot be.
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
        if frame.system_id != vehicle_system or component in self._own_components:
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
                # A ground station may give the whole number: its secret is neither recorded nor sent.
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
        """Whether a System that the autopilot sends tells something new about the operator."""
        before, self._relayed_utc_s = self._relayed_utc_s, system.timestamp_utc_s
        direct_s = self._station_heard_s
        return (
            before is not None
            and system.timestamp_utc_s not in (None, before)
            and system.operator_location_type is not OperatorLocationType.TAKEOFF
            and (direct_s is None or now_s - direct_s > _STATION_SPEAKS_S)
        )


class RemoteIdComponent:
    """What we say as the vehicle's Remote ID component, numbered on its own.

    Nothing before the first report: a component that does not broadcast must not look like one that does.

    The autopilot is told the identity too, since ArduPilot arms with none (DID_OPTIONS = 1) until it has one.
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
        """What to say from now on; it is due at once."""
        self._status = status
        self._status_sent_s = None

    def has_sent(self, status: Frame) -> bool:
        """Whether this is a status of ours that the link brings back, to the byte."""
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
