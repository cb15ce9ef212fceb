"""Which messages are asked for, how often again, and when it is enough."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.polled.streams import STREAM_RATES_HZ, Streams
from companion.autopilot.wire import CURRENT_MODE
from companion.events import Firmware

POSITION = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
TRAFFIC = mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE
ARDUPILOTS, PX4S = mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT, mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS


def started(firmware: Firmware = Firmware.ARDUPILOT) -> tuple[Streams, dict[int, int]]:
    streams = Streams()
    streams.restart(100.0, firmware)
    return streams, dict(streams.due(100.0))


@pytest.mark.parametrize(
    ("firmware", "others"), [(Firmware.ARDUPILOT, {PX4S, CURRENT_MODE}), (Firmware.PX4, {ARDUPILOTS})]
)
def test_all_that_the_firmware_has_is_asked_for_at_once(firmware: Firmware, others: set[int]) -> None:
    streams, asked = started(firmware)
    assert set(asked) == set(STREAM_RATES_HZ) - others
    # In microseconds.
    assert asked[POSITION] == 100_000
    assert asked[TRAFFIC] == 40_000
    assert streams.due(100.0) == []


def asked_s(received_hz: float, message_id: int = POSITION, until_s: float = 150.0) -> list[float]:
    """When a message that arrives at this rate is asked for again."""
    streams, _ = started(Firmware.PX4)
    found, due = [], 0.0
    for step in range(1, round((until_s - 100.0) * 10) + 1):
        due += 0.1 * received_hz
        while due >= 1.0:
            streams.received(message_id)
            due -= 1.0
        now_s = 100.0 + 0.1 * step
        if message_id in dict(streams.due(now_s)):
            found.append(round(now_s, 1))
    return found


def test_a_message_that_does_not_come_is_asked_for_ever_more_rarely() -> None:
    """After 2 s, then after twice as long each time, 30 s at most."""
    assert asked_s(0.0, until_s=230.0) == [102.0, 106.0, 114.0, 130.0, 160.0, 190.0, 220.0]


@pytest.mark.parametrize(("rate_hz", "enough"), [(10.0, True), (5.5, True), (4.5, False)])
def test_half_of_the_rate_is_enough(rate_hz: float, enough: bool) -> None:
    assert (asked_s(rate_hz) == []) is enough


@pytest.mark.parametrize(("rate_hz", "enough"), [(2.0, True), (1.2, True), (0.8, False)])
def test_the_mode_comes_twice_a_second_whatever_is_asked_for(rate_hz: float, enough: bool) -> None:
    assert (asked_s(rate_hz, CURRENT_MODE) == []) is enough


def test_traffic_is_asked_for_three_times_and_no_more_once_it_comes() -> None:
    assert asked_s(0.0, TRAFFIC, until_s=300.0) == [102.0, 106.0]
    assert asked_s(1.0, TRAFFIC, until_s=300.0) == []


def test_after_a_restart_all_is_asked_for_again() -> None:
    streams, first = started()
    for _ in range(9):
        streams.received(POSITION)
        streams.received(TRAFFIC)
    streams.due(102.0)
    streams.restart(103.0, Firmware.ARDUPILOT)
    assert dict(streams.due(103.0)) == first
    assert set(dict(streams.due(105.0))) == set(first)
