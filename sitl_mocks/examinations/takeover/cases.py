"""Cases for `sitl-mocks takeover`: a companion controls a vehicle, and a pilot selects a mode around a fault.

Flights are prepared once and kept as snapshots. A case continues one of them with a link and faults of its
own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Any, Final

import numpy as np

from companion.errors import ConfigError
from companion.events import Firmware
from sitl_mocks.examinations.faults import Fault, drawn, from_json, to_json
from sitl_mocks.examinations.flights import Flights
from sitl_mocks.examinations.modelled_link import KINDS as LINKS
from sitl_mocks.examinations.modelled_link import Kind, ModelledLink
from sitl_mocks.examinations.rule_judge import Breach
from sitl_mocks.examinations.world import Snapshot, Use, World
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode

PAIRS: Final[tuple[tuple[Firmware, Use], ...]] = tuple(product(Firmware, ("guard", "fly")))
TROUBLES: Final = (
    "stall", "burst", "late", "reorder", "duplicate", "down", "up", "slow", "modes", "disobeyed",
    "unanswered", "denied",
)  # fmt: skip
"""Faults that may occur around the pilot's choice. `modes`: two choices in one step, no other fault."""
_PREPARED_SEED = 1
_SNAPSHOTS = 60
_EVERY_S = 0.73
"""Time between two snapshots, chosen to cover all phases of the step and of the vehicle's messages."""
_MET_EVERY_S = 45.0
_SOON_S, _LONG_S = 1.0, 6.0
"""How long a case is watched after the last event. One in seven is watched for the long time, until a fault
would be over.
"""
_LONG_SHARE = 0.15
_AROUND_S = 0.5
"""Longest time before or after the fault at which the pilot selects a mode."""
_HELD: Final = (VehicleMode.EXTERNAL, VehicleMode.BRAKE)
PILOTS: Final = ("rtl", "land", "hold", "manual")
"""Modes that a pilot selects against a companion."""


@dataclass(frozen=True, slots=True)
class Case:
    """All data that determines one case."""

    firmware: Firmware
    use: Use
    trouble: str
    snapshot: int
    link: Kind
    routed: bool
    faults: tuple[Fault, ...]
    """Faults with times relative to the snapshot."""
    watch_s: float
    seed: int


@dataclass(frozen=True, slots=True)
class Verdict:
    """Result of a case."""

    breaches: tuple[Breach, ...]
    """First breach of each rule that was broken, in their order. Times count from the snapshot."""
    crossed: int
    alike: int
    held: bool
    """Whether the companion controlled the vehicle when the case began."""


@lru_cache(maxsize=len(PAIRS))
def prepared(firmware: Firmware, use: Use) -> tuple[Snapshot, ...]:
    """Snapshots of one flight, from which cases continue: in control and avoiding, taking and giving back."""
    flights = Flights(firmware, use, _PREPARED_SEED)
    flights.others.mean_s = math.inf
    found: list[Snapshot] = []
    met_s = next_s = 0.0
    while len(found) < _SNAPSHOTS:
        flights.step()
        vehicle, now_s = flights.vehicle, flights.now_s
        if not flights.at_work:
            continue
        if now_s - met_s >= _MET_EVERY_S:
            met_s = now_s
            flights.others.meet(now_s, vehicle.position_ned_m, vehicle.velocity_ned_mps)
        # Take only a tenth as many while the autopilot flies the vehicle, because the companion then has no
        # control to lose.
        if now_s >= next_s:
            next_s = now_s + (_EVERY_S if vehicle.mode in _HELD else 10.0 * _EVERY_S)
            found.append(flights.snapshot())
    return tuple(found)


# ------------------------------------------------------------ drawing


def case_of(seed: int, number: int, troubles: Sequence[str]) -> Case:
    """Case `number` of a seed."""
    rng = np.random.default_rng((seed, number))
    firmware, use = PAIRS[number % len(PAIRS)]
    trouble = troubles[number // len(PAIRS) % len(troubles)]
    begins_s = float(rng.uniform(0.05, 0.6))
    lasts_s = float(np.exp(rng.uniform(math.log(0.1), math.log(10.0))))
    faults = [drawn("traffic", 0.0, 60.0, rng)]
    if trouble == "stall":
        faults.append(replace(drawn("stall", begins_s, lasts_s, rng), lasts_s=round(lasts_s, 3)))
    elif trouble != "modes":
        faults.append(drawn(trouble, begins_s, lasts_s, rng))
    lasts_s = 0.0 if trouble in ("modes", "burst") else lasts_s
    selects_s = float(rng.uniform(max(0.0, begins_s - _AROUND_S), begins_s + lasts_s + _AROUND_S))
    count = 2 if trouble == "modes" or rng.random() < 0.15 else 1
    modes = tuple(str(mode) for mode in rng.choice(PILOTS, count, replace=False))
    faults.append(Fault("mode", round(selects_s, 3), modes=modes))
    after_s = _LONG_S if rng.random() < _LONG_SHARE else _SOON_S
    return Case(
        firmware=firmware,
        use=use,
        trouble=trouble,
        snapshot=int(rng.integers(_SNAPSHOTS)),
        link=LINKS[int(rng.integers(len(LINKS)))],
        routed=bool(rng.random() < 0.8),
        faults=tuple(faults),
        watch_s=round(max(begins_s + lasts_s, selects_s) + after_s, 3),
        seed=int(rng.integers(1 << 32)),
    )


def to_schedule(case: Case) -> dict[str, Any]:
    """Plain values of a case for a file."""
    return {
        "firmware": case.firmware.value,
        "use": case.use,
        "trouble": case.trouble,
        "snapshot": case.snapshot,
        "link": case.link,
        "routed": case.routed,
        "watch_s": case.watch_s,
        "seed": case.seed,
        "faults": [to_json(fault) for fault in case.faults],
    }


def from_schedule(value: dict[str, Any]) -> Case:
    """Read a case from plain values.

    Raises:
        ConfigError: the value is not a valid case.
    """
    try:
        given = dict(value)
        given["firmware"] = Firmware(given["firmware"])
        given["faults"] = tuple(from_json(fault) for fault in given["faults"])
        case = Case(**given)
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"schedule: not a case of sitl-mocks takeover: {error!r}") from error
    if (case.firmware, case.use) not in PAIRS or case.link not in LINKS:
        raise ConfigError(
            f"schedule: use {case.use!r}, link {case.link!r}; "
            f"allowed: use guard or fly, link {', '.join(LINKS)}"
        )
    if not 0 <= case.snapshot < _SNAPSHOTS or not 0.0 < case.watch_s <= 120.0:
        raise ConfigError(
            f"schedule: snapshot or watch_s is out of range; allowed: snapshot 0 to {_SNAPSHOTS - 1}, "
            f"watch_s above 0, up to 120"
        )
    return case


# ------------------------------------------------------------ flying


def fly(case: Case, portions: int | None) -> Verdict:
    """Fly one case until its end or an exception.

    Args:
        portions: see `ModelledLink`.
    """
    world = prepared(case.firmware, case.use)[case.snapshot].world()
    held = world.vehicle.mode in _HELD
    start_s = world.now_s
    world.link = ModelledLink(
        case.link, np.random.default_rng(case.seed), portions=portions, routed=case.routed
    )
    world.plan(*(replace(fault, at_s=start_s + fault.at_s) for fault in case.faults))
    judge = world.judge
    try:
        while world.now_s < start_s + case.watch_s:
            World.step(world)
    except Exception as error:
        # An exception that would end the companion's loop is also a verdict.
        judge.breaches.append(Breach(world.now_s, "exception", f"{type(error).__name__}: {error}"))
    breaches = tuple(b._replace(at_s=round(b.at_s - start_s, 3)) for b in judge.first())
    return Verdict(breaches, judge.crossed, judge.alike, held)


def shorter(case: Case) -> Iterator[Case]:
    """Cases that are slightly reduced, those with the greatest reduction first."""
    for number in range(len(case.faults)):
        yield replace(case, faults=case.faults[:number] + case.faults[number + 1 :])
    for number, fault in enumerate(case.faults):
        if len(fault.modes) > 1:
            for mode in fault.modes:
                yield _with(case, number, replace(fault, modes=(mode,)))
        if fault.kind not in ("mode", "traffic") and fault.lasts_s > 0.1:
            for share in (0.25, 0.5, 0.8):
                yield _with(case, number, replace(fault, lasts_s=round(share * fault.lasts_s, 2)))
        if fault.kind == "traffic" and fault.numbers[0] > 10.0:
            yield _with(case, number, replace(fault, numbers=(round(0.5 * fault.numbers[0]),)))
    if case.routed is False:
        yield replace(case, routed=True)


def _with(case: Case, number: int, fault: Fault) -> Case:
    """Replace a fault. If it became shorter, later faults move earlier, so that the pilot stays within it."""
    before, faults = case.faults[number], list(case.faults)
    faults[number] = fault
    if before.lasts_s > fault.lasts_s:
        cut_s = before.lasts_s - fault.lasts_s
        for other, moved in enumerate(faults):
            if other != number and moved.at_s > before.at_s:
                faults[other] = replace(moved, at_s=round(max(before.at_s, moved.at_s - cut_s), 3))
    return replace(case, faults=tuple(faults))
