"""A session begins with a scripted controller: probing, what it lacks, refusals."""

from __future__ import annotations

import re

import pytest

from companion.radio.hci.advertising import HciCounts
from companion.radio.hci.session import HciSession
from companion.remote_id.transports import BLE4, BLE5
from tests.companion.radio.hci.controller import (
    CODED,
    DATA,
    ENABLE,
    EXTENDED,
    FEATURES,
    LEGACY_DATA,
    LEGACY_ENABLE,
    LEGACY_SCAN,
    PARAMETERS,
    RESET,
    SCAN,
    SCAN_PARAMETERS,
    SETS,
    VERSION,
    Controller,
    complete,
    extended_report,
)
from tests.companion.radio.hci.host import ADDRESS, LOCATION, SELF_ID, Host

# ---------------------------------------------------------------- set-up


def test_set_up_of_a_whole_controller() -> None:
    host = Host(Controller())
    assert host.session.ready
    assert host.session.failure is None
    assert host.session.abilities.missing == []
    assert host.session.can_send == {BLE4, BLE5}
    assert host.session.abilities.hears == {BLE4, BLE5}
    assert host.controller.opcodes()[0] == RESET
    assert host.controller.opcodes().count(RESET) == 1
    parameters = {data[0]: data for opcode, data in host.controller.log if opcode == PARAMETERS}
    assert {handle: (data[1], data[20], data[22]) for handle, data in parameters.items()} == {
        0: (0x10, 1, 1),
        1: (0x00, 3, 3),
    }
    assert host.controller.opcodes()[-2:] == [SCAN, SCAN_PARAMETERS]
    assert host.controller.scanning


@pytest.mark.parametrize(
    ("controller", "can_send", "hears", "missing"),
    [
        (Controller(features=EXTENDED), {BLE4}, {BLE4}, "no LE Coded PHY"),
        (Controller(features=0), {BLE4}, {BLE4}, "no LE Extended Advertising"),
        (Controller(features=CODED), {BLE4}, {BLE4}, "no LE Extended Advertising"),
        (Controller(sets=1), {BLE5}, {BLE4, BLE5}, "advertising sets, here: 1"),
        (Controller(max_data=31), {BLE4}, {BLE4, BLE5}, "31 bytes of advertising data, 0 messages"),
        (Controller(max_data=191), {BLE4, BLE5}, {BLE4, BLE5}, "191 bytes of advertising data, 7 messages"),
    ],
)
def test_what_a_lesser_controller_lacks_is_said(
    controller: Controller, can_send: set[str], hears: set[str], missing: str
) -> None:
    session = Host(controller).session
    assert session.ready
    assert session.can_send == can_send
    assert session.abilities.hears == hears
    assert len(session.abilities.missing) == 1
    assert missing in session.abilities.missing[0]


def test_a_set_that_the_controller_refuses_is_missing_with_its_reason() -> None:
    class NoCoded(Controller):
        def _answer(self, opcode: int, data: bytes) -> bytes:
            self.status[PARAMETERS] = 0x11 if opcode == PARAMETERS and data[0] == 1 else 0
            return super()._answer(opcode, data)

    session = Host(NoCoded()).session
    assert session.can_send == {BLE4}
    (text,) = session.abilities.missing
    assert "LE Set Extended Advertising Parameters: Unsupported Feature" in text
    assert text.startswith("BLE 5 Long Range is missing")


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (Controller(status={FEATURES: 0x01}), "no Bluetooth Low Energy"),
        (Controller(status={RESET: 0x1F}), "Reset: Unspecified Error"),
        (Controller(status={SCAN_PARAMETERS: 0x12}), "LE Set Extended Scan Parameters: Invalid"),
        (Controller(status={SCAN: 0x0C}), "Command Disallowed: legacy and extended commands were mixed"),
        (Controller(status={PARAMETERS: 0x07}), "nothing can be sent: .*Memory Capacity Exceeded"),
        (Controller(sets=0), "nothing can be sent"),
        (Controller(short={SETS}), "an answer of 0 bytes during set-up"),
        (Controller(features=0, commands=bytes(64)), "cannot advertise"),
    ],
)
def test_a_controller_that_cannot_serve_ends_the_session_in_words(controller: Controller, words: str) -> None:
    session = Host(controller).session
    assert not session.ready
    assert session.failure is not None
    assert re.search(words, session.failure)


@pytest.mark.parametrize("opcode", [RESET, VERSION, FEATURES, PARAMETERS, SCAN])
def test_a_controller_that_falls_silent_during_set_up(opcode: int) -> None:
    host = Host(Controller(silent={opcode}))
    host.wait(3.5)
    assert host.session.failure is not None
    assert "no answer to" in host.session.failure
    assert "baud rate" in host.session.failure
    assert host.controller.opcodes().count(RESET) == (3 if opcode == RESET else 1)


def test_somebody_who_is_no_controller_is_told_from_silence() -> None:
    host = Host(Controller(silent={RESET}))
    for _ in range(40):
        host.wait(0.1)
        host.session.receive(b"\xfd\x09\x00\x00mavlink" * 2, host.now_s)
    assert host.session.failure is not None
    assert "only bytes that are not HCI events" in host.session.failure


def test_an_echo_is_no_controller() -> None:
    session = HciSession(ADDRESS, send=True, listen=True, counts=HciCounts(), now_s=0.0)
    for step in range(50):
        for packet in session.packets():
            session.receive(packet, step / 10)
        session.tick(step / 10)
    assert session.failure is not None
    assert "not HCI events" in session.failure


def test_what_an_earlier_user_left_in_the_line_is_ignored() -> None:
    session = HciSession(ADDRESS, send=True, listen=True, counts=HciCounts(), now_s=0.0)
    session.receive(extended_report(b"x" * 30)[9:] + complete(ENABLE) + complete(SCAN), 0.0)
    controller = Controller()
    for _ in range(100):
        for packet in session.packets():
            session.receive(controller.feed(packet), 0.0)
    assert session.ready


def test_listening_only_sets_up_no_advertising() -> None:
    host = Host(Controller(), send=False)
    assert host.session.ready
    assert host.session.can_send == set()
    assert not {PARAMETERS, DATA, ENABLE, SETS} & set(host.controller.opcodes())


def test_sending_only_does_not_scan() -> None:
    host = Host(Controller(), listen=False)
    assert host.session.abilities.hears == set()
    assert not {SCAN, SCAN_PARAMETERS, LEGACY_SCAN} & set(host.controller.opcodes())


# ---------------------------------------------------------------- without extended advertising


def test_a_legacy_controller_sends_ble4_by_legacy_commands_only() -> None:
    host = Host(Controller(features=0))
    frames = host.broadcast(BLE4, LOCATION, SELF_ID)
    host.run()
    assert host.controller.log[-1] == (LEGACY_ENABLE, b"\x01")
    host.wait(1.0)
    data = [content[1 : 1 + content[0]] for opcode, content in host.controller.log if opcode == LEGACY_DATA]
    assert data == frames
    switches = [content for opcode, content in host.controller.log if opcode == LEGACY_ENABLE]
    assert switches == [b"\x01", b"\x00"] * 2
    assert host.counts.sent == 2
    assert LEGACY_SCAN in host.controller.opcodes()
    assert all(not 0x2034 <= opcode <= 0x2043 for opcode in host.controller.opcodes())
