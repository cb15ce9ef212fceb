"""The Transport on a scripted controller behind TCP or a UART: opening, sending, loss and return, closing."""

import os
import random
import select
import struct
import threading
import tty
from collections.abc import Callable, Iterator
from typing import NoReturn

import pytest

from companion.errors import ConfigError
from companion.events import RemoteIdHeard
from companion.radio.frames_io import FrameSender, radio_address
from companion.radio.hci import hci_radio, session
from companion.radio.hci.hci_radio import HciTransport
from companion.radio.hci.section import HciRadio
from companion.radio.hci.session import HciSession
from companion.remote_id.messages import Authentication, BasicId, IdType, Location, SelfId, UaType
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from companion.runtime.radios import open_radio
from tests.companion.radio.hci.controller import (
    CODED,
    DATA,
    EXTENDED,
    RESET,
    SCAN_PARAMETERS,
    VERSION,
    Controller,
    TcpController,
    extended_report,
)
from tests.support.waiting import PATIENCE_S, until

ADDRESS = "c2:01:02:03:04:05"
MESSAGES = (SelfId(description_type=0, text="survey"), Location(lat_deg=47.5, lon_deg=8.5))


Open = Callable[..., tuple[HciTransport, TcpController]]


@pytest.fixture
def serve() -> Iterator[Callable[..., TcpController]]:
    servers: list[TcpController] = []

    def start(*controllers: Controller | None) -> TcpController:
        servers.append(TcpController(*controllers))
        return servers[-1]

    yield start
    for server in servers:
        server.close()


@pytest.fixture
def start(serve: Callable[..., TcpController]) -> Iterator[Open]:
    radios: list[HciTransport] = []

    def run(
        *controllers: Controller | None, send: bool = True, listen: bool = True
    ) -> tuple[HciTransport, TcpController]:
        server = serve(*controllers)
        radios.append(HciTransport(server.name, ADDRESS, send=send, listen=listen))
        return radios[-1], server

    yield run
    for radio in radios:
        radio.close()


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time limits that a test can wait for."""
    monkeypatch.setattr(hci_radio, "_PAUSE_S", 0.02)
    monkeypatch.setattr(session, "_RESET_S", 0.1)
    monkeypatch.setattr(session, "_ALIVE_S", 0.1)
    monkeypatch.setattr(session, "ANSWER_S", 0.3)


# ---------------------------------------------------------------- opening


def test_what_it_says_of_itself(start: Open) -> None:
    radio, server = start(Controller())
    health = radio.health(0.0)
    assert health.ok
    assert health.text == f"Bluetooth controller on {server.name}: BLE 4 and BLE 5 Long Range, scanning"
    assert health.can_send == radio.capabilities == radio.hears == {BLE4, BLE5}
    assert health.missing == ()
    assert radio.own_addresses == {ADDRESS}
    assert radio.wifi_channel is None
    radio.configure({BLE4: 1, BLE5: 3})


def test_a_listener_sends_nothing_and_has_no_address(start: Open) -> None:
    radio, _ = start(Controller(), send=False)
    assert radio.health(0.0).text.endswith(": scanning")
    assert radio.capabilities == radio.own_addresses == frozenset()
    with pytest.raises(ValueError, match="allowed on this controller: none"):
        radio.broadcast(BLE4, MESSAGES, 0.0)


def test_without_coded_phy_the_pilot_reads_what_is_missing(start: Open) -> None:
    radio, _ = start(Controller(features=EXTENDED))
    assert radio.capabilities == radio.hears == radio.health(0.0).can_send == {BLE4}
    (text,) = radio.health(0.0).missing
    assert text.startswith("BLE 5 Long Range is missing: this controller has no LE Coded PHY")
    with pytest.raises(ValueError, match="'ble5'; allowed on this controller: ble4"):
        radio.broadcast(BLE5, MESSAGES, 0.0)


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (Controller(silent={RESET}), "no answer to Reset: check that it is a Bluetooth controller"),
        (Controller(silent={VERSION}), "no answer to Read Local Version Information"),
        (Controller(status={RESET: 0x0C}), "Reset: Command Disallowed"),
        (None, "closed the connection|reset by peer"),
    ],
)
@pytest.mark.usefixtures("impatient")
def test_a_controller_that_cannot_be_opened(
    serve: Callable[..., TcpController], controller: Controller | None, words: str
) -> None:
    server = serve(controller)
    threads = threading.active_count()
    with pytest.raises(ConfigError, match=words) as caught:
        HciTransport(server.name, ADDRESS, send=True, listen=True)
    assert str(caught.value).startswith(f"radio.channel: {server.name}: ")
    assert threading.active_count() == threads


@pytest.mark.usefixtures("impatient")
def test_a_peer_that_speaks_something_else(serve: Callable[..., TcpController]) -> None:
    class Talker(Controller):
        def feed(self, stream: bytes) -> bytes:
            return b"SSH-2.0-OpenSSH_9.2\r\n" * 300

    with pytest.raises(ConfigError, match="no HCI events"):
        HciTransport(serve(Talker()).name, ADDRESS, send=True, listen=True)


def test_the_configuration_opens_it(serve: Callable[..., TcpController]) -> None:
    server = serve(Controller())
    radio = open_radio(HciRadio(channel=server.name, listen=False), "1596F123456789")
    try:
        assert isinstance(radio, HciTransport)
        assert radio.own_addresses == {radio_address("1596F123456789")}
        assert radio.hears == frozenset()
    finally:
        radio.close()


# ---------------------------------------------------------------- sending and hearing


def test_both_transports_at_once_byte_exact(start: Open) -> None:
    controller = Controller()
    radio, _ = start(controller)
    radio.broadcast(BLE4, MESSAGES, 0.0)
    radio.broadcast(BLE5, MESSAGES, 0.0)
    until(lambda: radio.health(0.0).frames_sent == 3)
    sender = FrameSender(ADDRESS)
    assert sorted(controller.loaded(0)) == sorted(sender.frames(BLE4, MESSAGES))
    assert controller.loaded(1) == sender.frames(BLE5, MESSAGES)


def test_packs_are_as_long_as_the_controller_can_hold(start: Open) -> None:
    controller = Controller(max_data=84)
    radio, _ = start(controller)
    pages = tuple(Authentication(auth_type=1, page=page, data=b"x" * 23) for page in range(1, 6))
    radio.broadcast(BLE5, (*MESSAGES, *pages), 0.0)
    until(lambda: radio.health(0.0).frames_sent == 3)
    assert [len(data) for data in controller.loaded(1)] == [9 + 25 * n for n in (3, 3, 1)]


def test_what_cannot_be_sent_raises_and_sends_nothing(start: Open) -> None:
    controller = Controller()
    radio, _ = start(controller)
    with pytest.raises(ValueError, match="'wifi'"):
        radio.broadcast(WIFI_BEACON, MESSAGES, 0.0)
    with pytest.raises(ValueError):
        radio.broadcast(BLE4, (*MESSAGES, Location(lat_deg=95.0, lon_deg=0.0)), 0.0)
    radio.broadcast(BLE4, (), 0.0)
    radio.broadcast(BLE5, (), 0.0)
    radio.broadcast(BLE4, MESSAGES[:1], 0.0)
    until(lambda: radio.health(0.0).frames_sent)
    assert len(controller.loaded(0)) == 1
    assert controller.loaded(1) == []


def test_refusals_show_and_are_not_counted_as_sent(start: Open) -> None:
    radio, _ = start(Controller(status={DATA: 0x0C}))
    radio.broadcast(BLE5, MESSAGES, 0.0)
    until(lambda: not radio.health(0.0).ok)
    health = radio.health(0.0)
    assert health.can_send == {BLE4}
    assert "BLE 5 Long Range: Command Disallowed: legacy and extended commands were mixed" in health.text
    assert "1 commands refused" in health.text
    assert health.frames_sent == 0


def test_heard_frames_that_are_lost_are_told(start: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "_MAX_HEARD", 5)
    radio, server = start(Controller())
    (frame,) = FrameSender("c1:02:03:04:05:06").frames(BLE5, MESSAGES)
    for _ in range(12):
        server.send(extended_report(frame))
    until(lambda: "7 received frames lost because they came too fast" in radio.health(0.0).text)
    assert len(radio.heard(0.0)) == 5


def test_hearing_in_small_helpings(start: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hci_radio, "_MAX_FRAMES", 10)
    radio, server = start(Controller())
    (frame,) = FrameSender("c1:02:03:04:05:06").frames(BLE5, MESSAGES)
    broken = frame[:-30]
    stranger = b"\x05\x16\xfa\xff\x0d\x00"
    for data in [frame] * 25 + [broken, stranger]:
        server.send(extended_report(data))
    server.send(extended_report(frame)[:12] + struct.pack("B", 0))  # torn: costs itself and what follows
    heard: list[RemoteIdHeard] = []
    most = 0

    def all_heard() -> bool:
        nonlocal most
        events = radio.heard(0.0)
        most = max(most, len(events))
        heard.extend(events)
        return len(heard) >= 25 and radio.health(0.0).bad_frames >= 2

    until(all_heard)
    assert len(heard) == 25
    assert most <= 10
    assert heard[0] == RemoteIdHeard(
        transport=BLE5, address="c1:02:03:04:05:06", messages=MESSAGES, rssi_dbm=-60.0, counter=0
    )
    assert radio.health(0.0).frames_heard == 25


# ---------------------------------------------------------------- loss and return


@pytest.mark.usefixtures("impatient")
def test_a_controller_that_dies_and_comes_back(start: Open) -> None:
    second = Controller()
    radio, server = start(Controller(), None, None, second)
    server.die()
    until(lambda: not radio.health(0.0).ok)
    assert radio.health(0.0).can_send == radio.hears == frozenset()
    assert "lost, trying again" in radio.health(0.0).text
    radio.broadcast(BLE4, MESSAGES, 0.0)
    assert "2 frames could not be sent" in radio.health(0.0).text
    until(lambda: radio.health(0.0).ok)
    assert server.connections == 4
    assert second.loaded(0) == []  # what was lost meanwhile does not go out late
    radio.broadcast(BLE4, MESSAGES, 0.0)
    until(lambda: radio.health(0.0).frames_sent == 2)
    assert radio.health(0.0).can_send == {BLE4, BLE5}


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("listen_only", [False, True])
def test_a_controller_that_falls_silent_is_started_anew(start: Open, listen_only: bool) -> None:
    first = Controller()
    radio, server = start(first, Controller(), send=not listen_only)
    first.silent = {VERSION, DATA, SCAN_PARAMETERS}
    if not listen_only:
        radio.broadcast(BLE5, MESSAGES, 0.0)
    until(lambda: server.connections == 2 and radio.health(0.0).ok)
    assert radio.health(0.0).can_send == radio.capabilities


@pytest.mark.usefixtures("impatient")
def test_a_fault_of_the_program_costs_a_session_not_the_radio(
    start: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second, third = Controller(), Controller(), Controller()
    radio, server = start(first, second, third)
    handle, start_up = HciSession._report, HciSession._reset_done

    def fail(*_: object, **__: object) -> NoReturn:
        raise KeyError("fault")

    monkeypatch.setattr(HciSession, "_report", fail)
    monkeypatch.setattr(HciSession, "_reset_done", fail)
    server.send(extended_report(b"x"))
    until(lambda: "a fault of this program: KeyError('fault')" in radio.health(0.0).text)
    assert not radio.health(0.0).ok
    assert radio.health(0.0).can_send == frozenset()
    monkeypatch.setattr(HciSession, "_report", handle)
    monkeypatch.setattr(HciSession, "_reset_done", start_up)
    until(lambda: radio.health(0.0).ok)
    assert server.connections > 1
    radio.close()
    assert server.closed_by_peer.wait(PATIENCE_S)


@pytest.mark.usefixtures("impatient")
def test_a_controller_that_refuses_everything_is_reset(start: Open) -> None:
    first, second = Controller(status={DATA: 0x0C}), Controller()
    radio, server = start(first, second)
    until(lambda: radio.broadcast(BLE4, MESSAGES, 0.0) or server.connections == 2)
    until(lambda: radio.health(0.0).ok)
    radio.broadcast(BLE4, MESSAGES, 0.0)
    until(lambda: second.loaded(0))


@pytest.mark.usefixtures("impatient")
def test_a_lesser_controller_that_comes_back_sends_what_it_can(start: Open) -> None:
    radio, server = start(Controller(), Controller(features=EXTENDED))
    server.die()
    until(lambda: server.connections == 2 and radio.health(0.0).can_send)
    assert radio.capabilities == {BLE4, BLE5}
    health = radio.health(0.0)
    assert health.can_send == radio.hears == {BLE4}
    assert not health.ok
    assert "no BLE 5 Long Range since it was reopened; " in health.text
    assert "this controller has no LE Coded PHY" in health.text


@pytest.mark.usefixtures("impatient")
def test_any_bytes_from_the_controller_are_survived(start: Open) -> None:
    generator = random.Random(5)
    radio, server = start(*(Controller() for _ in range(2000)))
    for _ in range(300):
        try:
            server.send(generator.choice((b"\x04\x3e", b"\x04\x0e", b"")) + generator.randbytes(40))
        except OSError:
            continue  # it was given up, rightly, and is being opened again
        radio.broadcast(generator.choice((BLE4, BLE5)), MESSAGES, 0.0)
        radio.heard(0.0)
        assert radio.health(0.0).can_send <= {BLE4, BLE5}
    sent = radio.health(0.0).frames_sent
    until(lambda: radio.broadcast(BLE5, MESSAGES, 0.0) or radio.health(0.0).frames_sent > sent)


# ---------------------------------------------------------------- closing


def test_closing_resets_the_controller_and_hangs_up(start: Open) -> None:
    controller = Controller()
    radio, server = start(controller)
    radio.close()
    assert server.closed_by_peer.wait(PATIENCE_S)
    assert controller.opcodes()[-1] == RESET
    assert controller.opcodes().count(RESET) == 2
    health = radio.health(0.0)
    assert not health.ok
    assert health.can_send == frozenset()
    assert radio.heard(0.0) == []
    radio.broadcast(BLE4, MESSAGES, 0.0)
    radio.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("hci")]


@pytest.mark.usefixtures("impatient")
def test_closing_a_lost_one(start: Open) -> None:
    radio, server = start(Controller())
    server.die()
    until(lambda: not radio.health(0.0).ok)
    radio.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("hci")]


# ---------------------------------------------------------------- a UART


def test_the_same_on_a_uart() -> None:
    master, slave = os.openpty()
    tty.setraw(slave)  # as a UART is: no echo
    controller = Controller(features=EXTENDED | CODED)
    ended = threading.Event()

    def answer() -> None:
        buffer = b""
        while not ended.is_set():
            if not select.select([master], [], [], 0.05)[0]:
                continue
            buffer += os.read(master, 4096)
            while len(buffer) >= 4 and len(buffer) >= 4 + buffer[3]:
                size = 4 + buffer[3]
                os.write(master, controller.feed(buffer[:size]))
                buffer = buffer[size:]

    os.write(master, b"\x3e\x0d noise before the start")
    thread = threading.Thread(target=answer, daemon=True)
    thread.start()
    try:
        radio = HciTransport(f"uart:{os.ttyname(slave)}:1000000", ADDRESS, send=True, listen=True)
        radio.broadcast(BLE4, MESSAGES, 0.0)
        serial = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.AEROPLANE, uas_id="A")
        radio.broadcast(BLE5, (*MESSAGES, serial), 0.0)
        until(lambda: radio.health(0.0).frames_sent == 3)
        assert len(controller.loaded(1)[0]) == 84
        radio.close()
        assert controller.opcodes()[-1] == RESET
    finally:
        ended.set()
        thread.join(60.0)
        os.close(slave)
        os.close(master)
