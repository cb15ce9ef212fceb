"""Interface between Remote ID messages and a radio."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from companion.events import RemoteIdHeard
from companion.remote_id.messages import Message


@dataclass(frozen=True, slots=True)
class Health:
    """State of a radio, in words for the pilot."""

    ok: bool
    text: str
    frames_sent: int
    frames_heard: int
    bad_frames: int
    can_send: frozenset[str] = frozenset()
    """Transports that the radio can send on now; a subset of its capabilities."""
    confirmed: frozenset[str] | None = None
    """Transports that the radio itself reports as being on the air now (a module's status); None if it cannot
    tell."""
    missing: tuple[str, ...] = ()
    """One plain sentence for each function that needs other hardware, rights or settings."""


class Radio(Protocol):
    """One or several radios that send and receive Remote ID. Implementations own their sockets.

    Opening one (its constructor) may take seconds and raises ConfigError. After that nothing blocks. Only
    ValueError is raised, for messages or transports that cannot be sent; `health` reports every other
    failure.
    """

    @property
    def capabilities(self) -> frozenset[str]:
        """Transports that the hardware can send on: `BLE4`, `BLE5`, `WIFI_BEACON`, `WIFI_NAN`."""
        ...

    @property
    def hears(self) -> frozenset[str]:
        """Transports that it receives. A radio does not receive its own transmissions."""
        ...

    @property
    def own_addresses(self) -> frozenset[str]:
        """Radio addresses that it sends from (lower-case hex with colons), as other receivers report them."""
        ...

    @property
    def wifi_channel(self) -> int | None:
        """Channel of its Wi-Fi frames; None without Wi-Fi."""
        ...

    def configure(self, rates: Mapping[str, int], *, probe: bool = False) -> tuple[str, ...]:
        """Prepare for these transports and message rates (per second), before arming. May take seconds.

        Args:
            probe: Change nothing, here or on the hardware. Only report what would be changed.

        Returns:
            Sentences about the rates of a radio that repeats by itself: which were set, which it had already.

        Raises:
            ConfigError: the hardware cannot do it. The text says why.
        """
        ...

    def broadcast(self, transport: str, messages: tuple[Message, ...], now_s: float) -> None:
        """Send these messages once.

        Raises:
            ValueError: a transport outside `capabilities`, or messages that cannot be sent.
        """
        ...

    def heard(self, now_s: float) -> list[RemoteIdHeard]:
        """Return the messages that arrived since the last call. Bad frames are counted, never raised."""
        ...

    def health(self, now_s: float) -> Health:
        """Return the current state."""
        ...

    def close(self) -> None:
        """Stop sending and release the radio."""
        ...
