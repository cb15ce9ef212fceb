"""The fence over the mission protocol, beside the mission."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.events import (
    DownloadFence,
    DownloadMission,
    Event,
    FenceArea,
    FenceDownloaded,
    FenceRefused,
    MissionDownloaded,
    MissionRefused,
)
from tests.companion.autopilot.conftest import Scripted
from tests.companion.autopilot.lists.test_mission_download import count, wait
from tests.companion.autopilot.lists.test_mission_download import item as mission_item

TRIANGLE = ((47.0, 8.0), (47.01, 8.0), (47.01, 8.01))
AREA = FenceArea(inclusion=True, points=TRIANGLE)


@pytest.fixture(params=["ardupilot", "px4"])
def vehicle(request: pytest.FixtureRequest) -> Scripted:
    scripted: Scripted = request.getfixturevalue(request.param)
    return scripted


def vertex(seq: int, **over: Any) -> Any:
    values: dict[str, Any] = {"frame": 0, "command": 5001, "current": 0, "autocontinue": 0, "param1": 3.0}
    values |= {"param2": 0.0, "param3": 0.0, "param4": 0.0, "z": 0.0, "mission_type": 1}
    values |= {"x": round(TRIANGLE[seq][0] * 1e7), "y": round(TRIANGLE[seq][1] * 1e7)}
    return mavlink.MAVLink_mission_item_int_message(1, 191, seq, **(values | over))


def ack(result: int, mission_type: int = 1) -> Any:
    return mavlink.MAVLink_mission_ack_message(1, 191, result, mission_type)


def ask(scripted: Scripted, command: Any = None) -> None:
    scripted.link.send(command or DownloadFence(), scripted.now_s)


def lists(scripted: Scripted) -> list[int]:
    return [m.mission_type for m in scripted.told("MISSION_REQUEST_LIST")]


def requested(scripted: Scripted) -> list[tuple[str, int, int]]:
    return [
        (m.get_type(), m.seq, m.mission_type)
        for m in scripted.told()
        if m.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT")
    ]


def test_no_item_of_a_fence_is_home(vehicle: Scripted) -> None:
    ask(vehicle)
    assert lists(vehicle) == [1]
    events = vehicle.says(count(3, mission_type=1))
    for seq in range(3):
        assert requested(vehicle) == [("MISSION_REQUEST_INT", seq, 1)]
        events = vehicle.says(vertex(seq))
    assert events == [FenceDownloaded(areas=(AREA,))]
    (thanks,) = vehicle.told()
    assert (thanks.get_type(), thanks.type, thanks.mission_type) == ("MISSION_ACK", 0, 1)


def test_no_fence(vehicle: Scripted) -> None:
    ask(vehicle)
    assert vehicle.says(count(0, mission_type=1)) == [FenceDownloaded(areas=())]


def test_a_vehicle_without_fences(vehicle: Scripted) -> None:
    ask(vehicle)
    assert vehicle.says(ack(3)) == [FenceRefused(reason="the vehicle answered: unsupported")]


def test_lost_answers_are_asked_for_again_and_never_in_floats(vehicle: Scripted) -> None:
    ask(vehicle)
    vehicle.told()
    vehicle.after(1.0)
    assert lists(vehicle) == [1]
    vehicle.says(count(3, mission_type=1))
    vehicle.told()
    wait(vehicle, 4)
    assert requested(vehicle) == [("MISSION_REQUEST_INT", 0, 1)] * 4
    vehicle.says(vertex(0), vertex(0), vertex(2))
    assert requested(vehicle) == [("MISSION_REQUEST_INT", 1, 1)]
    (refused,) = wait(vehicle, 20)
    assert refused == FenceRefused(reason="item 1 of 3 was not received after 5 tries")
    (cancelled,) = vehicle.told("MISSION_ACK")
    assert (cancelled.type, cancelled.mission_type) == (mavlink.MAV_MISSION_OPERATION_CANCELLED, 1)


def test_silence_is_refused_and_nothing_cancelled_that_never_began(vehicle: Scripted) -> None:
    ask(vehicle)
    assert wait(vehicle, 20) == [FenceRefused(reason="MISSION_COUNT was not received after 5 tries")]
    assert vehicle.told("MISSION_ACK") == []


def test_answers_about_the_mission_are_not_the_fences(vehicle: Scripted) -> None:
    ask(vehicle)
    vehicle.told()
    assert vehicle.says(count(0, mission_type=0), ack(3, mission_type=0), mission_item(0)) == []
    vehicle.says(count(3, mission_type=1))
    assert vehicle.says(mission_item(0)) == []
    assert requested(vehicle) == [("MISSION_REQUEST_INT", 0, 1)]


def test_a_fence_that_is_not_understood_names_the_item(vehicle: Scripted) -> None:
    ask(vehicle)
    events = vehicle.says(count(3, mission_type=1), vertex(0), vertex(1), vertex(2, command=5002))
    (refused,) = events
    assert isinstance(refused, FenceRefused)
    assert refused.reason.startswith("fence item 2 (FENCE_POLYGON_VERTEX_EXCLUSION): ")


@pytest.mark.parametrize("over", [{"x": 910000000}, {"z": math.inf}])
def test_a_senseless_item_ends_the_download(vehicle: Scripted, over: dict[str, Any]) -> None:
    ask(vehicle)
    (refused,) = vehicle.says(count(3, mission_type=1), vertex(0, **over))
    assert isinstance(refused, FenceRefused)
    assert refused.reason.startswith("fence item 0: ")
    assert vehicle.link.counts.bad_values == 1


def test_no_vehicle_no_fence() -> None:
    scripted = Scripted()
    ask(scripted)
    assert scripted.after(0.0) == [FenceRefused(reason="no vehicle has been heard yet")]


# ---------------------------------------------------------------- one at a time


def finish_mission(vehicle: Scripted) -> list[Event]:
    return vehicle.says(count(2), mission_item(0), mission_item(1))


def finish_fence(vehicle: Scripted) -> list[Event]:
    return vehicle.says(count(3, mission_type=1), *map(vertex, range(3)))


def test_a_fence_waits_for_the_mission(vehicle: Scripted) -> None:
    ask(vehicle, DownloadMission())
    ask(vehicle)
    ask(vehicle)
    assert lists(vehicle) == [0]
    wait(vehicle, 2)
    assert lists(vehicle) == [0, 0]
    (mission,) = finish_mission(vehicle)
    assert isinstance(mission, MissionDownloaded)
    told = [m for m in vehicle.told() if m.get_type() in ("MISSION_ACK", "MISSION_REQUEST_LIST")]
    assert [(m.get_type(), m.mission_type) for m in told] == [("MISSION_ACK", 0), ("MISSION_REQUEST_LIST", 1)]
    assert finish_fence(vehicle) == [FenceDownloaded(areas=(AREA,))]
    wait(vehicle, 20)
    assert lists(vehicle) == []


def test_a_mission_waits_for_the_fence_even_if_that_fails(vehicle: Scripted) -> None:
    ask(vehicle)
    ask(vehicle, DownloadMission())
    assert lists(vehicle) == [1]
    assert vehicle.says(ack(14)) == [FenceRefused(reason="the vehicle answered: denied")]
    assert lists(vehicle) == [0]
    (mission,) = finish_mission(vehicle)
    assert isinstance(mission, MissionDownloaded)


def test_asked_again_it_begins_again_and_the_other_still_comes(vehicle: Scripted) -> None:
    ask(vehicle, DownloadMission())
    ask(vehicle)
    vehicle.says(count(2), mission_item(0))
    ask(vehicle, DownloadMission())
    assert lists(vehicle) == [0, 0]
    assert len(finish_mission(vehicle)) == 1
    assert finish_fence(vehicle) == [FenceDownloaded(areas=(AREA,))]


def test_both_end_in_a_refusal_when_the_vehicle_is_silent(vehicle: Scripted) -> None:
    ask(vehicle, DownloadMission())
    ask(vehicle)
    assert [type(event) for event in wait(vehicle, 20)] == [MissionRefused, FenceRefused]


# ---------------------------------------------------------------- MAVLink 1


class OldScripted(Scripted):
    """A vehicle whose port is set to MAVLink 1."""

    def bytes(self, message: Any, system: int = 1, component: int = 1) -> bytes:
        packer = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        packed: bytes = message.pack(packer, force_mavlink1=True)
        return packed


@pytest.mark.parametrize("answer", [count(5), ack(3, mission_type=0)])
def test_mavlink_1_carries_no_fence(answer: Any) -> None:
    """An ArduPilot refuses (without a type), an older vehicle counts its mission: neither is a fence."""
    old = OldScripted()
    old.heartbeat()
    ask(old)
    (refused,) = old.says(answer)
    assert isinstance(refused, FenceRefused)
    assert "MAVLink 1" in refused.reason
    ask(old, DownloadMission())
    (mission,) = finish_mission(old)
    assert isinstance(mission, MissionDownloaded)
