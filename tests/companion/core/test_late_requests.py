"""Requests for a mode that the vehicle obeys after the pilot has selected another one."""

from __future__ import annotations

import pytest

from companion.authority.table import HOLDING, State
from companion.events import Firmware, FlightMode, Say, SetMode, Settings, Severity


def test_a_request_that_the_vehicle_obeys_after_the_pilots_choice_gives_no_authority(make_bench):
    """It was on its way as he selected his mode. Only what he selects after that counts."""
    bench = make_bench(rearm="mode")
    bench.firmware, bench.mode, bench.obeys = Firmware.ARDUPILOT, FlightMode.MISSION, False
    bench.until(lambda: any(isinstance(c, SetMode) for c in bench.commands))
    bench.mode = FlightMode.STICKS
    bench.step(2)
    assert bench.core.state is State.YIELDED
    bench.mode = FlightMode.EXTERNAL
    bench.step(200)
    assert bench.core.state is State.YIELDED
    bench.mode = FlightMode.STICKS
    bench.step(2)
    bench.mode = FlightMode.EXTERNAL
    bench.until(lambda: bench.core.in_control)


@pytest.mark.parametrize(
    ("custom_mode", "mode", "asked", "words"),
    [
        (5, FlightMode.STICKS, [FlightMode.STICKS], "LOITER is requested again"),
        (17, FlightMode.HOLD, [FlightMode.HOLD], "BRAKE is requested again"),
        (6, FlightMode.OTHER, [], "RTL must be selected again"),
    ],
)
@pytest.mark.parametrize("rearm", ["mode", "disarm", "never"])
def test_a_mode_that_a_late_request_of_ours_ended_is_restored_once(
    make_bench, rearm, custom_mode, mode, asked, words
):
    """The vehicle would stay in GUIDED, which no pilot has selected and nobody flies."""
    bench = make_bench(rearm=rearm)
    bench.firmware, bench.mode, bench.custom_mode = Firmware.ARDUPILOT, FlightMode.MISSION, 3
    bench.obeys = False
    bench.until(lambda: any(isinstance(c, SetMode) for c in bench.commands))
    bench.mode, bench.custom_mode = mode, custom_mode
    assert not [c for c in bench.step(20) if isinstance(c, SetMode)]
    bench.mode, bench.custom_mode = FlightMode.EXTERNAL, 4
    commands = bench.step(10)
    assert [c.mode for c in commands if isinstance(c, SetMode)] == asked
    (said,) = [c for c in commands if isinstance(c, Say)]
    assert said.severity is Severity.WARNING
    name = words.split()[0]
    assert said.text == f"DMUCA: GUIDED entered after {name}, by our earlier request: {words}"
    bench.mode, bench.custom_mode = mode, custom_mode
    bench.step(2)
    bench.mode, bench.custom_mode = FlightMode.EXTERNAL, 4
    assert not [c for c in bench.step(100) if isinstance(c, SetMode | Say)], "now it is his own choice"
    assert bench.core.state is State.YIELDED


def test_a_pilot_who_selects_his_mode_after_ours_was_entered_hears_nothing_of_it(make_bench):
    bench = make_bench(rearm="mode")
    bench.firmware, bench.mode, bench.custom_mode = Firmware.ARDUPILOT, FlightMode.MISSION, 3
    bench.obeys = False
    bench.until(lambda: any(isinstance(c, SetMode) for c in bench.commands))
    bench.mode, bench.custom_mode = FlightMode.EXTERNAL, 4
    bench.until(lambda: bench.core.in_control)
    bench.mode, bench.custom_mode = FlightMode.STICKS, 5
    bench.step(2)
    bench.mode, bench.custom_mode = FlightMode.EXTERNAL, 4
    commands = bench.step(2)
    assert bench.core.state in HOLDING
    assert not [c for c in commands if isinstance(c, SetMode) and c.mode is FlightMode.STICKS]


@pytest.mark.parametrize("rearm", ["mode", "disarm"])
def test_what_was_obeyed_in_a_silence_gives_no_authority_and_is_told(make_bench, rearm):
    """The vehicle obeys just after the pilot's choice, but is heard again only after the time for that."""
    bench = make_bench(rearm=rearm)
    bench.firmware, bench.mode, bench.custom_mode = Firmware.ARDUPILOT, FlightMode.MISSION, 3
    bench.obeys = False
    bench.until(lambda: any(isinstance(c, SetMode) for c in bench.commands))
    bench.mode, bench.custom_mode = FlightMode.STICKS, 5
    bench.step(2)
    bench.silent = True
    bench.step(100)
    bench.silent, bench.mode, bench.custom_mode = False, FlightMode.EXTERNAL, 4
    commands = bench.step(100)
    assert bench.core.state is State.YIELDED
    texts = [c.text for c in commands if isinstance(c, Say)]
    assert (
        "DMUCA: GUIDED entered after LOITER, by our earlier request: LOITER must be selected again" in texts
    )
    assert not [c for c in commands if isinstance(c, SetMode)], "he may have selected it himself"


@pytest.mark.parametrize("fault", ["gnss", "switched off"])
def test_our_mode_that_is_entered_after_a_fault_is_left_again(make_bench, fault):
    """The fault gave up the request. ArduPilot would stay in GUIDED with nobody to fly it."""
    bench = make_bench()
    bench.firmware, bench.mode, bench.obeys = Firmware.ARDUPILOT, FlightMode.MISSION, False
    bench.until(lambda: any(isinstance(c, SetMode) for c in bench.commands))
    if fault == "gnss":
        bench.fix_type = 1
    else:
        bench.extra.append(Settings(enable=False))
    assert not [c for c in bench.step(5) if isinstance(c, SetMode)]
    assert bench.core.state is State.FAULT
    bench.mode = FlightMode.EXTERNAL
    assert [c.mode for c in bench.step(20) if isinstance(c, SetMode)] == [FlightMode.HOLD]
    bench.mode = FlightMode.HOLD
    bench.step(20)
    assert bench.core.state is State.FAULT, "the hold is ours"
