"""All links of one mock vehicle, and the forwarding of frames from one link to another."""

from __future__ import annotations

from companion.autopilot.signing import Signing
from companion.autopilot.wire import Frame, MavlinkMessage
from sitl_mocks.vehicle.firmware.behaviour import Manners
from sitl_mocks.vehicle.links import Link, Payload, SetpointMessage


class LinkSet(dict[int, Link]):
    """Links by their numbers.

    Args:
        address: system and component id of the vehicle.
        manners: behaviour of the firmware, which gives the message streams of a fresh link.
    """

    def __init__(self, address: tuple[int, int], manners: Manners, signing: Signing | None) -> None:
        super().__init__()
        self._address = address
        self._manners = manners
        self._signing = signing
        self._routes: dict[tuple[int, int], int] = {}
        """Link on which each system and component was heard last."""

    def open(self, number: int, now_s: float) -> None:
        """Open or reopen a link with only the message streams that every fresh link carries."""
        streams = self._manners.fresh_streams
        self[number] = Link(self._address[0], streams, now_s, self._signing, number % 256)

    def forget(self, number: int) -> None:
        """Forget a link with its message rates and its unsent bytes."""
        self.pop(number, None)
        self._routes = {route: via for route, via in self._routes.items() if via != number}

    def send(self, message: MavlinkMessage | Payload) -> None:
        """Send a message on every link."""
        for link in self.values():
            link.send(message)

    def pass_on(self, frame: bytes) -> None:
        """Send a frame of another component of this vehicle on every link."""
        signed = frame if self._signing is None else self._signing.sign(frame, 0)
        for link in self.values():
            link.pass_on(signed)

    def forward(self, frame: Frame, message: MavlinkMessage | SetpointMessage, number: int) -> None:
        """Forward a frame: without a target to all other links, else to links where its target was heard."""
        self._routes[frame.system_id, frame.component_id] = number
        target = (getattr(message, "target_system", 0), getattr(message, "target_component", 0))
        if target == self._address:
            return
        for other, link in self.items():
            known = any(
                via == other and target[0] in (0, system) and target[1] in (0, component)
                for (system, component), via in self._routes.items()
            )
            if other != number and (target[0] == 0 or known):
                link.pass_on(frame.raw)
