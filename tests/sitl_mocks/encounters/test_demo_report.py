"""The verdict of `sitl-mocks demo`: each requirement alone fails a flight, as does what is not a number."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest
from rich.console import Console

from sitl_mocks.encounters.demo_report import Outcome, Verdict, show
from sitl_mocks.encounters.scenario_file import DEFAULT
from sitl_mocks.encounters.verdict import Deviation, Pair, on_path_limit_m

LIMIT_M = 2.0 * DEFAULT.avoidance.conflict_radius_m
ON_PATH_M = on_path_limit_m(DEFAULT)


def outcome(separations=(20.0, 30.0), finals=(1.0, 2.0), **changed):
    return Outcome(
        seed=1,
        avoided=True,
        pairs=[Pair("A", f"B{n}", metres, 10.0) for n, metres in enumerate(separations)],
        deviations=[Deviation(f"A{n}", 25.0, metres, 9.0) for n, metres in enumerate(finals)],
        wall_s=1.0,
        simulated_s=50.0,
        air=[],
        messages={"sent": 1, "delivered": 1},
        chosen={},
        **changed,
    )


def verdict(unavoided=(3.0, 30.0), **flown):
    return Verdict(1, DEFAULT, outcome(**flown), outcome(separations=unavoided))


def test_a_flight_that_keeps_apart_and_returns_is_ok():
    assert verdict().ok
    assert verdict().reasons() == []
    assert verdict().as_dict()["min_separation_m"] == 20.0


@pytest.mark.parametrize("metres", [0.0, LIMIT_M - 0.01, LIMIT_M, math.nan])
@pytest.mark.parametrize("place", [0, 1])
def test_one_pair_that_came_too_near_fails(metres, place):
    separations = [20.0, 30.0]
    separations[place] = metres
    found = verdict(separations=separations)
    assert not found.ok
    assert found.reasons() == [f"1 of 2 pairs came within {LIMIT_M:g} m of each other"]
    assert verdict(separations=(LIMIT_M + 0.01, 30.0)).ok


@pytest.mark.parametrize("metres", [ON_PATH_M + 0.01, 100.0, math.inf, math.nan])
def test_one_aircraft_that_is_not_back_fails(metres):
    found = verdict(finals=(1.0, metres))
    assert not found.ok
    assert found.reasons()[0].startswith("1 of 2 aircraft were not back")
    assert verdict(finals=(ON_PATH_M, ON_PATH_M)).ok


def test_a_law_that_failed_fails():
    found = verdict(faults={"A1": "the law raised"})
    assert not found.ok
    assert found.reasons() == ["A1: the law raised"]


@pytest.mark.parametrize("empty", [{"separations": ()}, {"finals": ()}])
def test_a_flight_of_nobody_fails(empty):
    assert verdict(**empty).reasons() == ["nothing was flown"]


@pytest.mark.parametrize(("unavoided", "met"), [((LIMIT_M, 30.0), True), ((LIMIT_M + 0.01, 30.0), False)])
def test_a_flight_without_a_conflict_is_said_to_show_nothing(unavoided, met):
    console = Console(record=True, width=200)
    found = verdict(unavoided=unavoided)
    show(found, Path("runs/x"), console)
    assert found.met == met
    assert ("shows nothing" in console.export_text()) == (not met)


def test_the_wider_limit_of_a_scenario_counts():
    avoidance = msgspec.structs.replace(DEFAULT.avoidance, conflict_radius_m=11.0)
    wider = msgspec.structs.replace(DEFAULT, avoidance=avoidance)
    assert replace(verdict(), scenario=wider).reasons() == ["1 of 2 pairs came within 22 m of each other"]
