"""What the vehicle is asked for."""

from __future__ import annotations

import itertools

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.polled.streams import FIRMWARE_OF, STREAM_RATES_HZ
from companion.events import (
    AdsbVehicle,
    Firmware,
)
from tests.companion.autopilot.conftest import Scripted
from tests.support.place import LAT_E7, LON_E7

ARDUPILOT_RATES_HZ = {
    number: rate for number, rate in STREAM_RATES_HZ.items() if FIRMWARE_OF.get(number) is not Firmware.PX4
}
"""What the other firmware alone sends is not asked for."""


def asked(scripted: Scripted) -> list[int]:
    return [int(m.param1) for m in scripted.told("COMMAND_LONG") if m.command == 511]


def test_streams_are_asked_for_once_the_vehicle_is_known() -> None:
    scripted = Scripted()
    scripted.after(0.0)
    assert asked(scripted) == []
    scripted.heartbeat()
    scripted.after(0.1)
    requests = [m for m in scripted.told("COMMAND_LONG") if m.command == 511]
    assert {int(m.param1): 1e6 / m.param2 for m in requests} == pytest.approx(ARDUPILOT_RATES_HZ)
    assert {m.param3 for m in requests} == {0.0}


def test_streams_that_arrive_are_not_asked_for_again(ardupilot: Scripted) -> None:
    for step in range(300):
        if step % 10 == 0:
            ardupilot.heartbeat()
        ardupilot.says(ardupilot.position(1000 + 100 * step))
        ardupilot.after(0.1)
    assert mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT not in asked(ardupilot)


def test_a_refusing_vehicle_is_asked_ever_more_rarely(ardupilot: Scripted) -> None:
    asked_at = []
    for step in range(1200):
        if step % 10 == 0:
            ardupilot.heartbeat()
        ardupilot.after(0.1)
        if mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT in asked(ardupilot):
            asked_at.append(step / 10)
    gaps = [round(b - a) for a, b in itertools.pairwise(asked_at)]
    assert gaps[:3] == [4, 8, 16]
    assert max(gaps) <= 31
    assert len(asked_at) <= 7


def test_a_stream_at_a_fraction_of_its_rate_is_asked_for_again(ardupilot: Scripted) -> None:
    for step in range(30):
        if step % 10 == 0:
            ardupilot.heartbeat()
            ardupilot.says(ardupilot.position(1000 + 100 * step))
        ardupilot.after(0.1)
    assert mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT in asked(ardupilot)


def test_a_reboot_forgets_rates_so_they_are_asked_for_at_once(ardupilot: Scripted) -> None:
    ardupilot.says(ardupilot.position(60_000))
    ardupilot.after(0.5)
    ardupilot.says(ardupilot.position(59_950))
    ardupilot.after(0.1)
    assert asked(ardupilot) == []
    ardupilot.says(ardupilot.position(400))
    ardupilot.after(0.1)
    assert set(asked(ardupilot)) == set(ARDUPILOT_RATES_HZ)
    assert ardupilot.link.counts.reboots == 1


def test_a_dropped_link_is_not_talked_at_and_asked_again_when_it_returns(ardupilot: Scripted) -> None:
    ardupilot.after(3.5)
    ardupilot.told()
    for _ in range(100):
        ardupilot.after(0.5)
    assert asked(ardupilot) == []
    ardupilot.heartbeat()
    ardupilot.after(0.1)
    assert set(asked(ardupilot)) == set(ARDUPILOT_RATES_HZ)
    assert ardupilot.link.counts.drops == 1


ADSB = mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE


def adsb(flags: int = 3, icao: int = 0x4B1234) -> mavlink.MAVLink_adsb_vehicle_message:
    return mavlink.MAVLink_adsb_vehicle_message(
        icao, LAT_E7, LON_E7, 0, 500_000, 0, 0, 0, b"", 1, 0, flags, 0
    )


def asked_for_traffic(scripted: Scripted, *, traffic_at_s: float) -> list[float]:
    """When ADSB_VEHICLE is asked for within a minute, with one report at `traffic_at_s`."""
    asked_at = []
    for step in range(1, 601):
        if step % 10 == 0:
            scripted.heartbeat()
        if step == round(traffic_at_s * 10):
            scripted.says(adsb())
        scripted.after(0.1)
        if ADSB in asked(scripted):
            asked_at.append(step / 10)
    return asked_at


def test_traffic_is_asked_for_three_times_and_then_silence_is_believed(ardupilot: Scripted) -> None:
    # The first time was when the vehicle was first heard.
    assert asked_for_traffic(ardupilot, traffic_at_s=1e9) == pytest.approx([2.0, 6.0], abs=0.3)


def test_traffic_that_comes_is_not_asked_for_again(ardupilot: Scripted) -> None:
    assert asked_for_traffic(ardupilot, traffic_at_s=1.0) == []
    scripted = Scripted()
    assert asked_for_traffic(scripted, traffic_at_s=5.0) == pytest.approx([1.0, 3.0], abs=0.3)


def test_traffic_is_taken_from_the_autopilot_alone(ardupilot: Scripted) -> None:
    (event,) = ardupilot.says(adsb())
    assert isinstance(event, AdsbVehicle)
    assert event.icao == 0x4B1234
    # A receiver's own frames, as ArduPilot forwards them, and another vehicle's.
    assert ardupilot.says(adsb(), component=156) == []
    assert ardupilot.says(adsb(), system=2) == []
    assert ardupilot.link.counts.foreign == 2
    assert ardupilot.says(adsb(flags=0)) == []
    assert ardupilot.link.counts.no_position == 1
    assert ardupilot.says(adsb(icao=2**24)) == []
    assert ardupilot.link.counts.bad_values == 1
