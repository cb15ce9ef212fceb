"""The simulated air as a real process: clients hear each other over loopback, hostile bytes are survived."""

import argparse
import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from companion.errors import ConfigError
from companion.events import RemoteIdHeard
from companion.radio.ether import datagrams
from companion.radio.ether.datagrams import SILENCE_S, Heard, Join, Leave, Send, Welcome
from companion.radio.ether.ether_radio import EtherTransport
from companion.radio.frames_io import FrameSender, radio_address
from companion.remote_id.messages import Location, SelfId
from sitl_mocks.air.server import MAX_CLIENTS, EtherServer, add_arguments, run
from sitl_mocks.channel.simple import SimpleChannel
from tests.support.waiting import PATIENCE_S, until

PROGRAM = """
import argparse, sys
from sitl_mocks.air.server import add_arguments, run
parser = argparse.ArgumentParser()
add_arguments(parser)
sys.exit(run(parser.parse_args()))
"""
MESSAGES = (SelfId(description_type=0, text="survey"), Location(lat_deg=47.5, lon_deg=8.5))


def start(*arguments: str) -> tuple[subprocess.Popen[str], str]:
    """The process, and where it listens."""
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "--listen", "127.0.0.1:0", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line.startswith("ether on 127.0.0.1:"), process.communicate()[1]
    return process, line.removeprefix("ether on ").strip()


def answered(radio: EtherTransport) -> bool:
    now = time.monotonic()
    radio.heard(now)
    return radio.health(now).ok


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_two_clients_hear_each_other_and_the_air_ends_cleanly(number: signal.Signals) -> None:
    process, endpoint = start("--delay", "0.01", "0.02", "--seed", "3")
    radios = {name: EtherTransport(endpoint, name, radio_address(name)) for name in ("a", "b")}
    heard: dict[str, list[RemoteIdHeard]] = {"a": [], "b": []}
    try:
        for radio in radios.values():
            until(lambda radio=radio: answered(radio))  # type: ignore[misc]
        stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        host, port = endpoint.split(":")
        for data in (b"", b"EA", b"EA\x01\x63", b"EA\x01\x04" + b"\x00" * 40, b"\xff" * 5000):
            stranger.sendto(data, (host, int(port)))
        stranger.close()
        for _ in range(5):
            radios["a"].broadcast("wifi", MESSAGES, time.monotonic())
            radios["b"].broadcast("ble4", MESSAGES, time.monotonic())

        def all_heard() -> bool:
            for name, radio in radios.items():
                heard[name] += radio.heard(time.monotonic())
            return len(heard["a"]) >= 10 and len(heard["b"]) >= 5

        until(all_heard)
    finally:
        for radio in radios.values():
            radio.close()
        process.send_signal(number)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    assert {(e.transport, e.address, len(e.messages)) for e in heard["b"]} == {
        ("wifi", radio_address("a"), 2)
    }
    assert {(e.transport, e.address, len(e.messages)) for e in heard["a"]} == {
        ("ble4", radio_address("b"), 1)
    }
    statistics = json.loads(out.splitlines()[-1])
    assert statistics["bad_datagrams"] == 5
    assert statistics["pairs"]["a>b"]["delivered"] == 5
    assert statistics["pairs"]["b>a"]["delivered"] == 10
    assert 0.01 <= statistics["pairs"]["a>b"]["age_min_s"] <= statistics["pairs"]["a>b"]["age_max_s"]


def test_the_air_of_packets_lets_through_what_its_channel_does(tmp_path: Path) -> None:
    """Beacons in real time: some are heard, the lost ones are counted, and so is the age of information."""
    parameters = tmp_path / "p.toml"
    parameters.write_text("[wifi]\nscan_ms = 60.0\n")
    process, endpoint = start("--channel", "packets", "--parameters", str(parameters))
    radios = {name: EtherTransport(endpoint, name, radio_address(name)) for name in ("a", "b")}
    heard: list[RemoteIdHeard] = []
    try:
        for radio in radios.values():
            until(lambda radio=radio: answered(radio))  # type: ignore[misc]

        def enough() -> bool:
            radios["a"].broadcast("wifi", MESSAGES, time.monotonic())
            heard.extend(radios["b"].heard(time.monotonic()))
            return len(heard) >= 20

        until(enough)
    finally:
        for radio in radios.values():
            radio.close()
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, err
    pair = json.loads(out.splitlines()[-1])["pairs"]["a>b"]
    assert pair["delivered"] >= 20
    # Two thirds of the time it listens on other channels.
    assert pair["lost"] > 0
    # On a busy machine the last ones are still under way when it ends.
    assert pair["sent"] >= pair["delivered"] + pair["lost"]
    assert pair["transports"]["wifi"]["sent"] == pair["sent"]
    assert 0.0 < pair["information_age_mean_s"] <= pair["information_age_max_s"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--channel", "packets", "--delay", "0", "1"], "--delay: allowed only with --channel interval"),
        (["--channel", "analytic", "--loss", "0.1"], "--loss: allowed only with --channel interval"),
        (["--channel", "packets", "--range", "100"], "--range: allowed only with --channel interval"),
        (
            ["--parameters", "x.toml"],
            "--parameters: allowed only with --channel analytic or --channel packets",
        ),
        (["--loss", "2"], "channel.loss: 2 is out of range; allowed: 0 to 1"),
    ],
)
def test_options_of_another_channel_are_refused(arguments: list[str], words: str) -> None:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    with pytest.raises(ConfigError) as refused:
        run(parser.parse_args(arguments))
    assert words in str(refused.value)


# ------------------------------------------------------- the server itself, with a clock of the test's own


@pytest.fixture
def server() -> Iterator[EtherServer]:
    air = EtherServer("127.0.0.1", 0, SimpleChannel(), np.random.default_rng(0))
    yield air
    air.close()


@pytest.fixture
def clients(server: EtherServer) -> Iterator[list[socket.socket]]:
    sockets = []
    for _ in range(3):
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.connect(server.endpoint)
        sock.settimeout(PATIENCE_S)
        sockets.append(sock)
    yield sockets
    for sock in sockets:
        sock.close()


def send(server: EtherServer, now_s: float, client: socket.socket, *sent: datagrams.Datagram) -> None:
    for datagram in sent:
        client.send(datagrams.encode(datagram))
    # Loopback has delivered by the time send returns.
    server.step(now_s)


def receive(client: socket.socket) -> datagrams.Datagram:
    return datagrams.decode(client.recv(2000))


def test_a_client_joins_by_any_datagram_and_is_named(
    server: EtherServer, clients: list[socket.socket]
) -> None:
    one, two, three = clients
    frame = Send("wifi", "c2:01:02:03:04:05", b"frame")
    send(server, 0.0, one, Join("a"))
    assert receive(one) == Welcome(1)
    send(server, 0.0, two, Join("a"))
    assert receive(two) == Welcome(2)
    send(server, 0.0, three, frame)
    ports = [sock.getsockname()[1] for sock in clients]
    assert server.clients == ("a", f"a@{ports[1]}", str(ports[2]))
    assert receive(one) == receive(two) == Heard("wifi", "c2:01:02:03:04:05", b"frame")


def test_a_client_leaves_by_goodbye_or_silence(server: EtherServer, clients: list[socket.socket]) -> None:
    one, two, three = clients
    send(server, 0.0, one, Join("a"))
    send(server, 0.0, two, Join("b"))
    send(server, 0.0, three, Join("c"))
    send(server, 1.0, one, Leave())
    assert server.clients == ("b", "c")
    send(server, SILENCE_S, two, Join("b"))
    assert server.clients == ("b", "c")
    server.step(SILENCE_S + 0.1)
    assert server.clients == ("b",)
    send(server, SILENCE_S + 0.2, three, Join("c"))
    assert server.clients == ("b", "c")


def test_a_client_may_not_speak_as_the_air(server: EtherServer, clients: list[socket.socket]) -> None:
    send(server, 0.0, clients[0], Welcome(9), Heard("wifi", "c2:01:02:03:04:05", b"x"))
    assert server.clients == ()
    assert server.counts.bad_datagrams == 2


def test_a_client_that_vanished_does_not_stop_the_air(
    server: EtherServer, clients: list[socket.socket]
) -> None:
    one, two, three = clients
    for name, client in zip("abc", clients, strict=True):
        send(server, 0.0, client, Join(name))
    receive(one)
    two.close()
    for _ in range(5):
        send(server, 0.1, three, Send("wifi", "c2:01:02:03:04:05", b"x"))
        assert receive(one) == Heard("wifi", "c2:01:02:03:04:05", b"x")


def test_the_number_of_clients_is_bounded(
    server: EtherServer, clients: list[socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert MAX_CLIENTS >= 50
    monkeypatch.setattr("sitl_mocks.air.server.MAX_CLIENTS", 2)
    for name, client in zip("abc", clients, strict=True):
        send(server, 0.0, client, Join(name))
    assert server.clients == ("a", "b")
    assert server.counts.refused_clients == 1


def test_a_carried_position_sets_the_range(clients: list[socket.socket]) -> None:
    """Over UDP nobody tells positions: the range holds by those in the frames."""
    air = EtherServer("127.0.0.1", 0, SimpleChannel(range_m=500.0), np.random.default_rng(0))
    for client in clients:
        client.connect(air.endpoint)
    for name, lat, client in zip("abc", (0.0, 0.004, 0.005), clients, strict=True):
        place = Location(lat_deg=lat, lon_deg=8.5, alt_geodetic_m=100.0)
        (frame,) = FrameSender(radio_address(name)).frames("wifi", (place,))
        send(air, 0.0, client, Join(name), Send("wifi", radio_address(name), frame))
    pairs = air.ether.stats
    assert (pairs["b", "a"].delivered, pairs["b", "a"].lost) == (1, 0)
    assert (pairs["c", "b"].delivered, pairs["c", "b"].lost) == (1, 0)
    assert (pairs["c", "a"].delivered, pairs["c", "a"].lost) == (0, 1)
    air.close()


def test_a_port_in_use_is_a_configuration_error(server: EtherServer) -> None:
    with pytest.raises(ConfigError, match=f"{server.endpoint[1]}: already in use"):
        EtherServer(*server.endpoint, SimpleChannel(), np.random.default_rng(0))


@pytest.mark.parametrize("host", ["0.0.0.0", "192.0.2.1", "example.invalid", ""])
def test_the_air_listens_on_loopback_only(host: str) -> None:
    with pytest.raises(ConfigError, match="endpoint"):
        EtherServer(host, 0, SimpleChannel(), np.random.default_rng(0))
