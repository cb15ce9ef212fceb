from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkWriter
from companion.events import (
    DownloadMission,
    Event,
    MissionCurrent,
    MissionDownloaded,
    MissionItem,
    MissionRefused,
)
from tests.companion.autopilot.conftest import Scripted
from tests.support.place import HOME, LAT_E7, LON_E7

US = {"target_system": 1, "target_component": 191}
GUIDED = 4


def item(seq: int, **over: Any) -> Any:
    values: dict[str, Any] = {"frame": 3, "command": 16, "current": 0, "autocontinue": 1}
    values |= dict.fromkeys(["param1", "param2", "param3", "param4"], 0.0)
    values |= {"x": LAT_E7 + seq * 1000, "y": LON_E7, "z": 30.0}
    return mavlink.MAVLink_mission_item_int_message(1, 191, seq, **(values | over))


def float_item(seq: int) -> Any:
    return mavlink.MAVLink_mission_item_message(1, 191, seq, 3, 16, 0, 1, 0, 0, 0, math.nan, 47.5, 8.5, 30.0)


def count(number: int, target_component: int = 191, mission_type: int = 0) -> Any:
    return mavlink.MAVLink_mission_count_message(1, target_component, number, mission_type)


def start(scripted: Scripted) -> None:
    scripted.link.send(DownloadMission(), scripted.now_s)
    assert [m.get_type() for m in scripted.told()] == ["MISSION_REQUEST_LIST"]


def requested(scripted: Scripted) -> list[tuple[str, int]]:
    return [(m.get_type(), m.seq) for m in scripted.told() if m.get_type().startswith("MISSION_REQUEST")]


def wait(scripted: Scripted, seconds: int) -> list[Event]:
    events: list[Event] = []
    for _ in range(seconds):
        events += scripted.after(1.0)
    return events


def test_ardupilots_home_is_left_out(ardupilot: Scripted) -> None:
    start(ardupilot)
    events = ardupilot.says(count(3))
    for seq in range(3):
        assert requested(ardupilot) == [("MISSION_REQUEST_INT", seq)]
        events = ardupilot.says(item(seq))
    (downloaded,) = events
    assert isinstance(downloaded, MissionDownloaded)
    assert [i.seq for i in downloaded.items] == [1, 2]
    assert downloaded.items[0] == MissionItem(
        seq=1, command=16, frame=3, lat_deg=(LAT_E7 + 1000) / 1e7, lon_deg=HOME.lon_deg, alt_m=30.0
    )
    (thanks,) = ardupilot.told()
    assert (thanks.get_type(), thanks.type) == ("MISSION_ACK", 0)


def test_px4_has_no_home_item(px4: Scripted) -> None:
    start(px4)
    px4.says(count(2))
    px4.says(item(0))
    (downloaded,) = px4.says(item(1))
    assert isinstance(downloaded, MissionDownloaded)
    assert [i.seq for i in downloaded.items] == [0, 1]


@pytest.mark.parametrize("number", [0, 1])
def test_an_empty_mission_is_empty(ardupilot: Scripted, number: int) -> None:
    start(ardupilot)
    events = ardupilot.says(count(number), *[item(seq) for seq in range(number)])
    assert events == [MissionDownloaded(items=())]


def test_lost_answers_are_asked_for_again(px4: Scripted) -> None:
    start(px4)
    px4.after(1.0)
    assert [m.get_type() for m in px4.told()].count("MISSION_REQUEST_LIST") == 1
    px4.says(count(2))
    assert requested(px4) == [("MISSION_REQUEST_INT", 0)]
    px4.after(1.0)
    assert requested(px4) == [("MISSION_REQUEST_INT", 0)]
    px4.says(item(0), item(0))
    assert requested(px4) == [("MISSION_REQUEST_INT", 1)]
    assert len(px4.says(item(1))) == 1


def test_old_vehicles_answer_in_floats(px4: Scripted) -> None:
    start(px4)
    px4.says(count(1))
    wait(px4, 3)
    assert requested(px4) == [*[("MISSION_REQUEST_INT", 0)] * 3, ("MISSION_REQUEST", 0)]
    (downloaded,) = px4.says(float_item(0))
    assert isinstance(downloaded, MissionDownloaded)
    (only,) = downloaded.items
    assert (only.lat_deg, only.lon_deg, only.params[3]) == (47.5, 8.5, None)


def test_silence_ends_in_a_refusal_that_says_what_is_missing(px4: Scripted) -> None:
    start(px4)
    assert wait(px4, 20) == [MissionRefused(reason="MISSION_COUNT was not received after 5 tries")]
    px4.told()
    start(px4)
    px4.says(count(4))
    px4.says(item(0))
    (refused,) = wait(px4, 20)
    assert refused == MissionRefused(reason="item 1 of 4 was not received after 5 tries")


def test_a_mission_that_takes_too_long_is_refused_for_that(px4: Scripted) -> None:
    """Each item is answered at the first try, so a number of tries explained nothing."""
    start(px4)
    events: list[Event] = px4.says(count(2000))
    for seq in range(2000):
        if events:
            break
        events = [*px4.says(item(seq)), *px4.after(0.1)]
    (refused,) = events
    assert refused.reason.startswith("item 60")
    assert refused.reason.endswith(" of 2000 was not received within 60 s")


def test_a_refusing_vehicle_is_quoted(px4: Scripted) -> None:
    start(px4)
    (refused,) = px4.says(mavlink.MAVLink_mission_ack_message(1, 191, 14, 0))
    assert isinstance(refused, MissionRefused)
    assert "denied" in refused.reason


def test_answers_to_others_and_other_lists_are_left_out(px4: Scripted) -> None:
    start(px4)
    px4.says(count(9, target_component=190), count(5, mission_type=1))
    assert requested(px4) == []
    px4.says(mavlink.MAVLink_mission_ack_message(255, 190, 14, 0))
    px4.says(count(1))
    assert requested(px4) == [("MISSION_REQUEST_INT", 0)]


def test_absurd_counts_are_refused(px4: Scripted) -> None:
    start(px4)
    (refused,) = px4.says(count(60000))
    assert isinstance(refused, MissionRefused)


@pytest.mark.parametrize("y", [-1_800_000_000, 1_800_000_000])
def test_the_180th_meridian_is_on_earth(px4: Scripted, y: int) -> None:
    start(px4)
    px4.says(count(1))
    (downloaded,) = px4.says(item(0, x=900_000_000, y=y))
    assert isinstance(downloaded, MissionDownloaded)
    assert downloaded.items[0].lon_deg == y / 1e7


@pytest.mark.parametrize("over", [{"x": 910000000}, {"y": 1800000001}, {"z": math.inf}])
def test_a_senseless_item_ends_the_download(px4: Scripted, over: dict[str, Any]) -> None:
    start(px4)
    px4.says(count(1))
    (refused,) = px4.says(item(0, **over))
    assert isinstance(refused, MissionRefused)
    assert "item 0" in refused.reason
    assert px4.link.counts.bad_values == 1


def test_values_left_open_are_unknown(px4: Scripted) -> None:
    start(px4)
    px4.says(count(1))
    (downloaded,) = px4.says(item(0, command=21, x=2**31 - 1, y=2**31 - 1, z=math.nan, param4=math.nan))
    assert isinstance(downloaded, MissionDownloaded)
    (only,) = downloaded.items
    assert (only.lat_deg, only.lon_deg, only.alt_m, only.params) == (None, None, None, (0.0, 0.0, 0.0, None))


def test_a_mission_that_changes_meanwhile_is_begun_again(px4: Scripted) -> None:
    start(px4)
    px4.says(count(3))
    px4.says(item(0))
    px4.says(count(1))
    (downloaded,) = px4.says(item(0))
    assert isinstance(downloaded, MissionDownloaded)
    assert len(downloaded.items) == 1


def current(scripted: Scripted, total: int, mission_id: int) -> list[Event]:
    """MISSION_CURRENT with the fields that pymavlink's layout lacks."""
    payload = struct.pack("<HHBBI", 0, total, 3, 1, mission_id)
    frame = MavlinkWriter(1, 1).pack_payload(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT, payload)
    return [e for e in scripted.link.receive(frame, scripted.now_s) if not isinstance(e, MissionCurrent)]


@pytest.mark.parametrize("marks", [((2, 7), (2, 8)), ((3, 0), (2, 0))])
def test_a_mission_that_is_replaced_meanwhile_is_no_mixture_of_both(px4: Scripted, marks) -> None:
    """Items 0 of the old mission and 1 of the new one would be a path that nobody has planned."""
    old, new = marks
    current(px4, *old)
    start(px4)
    px4.says(count(2))
    px4.says(item(0, z=30.0))
    assert current(px4, *new) == []
    assert "MISSION_REQUEST_LIST" in [m.get_type() for m in px4.told()]
    assert px4.says(item(1, z=90.0)) == [], "the answer to the request before"
    px4.says(count(2))
    events = px4.says(item(0, z=80.0)) + px4.says(item(1, z=90.0)) + current(px4, *new)
    (downloaded,) = events
    assert isinstance(downloaded, MissionDownloaded)
    assert [i.alt_m for i in downloaded.items] == [80.0, 90.0]


def test_an_ardupilot_that_receives_a_mission_ends_the_download(ardupilot: Scripted) -> None:
    """It names no mission, but serves none while one is uploaded. The items so far are dropped."""
    start(ardupilot)
    ardupilot.says(count(3))
    ardupilot.says(item(1, z=30.0))
    (refused,) = ardupilot.says(mavlink.MAVLink_mission_ack_message(1, 191, 14, 0))
    assert isinstance(refused, MissionRefused)
    assert ardupilot.says(item(2, z=90.0)) == []
    assert wait(ardupilot, 20) == []


def test_a_mission_that_is_replaced_by_its_last_item_is_fetched_again(px4: Scripted) -> None:
    """The id of the new mission is reported after the last item has arrived."""
    current(px4, 2, 7)
    start(px4)
    px4.says(count(2))
    assert px4.says(item(0)) + px4.says(item(1)) == []
    assert current(px4, 2, 8) == []
    px4.says(count(2))
    px4.says(item(0))
    assert px4.says(item(1)) == []
    (downloaded,) = current(px4, 2, 8)
    assert isinstance(downloaded, MissionDownloaded)


def test_a_mission_with_an_id_that_is_not_confirmed_is_refused(px4: Scripted) -> None:
    current(px4, 1, 7)
    start(px4)
    px4.says(count(1))
    px4.says(item(0))
    (refused,) = wait(px4, 10)
    assert refused == MissionRefused(reason="MISSION_CURRENT, which confirms the mission, was not received")


def test_no_vehicle_no_mission() -> None:
    scripted = Scripted()
    scripted.link.send(DownloadMission(), 0.0)
    (refused,) = scripted.after(0.0)
    assert isinstance(refused, MissionRefused)
