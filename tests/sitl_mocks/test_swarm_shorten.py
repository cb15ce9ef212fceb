"""The search for the shortest schedule with which an aircraft still breaks a rule, without its flights."""

from __future__ import annotations

import json

from rich.console import Console

from sitl_mocks.encounters import swarm
from sitl_mocks.encounters.scenario_file import DEFAULT
from sitl_mocks.examinations.faults import Fault
from sitl_mocks.examinations.swarm.schedule import GIVEN_BACK, AircraftSchedule, from_file

FAULTS = (
    Fault("traffic", 0.0, 60.0, (50.0,)),
    Fault("late", 4.0, 1.0, (0.5,)),
    Fault("mode", 5.0, modes=("hold",)),
    Fault(GIVEN_BACK, 7.0),
    Fault("stall", 20.0, 3.0, (0.0,)),
    Fault("mode", 21.0, modes=("rtl",)),
    Fault(GIVEN_BACK, 30.0),
)
ROW = {"rule": "left", "schedule_s": 23.1, "words": "left"}


def plan(schedule):
    return swarm.Plan(DEFAULT, 7, 60.0, (0, 1), {0: schedule, 1: schedule})


def shortened(folder, monkeypatch, tries, breaks):
    flown = []

    def fly_alone(into, scenario, schedule):
        assert into.parent == folder
        flown.append(schedule)
        return {"DMUCA002": {"breaches": breaks(schedule)}}

    monkeypatch.setattr(swarm, "fly_alone", fly_alone)
    schedule = AircraftSchedule(7, 5, 1, "tcp", 60.0, FAULTS)
    faults = {"DMUCA001": {"breaches": []}, "DMUCA002": {"breaches": [ROW]}}
    swarm._shorten(folder, plan(schedule), faults, tries, Console(quiet=True))
    return flown, from_file(json.loads((folder / "DMUCA002.shortest.json").read_text()))


def test_only_what_breaks_the_rule_is_left(tmp_path, monkeypatch):
    def breaks(schedule):
        """The rule breaks 0.1 s after a stall in which the pilot selects RTL."""
        stalls = [f for f in schedule.faults if f.kind == "stall"]
        modes = [f.at_s for f in schedule.faults if f.modes == ("rtl",)]
        ends_s = [s.at_s + s.lasts_s for s in stalls if any(s.at_s < at < s.at_s + s.lasts_s for at in modes)]
        return [ROW | {"schedule_s": ends_s[0] + 0.1}] if ends_s else []

    flown, short = shortened(tmp_path, monkeypatch, 30, breaks)
    assert {fault.kind for fault in short.faults} == {"stall", "mode"}
    assert (short.link, short.number, short.aircraft, short.seed) == ("tcp", 1, 5, 7)
    assert min(fault.at_s for fault in short.faults) == 2.0
    assert short.until_s < 6.0
    assert max(schedule.until_s for schedule in flown) < 25.0


def test_a_failure_that_does_not_come_back_is_kept_whole(tmp_path, monkeypatch):
    flown, short = shortened(tmp_path, monkeypatch, 5, lambda schedule: [])
    assert len(flown) == 5
    assert len(short.faults) == 6  # all until the rule was broken


def test_another_rule_is_not_the_same_failure(tmp_path, monkeypatch):
    _, short = shortened(tmp_path, monkeypatch, 5, lambda schedule: [ROW | {"rule": "old"}])
    assert len(short.faults) == 6
