"""The radio passes the kit."""

import contextlib
import socket

from companion.radio.frames_io import FrameSender, radio_address
from companion.remote_id.messages import SelfId
from dmuca.testing import RadioConformance


class TestUdp(RadioConformance):
    name = "udp"

    def setup_method(self):
        self.air = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.air.bind(("127.0.0.1", 0))
        self.air.setblocking(False)

    def teardown_method(self):
        self.air.close()

    def options(self):
        return {"to": f"127.0.0.1:{self.air.getsockname()[1]}"}

    def bad_options(self):
        return {"to": "127.0.0.1:9", "lisen": 15555}

    def sent(self, radio):
        with contextlib.suppress(BlockingIOError):
            while True:
                transport, _, frame = self.air.recv(4096).partition(b"\0")
                yield transport.decode(), frame

    def feed(self, radio, transport, frame):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.sendto(transport.encode() + b"\0" + frame, radio.socket.getsockname())

    def test_senders_on_ble_are_told_apart(self):
        with contextlib.closing(self.open()) as radio:
            words = SelfId(description_type=0, text="hello")
            (frame,) = FrameSender(radio_address("OTHER")).frames("ble4", [words])
            with contextlib.ExitStack() as stack:
                for _ in range(2):
                    other = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                    other.sendto(b"ble4\0" + frame, radio.made.socket.getsockname())
                assert len({event.address for event in radio.heard(0.0)}) == 2
