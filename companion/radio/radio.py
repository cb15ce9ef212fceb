"""The one interface between Remote ID messages and a radio."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from companion.events import RemoteIdHeard
from companion.remote_id.messages import Message


@dataclass(frozen=True, slots=True)
class Health:
    """State of a radio, in words a pilot reads."""

    ok: bool
    text: str
    frames_sent: int
    frames_heard: int
    bad_frames: int
    can_send: frozenset[str] = frozenset()
    """Transports that the radio can send on now; a subset of its capabilities."""
    confirmed: frozenset[str] | None = None
    """Transports that the radio itself reports as being on the air now (a module's status); None where it
    cannot tell."""
    missing: tuple[str, ...] = ()
    """What this radio could do with other hardware, rights or settings, one plain sentence each."""


class Radio(Protocol):
    """A radio (or several) that sends and hears Remote ID. Implementations own their sockets.

    Opening one (its constructor) may take seconds and raises ConfigError; after that nothing blocks, and only
    ValueError is raised, for messages or transports that cannot be sent: what fails shows in `health`.
    """

    @property
    def capabilities(self) -> frozenset[str]:
        """Transports that the hardware can send on: `BLE4`, `BLE5`, `WIFI_BEACON`, `WIFI_NAN`."""
        ...

    @property
    def hears(self) -> frozenset[str]:
        """Transports that it listens to; a radio does not hear what it sends itself."""
        ...

    @property
    def own_addresses(self) -> frozenset[str]:
        """Radio addresses that it sends from (lower-case hex with colons), as others report them."""
        ...

    @property
    def wifi_channel(self) -> int | None:
        """Channel that its Wi-Fi frames go out on; None without Wi-Fi."""
        ...

    def configure(self, rates: Mapping[str, int], *, probe: bool = False) -> tuple[str, ...]:
        """Prepare for these transports and message rates (per second), before arming; may take seconds.

        Args:
            probe: change nothing, here or on the hardware, and only say what would be changed.

        Returns:
            The rates of a radio that repeats by itself, in words: what was set on it, what it had already.

        Raises:
            ConfigError: the hardware cannot, in words.
        """
        ...

    def broadcast(self, transport: str, messages: tuple[Message, ...], now_s: float) -> None:
        """Send these messages once.

        Raises:
            ValueError: a transport outside `capabilities`, or messages that cannot be sent.
        """
        ...

    def heard(self, now_s: float) -> list[RemoteIdHeard]:
        """What arrived since the last call. Bad frames are counted, never raised."""
        ...

    def health(self, now_s: float) -> Health:
        """State now."""
        ...

    def close(self) -> None:
        """Go off the air and release the radio."""
        ...
