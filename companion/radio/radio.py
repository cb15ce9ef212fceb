"""Interface between Remote ID messages and a radio."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from companion.events import RemoteIdHeard
from companion.radio.frames_io import radio_address
from companion.remote_id.messages import Message


class ByteLink(Protocol):
    """A link over which a radio is driven. Only `wait` takes time."""

    def wait(self, timeout_s: float) -> None:
        """Wait until bytes arrive, at most this long."""
        ...

    def receive(self, now_s: float) -> bytes:
        """Return the bytes that have arrived."""
        ...

    def send(self, data: bytes) -> None:
        """Send now. Bytes that cannot be sent now are lost."""
        ...

    def close(self) -> None:
        """Release the link."""
        ...


@dataclass(frozen=True, slots=True)
class RadioContext:
    """What a driver receives in addition to its section of the configuration."""

    name: str
    """Name of the aircraft."""
    now_s: Callable[[], float]
    """The monotonic clock (s)."""
    open_link: Callable[[str], ByteLink]
    """Opens a link of a form in `LINK_FORMS` and reopens it when it is lost. Raises ConfigError."""

    @property
    def address(self) -> str:
        """Radio address of the aircraft, derived from its name."""
        return radio_address(self.name)


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
