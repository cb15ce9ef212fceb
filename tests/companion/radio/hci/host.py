"""A session with a scripted controller."""

from __future__ import annotations

from companion.radio.frames_io import FrameSender
from companion.radio.hci.advertising import HciCounts
from companion.radio.hci.reports import HeardFrame
from companion.radio.hci.session import HciSession
from companion.remote_id.messages import (
    BasicId,
    IdType,
    Location,
    Message,
    SelfId,
    UaType,
)
from tests.companion.radio.hci.controller import (
    Controller,
)

ADDRESS = "c2:01:02:03:04:05"
LOCATION = Location(lat_deg=47.5, lon_deg=8.5)
SELF_ID = SelfId(description_type=0, text="survey")
SERIAL = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="A1")


class Host:
    """A session wired to a controller; nothing moves but by `run` and `wait`."""

    def __init__(self, controller: Controller, *, send: bool = True, listen: bool = True) -> None:
        self.controller = controller
        self.counts = HciCounts()
        self.now_s = 100.0
        self.sender = FrameSender(ADDRESS)
        self.session = HciSession(ADDRESS, send=send, listen=listen, counts=self.counts, now_s=self.now_s)
        self.run()

    def run(self) -> None:
        """Until both have nothing more to say."""
        for _ in range(1000):
            packets = self.session.packets()
            if not packets:
                return
            answer = self.controller.feed(b"".join(packets))
            if answer:
                self.session.receive(answer, self.now_s)
        raise AssertionError("never quiet")

    def wait(self, duration_s: float) -> None:
        """Time passes, in steps as a thread takes them."""
        end_s = self.now_s + duration_s
        while self.now_s < end_s:
            self.now_s = min(end_s, max(self.now_s + 0.001, min(self.session.next_s, self.now_s + 0.25)))
            self.session.tick(self.now_s)
            self.run()

    def broadcast(self, transport: str, *messages: Message) -> list[bytes]:
        frames = self.sender.frames(transport, messages)
        self.session.offer(transport, frames, self.now_s)
        return frames

    def hear(self, *packets: bytes) -> list[HeardFrame]:
        self.session.receive(b"".join(packets), self.now_s)
        heard = list(self.session.heard)
        self.session.heard.clear()
        return heard
