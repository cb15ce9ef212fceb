"""The router's end of a companion's link, and the configuration that a companion of the swarm is given."""

from __future__ import annotations

import contextlib
import select
import selectors
import socket
import struct
from pathlib import Path

import pytest

from companion import config as configuration
from companion.runtime.links.unsent import unsent_bytes
from sitl_mocks.encounters import swarm
from sitl_mocks.encounters.lockstep import paths_of
from sitl_mocks.encounters.scenario_file import DEFAULT
from sitl_mocks.examinations.modelled_link import Weather
from sitl_mocks.examinations.processes.companion_ends import TcpEnd
from tests.support.waiting import until

CALM = Weather()
PATIENCE_S = 30.0


@pytest.fixture
def end():
    with contextlib.closing(selectors.DefaultSelector()) as selector:
        found = TcpEnd(selector)
        yield found
        found.close()


def connect(end):
    sock = socket.create_connection(("127.0.0.1", int(end.name.rsplit(":", 1)[1])), timeout=PATIENCE_S)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    before = end.connections
    until(lambda: end.read(0.0, CALM) or end.connections > before, "a connection")
    return sock


def test_a_half_open_stream_acknowledges_nothing_and_does_not_learn_of_a_reset(end):
    companion = connect(end)
    cut = Weather(up_stands=True)
    end.read(1.0, cut)
    assert not end.confirms
    companion.send(b"lost")
    assert unsent_bytes(companion) == 4
    companion.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    companion.close()  # resets the connection
    assert end.read(2.0, cut) == []
    assert end.connected
    end.read(3.0, CALM)
    assert end.confirms
    end.write(b"to nobody")
    until(lambda: not (end.read(4.0, CALM) or end.connected), "the end of the old connection")
    with connect(end) as again:
        again.send(b"heard")
        assert until(lambda: end.read(5.0, CALM))[0].data == b"heard"


def test_a_short_cut_delays_what_was_sent(end):
    with connect(end) as companion:
        end.read(1.0, Weather(up_stands=True))
        companion.send(b"late")
        end.read(1.1, CALM)
        assert until(lambda: end.read(1.2, CALM))[0].data == b"late"


def test_a_slow_stream_is_read_at_its_rate_and_holds_the_companion_up(end):
    slow = Weather(rate_bps=8000.0)
    with connect(end) as companion:
        companion.setblocking(False)
        end.read(10.0, slow)
        assert end.polled
        with contextlib.suppress(BlockingIOError):
            for _ in range(100_000):
                companion.send(bytes(65))
        assert select.select([], [companion], [], 0.0)[1] == []
        end.read(10.0, slow)
        (left,) = end.read(10.1, slow)
        assert len(left.data) == pytest.approx(80, abs=1)  # 800 bytes a second
        assert left.at_s == pytest.approx(10.0)
        assert left.waited_s == pytest.approx(0.1)
        end.read(10.2, CALM)
        assert not end.polled


def test_time_in_a_slow_far_end_is_told_apart_from_time_in_the_companion(end):
    slow = Weather(rate_bps=8000.0)
    with connect(end) as companion:
        end.read(9.99, CALM)
        companion.send(bytes(100))
        first = until(lambda: end.read(10.01, slow))
        (rest,) = end.read(12.0, slow)
        assert first[0].waited_s == 0.0
        assert rest.at_s == pytest.approx(10.01)
        assert rest.at_s + rest.waited_s == pytest.approx(12.0)
        assert len(first[0].data) == pytest.approx(16, abs=1)  # 800 bytes a second for 0.02 s
        assert len(first[0].data) + len(rest.data) == 100


def test_companions_record_in_the_run_folder_also_where_its_path_is_relative(tmp_path, monkeypatch):
    """A relative `record.folder` would be relative to the configuration, which is in the run folder."""
    monkeypatch.chdir(tmp_path)
    folder = Path("runs/one")
    folder.mkdir(parents=True)
    monkeypatch.setattr(swarm.Swarm, "start", lambda *arguments, **options: None)
    swarm._start_companion(
        swarm.Swarm(folder), swarm.Plan(DEFAULT, 1, 60.0, (0,), {}), "DMUCA001", paths_of(DEFAULT, 1)[0],
        "udpout:127.0.0.1:14540", "127.0.0.1:14640", 1e9,
    )  # fmt: skip
    assert Path(configuration.load(folder / "DMUCA001.toml").record.folder) == tmp_path / folder
