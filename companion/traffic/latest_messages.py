"""What senders report in addition to positions."""

from __future__ import annotations

from dataclasses import dataclass

from companion.remote_id.authentication import AuthenticationData
from companion.remote_id.messages import BasicId, Message, OperatorId, SelfId, System


@dataclass(slots=True)
class LatestMessages:
    """The last message of each type from a sender, and how the sender was last received."""

    transport: str
    address: str
    rssi_dbm: float | None = None
    basic_id: BasicId | None = None
    """Basic ID with the identity that the track uses."""
    other_id: BasicId | None = None
    """Another Basic ID from the same address, such as a registration in addition to the serial number."""
    system: System | None = None
    operator_id: OperatorId | None = None
    self_id: SelfId | None = None
    authentication: AuthenticationData | None = None

    def keep(self, message: Message) -> None:
        """Hold the message if it is a System, Operator ID or Self ID; other messages are ignored."""
        if type(message) is System:
            self.system = message
        elif type(message) is OperatorId:
            self.operator_id = message
        elif type(message) is SelfId:
            self.self_id = message

    def keep_id(self, message: BasicId, identity: str | None) -> None:
        """Hold a Basic ID as `basic_id` if it carries the sender's `identity`, else as `other_id`."""
        if message.uas_id == identity:
            self.basic_id = message
        else:
            self.other_id = message

    def update(self, other: LatestMessages) -> None:
        """Take over everything that is set in `other`, which is newer."""
        self.transport, self.address, self.rssi_dbm = other.transport, other.address, other.rssi_dbm
        if other.basic_id is not None:
            self.basic_id = other.basic_id
        if other.other_id is not None:
            self.other_id = other.other_id
        if other.system is not None:
            self.system = other.system
        if other.operator_id is not None:
            self.operator_id = other.operator_id
        if other.self_id is not None:
            self.self_id = other.self_id
        if other.authentication is not None:
            self.authentication = other.authentication
