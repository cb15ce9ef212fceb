"""The mock vehicle's fence, sent by hand and by the companion's link, over lossless and lossy lines."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.link import AutopilotLink
from companion.autopilot.wire import FrameScanner
from companion.config import VehicleConfig
from companion.errors import ConfigError
from companion.events import (
    DownloadFence,
    DownloadMission,
    FenceArea,
    FenceDownloaded,
    Firmware,
    MissionDownloaded,
    MissionItem,
    Threat,
)
from sitl_mocks.vehicle.mock_vehicle import MockVehicle
from sitl_mocks.vehicle.options import VehicleOptions
from tests.sitl_mocks.vehicle.test_mission import download as download_mission
from tests.sitl_mocks.vehicle.test_mission import plan, upload
from tests.support.place import HOME

AP, PX4 = Firmware.ARDUPILOT, Firmware.PX4
BOTH = pytest.mark.parametrize("firmware", [AP, PX4])
FENCE = 1
SQUARE = ((47.396, 8.543), (47.4, 8.543), (47.4, 8.55), (47.396, 8.55))
AREAS = (
    FenceArea(inclusion=True, points=SQUARE),
    FenceArea(inclusion=False, points=((47.3978, 8.5468),), radius_m=25.0),
    FenceArea(inclusion=False, points=SQUARE[:3]),
)


def wire(seq, command, p1, lat=47.4, lon=8.5, frame=0, z=12.0):
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, seq, frame, command, 0, 1, p1, 1.0, 2.0, 3.0, round(lat * 1e7), round(lon * 1e7), z, FENCE
    )


TRIANGLE = [wire(seq, 5001, 3.0, *place) for seq, place in enumerate(SQUARE[:3])]


def send_fence(b, items):
    """Upload a fence; returns the type of the final MISSION_ACK."""
    answers = b.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), FENCE))
    for _ in range(len(items) + 1):
        last = answers[-1]
        assert last.mission_type == FENCE
        if last.get_type() == "MISSION_ACK":
            return last.type
        answers = b.send(items[last.seq])
    raise AssertionError("no end")


def download(b):
    (count,) = b.send(mavlink.MAVLink_mission_request_list_message(1, 1, FENCE))
    assert (count.get_type(), count.mission_type) == ("MISSION_COUNT", FENCE)
    got = [
        b.send(mavlink.MAVLink_mission_request_int_message(1, 1, seq, FENCE))[0] for seq in range(count.count)
    ]
    b.send(mavlink.MAVLink_mission_ack_message(1, 1, 0, FENCE))
    return got


@pytest.mark.parametrize(("firmware", "frames", "z"), [(AP, [0, 0], 0.0), (PX4, [5, 6], 12.0)])
def test_an_uploaded_fence_comes_back_in_the_firmwares_manner(bench, firmware, frames, z):
    b = bench(firmware)
    items = [*TRIANGLE, wire(3, 5004, 20.0, frame=3), wire(4, 5000, 7.0)]
    assert send_fence(b, items) == mavlink.MAV_MISSION_ACCEPTED
    got = download(b)
    assert [(m.command, m.param1, m.x, m.y) for m in got[:4]] == [
        (m.command, m.param1, m.x, m.y) for m in items[:4]
    ]
    assert [got[0].frame, got[3].frame] == frames
    assert {(m.z, m.param2, m.param3, m.param4) for m in got} == {(z, 0.0, 0.0, 0.0)}
    assert (got[4].command, got[4].param1) == (5000, 0.0)
    assert "Flight plan received" not in b.texts()


@BOTH
@pytest.mark.parametrize(
    ("bad", "result"),
    [
        ([wire(0, 16, 3.0)], mavlink.MAV_MISSION_UNSUPPORTED),
        ([wire(0, 5003, 3.0, frame=1)], mavlink.MAV_MISSION_UNSUPPORTED_FRAME),
        ([wire(0, 5003, 0.0)], mavlink.MAV_MISSION_ERROR),
        ([wire(0, 5003, math.nan)], mavlink.MAV_MISSION_ERROR),
        ([wire(0, 5001, math.nan)], mavlink.MAV_MISSION_ERROR),
        ([wire(0, 5001, 2.0), wire(1, 5001, 2.0)], mavlink.MAV_MISSION_ERROR),
        (TRIANGLE[:2], mavlink.MAV_MISSION_ERROR),
        ([*TRIANGLE[:2], wire(2, 5002, 3.0)], mavlink.MAV_MISSION_ERROR),
    ],
)
def test_a_bad_fence_is_refused_and_the_old_one_stays(bench, firmware, bad, result):
    b = bench(firmware, fence=AREAS)
    assert send_fence(b, bad) == result
    assert len(download(b)) == 8


@BOTH
def test_fence_and_mission_are_two_lists(bench, firmware):
    b = bench(firmware, fence=AREAS)
    items = plan(firmware)
    upload(b, items)
    assert len(download(b)) == 8
    assert len(download_mission(b)) == len(items)
    b.send(mavlink.MAVLink_mission_clear_all_message(1, 1, FENCE))
    assert download(b) == []
    assert len(download_mission(b)) == len(items)
    send_fence(b, TRIANGLE)
    (ack,) = b.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 255))
    assert (ack.type, ack.mission_type) == (mavlink.MAV_MISSION_ACCEPTED, 255)
    assert download(b) == download_mission(b) == []


@BOTH
def test_a_fence_nobody_could_fly_in_is_no_option(bench, firmware):
    with pytest.raises(ConfigError, match=r"^fence: area\[0\]\.points: 2 points"):
        bench(firmware, fence=(FenceArea(inclusion=True, points=SQUARE[:2]),))


def test_ardupilot_that_receives_a_list_does_not_send_it(bench):
    b = bench(AP, fence=AREAS)
    b.send(mavlink.MAVLink_mission_count_message(1, 1, 3, FENCE))
    for question in (
        mavlink.MAVLink_mission_request_list_message(1, 1, FENCE),
        mavlink.MAVLink_mission_request_int_message(1, 1, 0, FENCE),
    ):
        (ack,) = b.send(question)
        assert (ack.type, ack.mission_type) == (mavlink.MAV_MISSION_DENIED, FENCE)
    b.run(9.0)
    assert "Fence upload timeout" in b.texts()
    assert len(download(b)) == 8


def ask(b, kind):
    return [m.get_type() for m in b.send(mavlink.MAVLink_mission_request_list_message(1, 1, kind))]


def item(b, seq, kind=FENCE):
    return [m.get_type() for m in b.send(mavlink.MAVLink_mission_request_int_message(1, 1, seq, kind))]


def test_px4_sends_one_list_at_a_time(bench):
    b = bench(PX4, fence=AREAS)
    upload(b, plan(PX4))
    assert item(b, 0) == []
    assert ask(b, FENCE) == ["MISSION_COUNT"]
    assert item(b, 0) == ["MISSION_ITEM_INT"]
    assert ask(b, 0) == []
    assert item(b, 0, kind=0) == []
    assert item(b, 0) == item(b, 1) == ["MISSION_ITEM_INT"]
    # Nor may it be changed during the transfer.
    assert b.send(mavlink.MAVLink_mission_clear_all_message(1, 1, FENCE)) == []
    assert b.send(mavlink.MAVLink_mission_count_message(1, 1, 3, FENCE)) == []
    # After a cancellation, or 5 s of silence, it serves the other partner.
    b.send(mavlink.MAVLink_mission_ack_message(1, 1, mavlink.MAV_MISSION_OPERATION_CANCELLED, FENCE))
    assert ask(b, 0) == ["MISSION_COUNT"]
    assert item(b, 0, kind=0) == ["MISSION_ITEM_INT"]
    b.run(4.0)
    assert ask(b, FENCE) == []
    b.run(1.1)
    assert ask(b, FENCE) == ["MISSION_COUNT"]
    # Out of order: the transfer is over.
    (ack,) = b.send(mavlink.MAVLink_mission_request_int_message(1, 1, 4, FENCE))
    assert (ack.get_type(), ack.type) == ("MISSION_ACK", mavlink.MAV_MISSION_ERROR)
    assert item(b, 0) == []


def test_px4_that_receives_a_list_sends_none(bench):
    b = bench(PX4, fence=AREAS)
    b.send(mavlink.MAVLink_mission_count_message(1, 1, 3, 0))
    assert ask(b, FENCE) == ask(b, 0) == item(b, 0) == []
    b.run(6.0)
    assert len(download(b)) == 8


# ---------------------------------------------------------------- with the companion's link

MISSION = tuple(
    MissionItem(seq=n, command=16, frame=6, lat_deg=HOME.lat_deg + n * 1e-4, lon_deg=HOME.lon_deg, alt_m=50.0)
    for n in range(6)
)


class Line:
    """A line between a link and a vehicle that loses a share of the frames in each direction."""

    def __init__(self, firmware, loss=0.0, seed=1, **options):
        self.vehicle = MockVehicle(VehicleOptions(firmware=firmware, **options), np.random.default_rng(1))
        self.link = AutopilotLink(VehicleConfig())
        self.loss = loss
        self.random = random.Random(seed)
        self.scanners = FrameScanner(), FrameScanner()
        self.tick = 0
        self.events = []
        self.lost = 0

    @property
    def now_s(self):
        return self.tick * 0.05

    def survivors(self, way, data):
        kept = b""
        for frame in self.scanners[way].frames(data):
            # The mission protocol alone is disturbed: a link without heartbeats is another test.
            mission = frame.message_id in (39, 40, 43, 44, 47, 51, 73)
            if mission and self.random.random() < self.loss:
                self.lost += 1
            else:
                kept += frame.raw
        return kept

    def run(self, seconds):
        for _ in range(round(seconds / 0.05)):
            self.tick += 1
            self.vehicle.advance(self.now_s)
            self.events += self.link.receive(self.survivors(0, self.vehicle.drain()), self.now_s)
            self.events += self.link.advance(self.now_s)
            self.vehicle.receive(self.survivors(1, self.link.drain()), self.now_s)

    def of(self, *kinds):
        return [event for event in self.events if isinstance(event, kinds)]


@BOTH
@pytest.mark.parametrize("first", [DownloadMission(), DownloadFence()])
def test_mission_and_fence_asked_for_at_once(firmware, first):
    line = Line(firmware, fence=AREAS, mission=MISSION)
    line.run(1.5)
    line.link.send(first, line.now_s)
    line.link.send(DownloadMission(), line.now_s)
    line.link.send(DownloadFence(), line.now_s)
    line.run(5.0)
    assert line.of(FenceDownloaded) == [FenceDownloaded(areas=AREAS)]
    (mission,) = line.of(MissionDownloaded)
    assert [item.alt_m for item in mission.items] == [50.0] * 6


@BOTH
def test_a_vehicle_without_a_fence(firmware):
    line = Line(firmware)
    line.run(1.5)
    line.link.send(DownloadFence(), line.now_s)
    line.run(1.0)
    assert line.of(FenceDownloaded) == [FenceDownloaded(areas=())]


@BOTH
@pytest.mark.parametrize("seed", range(5))
def test_over_a_line_that_loses_frames(firmware, seed):
    line = Line(firmware, loss=0.15, seed=seed, fence=AREAS, mission=MISSION)
    line.run(1.5)
    line.link.send(DownloadMission(), line.now_s)
    line.link.send(DownloadFence(), line.now_s)
    line.run(60.0)
    assert line.lost > 0
    assert line.of(FenceDownloaded) == [FenceDownloaded(areas=AREAS)]
    assert len(line.of(MissionDownloaded)) == 1


@BOTH
def test_threats_reach_the_vehicle(firmware):
    line = Line(firmware)
    line.run(1.5)
    for level in (1, 2):
        threat = Threat(
            track_id="4b1234",
            adsb=True,
            level=level,
            acting=level == 2,
            time_to_closest_s=20.0,
            horizontal_m=50.0,
            vertical_m=10.0,
        )
        line.link.send(threat, line.now_s)
        line.run(0.1)
    told = [message for _, message in line.vehicle.collisions]
    assert [(m.src, m.id, m.action, m.threat_level) for m in told] == [
        (0, 0x4B1234, 1, 1),
        (0, 0x4B1234, 4, 2),
    ]
    assert {m.horizontal_minimum_delta for m in told} == {50.0}
