"""Remote ID on the air: frames received, the radios' state, operator data, and what we broadcast."""

from __future__ import annotations

from typing import Literal

from companion.events.base import Command, Event
from companion.remote_id.messages import Message


class RemoteIdHeard(Event, frozen=True):
    """One received frame with Remote ID messages."""

    transport: str
    address: str
    """Radio address of the transmitter."""
    messages: tuple[Message, ...]
    rssi_dbm: float | None = None
    counter: int | None = None
    """Message counter of the frame, 0 to 255; None if the radio does not report it."""


class RadioState(Event, frozen=True):
    """Current capabilities of the radios. Sent once at the start and whenever they change."""

    can_send: tuple[str, ...] = ()
    """Transports on which the radios can send, sorted."""
    monitored: tuple[str, ...] = ()
    """Transports on which one of our receivers would hear our own frames."""
    confirmed: tuple[str, ...] = ()
    """Transports that a radio itself reports as on the air."""
    own_addresses: tuple[str, ...] = ()
    """Radio addresses of our own frames."""
    wifi_channel: int | None = None
    """Channel of our Wi-Fi frames."""
    text: str = ""
    """Description of a problem; empty if there is none."""


class OperatorData(Event, frozen=True):
    """Operator data from a ground station (OPEN_DRONE_ID_SYSTEM, _SYSTEM_UPDATE, _OPERATOR_ID, _SELF_ID)."""

    messages: tuple[Message, ...]


class RemoteIdModule(Event, frozen=True):
    """OPEN_DRONE_ID_ARM_STATUS of another component of our vehicle, which is a Remote ID transmitter."""

    component_id: int
    ready: bool
    """MAV_ODID_ARM_STATUS_GOOD_TO_ARM."""
    text: str = ""


class ArmStatus(Command, frozen=True):
    """OPEN_DRONE_ID_ARM_STATUS, sent if we are the vehicle's Remote ID component."""

    ready: bool
    text: str = ""
    """Why Remote ID is not ready. Ground stations recognise "missing basic_id message"."""


class Broadcast(Command, frozen=True):
    """Send these messages once, now."""

    transport: str
    messages: tuple[Message, ...]


class BroadcastChanged(Command, frozen=True):
    """The broadcast on the radio changed."""

    rates: tuple[tuple[str, float], ...]
    """Transports with their messages per second."""
    legal: bool
    """Whether the broadcast meets the legal minimum of the region."""
    reason: str


class TransportsChosen(Command, frozen=True):
    """The transports for our own Remote ID were chosen again.

    What is actually sent also meets the legal minimum of the region (`BroadcastChanged`).
    """

    rates: tuple[tuple[str, int], ...]
    """Transports with their Location messages per second."""
    by: Literal["policy", "rule", "fixed", "fallback"]
    reason: str
