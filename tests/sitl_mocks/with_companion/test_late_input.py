"""Messages of the vehicle that arrive late: what the status and the pilot are told."""

from __future__ import annotations

from itertools import pairwise

import pytest

from companion.authority.late_input import ClockRate, LateInput
from companion.events import ClockRead, Firmware, InputBehind
from companion.runtime.status.live_state import core_status
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from tests.companion.conftest import config
from tests.sitl_mocks.with_companion.delayed import WATCHING, Delayed

LATE = "by its own clock, the vehicle's messages arrive"
SLOW = "the vehicle's clock runs at 0.930 of ours: " + LATE
RECENT = "; nothing is commanded until its messages are recent and show the mode"
KEPT = "; nothing is commanded until it keeps time and the companion is restarted"

ENDS_IN = {Firmware.ARDUPILOT: "standby", Firmware.PX4: "yielded"}
"""Without setpoints, ArduPilot stays in GUIDED, and PX4 returns by its failsafe."""


class Flown(Delayed):
    """A vehicle in the air in the mode that gives the companion authority."""

    def __init__(self, firmware, *, rate=1.0, configured=None, **options):
        configured = config() if configured is None else configured
        options = {"airborne": True, "start_position_ned_m": (0.0, 0.0, -50.0), **options}
        options.setdefault("start_mode", VehicleMode.EXTERNAL)
        super().__init__(firmware, 0.0, 0.0, rate=rate, config=configured, **options)

    @property
    def status(self):
        return core_status(self.onboard.core, self.now_s, None)

    @property
    def warned(self):
        return [text for _, text in self.said if "nothing is commanded" in text]


@pytest.mark.parametrize("firmware", Firmware)
def test_messages_that_are_held_up_are_named_with_what_follows(firmware):
    link = Flown(firmware)
    link.run(5.0)
    assert link.status["state"] == "guarding"
    assert link.status["waits_for"] is None
    link.down_s = 0.8
    link.run(10.0)
    assert link.status["state"] == ENDS_IN[firmware]
    why = link.status["waits_for"]
    assert why == f"{LATE} 0.8 s late (allowed: up to 0.5 s){RECENT}"
    assert any(text.startswith("DMUCA fault: no command sent for 1 s: " + LATE) for _, text in link.said)
    assert [text.startswith(f"DMUCA: {LATE}") and text.endswith(RECENT) for text in link.warned] == [True]
    link.down_s = 0.0
    link.run(10.0)
    assert link.onboard.core._late_input.text is None
    assert "DMUCA: the vehicle's messages are recent again" in [text for _, text in link.said]


@pytest.mark.parametrize("firmware", Firmware)
def test_a_clock_that_runs_slow_is_named_and_still_refused(firmware):
    link = Flown(firmware, rate=0.93)
    link.run(5.0)
    assert link.status["state"] == "guarding"
    link.run(40.0)
    assert link.status["state"] == ENDS_IN[firmware]
    assert link.status["waits_for"].startswith(SLOW)
    assert link.status["waits_for"].endswith(KEPT)
    named = [text.startswith(f"DMUCA: {SLOW}") and text.endswith(KEPT) for text in link.warned]
    assert named == [True]


@pytest.mark.parametrize("firmware", Firmware)
def test_a_clock_that_runs_a_little_slow_is_flown_by(firmware):
    """As that of PX4's simulator on a busy computer."""
    link = Flown(firmware, rate=0.967)
    link.run(120.0)
    assert link.status["state"] == "guarding"
    assert not link.warned


def test_a_companion_that_only_watches_warns_of_nothing_that_it_would_not_do_anyway():
    link = Flown(Firmware.PX4, configured=WATCHING)
    link.run(5.0)
    link.down_s = 0.8
    link.run(10.0)
    assert link.onboard.core._late_input.text is not None
    assert not link.warned


def read(rate, readings, down_s=lambda now_s: 0.01, jump_s=0.0):
    """Rate that a series of answers to TIMESYNC shows, one a second over a link without delay upwards."""
    measured = ClockRate()
    for asked_s in range(readings):
        boot_s = rate * asked_s - (jump_s if asked_s > readings / 2 else 0.0)
        measured.read(ClockRead(time_boot_s=boot_s, asked_s=asked_s, heard_s=asked_s + down_s(asked_s)))
    return measured.slow()


def test_only_a_clock_that_loses_steadily_is_called_slow():
    assert read(0.953, 30) == pytest.approx(0.953, abs=1e-9)
    assert read(0.99, 30) == pytest.approx(0.99, abs=1e-9)
    assert read(0.953, 1) is None
    assert read(0.953, 20) is None  # 19 s are too short
    assert read(0.953, 21) == pytest.approx(0.953, abs=1e-9)
    assert read(0.9995, 60) is None  # as good as the gate asks for
    assert read(1.05, 30) is None  # ahead of ours
    assert read(1.0, 30, jump_s=0.9) is None  # stood still once


def test_a_link_that_becomes_slower_and_slower_is_no_slow_clock():
    assert read(1.0, 30, lambda now_s: 0.01 + 0.016 * now_s) is None


def test_a_slow_clock_is_told_through_a_link_whose_delay_varies():
    assert read(0.953, 30, lambda now_s: 0.01 if now_s % 3 else 0.4) == pytest.approx(0.953, abs=0.01)


def test_an_older_record_that_holds_no_measurement_replays_without_warnings():
    late = LateInput()
    assert not any(late.step(0.05 * step, InputBehind(since_s=0.0)) for step in range(100))
    assert late.text is None


def test_a_link_that_is_late_again_and_again_is_warned_of_every_ten_seconds():
    late, warned = LateInput(), []
    for step in range(800):
        behind = InputBehind(since_s=0.0, why="late") if step % 50 < 40 else None
        if any("nothing is commanded" in said.text for said in late.step(0.05 * step, behind)):
            warned.append(0.05 * step)
    assert len(warned) == 4
    assert all(later - earlier >= 10.0 for earlier, later in pairwise(warned))
