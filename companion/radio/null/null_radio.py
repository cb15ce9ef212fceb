"""A placeholder for a missing radio: it neither sends nor receives, and its `health` says so.

It is meant for bench tests and for flights that only observe.
"""

from __future__ import annotations

from collections.abc import Mapping

from companion.events import RemoteIdHeard
from companion.radio.null.section import NullRadio
from companion.radio.radio import Health, RadioContext
from companion.remote_id.messages import Message


class NullTransport:
    """A `Radio` without hardware."""

    @property
    def capabilities(self) -> frozenset[str]:
        """No transports."""
        return frozenset()

    @property
    def hears(self) -> frozenset[str]:
        """No transports."""
        return frozenset()

    @property
    def own_addresses(self) -> frozenset[str]:
        """No addresses."""
        return frozenset()

    @property
    def wifi_channel(self) -> int | None:
        """None, as there is no Wi-Fi."""
        return None

    def configure(self, rates: Mapping[str, int], *, probe: bool = False) -> tuple[str, ...]:
        """Do nothing."""
        return ()

    def broadcast(self, transport: str, messages: tuple[Message, ...], now_s: float) -> None:
        """Raise ValueError, because there is nothing to send with."""
        raise ValueError(f"no radio: {transport!r} cannot be sent")

    def heard(self, now_s: float) -> list[RemoteIdHeard]:
        """Return no messages."""
        return []

    def health(self, now_s: float) -> Health:
        """Report a state that is never ok: this aircraft is not visible to others and cannot see them."""
        return Health(
            ok=False,
            text="no radio (backend null): nothing is sent and nobody is heard",
            frames_sent=0,
            frames_heard=0,
            bad_frames=0,
        )

    def close(self) -> None:
        """Do nothing."""


def open_radio(_section: NullRadio, _context: RadioContext) -> NullTransport:
    """Make the placeholder."""
    return NullTransport()
