"""The other ends of a flight, and how a test runs one."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time

import msgspec
import numpy as np

from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from companion.config import RecordConfig, VehicleConfig
from companion.events import RadioState
from companion.radio.null.null_radio import NullTransport
from companion.runtime import clock
from companion.runtime.links.byte_link import Received
from sitl_mocks.vehicle.firmware.behaviour import MANNERS
from sitl_mocks.vehicle.mock_vehicle import MockVehicle
from sitl_mocks.vehicle.options import VehicleOptions

LONG_S = 60.0
KEY = bytes.fromhex("d4ee003d187614d9ffa24d20f58b448551c2cdc1e54cf42fc00bb86182249126")


class Autopilot:
    """The autopilot's side of a TCP link: sends heartbeats to whoever connects."""

    def __init__(self, port=0, wrap=bytes):
        self._wrap = wrap
        self.armed = False
        self._server = socket.socket()
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._server.bind(("127.0.0.1", port))
        self._server.listen()
        self._server.settimeout(0.05)
        self.port = self._server.getsockname()[1]
        self.commands = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        with self._server:
            while not self._ended.is_set():
                try:
                    peer = self._server.accept()[0]
                except TimeoutError:
                    continue
                with peer, contextlib.suppress(ConnectionError):
                    self._speak(peer)

    def _speak(self, peer):
        writer, reader = MavlinkWriter(1, 1), MavlinkReader()
        peer.setblocking(False)
        while not self._ended.wait(0.02):
            base_mode = 129 if self.armed else 1
            peer.sendall(self._wrap(writer.pack(writer.encoder.heartbeat_encode(2, 3, base_mode, 5, 4))))
            try:
                data = peer.recv(65536)
            except BlockingIOError:
                continue
            self.commands += [m for m in reader.feed(data) if m.get_type() == "COMMAND_LONG"]

    def end(self):
        """Drop the connection and the port."""
        self._ended.set()
        self._thread.join(LONG_S)


class Radio(NullTransport):
    """Keeps when it was asked to broadcast; refuses if told to."""

    def __init__(self):
        self.broadcasts = 0
        self.refusals = []
        self.closed = False
        self._states = [RadioState(can_send=("wifi",))]

    def events(self, now_s):
        states, self._states = self._states, []
        return states

    def broadcast(self, transport, messages, now_s):
        self.broadcasts += 1
        if self.refusals:
            raise ValueError(self.refusals[self.broadcasts % len(self.refusals)])

    def close(self):
        self.closed = True


def configured(make_config, tmp_path, port):
    return msgspec.structs.replace(
        make_config(use="watch"),
        vehicle=VehicleConfig(link=f"tcp:127.0.0.1:{port}", wait_s=LONG_S),
        record=RecordConfig(folder=str(tmp_path)),
    )


def fly(flight, *script):
    """Run the flight while a thread does `script` in turn, then stops it; what failed there fails here."""
    failed = []

    def act():
        try:
            for part in script:
                part()
        except AssertionError as error:
            failed.append(error)
        finally:
            flight.stop()

    thread = threading.Thread(target=act, daemon=True)
    thread.start()
    flight.run()
    thread.join(LONG_S)
    if failed:
        raise failed[0]


def summary(flight):
    return json.loads((flight.folder / "summary.json").read_text())


def heard_of(said, text, after=0):
    """A condition for `until`: a line with `text` was said."""
    return lambda: any(text in line for line in said[after:])


class Joined:
    """A link whose other end is a mock vehicle in this process; keeps every frame that left."""

    up = True

    def __init__(self, firmware):
        options = VehicleOptions(
            firmware=firmware,
            airborne=True,
            start_position_ned_m=(0.0, 0.0, -50.0),
            start_mode=MANNERS[firmware].waits_in,
            utc_at_zero_s=time.time() - clock.now_s(),
        )
        self.vehicle = MockVehicle(options, np.random.default_rng(1), clock.now_s())
        self.left = []
        self._reader = MavlinkReader()

    def wait(self, timeout_s):
        time.sleep(min(timeout_s, 0.01))

    def receive(self, now_s):
        self.vehicle.advance(now_s)
        return Received(self.vehicle.drain())

    def send(self, data):
        self.left += self._reader.feed(data)
        self.vehicle.receive(data, clock.now_s())

    def discard(self):
        """Nothing waits."""

    def close(self):
        """Nothing to release."""
