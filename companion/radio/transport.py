"""The one interface between Remote ID messages and a radio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from companion.events import RemoteIdHeard
from companion.remote_id.messages import Message

BLE4 = "ble4"
BLE5 = "ble5"
WIFI_BEACON = "wifi"


@dataclass(frozen=True, slots=True)
class Health:
    """State of a radio, in words a pilot reads."""

    ok: bool
    text: str
    frames_sent: int
    frames_heard: int
    bad_frames: int


class Transport(Protocol):
    """A radio (or several) that sends and hears Remote ID. Implementations own their sockets."""

    @property
    def capabilities(self) -> frozenset[str]:
        """Transports that can be sent on: `BLE4`, `BLE5`, `WIFI_BEACON`."""
        ...

    def broadcast(self, transport: str, messages: tuple[Message, ...], now_s: float) -> None:
        """Send these messages once. Raises ValueError for a transport outside `capabilities`."""
        ...

    def heard(self, now_s: float) -> list[RemoteIdHeard]:
        """What arrived since the last call. Bad frames are counted, never raised."""
        ...

    def health(self, now_s: float) -> Health:
        """State now."""
        ...

    def close(self) -> None:
        """Release the radio."""
        ...
