"""The companion's estimate of the age of its position, over links that are slow in one or both directions."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.polled.timesync import timesync
from companion.autopilot.wire import MavlinkWriter
from companion.events import Firmware
from tests.sitl_mocks.with_companion.delayed import Delayed

WAYS = [(0.15, 0.0), (0.0, 0.15), (0.15, 0.15), (0.02, 0.02), (0.0, 0.0)]
"""Down and up (s)."""
SLACK_S = 0.055
"""A request waits for at most one tick, and positions arrive every 100 ms."""


@pytest.mark.parametrize(("down_s", "up_s"), WAYS)
@pytest.mark.parametrize("firmware", Firmware)
def test_the_age_is_true_to_half_the_round_trip(firmware, down_s, up_s):
    link = Delayed(firmware, down_s, up_s)
    link.run(5.0)
    assert link.onboard.link.counts.clock_reads >= 4
    assert abs(link.error_s) <= link.half_s + SLACK_S / 2
    if down_s == up_s:
        assert abs(link.error_s) <= SLACK_S / 2
    age_s = link.onboard.core.own.age_s(link.now_s)
    assert age_s >= down_s / 2 - SLACK_S / 2


@pytest.mark.parametrize("firmware", Firmware)
def test_a_link_that_turns_slow_in_flight(firmware):
    link = Delayed(firmware, 0.0, 0.0, airborne=True, start_position_ned_m=(0.0, 0.0, -50.0))
    link.run(5.0)
    link.down_s = 0.4
    link.run(10.0)
    assert abs(link.error_s) <= SLACK_S / 2


def test_a_vehicle_that_answers_nothing_is_dated_by_its_messages():
    link = Delayed(Firmware.ARDUPILOT, 0.15, 0.15)
    link.vehicle._handlers.pop("TIMESYNC")
    link.run(5.0)
    assert link.onboard.link.counts.clock_reads == 0
    assert link.error_s == pytest.approx(-0.15, abs=0.06)


@pytest.mark.parametrize("firmware", Firmware)
def test_after_a_reboot_the_new_clock_counts(firmware):
    link = Delayed(firmware, 0.05, 0.05)
    link.run(5.0)
    writer = MavlinkWriter(255, 190)
    reboot = mavlink.MAVLink_command_long_message(1, 1, 246, 0, 1, 0, 0, 0, 0, 0, 0)
    link.vehicle.receive(writer.pack(reboot), link.now_s)
    link.run(7.0)
    assert link.onboard.link.counts.reboots == 1
    assert link.onboard.core.own.position.time_boot_s < 5.0
    assert abs(link.error_s) <= SLACK_S / 2


def test_forged_answers_move_nothing():
    """The forged answers seem to come from the vehicle, with another clock, from a sender that does not see
    the requests."""
    alone, forged = (Delayed(Firmware.PX4, 0.05, 0.05) for _ in range(2))
    writer = MavlinkWriter(1, 1)
    told = [(5_000_000_000, 0, 1, 191), (125_000_000_000, 3_000_000_000, 1, 191), (1, 1, 0, 0)]
    forged.inject = b"".join(writer.pack_payload(*timesync(*fields)) for fields in told)
    alone.run(5.0)
    forged.run(5.0)
    assert forged.onboard.core.own.age_s(5.0) == alone.onboard.core.own.age_s(5.0)


@pytest.mark.parametrize("firmware", Firmware)
def test_the_vehicle_reads_our_clock_as_well(firmware):
    link = Delayed(firmware, 0.0, 0.0)
    link.run(12.0)
    assert link.onboard.link.counts.clock_answers >= 1
