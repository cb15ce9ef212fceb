"""`sitl-mocks soak`: hours of flights in virtual time with random faults, checked by independent rules.

One vehicle flies its mission again and again with a companion that guards or flies it, and other aircraft
cross its path. Links, navigation, autopilot, pilot, companion and radio fail at random. The rules are checked
on the bytes that cross the link (`rule_judge`), not on the companion's own reports. The faults are a schedule
that is drawn in advance: a seed determines everything, and a schedule that breaks a rule is shortened as far
as possible.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from companion.errors import ConfigError
from companion.events import Firmware
from sitl_mocks.examinations.faults import Fault, drawn, from_json, to_json
from sitl_mocks.examinations.flights import BrokenRuleError, Flights, Told
from sitl_mocks.examinations.modelled_link import KINDS as LINKS
from sitl_mocks.examinations.modelled_link import Kind, ModelledLink
from sitl_mocks.examinations.schedule_file import read_schedule, write_schedule
from sitl_mocks.examinations.shrink import shortest
from sitl_mocks.examinations.world import Use
from sitl_mocks.worker_pool import interrupts_held, worker_pool

_TROUBLES: Final = (
    "link", "reboot", "gnss", "estimator", "mode", "sticks", "garbage", "mission", "companion", "stall",
    "burst", "traffic", "late", "duplicate", "reorder", "slow", "down", "up", "disobeyed", "unanswered",
    "denied",
)  # fmt: skip
_FIRST_S = 60.0
_MEAN_S = 90.0
"""Mean time between the end of one trouble and the next."""
_WITH_PILOT = 0.3
"""Share of the troubles around which the pilot also selects a mode."""
_AROUND_S = 0.5


@dataclass(frozen=True, slots=True)
class Schedule:
    """All data that determines one run."""

    firmware: Firmware
    use: Use
    seed: int
    link: Kind
    until_s: float
    faults: tuple[Fault, ...]


@dataclass(slots=True)
class Flown:
    """Results of a soak."""

    hours: float
    link: str
    told: Told
    memory_mb: list[float] = field(default_factory=list)
    """Resident memory at the end of each simulated hour (MB)."""


def schedule_of(firmware: Firmware, use: Use, seed: int, hours: float) -> Schedule:
    """Draw the schedule of faults for some hours."""
    rng = np.random.default_rng((seed, list(Firmware).index(firmware), use == "fly", 99))
    until_s, at_s = hours * 3600.0, _FIRST_S
    link = LINKS[int(rng.integers(len(LINKS)))]
    faults: list[Fault] = []
    while at_s < until_s:
        kind = _TROUBLES[int(rng.integers(len(_TROUBLES)))]
        fault = drawn(kind, at_s, float(rng.uniform(1.0, 40.0)), rng)
        faults.append(fault)
        if kind != "mode" and rng.random() < _WITH_PILOT:
            selects_s = float(rng.uniform(at_s - _AROUND_S, at_s + fault.lasts_s + _AROUND_S))
            faults.append(drawn("mode", selects_s, 0.0, rng))
        at_s += fault.lasts_s + float(rng.exponential(_MEAN_S))
    return Schedule(firmware, use, seed, link, until_s, tuple(faults))


def to_file(schedule: Schedule, portions: int | None) -> dict[str, Any]:
    """Plain values of a schedule."""
    given = asdict(schedule) | {"faults": [to_json(fault) for fault in schedule.faults]}
    return given | {"firmware": schedule.firmware.value, "portions": portions}


def from_file(value: dict[str, Any]) -> tuple[Schedule, int | None]:
    """Read a schedule from plain values.

    Raises:
        ConfigError: the value is not a valid schedule.
    """
    try:
        given = dict(value)
        portions = given.pop("portions")
        given["firmware"] = Firmware(given["firmware"])
        given["faults"] = tuple(from_json(fault) for fault in given["faults"])
        schedule = Schedule(**given)
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"schedule: not a schedule of sitl-mocks soak: {error!r}") from error
    if schedule.use not in ("guard", "fly") or schedule.link not in LINKS:
        raise ConfigError(
            f"schedule: use {schedule.use!r}, link {schedule.link!r}; allowed: use "
            f"guard or fly, link {', '.join(LINKS)}"
        )
    return schedule, portions


def fly(schedule: Schedule, portions: int | None = None) -> Flown:
    """Fly one schedule to its end.

    Args:
        portions: see `ModelledLink`.

    Raises:
        BrokenRuleError: a rule was broken.
    """
    rng = np.random.default_rng((schedule.seed, 98))
    flights = Flights(
        schedule.firmware,
        schedule.use,
        schedule.seed,
        ModelledLink(schedule.link, rng, portions=portions),
    )
    flights.plan(*schedule.faults)
    flown = Flown(round(schedule.until_s / 3600.0, 4), schedule.link, flights.told)
    hour_s = 3600.0
    while flights.now_s < schedule.until_s:
        try:
            flights.step()
        except BrokenRuleError as error:
            error.flight_s = flights.flight_s
            raise
        except Exception as error:
            words = f"{type(error).__name__}: {error}"
            raise BrokenRuleError("exception", flights.now_s, words) from error
        if flights.now_s >= hour_s:
            hour_s += 3600.0
            flown.memory_mb.append(round(_resident_mb(), 1))
    flown.memory_mb.append(round(_resident_mb(), 1))
    return flown


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def shorten(schedule: Schedule, error: BrokenRuleError, portions: int | None) -> Schedule:
    """The shortest schedule found that breaks the same rule."""

    def breaks(faults: tuple[Fault, ...], until_s: float) -> BrokenRuleError | None:
        try:
            fly(replace(schedule, faults=faults, until_s=until_s), portions)
        except BrokenRuleError as other:
            return other if other.rule == error.rule else None
        return None

    faults, until_s = shortest(schedule.faults, error, breaks)
    return replace(schedule, faults=faults, until_s=until_s)


def _pair(
    firmware: Firmware, use: Use, seed: int, hours: float, portions: int | None
) -> Flown | tuple[str, dict[str, Any]]:
    """Result of one pair; if a rule was broken, its description and the shortest schedule."""
    schedule = schedule_of(firmware, use, seed, hours)
    try:
        return fly(schedule, portions)
    except BrokenRuleError as error:
        return str(error), to_file(shorten(schedule, error, portions), portions)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sitl-mocks soak`."""
    parser.description = (
        "Flies for hours with random faults, in virtual time, with both firmwares, guarding missions and "
        "flying paths. If a rule is broken, the exit code is 1 and the shortest schedule of faults found "
        "that breaks it is printed and written to a file."
    )
    parser.epilog = "example: sitl-mocks soak --hours 24 --seed 1"
    parser.add_argument(
        "--hours",
        type=float,
        default=1.0,
        metavar="H",
        help="simulated hours in total (default: %(default)g)",
    )
    parser.add_argument("--seed", type=int, default=1, help="random seed (default: %(default)s)")
    parser.add_argument(
        "--portions",
        type=int,
        metavar="N",
        help="portions of input read after a stall before the companion decides (default: all waiting input)",
    )
    parser.add_argument("--schedule", type=Path, metavar="FILE", help="fly only the schedule in this file")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path(),
        metavar="FOLDER",
        help="folder for schedules that break a rule (default: the current one)",
    )


def run(args: argparse.Namespace) -> int:
    """Run `sitl-mocks soak`. Returns 0; 1 if a rule was broken, or a companion sent nothing to be judged.

    Raises:
        ConfigError: an option is out of range, or a file is not a schedule.
    """
    if args.schedule is not None:
        return _replay(args.schedule)
    if not 0.0 < args.hours <= 1000.0:
        raise ConfigError(f"--hours: {args.hours:g} is out of range; allowed: above 0, up to 1000")
    if args.seed < 0:
        raise ConfigError(f"--seed: {args.seed} is out of range; allowed: 0 or more")
    pairs: list[tuple[Firmware, Use]] = list(product(Firmware, ("guard", "fly")))
    hours, broken = args.hours / len(pairs), False
    idle: list[str] = []
    with worker_pool(min(len(pairs), os.cpu_count() or 1)) as pool:
        began = time.monotonic()
        with interrupts_held():
            flown = {pool.submit(_pair, *pair, args.seed, hours, args.portions): pair for pair in pairs}
        for future in as_completed(flown):
            firmware, use = flown[future]
            result = future.result()
            if isinstance(result, Flown):
                row = asdict(result)
                report = {"firmware": firmware.value, "use": use, "after_s": round(time.monotonic() - began)}
                print(json.dumps(report | row.pop("told") | row), flush=True)
                if result.told.setpoints == 0:
                    idle.append(f"{firmware.value}-{use}")
            else:
                broken = True
                _tell_broken(f"{args.seed}-{firmware.value}-{use}", *result, args.out)
    if idle:
        # Rules on what a companion sends hold for one that never takes the vehicle.
        print(f"no result for {', '.join(idle)}: the companion sent no setpoint; fly more hours", flush=True)
    elif not broken:
        print(f"{args.hours:g} simulated hours, seed {args.seed}: no rule was broken", flush=True)
    return int(broken or bool(idle))


def _tell_broken(name: str, words: str, schedule: dict[str, Any], folder: Path) -> None:
    path = folder / f"soak-{name}.json"
    write_schedule(path, schedule)
    print(f"rule broken: {name}, {words}")
    print(f"  shortest schedule found: {json.dumps(schedule)}")
    print(f"  sitl-mocks soak --schedule {path}", flush=True)


def _replay(path: Path) -> int:
    try:
        fly(*from_file(read_schedule(path)))
    except BrokenRuleError as error:
        print(f"rule broken: {error}")
        return 1
    print("no rule was broken")
    return 0
