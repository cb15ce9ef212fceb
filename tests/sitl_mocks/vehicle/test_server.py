"""The mock vehicle's server on real loopback sockets; the test passes the time in."""

from __future__ import annotations

import argparse
import json
import re
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator

import numpy
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from companion.errors import ConfigError
from sitl_mocks.vehicle.mock_vehicle import VehicleOptions
from sitl_mocks.vehicle.real_time import server as vehicle_server
from sitl_mocks.vehicle.real_time.server import VehicleServer

WRITER = MavlinkWriter(1, 191)


def command(number: int, *params: float) -> bytes:
    filled = (*params, *([0.0] * (7 - len(params))))
    return WRITER.pack(mavlink.MAVLink_command_long_message(1, 1, number, 0, *filled))


def port_of(name: str) -> int:
    return int(name.rpartition(":")[2])


class Peer:
    """A UDP socket of a client."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.0)
        self.reader = MavlinkReader()

    @property
    def port(self) -> int:
        return int(self.socket.getsockname()[1])

    def names(self) -> Counter[str]:
        """Messages received since the last call."""
        found: Counter[str] = Counter()
        while True:
            try:
                data = self.socket.recv(65536)
            except BlockingIOError:
                return found
            found.update(m.get_type() for m in self.reader.feed(data))


@pytest.fixture
def peers() -> Iterator[list[Peer]]:
    made = [Peer(), Peer()]
    yield made
    for peer in made:
        peer.socket.close()


@pytest.fixture
def serve() -> Iterator[object]:
    servers = []

    def make(*links: str) -> VehicleServer:
        server = VehicleServer(VehicleOptions(), list(links), numpy.random.default_rng(0))
        servers.append(server)
        return server

    yield make
    for server in servers:
        server.close()


def turn(server: VehicleServer, start_s: float, seconds: float) -> None:
    for tick in range(1, round(seconds * 50) + 1):
        server.turn(start_s + tick * 0.02)


def test_udpout_sends_to_its_peer_and_hears_only_that_peer(serve, peers):
    server = serve(f"udpout:127.0.0.1:{peers[0].port}")
    turn(server, 0.0, 2.0)
    assert peers[0].names()["HEARTBEAT"] == 3
    own_port = server._ports[0].sockets()[0].getsockname()[1]
    peers[1].socket.sendto(command(512, 242.0), ("127.0.0.1", own_port))
    turn(server, 2.0, 0.1)
    assert not peers[0].names()
    assert not peers[1].names()
    peers[0].socket.sendto(command(512, 242.0), ("127.0.0.1", own_port))
    turn(server, 2.1, 0.1)
    assert peers[0].names() == {"HOME_POSITION": 1, "COMMAND_ACK": 1}


def test_udpin_gives_every_peer_its_own_rates(serve, peers):
    server = serve("udpin:127.0.0.1:0")
    at = ("127.0.0.1", port_of(server.names[0]))
    peers[0].socket.sendto(command(511, 30.0, 1e5), at)
    peers[1].socket.sendto(command(511, 33.0, 1e5), at)
    turn(server, 0.0, 2.0)
    first, second = peers[0].names(), peers[1].names()
    assert first["ATTITUDE"] >= 19
    assert second["GLOBAL_POSITION_INT"] >= 19
    assert first["GLOBAL_POSITION_INT"] == second["ATTITUDE"] == 0
    turn(server, 62.0, 0.1)
    assert server._ports[0]._links == {}


def test_tcp_link_ends_at_a_reboot_and_takes_new_clients(serve):
    server = serve("tcpin:127.0.0.1:0")
    at = ("127.0.0.1", port_of(server.names[0]))
    with socket.create_connection(at, 60) as client:
        client.sendall(command(511, 30.0, 1e5))
        turn(server, 0.0, 1.0)
        names = Counter(m.get_type() for m in MavlinkReader().feed(client.recv(65536)))
        assert names["ATTITUDE"] >= 9
        client.sendall(command(246, 1.0))
        turn(server, 1.0, 0.1)
        client.settimeout(60.0)
        while client.recv(65536):
            pass
    with socket.create_connection(at, 60) as client:
        turn(server, 1.1, 5.0)
        names = Counter(m.get_type() for m in MavlinkReader().feed(client.recv(65536)))
        assert names["HEARTBEAT"] >= 2
        assert names["ATTITUDE"] == 0
    turn(server, 6.1, 0.1)
    assert server._ports[0].sockets()[1:] == []


def test_several_links_at_once(serve, peers):
    server = serve(f"udpout:127.0.0.1:{peers[0].port}", f"udpout:127.0.0.1:{peers[1].port}", "tcpin::0")
    turn(server, 0.0, 1.0)
    assert peers[0].names()["HEARTBEAT"] == peers[1].names()["HEARTBEAT"] == 2
    assert server.names[2].startswith("tcpin:127.0.0.1:")


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_port_in_use_is_a_plain_sentence(serve, kind):
    taken = serve(f"{kind}:127.0.0.1:0")
    with pytest.raises(ConfigError, match="already in use"):
        serve(taken.names[0])


@pytest.mark.parametrize(
    "spec", ["", "udp:1.2.3.4:5", "udpin:127.0.0.1", "udpin:127.0.0.1:x", "udpin:127.0.0.1:70000",
             "udpout:127.0.0.1:0", "udpin:no such host:1"],
)  # fmt: skip
def test_bad_link_texts(serve, spec):
    with pytest.raises(ConfigError, match="link"):
        serve(spec)


def test_arguments_become_options():
    parser = argparse.ArgumentParser()
    vehicle_server.add_arguments(parser)
    words = "--firmware px4 --system-id 3 --airborne 40 --start 5 6 --mode hold --no-rc"
    args = parser.parse_args(words.split())
    options = vehicle_server.options_of(args)
    assert options.start_position_ned_m == (5.0, 6.0, -40.0)
    assert (options.airborne, options.system_id, options.rc_connected) == (True, 3, False)
    with pytest.raises(ConfigError):
        vehicle_server.options_of(parser.parse_args(["--system-id", "0"]))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_process_prints_its_ports_and_its_stalls_and_ends_cleanly(number):
    code = (
        "import argparse, sys\nfrom sitl_mocks.vehicle.real_time import server as v\n"
        "p = argparse.ArgumentParser(); v.add_arguments(p); sys.exit(v.run(p.parse_args()))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, "--link", "udpin::0", "--airborne", "30"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stderr is not None
        assert port_of(process.stdout.readline()) > 0
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.5)
        process.send_signal(signal.SIGCONT)
        told = r"the program was stopped for \d+\.\d s; the vehicle flew on without its links\n"
        assert re.fullmatch(told, process.stderr.readline())
        process.send_signal(number)
        said, _ = process.communicate(timeout=60)
        assert process.returncode == 0
        assert json.loads(said)["position_ned_m"] == [0.0, 0.0, -30.0]
    finally:
        process.kill()
        process.wait(timeout=60)
