"""The companion as the vehicle's Remote ID component."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from companion.autopilot.link import AutopilotLink
from companion.autopilot.wire import MavlinkReader
from companion.config import VehicleConfig
from companion.errors import ConfigError
from companion.events import ArmStatus, OperatorData, RemoteIdModule
from companion.remote_id.messages import (
    BasicId,
    IdType,
    OperatorId,
    SelfId,
    System,
    UaType,
)
from tests.companion.autopilot.conftest import Scripted
from tests.companion.autopilot.remote_id.test_remote_id import (
    arm_status,
    location,
    operator_id,
    self_id,
    system,
)

NO_ID = bytes(20)
TAKEOFF, LIVE, FIXED = 0, 1, 2


# ---------------------------------------------------------------- being the component


class Component(Scripted):
    """A link that is the vehicle's Remote ID component."""

    def __init__(self, identity: BasicId | None = None) -> None:
        super().__init__()
        self.link = AutopilotLink(VehicleConfig(), remote_id_component=True, identity=identity)

    def told_by(self, component: int) -> list[Any]:
        return [m for m in self.told() if m.get_srcComponent() == component]


READY = ArmStatus(ready=True)


def test_nothing_is_said_as_the_component_before_there_is_something_to_say() -> None:
    scripted = Component()
    scripted.link.send(ArmStatus(ready=False, text="no radio"), scripted.now_s)
    scripted.after(5.0)
    assert scripted.told_by(236) == []  # whose component?
    scripted.heartbeat(system=42)
    scripted.after(0.05)
    beat, status = scripted.told_by(236)
    assert (beat.get_type(), beat.type, beat.autopilot, beat.get_srcSystem()) == ("HEARTBEAT", 34, 8, 42)
    assert (status.get_type(), status.status, status.error) == ("OPEN_DRONE_ID_ARM_STATUS", 1, "no radio")
    silent = Component()
    silent.heartbeat()
    silent.after(5.0)
    assert silent.told_by(236) == []


def test_status_repeats_off_one_hertz_and_heartbeats_come_each_second() -> None:
    scripted = Component()
    scripted.heartbeat()
    scripted.link.send(READY, scripted.now_s)
    times: dict[str, list[float]] = {}
    for _ in range(400):
        scripted.after(0.05)
        for message in scripted.told_by(236):
            times.setdefault(message.get_type(), []).append(scripted.now_s)
    assert set(times) == {"HEARTBEAT", "OPEN_DRONE_ID_ARM_STATUS"}
    beats, statuses = times["HEARTBEAT"], times["OPEN_DRONE_ID_ARM_STATUS"]
    assert {round(b - a, 3) for a, b in itertools.pairwise(beats)} == {1.0}
    assert {round(b - a, 3) for a, b in itertools.pairwise(statuses)} == {0.7}


def test_a_change_is_told_at_once_and_repeated() -> None:
    scripted = Component()
    scripted.heartbeat()
    scripted.link.send(READY, scripted.now_s)
    scripted.after(0.05)
    scripted.link.send(ArmStatus(ready=False, text="radio lost"), scripted.now_s)
    scripted.after(0.05)
    scripted.after(0.7)
    statuses = [m.error for m in scripted.told("OPEN_DRONE_ID_ARM_STATUS")]
    assert statuses == ["", "radio lost", "radio lost"]


def test_the_component_tells_the_autopilot_alone_who_it_broadcasts() -> None:
    scripted = Component(
        BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.AEROPLANE, uas_id="1596A0DMUCA0001")
    )
    scripted.heartbeat(system=42)
    scripted.after(5.0)
    assert scripted.told("OPEN_DRONE_ID_BASIC_ID") == []  # nobody has said yet that anything is broadcast
    scripted.link.send(READY, scripted.now_s)
    times = []
    for _ in range(200):
        scripted.after(0.05)
        for told in scripted.told("OPEN_DRONE_ID_BASIC_ID"):
            times.append(scripted.now_s)
            assert (told.get_srcSystem(), told.get_srcComponent()) == (42, 236)
            assert (told.target_system, told.target_component, bytes(told.id_or_mac)) == (42, 1, NO_ID)
            assert (told.id_type, told.ua_type) == (1, 1)
            assert bytes(told.uas_id).rstrip(b"\0") == b"1596A0DMUCA0001"
    assert [round(b - a, 3) for a, b in itertools.pairwise(times)] == [3.0] * 3


def test_an_aircraft_without_identity_takes_none_away_from_the_autopilot() -> None:
    scripted = Component(BasicId(id_type=IdType.NONE, ua_type=UaType.AEROPLANE, uas_id=""))
    scripted.heartbeat()
    scripted.link.send(READY, scripted.now_s)
    scripted.after(5.0)
    assert {m.get_type() for m in scripted.told_by(236)} == {"HEARTBEAT", "OPEN_DRONE_ID_ARM_STATUS"}


def test_both_components_number_their_own_frames() -> None:
    scripted = Component()
    scripted.heartbeat()
    scripted.link.send(READY, scripted.now_s)
    numbers: dict[int, list[int]] = {}
    reader = MavlinkReader()
    for _ in range(6000):
        scripted.after(0.05)
        for message in reader.feed(scripted.link.drain()):
            numbers.setdefault(message.get_srcComponent(), []).append(message.get_seq())
    assert set(numbers) == {191, 236}
    for sequence in numbers.values():
        assert all(b == (a + 1) % 256 for a, b in itertools.pairwise(sequence))
        assert len(sequence) > 256


def test_the_component_does_not_take_its_own_status_for_a_module() -> None:
    scripted = Component()
    scripted.heartbeat()
    scripted.link.send(READY, scripted.now_s)
    for _ in range(40):
        scripted.after(0.7)
        assert scripted.link.receive(scripted.link.drain(), scripted.now_s) == []  # a link that echoes
    scripted.transmitter(component=237)
    assert scripted.says(arm_status(), component=237) == [RemoteIdModule(component_id=237, ready=True)]


def test_a_second_transmitter_under_the_components_id_is_a_module() -> None:
    scripted = Component()
    scripted.heartbeat()
    scripted.link.send(READY, scripted.now_s)
    scripted.after(0.7)
    for _ in range(2):  # so that its sequence numbers differ from ours
        scripted.transmitter()
    for status, text in ((0, b""), (1, b"missing location message")):
        (event,) = scripted.says(arm_status(status, text), component=236)
        assert event == RemoteIdModule(component_id=236, ready=status == 0, text=text.decode())


def test_what_the_autopilot_sends_to_the_component_is_the_operators() -> None:
    scripted = Component()
    scripted.heartbeat()
    scripted.says(system(1000, target=1))
    events = scripted.says(
        location(NO_ID, target=1), system(1001, target=1), self_id(target=1), operator_id(target=1)
    )
    assert [type(e.messages[0]) for e in events if isinstance(e, OperatorData)] == [
        System,
        SelfId,
        OperatorId,
    ]


def test_who_is_not_the_component_has_no_status_to_send(ardupilot: Scripted) -> None:
    with pytest.raises(ValueError, match="ArmStatus"):
        ardupilot.link.send(READY, ardupilot.now_s)


def test_being_the_component_twice_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"vehicle\.component_id.*236"):
        AutopilotLink(VehicleConfig(component_id=236), remote_id_component=True)
    AutopilotLink(VehicleConfig(component_id=236))
