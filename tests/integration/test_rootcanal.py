"""Two aircraft's Bluetooth on a real, virtual controller each: rootcanal, in HCI over TCP.

What it does not model: PHYs that drown each other, lost frames, timing of the air.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from companion.events import RemoteIdHeard
from companion.radio.frames_io import FrameSender
from companion.radio.hci.hci_radio import HciTransport
from companion.radio.hci.packets import HciCommand, Opcode
from companion.remote_id.messages import (
    Authentication,
    BasicId,
    IdType,
    Location,
    OperatorId,
    SelfId,
    System,
    UaType,
)
from companion.remote_id.transports import BLE4, BLE5
from tests.integration.conftest import PATIENCE_S
from tests.support.waiting import until

A, B, C = "c2:01:02:03:04:0a", "c2:01:02:03:04:0b", "c2:01:02:03:04:0c"
SERIAL = BasicId(
    id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="1596F12345678"
)
LOCATION = Location(lat_deg=47.5, lon_deg=8.5, alt_geodetic_m=500.0)
SELF_ID = SelfId(description_type=0, text="survey")
SYSTEM = System(operator_lat_deg=47.4, operator_lon_deg=8.4)
OPERATOR = OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8")
ALL = (SERIAL, LOCATION, SELF_ID, SYSTEM, OPERATOR)

LEGACY_ONLY = "preset: CSR_RCK_PTS_DONGLE"
WITHOUT_CODED = "features { le_extended_advertising: true le_coded_phy: false }"


@pytest.fixture
def radio() -> Iterator[Callable[..., HciTransport]]:
    radios: list[HciTransport] = []

    def start(where: Any, address: str, *, send: bool = True, listen: bool = True) -> HciTransport:
        radios.append(HciTransport(where.name, address, send=send, listen=listen))
        return radios[-1]

    yield start
    for each in radios:
        each.close()


def hear(receiver: HciTransport, count: int) -> list[RemoteIdHeard]:
    """Wait for so many frames."""
    events: list[RemoteIdHeard] = []
    deadline = time.monotonic() + PATIENCE_S
    while len(events) < count:
        events += receiver.heard(time.monotonic())
        assert time.monotonic() < deadline, f"only {len(events)} of {count}: {receiver.health(0.0)}"
        time.sleep(0.002)
    return events


def silence(receiver: HciTransport, duration_s: float = 0.5) -> list[RemoteIdHeard]:
    """What still comes."""
    time.sleep(duration_s)
    return receiver.heard(time.monotonic())


Air = Callable[..., Any]
Start = Callable[..., HciTransport]


def test_both_transports_at_once_are_heard_byte_exact(air: Air, radio: Start) -> None:
    where = air()
    sender, receiver = radio(where, A), radio(where, B)
    assert sender.capabilities == receiver.hears == {BLE4, BLE5}
    sender.broadcast(BLE4, ALL, 0.0)
    sender.broadcast(BLE5, ALL, 0.0)
    heard = hear(receiver, 6)
    assert {event.address for event in heard} == {A}
    assert [event.messages for event in heard if event.transport == BLE5] == [ALL]
    ble4 = [event.messages for event in heard if event.transport == BLE4]
    assert ble4[0] == (LOCATION,)
    assert sorted(ble4, key=repr) == sorted(((message,) for message in ALL), key=repr)
    assert silence(receiver) == []  # one event a frame, none repeated
    assert sender.health(0.0).frames_sent == 6
    assert sender.health(0.0).ok
    assert receiver.health(0.0).frames_heard == 6
    assert sender.heard(0.0) == []


def test_the_frames_on_the_air_are_those_of_the_codec(
    air: Air, radio: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    where = air()
    sender, receiver = radio(where, A), radio(where, B)
    seen: list[tuple[str, str, bytes]] = []
    take = receiver._receiver.receive

    def spy(
        transport: str, address: str, frame: bytes, rssi_dbm: float | None = None
    ) -> RemoteIdHeard | None:
        seen.append((transport, address, frame))
        return take(transport, address, frame, rssi_dbm)

    monkeypatch.setattr(receiver._receiver, "receive", spy)
    pages = tuple(Authentication(auth_type=1, page=page, data=b"\xa5" * 23) for page in range(1, 9))
    sender.broadcast(BLE5, (LOCATION, *pages), 0.0)  # nine messages: the longest there is
    sender.broadcast(BLE4, (LOCATION,), 0.0)
    hear(receiver, 2)
    codec = FrameSender(A)
    expected = [
        (BLE5, A, codec.frames(BLE5, (LOCATION, *pages))[0]),
        (BLE4, A, codec.frames(BLE4, (LOCATION,))[0]),
    ]
    assert sorted(seen) == sorted(expected)
    assert sorted(len(frame) for _, _, frame in seen) == [31, 234]


def test_every_update_is_seen_and_counts_agree(air: Air, radio: Start) -> None:
    where = air()
    sender, receiver = radio(where, A), radio(where, B)
    heard: list[RemoteIdHeard] = []
    for step in range(40):
        location = Location(lat_deg=47.5 + step * 1e-4, lon_deg=8.5)
        sender.broadcast(BLE4, (location,), 0.0)
        sender.broadcast(BLE5, (SERIAL, location), 0.0)
        heard += hear(receiver, 2)
    for transport in (BLE4, BLE5):
        places = [
            message.lat_deg
            for event in heard
            if event.transport == transport
            for message in event.messages
            if isinstance(message, Location)
        ]
        assert places == pytest.approx([47.5 + step * 1e-4 for step in range(40)], abs=1e-7)
    # The controller may confirm the last one after the other has received it.
    until(lambda: sender.health(0.0).frames_sent == 80, "the last confirmation", PATIENCE_S)
    assert receiver.health(0.0).frames_heard == 80
    assert receiver.health(0.0).bad_frames == 0


def test_a_burst_sends_the_newest_and_loses_nothing_silently(air: Air, radio: Start) -> None:
    where = air()
    sender, receiver = radio(where, A), radio(where, B)
    for step in range(50):
        sender.broadcast(BLE4, (Location(lat_deg=47.5 + step * 1e-4, lon_deg=8.5),), 0.0)
    last = pytest.approx(47.5 + 49e-4, abs=1e-7)
    deadline = time.monotonic() + PATIENCE_S
    events: list[RemoteIdHeard] = []
    while not events or events[-1].messages[0].lat_deg != last:  # type: ignore[union-attr]
        events += receiver.heard(0.0)
        assert time.monotonic() < deadline
        time.sleep(0.002)
    events += silence(receiver)
    assert sender.health(0.0).frames_sent == len(events)
    assert sender._counts.replaced == 50 - len(events)


def test_three_aircraft_hear_each_other(air: Air, radio: Start) -> None:
    where = air()
    radios = {address: radio(where, address) for address in (A, B, C)}
    for each in radios.values():
        each.broadcast(BLE5, ALL, 0.0)
        each.broadcast(BLE4, (LOCATION,), 0.0)
    for own, each in radios.items():
        counts = Counter((event.address, event.transport) for event in hear(each, 4))
        others = {A, B, C} - {own}
        assert counts == {(address, transport): 1 for address in others for transport in (BLE4, BLE5)}


def test_nothing_is_on_the_air_after_closing(air: Air, radio: Start) -> None:
    where = air()
    sender, receiver = radio(where, A), radio(where, B)
    sender.broadcast(BLE4, ALL, 0.0)
    sender.broadcast(BLE5, ALL, 0.0)
    sender.close()
    silence(receiver, 0.2)
    assert silence(receiver) == []
    again = radio(where, A)
    again.broadcast(BLE4, (LOCATION,), 0.0)
    assert len(hear(receiver, 1)) == 1


def test_a_controller_without_coded_phy(air: Air, radio: Start) -> None:
    where = air(WITHOUT_CODED)
    sender, receiver = radio(where, A), radio(where, B)
    assert sender.capabilities == receiver.hears == sender.health(0.0).can_send == {BLE4}
    assert "no LE Coded PHY" in sender.health(0.0).missing[0]
    sender.broadcast(BLE4, ALL, 0.0)
    assert {event.messages for event in hear(receiver, 5)} == {(message,) for message in ALL}


def test_a_controller_of_bluetooth_4(air: Air, radio: Start) -> None:
    where = air(LEGACY_ONLY)
    sender, receiver = radio(where, A), radio(where, B)
    assert sender.capabilities == receiver.hears == {BLE4}
    assert "no LE Extended Advertising" in sender.health(0.0).missing[0]
    heard: list[RemoteIdHeard] = []
    while {event.messages for event in heard} != {(message,) for message in ALL}:
        # It does not say what it has sent, and on a busy machine it may be too late for one.
        sender.broadcast(BLE4, ALL, time.monotonic())
        heard += hear(receiver, 1) + silence(receiver)
    assert {(event.address, event.transport) for event in heard} == {(A, BLE4)}


def test_legacy_commands_in_between_are_refused_by_the_controller_and_harm_nothing(
    air: Air, radio: Start
) -> None:
    where = air()
    sender, receiver = radio(where, A), radio(where, B)
    statuses: list[int] = []
    with sender._lock:
        session = sender._link.session  # type: ignore[union-attr]
        session._submit(
            HciCommand(Opcode.LE_SET_ADVERTISING_ENABLE, b"\x01"), lambda s, _: statuses.append(s)
        )
    sender.broadcast(BLE4, (LOCATION,), 0.0)
    assert len(hear(receiver, 1)) == 1
    assert statuses == [0x0C]
    assert "1 commands refused" in sender.health(0.0).text
    assert sender.health(0.0).can_send == {BLE4, BLE5}


def test_an_air_that_ends_is_noticed(air: Air, radio: Start) -> None:
    where = air()
    sender = radio(where, A)
    where.close()
    deadline = time.monotonic() + PATIENCE_S
    while sender.health(0.0).ok:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert sender.health(0.0).can_send == frozenset()
