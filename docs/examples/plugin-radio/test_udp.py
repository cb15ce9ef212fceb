"""The radio passes the kit."""

import socket

from dmuca.testing import RadioConformance


class TestUdp(RadioConformance):
    name = "udp"

    def options(self):
        return {"to": "127.0.0.1:9"}

    def bad_options(self):
        return {"to": "127.0.0.1:9", "lisen": 15555}

    def feed(self, radio, transport, frame):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.sendto(transport.encode() + b"\0" + frame, radio.socket.getsockname())
