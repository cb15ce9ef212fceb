"""Pilots take over during a fault, in virtual time."""

from __future__ import annotations

import dataclasses
import json

import pytest

from companion.authority.modes import OurModes
from companion.errors import ConfigError
from companion.events import Firmware
from companion.gate.gate import Gate
from sitl_mocks import cli
from sitl_mocks.examinations.faults import Fault
from sitl_mocks.examinations.takeover import command as takeover
from sitl_mocks.examinations.takeover.cases import (
    PAIRS,
    TROUBLES,
    Case,
    case_of,
    fly,
    from_schedule,
    prepared,
    to_schedule,
)
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode

RTL_IN_A_STALL = Case(
    firmware=Firmware.ARDUPILOT,
    use="guard",
    trouble="stall",
    snapshot=24,
    link="udp",
    routed=True,
    faults=(Fault("stall", 0.3, 5.0), Fault("mode", 4.0, modes=("rtl",))),
    watch_s=10.0,
    seed=1,
)


def case(**over):
    return dataclasses.replace(RTL_IN_A_STALL, **over)


def broken(one, portions=None):
    return [f"{breach.rule}: {breach.words}" for breach in fly(one, portions).breaches]


TRAFFIC = Fault("traffic", 0.0, 60.0, (150.0,))


@pytest.mark.parametrize("portions", [None, 2, 1])
@pytest.mark.parametrize("link", ["udp", "tcp", "pty"])
@pytest.mark.parametrize("use", ["guard", "fly"])
@pytest.mark.parametrize("firmware", Firmware)
def test_a_mode_that_waits_behind_all_else_is_kept(firmware, use, link, portions):
    assert broken(case(firmware=firmware, use=use, link=link), portions) == []


@pytest.mark.parametrize("link", ["udp", "pty"])
@pytest.mark.parametrize("firmware", Firmware)
def test_a_mode_whose_message_found_the_buffer_full_is_kept(firmware, link):
    assert broken(case(firmware=firmware, link=link, faults=(TRAFFIC, *RTL_IN_A_STALL.faults))) == []


@pytest.mark.parametrize(
    "faults",
    [
        (Fault("late", 0.2, 4.0, (2.3,)), Fault("mode", 1.6, modes=("hold",))),
        (Fault("slow", 0.1, 5.0, (9500.0,)), Fault("mode", 2.7, modes=("hold",))),
        (Fault("down", 0.2, 4.0), Fault("mode", 0.4, modes=("rtl",))),
        (Fault("stall", 0.2, 1.5, (1.0,)), Fault("mode", 0.9, modes=("rtl", "land"))),
        (Fault("disobeyed", 0.0, 8.0), Fault("mode", 2.0, modes=("rtl",))),
        (Fault("denied", 0.0, 8.0), Fault("stall", 0.2, 1.5), Fault("mode", 0.9, modes=("manual",))),
    ],
    ids=lambda faults: faults[0].kind,
)
@pytest.mark.parametrize("link", ["udp", "tcp", "pty"])
def test_a_pilots_mode_is_kept_whatever_comes_late(faults, link):
    assert broken(case(link=link, use="fly", faults=faults)) == []


def test_a_heartbeat_that_positions_have_overtaken_hides_no_pilots_mode():
    """It showed GUIDED, was sent before the pilot selected LOITER and came after newer positions."""
    late = Fault("late", 0.405, 3.386, (0.8669081626490169,))
    found = Case(
        firmware=Firmware.ARDUPILOT,
        use="fly",
        trouble="late",
        snapshot=23,
        link="udp",
        routed=True,
        faults=(late, Fault("mode", 3.24, modes=("hold",))),
        watch_s=4.792,
        seed=2953737371,
    )
    assert broken(found) == []


def test_a_heartbeat_that_half_the_sequence_numbers_have_overtaken_hides_no_pilots_mode():
    """It showed GUIDED; so many messages overtook it that its sequence number looks newer than theirs."""
    late = Fault("late", 0.397, 3.173, (2.532955712043338,))
    found = Case(
        firmware=Firmware.ARDUPILOT,
        use="fly",
        trouble="late",
        snapshot=54,
        link="udp",
        routed=True,
        faults=(late, Fault("mode", 3.016, modes=("land",))),
        watch_s=9.57,
        seed=1239095751,
    )
    assert broken(found) == []


def test_a_pilots_mode_among_datagrams_out_of_order_ends_the_setpoints():
    found = Case(
        firmware=Firmware.PX4,
        use="guard",
        trouble="reorder",
        snapshot=3,
        link="udp",
        routed=True,
        faults=(
            Fault("traffic", 0.0, 60.0, (40.14733993204733,)),
            Fault("reorder", 0.509, 3.48, (0.28639243341170295,)),
            Fault("mode", 2.625, modes=("rtl",)),
        ),
        watch_s=5.5,
        seed=1182460499,
    )
    assert broken(found) == []


@pytest.mark.parametrize("trouble", ["burst", "duplicate", "modes", "unanswered", "disobeyed"])
def test_some_cases_of_a_kind_break_no_rule(trouble):
    result = takeover.some(1, 0, 16, (trouble,), None)
    assert result.failed == 0
    assert result.held > 10


def test_the_flights_are_continued_where_the_companion_holds_the_vehicle():
    for pair in PAIRS:
        snapshots = prepared(*pair)
        held = [one for one in snapshots if one.mode is VehicleMode.EXTERNAL]
        assert len(held) > 0.7 * len(snapshots)


def test_a_case_is_its_number_and_plain_text():
    for number in range(60):
        one = case_of(7, number, TROUBLES)
        assert one == case_of(7, number, TROUBLES)
        assert from_schedule(json.loads(json.dumps(to_schedule(one)))) == one
    assert fly(one, None) == fly(one, None)


@pytest.mark.parametrize(
    "wrong", [{"use": "watch"}, {"link": "can"}, {"snapshot": 60}, {"watch_s": 0.0}, {"more": 1}]
)
def test_a_schedule_that_is_none_is_refused(wrong):
    with pytest.raises(ConfigError, match="schedule:"):
        from_schedule(to_schedule(RTL_IN_A_STALL) | wrong)


@pytest.fixture
def stubborn(monkeypatch):
    """A companion that ignores the pilot's choice of mode."""
    monkeypatch.setattr(OurModes, "judge", lambda self, shown, now_s, held: None)
    monkeypatch.setattr(Gate, "release", lambda self, data, now_s: data)


def test_a_failure_is_made_as_short_as_it_gets(stubborn):
    faults = (TRAFFIC, Fault("stall", 0.3, 0.9), Fault("mode", 0.8, modes=("rtl",)))
    long = case(link="tcp", faults=faults)
    (breach, *_) = fly(long, None).breaches
    short, found = takeover.shortest(long, breach.rule, None)
    assert found.rule == breach.rule
    assert [fault.kind for fault in short.faults if fault.kind != "stall"] == ["mode"]
    assert fly(short, None).breaches[0] == found


def test_the_command_says_which_case_failed_and_replays_it(stubborn, tmp_path, capsys):
    args = ["takeover", "--cases", "8", "--trouble", "modes", "--out", str(tmp_path)]
    assert cli.main(args) == 1
    out = capsys.readouterr().out
    assert "8 cases, seed 1: " in out
    assert "broke a rule (" in out
    files = sorted(tmp_path.iterdir())
    assert files
    assert cli.main(["takeover", "--schedule", str(files[0])]) == 1
    number = files[0].stem.rpartition("-")[2]
    assert cli.main(["takeover", "--only", number, "--trouble", "modes", "--out", str(tmp_path)]) == 1
    assert "setpoint" in capsys.readouterr().out


@pytest.mark.parametrize("option", [["--cases", "0"], ["--jobs", "0"], ["--seed", "-1"], ["--portions", "0"]])
def test_an_option_out_of_range_is_refused(option, capsys):
    assert cli.main(["takeover", *option]) == 2
    assert option[0] in capsys.readouterr().err
