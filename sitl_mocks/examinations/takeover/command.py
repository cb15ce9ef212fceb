"""`sitl-mocks takeover`: checks that a mode selected by the pilot stays selected despite faults.

It runs thousands of short cases in virtual time, each judged from the bytes at the vehicle's end
(`rule_judge`), or fewer cases with real processes (`real_cases`). A failing case is shortened as far as
possible and written to a file.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import as_completed
from pathlib import Path
from typing import Final

from companion.errors import ConfigError
from sitl_mocks.examinations.rule_judge import Breach
from sitl_mocks.examinations.schedule_file import read_schedule, write_schedule
from sitl_mocks.examinations.takeover.cases import (
    TROUBLES,
    Case,
    Verdict,
    case_of,
    fly,
    from_schedule,
    shorter,
    to_schedule,
)
from sitl_mocks.examinations.takeover.real_cases import PLACES, many_real
from sitl_mocks.worker_pool import interrupts_held, worker_pool

_EXAMPLES: Final = """examples:
  sitl-mocks takeover --cases 100000 --seed 1 --jobs 2
  sitl-mocks takeover --cases 2000 --trouble all --portions 2
  sitl-mocks takeover --real 200 --jobs 3
  sitl-mocks takeover --seed 1 --only 4711
  sitl-mocks takeover --schedule takeover-1-4711.json
"""
_BATCH = 200
_MOST_CASES = 10_000_000


class Result:
    """Counts of many cases, and the first failing case for each rule."""

    def __init__(self) -> None:
        self.cases = 0
        self.held = 0
        self.crossed = 0
        self.alike = 0
        self.broken: Counter[tuple[str, str, str, str]] = Counter()
        """Number of cases by trouble, firmware, link and the rules broken ("" if none)."""
        self.first: dict[str, int] = {}
        """Number of the first case by its first broken rule."""

    def add(self, number: int, case: Case, verdict: Verdict) -> None:
        """Add one case."""
        self.cases += 1
        self.held += verdict.held
        self.crossed += verdict.crossed
        self.alike += verdict.alike
        rules = " ".join(breach.rule for breach in verdict.breaches)
        self.broken[case.trouble, case.firmware.value, case.link, rules] += 1
        if verdict.breaches:
            rule = verdict.breaches[0].rule
            self.first[rule] = min(number, self.first.get(rule, number))

    def merge(self, other: Result) -> None:
        """Add the cases of another process."""
        self.cases += other.cases
        self.held += other.held
        self.crossed += other.crossed
        self.alike += other.alike
        self.broken.update(other.broken)
        for rule, number in other.first.items():
            self.first[rule] = min(number, self.first.get(rule, number))

    @property
    def failed(self) -> int:
        """Number of cases in which a rule was broken."""
        return sum(count for key, count in self.broken.items() if key[3])

    def lines(self) -> Iterable[str]:
        """One line for each trouble: number of cases, and how often which rules were broken."""
        for trouble in TROUBLES:
            rows = {key: count for key, count in self.broken.items() if key[0] == trouble}
            if not rows:
                continue
            broken: Counter[str] = Counter()
            for (_, firmware, link, rules), count in rows.items():
                if rules:
                    broken[f"{rules} ({firmware}, {link})"] += count
            words = "; ".join(f"{what} {count}" for what, count in sorted(broken.items())) or "none"
            failed = sum(broken.values())
            yield f"{trouble}: {sum(rows.values())} cases, {failed} broke a rule: {words}"


def some(seed: int, first: int, count: int, troubles: tuple[str, ...], portions: int | None) -> Result:
    """Fly some cases of a seed, one after the other."""
    result = Result()
    for number in range(first, first + count):
        case = case_of(seed, number, troubles)
        result.add(number, case, fly(case, portions))
    return result


def many(seed: int, cases: int, troubles: tuple[str, ...], portions: int | None, jobs: int) -> Result:
    """Fly the cases from 0 to below `cases` of a seed on several processes, which do not affect the
    result.
    """
    batches = [(first, min(_BATCH, cases - first)) for first in range(0, cases, _BATCH)]
    result = Result()
    if jobs == 1:
        for first, count in batches:
            result.merge(some(seed, first, count, troubles, portions))
        return result
    with worker_pool(jobs) as pool:
        with interrupts_held():
            flown = [pool.submit(some, seed, first, count, troubles, portions) for first, count in batches]
        for future in as_completed(flown):
            result.merge(future.result())
    return result


def shortest(case: Case, rule: str, portions: int | None) -> tuple[Case, Breach]:
    """The shortest case found that still breaks this rule first, with parts left out or reduced."""

    def breach_of(one: Case) -> Breach | None:
        breaches = fly(one, portions).breaches
        return breaches[0] if breaches and breaches[0].rule == rule else None

    found = breach_of(case)
    if found is None:
        raise ValueError(f"the case does not break the rule {rule!r}")
    going = True
    while going:
        going = False
        for less in shorter(case):
            breach = breach_of(less)
            if breach is not None:
                case, found, going = less, breach, True
                break
    return case, found


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sitl-mocks takeover`."""
    parser.description = (
        "Flies short cases with a fault around the moment when the pilot selects a mode, with both "
        "firmwares, guarding missions and flying paths, over UDP, TCP and a serial line. The exit code is 1 "
        "if a rule is broken."
    )
    parser.epilog = _EXAMPLES
    add = parser.add_argument
    add(
        "--cases",
        type=int,
        default=2000,
        metavar="N",
        help="number of cases in virtual time (default: %(default)s)",
    )
    add("--seed", type=int, default=1, help="random seed (default: %(default)s)")
    add("--jobs", type=int, default=1, help="number of processes (default: %(default)s)")
    add("--trouble", nargs="+", default=["stall"], choices=[*TROUBLES, "all"], metavar="KIND",
        help=f"kinds of faults: {', '.join(TROUBLES)}, or all (default: stall)")  # fmt: skip
    add("--portions", type=int, metavar="N", help="portions of input read after a stall before "
        "the companion decides (default: all waiting input)")  # fmt: skip
    add("--only", type=int, metavar="CASE", help="fly only this case of the seed")
    add("--schedule", type=Path, metavar="FILE", help="fly only the case in this file")
    add("--real", type=int, metavar="N", help="fly N cases with real processes in real time instead")
    add(
        "--out",
        type=Path,
        default=Path(),
        metavar="FOLDER",
        help="folder for failing cases (default: the current one)",
    )


def run(args: argparse.Namespace) -> int:
    """Run `sitl-mocks takeover`. Returns 0, or 1 if a rule was broken.

    Raises:
        ConfigError: an option is out of range, or a file is not a schedule.
    """
    troubles = TROUBLES if "all" in args.trouble else tuple(args.trouble)
    for name, low, high in (("cases", 1, _MOST_CASES), ("jobs", 1, 64), ("seed", 0, 1 << 62)):
        if not low <= getattr(args, name) <= high:
            raise ConfigError(f"--{name}: {getattr(args, name)} is out of range; allowed: {low} to {high}")
    if args.portions is not None and args.portions < 1:
        raise ConfigError(f"--portions: {args.portions} is out of range; allowed: 1 or more")
    if args.real is not None:
        return _real(args)
    if args.schedule is not None:
        return _one(from_schedule(read_schedule(args.schedule)), args)
    if args.only is not None:
        return _one(case_of(args.seed, args.only, troubles), args, f"takeover-{args.seed}-{args.only}.json")
    began_s = time.monotonic()
    result = many(args.seed, args.cases, troubles, args.portions, args.jobs)
    took_s = time.monotonic() - began_s
    for line in result.lines():
        print(line)
    for rule, number in sorted(result.first.items(), key=lambda item: item[1]):
        case = case_of(args.seed, number, troubles)
        print(f"rule {rule!r} is first broken by case {number} of seed {args.seed}; the shortest case found:")
        _shorten(case, rule, args, f"takeover-{args.seed}-{number}.json")
    print(
        f"{result.cases} cases, seed {args.seed}: {result.failed} broke a rule (the companion was in "
        f"control in {result.held}; {result.crossed} mode selections crossed a request, {result.alike} were "
        f"not judged); "
        f"{took_s:.0f} s, {1e3 * took_s * args.jobs / result.cases:.1f} ms of process time per case"
    )
    return int(result.failed > 0)


def _real(args: argparse.Namespace) -> int:
    with tempfile.TemporaryDirectory(prefix="takeover-") as folder:
        verdicts = many_real(args.seed, args.real, args.jobs, Path(folder))
    failed = 0
    for verdict in verdicts:
        failed += bool(verdict.breaches)
        where = f"{verdict.firmware.value}, {verdict.link}, case {verdict.case.number}"
        if verdict.trouble is not None:
            print(f"no result: {where}: {verdict.trouble}")
        for breach in verdict.breaches:
            print(f"rule broken: {where}: {verdict.case}")
            print(f"  at {breach.at_s:.3f} s: {breach.rule}: {breach.words}")
    unknown = sum(verdict.trouble is not None for verdict in verdicts)
    for firmware, link in PLACES:
        here = [v for v in verdicts if (v.firmware, v.link) == (firmware, link)]
        broken = sum(bool(v.breaches) for v in here)
        print(f"{firmware.value}, {link}: {broken} of {len(here)} cases broke a rule")
    print(f"{len(verdicts)} cases, seed {args.seed}: {failed} broke a rule, {unknown} have no result")
    return int(failed > 0 or unknown > 0)


def _one(case: Case, args: argparse.Namespace, file: str | None = None) -> int:
    verdict = fly(case, args.portions)
    for breach in verdict.breaches:
        print(f"at {breach.at_s:.3f} s: {breach.rule}: {breach.words}")
    if not verdict.breaches:
        print("no rule was broken")
        return 0
    if file is not None:
        _shorten(case, verdict.breaches[0].rule, args, file)
    return 1


def _shorten(case: Case, rule: str, args: argparse.Namespace, name: str) -> None:
    case, breach = shortest(case, rule, args.portions)
    path = args.out / name
    write_schedule(path, to_schedule(case))
    print(f"  {json.dumps(to_schedule(case))}")
    print(f"  at {breach.at_s:.3f} s: {breach.rule}: {breach.words}")
    portions = "" if args.portions is None else f" --portions {args.portions}"
    print(f"  sitl-mocks takeover --schedule {path}{portions}")
