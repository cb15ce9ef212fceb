"""The commands that prepare a flight find no service manager and no status socket but the test's own."""

from __future__ import annotations

import contextlib
import math
import socket
import threading
import time
from collections.abc import Iterator

import pytest

from companion.autopilot.wire import MavlinkWriter
from tests.companion.runtime.conftest import kept_signals, no_service_manager
from tests.support.place import LAT_E7, LON_E7

__all__ = ["kept_signals", "no_service_manager"]


class Vehicle:
    """A vehicle, system 1, that sends everything fifty times a second to whoever connects."""

    def __init__(self) -> None:
        self.silent: set[str] = set()
        """Messages that it does not send."""
        self.fix_type = 3
        self.clock_off_s = 0.0
        self.old_s = 0.0
        """How old its positions grow within a second."""
        self.lat_e7 = LAT_E7
        self.noise = b""
        self.forwarded = b""
        """Frames of others."""
        self._began_s = time.monotonic()
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.05)
        self.port = self._server.getsockname()[1]
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _frames(self, writer: MavlinkWriter) -> bytes:
        encode, up_s = writer.encoder, time.monotonic() - self._began_s
        boot_ms = round((100.0 + up_s * (1.0 - self.old_s)) * 1e3)
        unix_us = 0 if self.clock_off_s == math.inf else round((time.time() - self.clock_off_s) * 1e6)
        place = self.lat_e7, LON_E7 if self.lat_e7 else 0
        messages = (
            encode.heartbeat_encode(2, 3, 1, 5, 4),
            encode.global_position_int_encode(boot_ms, *place, 450_000, 50_000, 0, 0, 0, 0),
            encode.local_position_ned_encode(boot_ms, 0, 0, 0, 0, 0, 0),
            encode.gps_raw_int_encode(0, self.fix_type, *place, 450_000, 0, 0, 0, 0, 12),
            encode.extended_sys_state_encode(0, 1),
            encode.system_time_encode(unix_us, boot_ms),
            encode.mission_current_encode(0),
        )
        return (
            self.noise
            + self.forwarded
            + b"".join(writer.pack(m) for m in messages if m.get_type() not in self.silent)
        )

    def _serve(self) -> None:
        writer, peers = MavlinkWriter(1, 1), list[socket.socket]()
        while not self._ended.wait(0.02):
            with contextlib.suppress(TimeoutError):
                peers.append(self._server.accept()[0])
                self._server.settimeout(0.001)
            for peer in list(peers):
                try:
                    peer.sendall(self._frames(writer))
                except OSError:
                    peers.remove(peer)
                    peer.close()
        for peer in peers:
            peer.close()

    def end(self) -> None:
        """Drop all connections and the port."""
        self._ended.set()
        self._thread.join(60.0)
        self._server.close()


@pytest.fixture
def vehicle(monkeypatch: pytest.MonkeyPatch) -> Iterator[Vehicle]:
    monkeypatch.setattr("companion.commands.check._SETTLE_S", 0.1)
    monkeypatch.setattr("companion.commands.check._MEASURE_S", 0.5)
    # It tells no parameters.
    monkeypatch.setattr("companion.commands.check._PARAMETERS_S", 0.2)
    made = Vehicle()
    yield made
    made.end()
