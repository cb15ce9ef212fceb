"""Schedules of a swarm under faults: each aircraft's link and its faults, drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from companion.errors import ConfigError
from sitl_mocks.examinations.faults import Fault, drawn, from_json, to_json
from sitl_mocks.examinations.modelled_link import KINDS as LINKS
from sitl_mocks.examinations.modelled_link import Kind
from sitl_mocks.examinations.takeover.cases import PILOTS, TROUBLES

GIVEN_BACK: Final = "given back"
"""Kind of event: disarming and arming in the air, by which a pilot gives authority again."""
_OTHERS: Final = (*(kind for kind in TROUBLES if kind != "stall"), "link")
_DATAGRAMS_ONLY: Final = ("duplicate", "reorder")
_ANSWERS: Final = ("disobeyed", "unanswered", "denied")
"""Faults of the vehicle's answers. They begin before the companion takes the vehicle."""
_MODES_AT_ONCE: Final = (0.6, 0.3, 0.1)
"""Probabilities of one, two and three modes within one step."""
_AROUND_S = 0.5
_LASTS_S: Final = (0.1, 10.0)
FIRST_S: Final = (2.0, 5.0)
_AFTER_S: Final = (0.5, 4.0)
"""Time from the last event of a round to its end."""
_BETWEEN_S: Final = (0.5, 4.0)
"""Time from the companion taking the vehicle to the next round."""


@dataclass(frozen=True, slots=True)
class AircraftSchedule:
    """Link and schedule of faults of one aircraft of a swarm."""

    seed: int
    """Seed of the swarm, which also draws the paths and the impairments of the link."""
    aircraft: int
    """Number of aircraft of the swarm."""
    number: int
    """Number of this aircraft, from 0."""
    link: Kind
    until_s: float
    """Length of the schedule on its own clock."""
    faults: tuple[Fault, ...]


def draw(seed: int, aircraft: int, number: int, duration_s: float, link: Kind | None) -> AircraftSchedule:
    """Draw the schedule of one aircraft.

    Args:
        link: kind of its link; None: each kind in turn, beginning with one that the seed draws.
    """
    kind = link_of(seed, number) if link is None else link
    faults = schedule_of(seed, number, duration_s, kind)
    return AircraftSchedule(seed, aircraft, number, kind, duration_s, faults)


def link_of(seed: int, number: int) -> Kind:
    """Kind of link of aircraft `number`."""
    return LINKS[(int(np.random.default_rng((seed, 9)).integers(len(LINKS))) + number) % len(LINKS)]


def schedule_of(seed: int, number: int, duration_s: float, link: Kind = "udp") -> tuple[Fault, ...]:
    """Schedule of faults for aircraft `number`, in the order of their times.

    Times count from the moment at which the companion first flies its vehicle. The clock stands still while
    the vehicle is given back and taken again.
    """
    rng = np.random.default_rng((seed, number, 7))
    found = [drawn("traffic", 0.0, duration_s, rng)]
    begins_s = float(rng.uniform(*FIRST_S))
    back_s = 0.0
    while begins_s < duration_s:
        faults, ends_s = _round(back_s, begins_s, link, rng)
        back_s = round(ends_s + float(rng.uniform(*_AFTER_S)), 3)
        found += [*faults, Fault(GIVEN_BACK, back_s)]
        begins_s = back_s + float(rng.uniform(*_BETWEEN_S))
    return tuple(sorted((fault for fault in found if fault.at_s < duration_s), key=lambda fault: fault.at_s))


def _round(
    given_s: float, begins_s: float, link: Kind, rng: np.random.Generator
) -> tuple[list[Fault], float]:
    """Draw one trouble, mostly with a stall, and a pilot around it. Returns their faults and end time."""
    others = [kind for kind in _OTHERS if link == "udp" or kind not in _DATAGRAMS_ONLY]
    trouble = "stall" if rng.random() < 0.5 else str(rng.choice(others))
    lasts_s = float(np.exp(rng.uniform(*np.log(_LASTS_S))))
    faults: list[Fault] = []
    if trouble in _ANSWERS:
        faults.append(drawn(trouble, given_s, begins_s - given_s + lasts_s, rng))
    elif trouble != "modes":
        faults.append(drawn(trouble, begins_s, lasts_s, rng))
    if trouble not in ("stall", "modes") and rng.random() < 0.5:
        faults.append(drawn("stall", begins_s + float(rng.uniform(0.0, lasts_s)), 0.0, rng))
    ends_s = max([begins_s, *(fault.at_s + fault.lasts_s for fault in faults)])
    for _ in range(1 + int(rng.random() < 0.3)):
        selects_s = float(rng.uniform(max(0.0, begins_s - _AROUND_S), ends_s + _AROUND_S))
        count = 1 + int(rng.choice(len(_MODES_AT_ONCE), p=_MODES_AT_ONCE))
        modes = tuple(str(mode) for mode in rng.choice(PILOTS, count, replace=False))
        faults.append(Fault("mode", round(selects_s, 3), modes=modes))
        ends_s = max(ends_s, selects_s)
    return faults, ends_s


def to_file(schedule: AircraftSchedule) -> dict[str, Any]:
    """Plain values of a schedule."""
    return {
        "seed": schedule.seed,
        "aircraft": schedule.aircraft,
        "number": schedule.number,
        "link": schedule.link,
        "until_s": schedule.until_s,
        "faults": [to_json(fault) for fault in schedule.faults],
    }


def from_file(value: dict[str, Any]) -> AircraftSchedule:
    """Read a schedule from plain values.

    Raises:
        ConfigError: the value is not a valid schedule.
    """
    try:
        given = dict(value)
        given["faults"] = tuple(
            Fault(**fault) if fault["kind"] == GIVEN_BACK else from_json(fault) for fault in given["faults"]
        )
        schedule = AircraftSchedule(**given)
        whole = schedule.seed >= 0 and 0 <= schedule.number < schedule.aircraft and schedule.until_s > 0.0
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"schedule: not a schedule of sitl-mocks swarm: {error!r}") from error
    if schedule.link not in LINKS or not whole:
        raise ConfigError(f"schedule: not a schedule of sitl-mocks swarm: {value}")
    return schedule
