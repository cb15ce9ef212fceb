"""No radio: sends nowhere and hears nothing, and says so. For bench tests and for flights that only watch."""

from __future__ import annotations

from collections.abc import Mapping

from companion.events import RemoteIdHeard
from companion.radio.radio import Health
from companion.remote_id.messages import Message


class NullTransport:
    """A `Radio` without a radio behind it."""

    @property
    def capabilities(self) -> frozenset[str]:
        """None."""
        return frozenset()

    @property
    def hears(self) -> frozenset[str]:
        """Nothing."""
        return frozenset()

    @property
    def own_addresses(self) -> frozenset[str]:
        """None."""
        return frozenset()

    @property
    def wifi_channel(self) -> int | None:
        """None."""
        return None

    def configure(self, rates: Mapping[str, int], *, probe: bool = False) -> tuple[str, ...]:
        """Nothing to prepare."""
        return ()

    def broadcast(self, transport: str, messages: tuple[Message, ...], now_s: float) -> None:
        """Raises ValueError: there is nothing to send with."""
        raise ValueError(f"no radio: {transport!r} cannot be sent")

    def heard(self, now_s: float) -> list[RemoteIdHeard]:
        """Nothing, ever."""
        return []

    def health(self, now_s: float) -> Health:
        """Never ok: nobody sees this aircraft and it sees nobody."""
        return Health(
            ok=False,
            text="no radio (backend null): nothing is sent and nobody is heard",
            frames_sent=0,
            frames_heard=0,
            bad_frames=0,
        )

    def close(self) -> None:
        """Nothing to release."""
