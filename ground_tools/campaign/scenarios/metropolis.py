"""Reads flight intentions of Metropolis 2 as planned paths.

A line holds the time of filing, the name, the type, the time of departure, "(longitude, latitude)" of the
start and of the goal, the priority, and six columns that only loitering missions fill. Times are HH:MM:SS.
Types are MP20 and MP30, which that project's scenario files create at 20 and 30 knots. The intentions contain
no routes or heights, because the concepts of that project differ in those. Here all aircraft fly straight, at
one height.
"""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from typing import Final, NamedTuple

from ground_tools.campaign.encounters.sampling import KNOT_MPS
from ground_tools.campaign.scenarios.bluesky import Place, Plan, Scenario, flat, place_of

SPEED_MPS: Final = {"MP20": 20.0 * KNOT_MPS, "MP30": 30.0 * KNOT_MPS}
_COLUMNS: Final = 7
"""Columns that every line fills."""
_TIME: Final = re.compile(r"(\d{1,4}):(\d{1,2}):(\d{1,2}(?:\.\d*)?)")
_PLACE: Final = re.compile(r"\(([^,()]+),([^,()]+)\)")


class _Flight(NamedTuple):
    name: str
    speed_mps: float
    departs_s: float
    start: Place
    goal: Place


def parse(text: str) -> Scenario:
    """The flights in the text of a file. Never raises: what is not understood is counted."""
    skipped: Counter[str] = Counter()
    flights = []
    for line in text.splitlines():
        if not line.strip(" ,"):
            continue
        try:
            (row,) = csv.reader([line])
        except (csv.Error, ValueError):
            skipped["a line that is no CSV"] += 1
            continue
        found = _flight([word.strip() for word in row])
        if isinstance(found, str):
            skipped[found] += 1
        else:
            flights.append(found)
    places = [place for flight in flights for place in (flight.start, flight.goal)]
    if not places:
        return Scenario([], skipped)
    middle = sum(p[0] for p in places) / len(places), sum(p[1] for p in places) / len(places)
    return Scenario([_plan(flight, middle) for flight in flights], skipped)


def _flight(row: Sequence[str]) -> _Flight | str:
    """The flight in a line, or the name of the fault if the line is not understood."""
    if len(row) < _COLUMNS:
        return "too few columns"
    if any(row[_COLUMNS:]):
        return "a loitering mission"
    _, name, kind, departs, start, goal, _ = row[:_COLUMNS]
    time, first, last = _TIME.fullmatch(departs), _place(start), _place(goal)
    if kind not in SPEED_MPS:
        return f"type {kind[:20]}"
    if time is None:
        return f"time {departs[:20]}"
    if first is None or last is None or first == last:
        return "place"
    departs_s = 3600.0 * int(time[1]) + 60.0 * int(time[2]) + float(time[3])
    return _Flight(name, SPEED_MPS[kind], departs_s, first, last)


def _place(text: str) -> Place | None:
    """Latitude and longitude of "(longitude, latitude)"."""
    match = _PLACE.fullmatch(text)
    return None if match is None else place_of([match[2], match[1]])


def _plan(flight: _Flight, middle: Place) -> Plan:
    start, goal = flat(flight.start, middle), flat(flight.goal, middle)
    takes_s = math.dist(start, goal) / flight.speed_mps
    corners = [(flight.departs_s, *start, 0.0), (flight.departs_s + takes_s, *goal, 0.0)]
    return Plan(flight.name, corners, goes_on=False)
