"""What a service manager and the status socket are told of a flight."""

from __future__ import annotations

import contextlib
import socket
import threading
import time

import msgspec
import pytest

from companion.avoidance.law import Neighbour
from companion.commands import status
from companion.config import VehicleConfig
from companion.errors import ConfigError
from companion.runtime.flight import Flight
from companion.runtime.status import live_state
from companion.traffic.tracks import BESIDE_NAME
from tests.companion.runtime.flying import (
    LONG_S,
    configured,
    fly,
    heard_of,
    summary,
)


@pytest.fixture
def manager(tmp_path, monkeypatch):
    """What a service manager with a watchdog is told."""
    name = str(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", name)
    monkeypatch.setenv("WATCHDOG_USEC", "20000")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind(name)
        server.setblocking(False)

        def told():
            lines = []
            with contextlib.suppress(BlockingIOError):
                while True:
                    lines.append(server.recv(4096).decode())
            return lines

        yield told


def test_the_service_manager_is_told_from_the_loop_alone(manager, flight, said, until):
    """A loop that hangs pings no more; one that goes on does again."""
    hang, hanging = threading.Event(), threading.Event()
    tick, told = flight.onboard.tick, []

    def stuck(now_s, **read):
        if hang.is_set():
            hanging.set()
            until(lambda: not hang.is_set())
        return tick(now_s, **read)

    flight.onboard.tick = stuck

    def hung():
        hang.set()
        until(hanging.is_set)
        told.extend(manager())
        time.sleep(0.3)
        assert "WATCHDOG=1" not in manager()
        hang.clear()
        until(lambda: "WATCHDOG=1" in manager())

    before = manager()
    fly(flight, lambda: until(heard_of(said, "recording to")), lambda: until(lambda: flight._ticks > 5), hung)
    assert before == [], "not ready before the vehicle is there"
    assert told.index("READY=1") < told.index("WATCHDOG=1")
    assert any(line.startswith("STATUS=standby: ") for line in told)
    assert manager()[-1] == "STOPPING=1"


def test_a_flight_that_finds_no_vehicle_is_never_ready(manager, make_config, tmp_path, kept_signals):
    config = configured(make_config, tmp_path, 0)
    config = msgspec.structs.replace(config, vehicle=VehicleConfig(link="udpin:127.0.0.1:0", wait_s=0.2))
    flight = Flight(config, lambda _line: None, dry_run=False)
    with pytest.raises(ConfigError, match="no vehicle"):
        flight.run()
    assert manager() == []


def test_the_live_state_is_served_and_gone_with_the_flight(flight, said, until):
    states = []

    def asked():
        states.append(status.ask(flight._server.path))
        status.render(states[0])

    fly(flight, lambda: until(heard_of(said, "recording to")), asked)
    (state,) = states
    assert state.aircraft == "OWN"
    assert state.state == "standby"
    assert state.mode is not None
    assert state.vehicle.startswith("ardupilot, system 1")
    assert state.folder == str(flight.folder)
    assert state.heartbeat_age_s < LONG_S
    assert state.position_age_s is None
    assert any("recording to" in line for line in state.said)
    assert not flight._server.path.exists()


def test_a_bug_in_what_is_shown_does_not_end_the_flight(flight, said, until, monkeypatch):
    monkeypatch.setattr(flight, "live", lambda _now_s: 1 // 0)
    path = flight._server.path

    def asked():
        with pytest.raises(ConfigError):
            status.ask(path)
        ticks = flight._ticks
        until(lambda: flight._ticks > ticks + 3)

    fly(flight, lambda: until(heard_of(said, "recording to")), asked)
    assert sum("status: no longer served: ZeroDivisionError" in line for line in said) == 1
    assert summary(flight)["ticks"] > 0


def test_a_second_companion_of_the_name_flies_without_a_socket(
    flight, autopilot, make_config, tmp_path, said
):
    before = len(said)
    second = Flight(configured(make_config, tmp_path, autopilot.port), said.append, dry_run=False)
    second._close()
    assert heard_of(said, "another companion of this name", before)()
    assert flight._server.path.exists(), "the first one's"
    flight._close()


def test_the_place_of_a_signal_is_shown_with_the_doubts_of_its_track():
    there = Neighbour("X" + BESIDE_NAME, (30.0, 40.0, -50.0), (3.0, 4.0, 0.0), 0.0, 1.5)
    doubts = ("signal_mismatch",)
    shown = live_state._track(
        there, (0.0, 0.0, -40.0), {}, {(False, there.track_id)}, {"X": ("wifi", doubts)}
    )
    assert (shown.track_id, shown.transport, shown.doubts) == (there.track_id, "wifi", doubts)
    assert (shown.distance_m, shown.above_m, shown.conflict) == (50.0, 10.0, True)
