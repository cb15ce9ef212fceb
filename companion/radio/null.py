"""No radio: sends nowhere and hears nothing, and says so. For bench tests and for flights that only watch."""

from __future__ import annotations

from companion.events import RemoteIdHeard
from companion.radio.transport import BLE4, BLE5, WIFI_BEACON, Health
from companion.remote_id.messages import Message


class NullTransport:
    """A `Transport` without a radio behind it."""

    @property
    def capabilities(self) -> frozenset[str]:
        """All transports: whatever would be sent is dropped alike."""
        return frozenset((BLE4, BLE5, WIFI_BEACON))

    def broadcast(self, transport: str, messages: tuple[Message, ...], now_s: float) -> None:
        """Drop the messages. Raises ValueError for a transport outside `capabilities`."""
        if transport not in self.capabilities:
            raise ValueError(f"no such transport: {transport!r}")

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
