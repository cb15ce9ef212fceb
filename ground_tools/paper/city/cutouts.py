"""The command `ground-tools paper city-policy`: policies trained for a city, beside fixed sets.

Cut-outs of a city are flown with the fixed set, the rule, the policy that is shipped, those that were trained
for a city, and every legal set of transports with BLE 4 at its highest rate, one for all aircraft. The search
over the sets bounds what a choice that all aircraft share can gain.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
from rich.console import Console

from companion.atmc.actions import SET_ACTIONS, legal
from companion.atmc.rule import FIXED_SETS
from companion.config import TrafficConfig
from companion.errors import ConfigError
from companion.shipped import shipped
from ground_tools.channel import options
from ground_tools.city import spread
from ground_tools.city.cells import City, Row, fly, region_of
from ground_tools.city.radio.choosing import ByPolicy, Chooser, Fixed
from ground_tools.city.spread import DATA
from ground_tools.city.traffic.demand import Demand
from ground_tools.common import provenance
from ground_tools.common.kept_lines import Kept, read_lines
from ground_tools.common.progress import progress
from ground_tools.common.provenance import Provenance
from ground_tools.common.rates import mean
from ground_tools.common.run_options import seeds_of
from ground_tools.paper.city import study
from ground_tools.paper.city.runs import FILE, PACKAGES, number_of

NAME: Final = "city-policy"
COMMAND: Final = (
    "ground-tools paper city-policy --densities 10 --out results/city-policy, then again with "
    "--densities 30 --loads 0 --seeds 101-102"
)
ROOTS: Final = ("ground_tools.paper.city.cutouts",)
TRAINED: Final = tuple(f"results/policies/city-{seed}.safetensors" for seed in range(1, 6))
"""The trained policies, one of each seed."""
USUAL: Final = "-".join(map(str, FIXED_SETS[0]))
"""The fixed set with which all are compared."""
_OURS: Final = ("rule", "policy", *(Path(name).stem for name in TRAINED))
_DENSITIES: Final = (10.0, 30.0, 100.0)
_LOADS: Final = (0.0, 0.6)
_SEEDS: Final = "101-103"
_REGION: Final = "us"
_AIRCRAFT, _DURATION_S, _SETTLE_S = 200, 120.0, 40.0


class Cut(msgspec.Struct, frozen=True):
    """One run."""

    city: City
    method: str
    """A set of transports, "rule", "policy", or the name of a trained policy."""
    row: Row


@dataclass(frozen=True, slots=True)
class Work:
    """A run that has to be flown."""

    city: City
    method: str
    seed: int


Cuts = Mapping[tuple[float, float], Mapping[str, Mapping[int, Row]]]
"""Runs by density and load, method, and seed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools paper city-policy`."""
    add = parser.add_argument
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.description = (
        "Fly cut-outs of a city with the rule, the shipped policy, policies that were trained for a\n"
        "city (ground-tools atmc train --algorithm city), and every legal set of transports with BLE 4 at\n"
        "ten messages a second, and compare the distance from the timed point and the losses of\n"
        "separation. Finished runs are kept in --out."
    )
    parser.epilog = "example: ground-tools paper city-policy --densities 10 --seeds 101-102 --methods policy"
    add("--densities", type=float, nargs="+", default=list(_DENSITIES), metavar="N",
        help="aircraft per km² (default: 10 30 100)")  # fmt: skip
    add("--loads", type=float, nargs="+", default=list(_LOADS), metavar="SHARE",
        help="shares of the Wi-Fi channel's time that others take (default: 0 0.6)")  # fmt: skip
    add("--methods", nargs="+", metavar="M", help="sets such as 10-0-2 (messages a second on BLE 4, "
        "BLE 5 and Wi-Fi), rule, policy, city-1 (default: all; the fixed set is always flown)")  # fmt: skip
    add("--seeds", default=_SEEDS, metavar="FROM-TO", help=f"seeds of the cut-outs (default: {_SEEDS})")
    add("--aircraft", type=int, default=_AIRCRAFT, metavar="N",
        help=f"aircraft in the air, which determine the area (default: {_AIRCRAFT})")  # fmt: skip
    add("--minutes", type=float, default=_DURATION_S / 60.0, metavar="N",
        help=f"length of a run (default: {_DURATION_S / 60.0:g})")  # fmt: skip
    add("--settle", type=float, default=_SETTLE_S, metavar="S",
        help=f"simulated time at which counting begins (default: {_SETTLE_S:g})")  # fmt: skip
    add("--out", type=Path, default=Path("runs/paper") / NAME, metavar="FOLDER",
        help=f"folder of {FILE} and table.md (default: runs/paper/{NAME})")  # fmt: skip
    spread.add_options(parser)
    add("--json", action="store_true", help="print one JSON object per line instead of tables")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Fly the missing runs and show all results. Returns 0.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read or written.
    """
    works, words = works_of(args), study.console_of(args)
    spread.jobs_of(args)
    options.make_folder(args.out)
    file = kept(args.out)
    missing = [work for work in works if _number(work) not in file.rows]
    if missing:
        file.add([])
        provenance.write(file.path, made_by_now())
        _fly_all(file, missing, args, words)
    cuts = cuts_of(file.rows[_number(work)] for work in works)
    lines = table(cuts)
    if args.json:
        for key, methods in cuts.items():
            for method, rows in methods.items():
                for row in rows.values():
                    found = {"per_km2": key[0], "load": key[1], "method": method}
                    print(json.dumps(found | msgspec.to_builtins(row)))
    else:
        words.print("\n".join(lines), highlight=False, soft_wrap=True, markup=False)
    study.write(args.out / "table.md", "\n".join(lines) + "\n")
    return 0


def works_of(args: argparse.Namespace) -> list[Work]:
    """All runs that the options ask for.

    Raises:
        ConfigError: an option is out of range.
    """
    methods = tuple(args.methods) if args.methods else (*_OURS, *sets())
    for method in methods:
        if method not in (*_OURS, *sets()):
            raise ConfigError(f"--methods: {method} is unknown; allowed: {', '.join((*_OURS, *sets()))}")
    return [
        Work(city_of(args, density, load), method, seed)
        for density in args.densities
        for load in args.loads
        for seed in seeds_of(args.seeds)
        for method in dict.fromkeys((USUAL, *methods))
    ]


def city_of(args: argparse.Namespace, density: float, load: float) -> City:
    """The cut-out of one density and load.

    Raises:
        ConfigError: an option is out of range.
    """
    settled = 0.0 <= args.settle < 60.0 * args.minutes
    if not (0.0 < density <= 200.0 and 2 <= args.aircraft <= 20_000 and settled):
        raise ConfigError(
            "--densities: above 0, up to 200; --aircraft: 2 to 20000; --settle: at least 0, below "
            "the run's length"
        )
    side_m = 1000.0 * math.sqrt(args.aircraft / density)
    if not 1000.0 <= side_m <= 20_000.0:
        raise ConfigError(
            f"--aircraft: {args.aircraft} at {density:g} per km² are a square of {side_m:,.0f} m; allowed: "
            "1,000 to 20,000 m"
        )
    if not 10.0 <= 60.0 * args.minutes <= 86_400.0:
        raise ConfigError(f"--minutes: {args.minutes:g} is out of range; allowed: 1/6 to 1440")
    city = City(
        demand=Demand(per_km2=density, north_m=side_m, east_m=side_m),
        duration_s=60.0 * args.minutes, settle_s=args.settle, region=_REGION, load=load,
    )  # fmt: skip
    try:
        return msgspec.convert(msgspec.to_builtins(city), City)
    except msgspec.ValidationError as error:
        raise ConfigError(f"the options are not allowed: {error}") from error


def sets() -> tuple[str, ...]:
    """The legal sets with BLE 4 at ten messages a second, as names of methods. With less, or without BLE 4,
    aircraft lose separation (docs/city-results.md)."""
    allowed = legal(SET_ACTIONS, region_of(City(region=_REGION)))
    most = max(ble4 for ble4, _, _ in SET_ACTIONS)
    return tuple(
        "-".join(map(str, action))
        for action, good in zip(SET_ACTIONS, allowed, strict=True)
        if good and action[0] == most
    )


def made_by_now() -> Provenance:
    """The provenance record of runs that the present software flies."""
    return provenance.now(COMMAND, ROOTS, data(), PACKAGES)


def data() -> tuple[str, ...]:
    """Data files on which the runs depend."""
    return (*DATA, *TRAINED)


def kept(folder: Path) -> Kept[Cut]:
    """The runs in an existing folder.

    Raises:
        ConfigError: the file cannot be read, or belongs to another study.
    """
    return Kept(folder / FILE, {"study": NAME}, Cut, lambda cut: _key(cut.city, cut.method, cut.row.seed))


def _key(city: City, method: str, seed: int) -> int:
    transports = method if method in ("rule", "policy") else f"set {method}"
    return number_of(msgspec.structs.replace(city, transports=transports), seed)


def _number(work: Work) -> int:
    return _key(work.city, work.method, work.seed)


def flown(work: Work) -> Row:
    """Fly one run."""
    city = work.city
    if work.method in ("rule", "policy"):
        return fly(msgspec.structs.replace(city, transports=work.method), work.seed)[0]
    return fly(city, work.seed, choosing_of(work.method, city))[0]


def choosing_of(method: str, city: City) -> Callable[[int], Chooser]:
    """Makes the chooser of a set of transports or of a trained policy, for a number of slots."""
    files = {Path(name).stem: name for name in TRAINED}
    if method not in files:
        ble4, ble5, wifi = (int(rate) for rate in method.split("-"))
        return lambda slots: Fixed((ble4, ble5, wifi))
    path, most = shipped(files[method]), TrafficConfig().max_tracks
    return lambda slots: ByPolicy(path.read_bytes(), path.name, region_of(city), slots, most)


def _fly_all(file: Kept[Cut], works: Sequence[Work], args: argparse.Namespace, words: Console) -> None:
    with progress("runs", len(works)) as advance:
        for work, row in spread.in_any_order(flown, works, args, words):
            file.add([Cut(work.city, work.method, row)])
            advance()


def cuts_of(runs: Iterable[Cut]) -> Cuts:
    """The runs, arranged."""
    found: dict[tuple[float, float], dict[str, dict[int, Row]]] = {}
    for cut in runs:
        cell = found.setdefault((cut.city.demand.per_km2, cut.city.load), {})
        cell.setdefault(cut.method, {})[cut.row.seed] = cut.row
    return found


def sample(path: Path) -> list[str]:
    """Fly the first kept run of the fixed set and of each chooser again. Returns the differences, as text."""
    found, done = [], set()
    for cut in read_lines(path, Cut)[1]:
        if cut.method not in (USUAL, *_OURS) or cut.method in done:
            continue
        done.add(cut.method)
        if flown(Work(cut.city, cut.method, cut.row.seed)) != cut.row:
            found.append(f"{cut.city.name}, {cut.method}, seed {cut.row.seed}: another run")
    return found


# ------------------------------------------------------------ what is shown

_HEAD: Final = (
    "| aircraft per km², foreign load | method | distance from the timed point (m) | minus the fixed set (m) "
    "| losses, hours | age within 500 m (s) | unheard within 500 m | Location messages a second |"
)


def table(cuts: Cuts) -> list[str]:
    """The comparison as lines of Markdown."""
    lines = [_HEAD, "|" + 8 * "---|"]
    for (density, load), methods in sorted(cuts.items()):
        usual = methods[USUAL]
        for words, rows in shown(methods):
            lines.append(f"| {density:g}, {load:g} | {words} | " + " | ".join(_cells(rows, usual)) + " |")
    return lines


def shown(methods: Mapping[str, Mapping[int, Row]]) -> list[tuple[str, Mapping[int, Row]]]:
    """The rows of one cell of the table, each with its runs by seed."""
    named = {"rule": "rule", "policy": "policy", USUAL: "fixed set"}
    found = [(named.get(m, m), methods[m]) for m in (USUAL, *_OURS) if m in methods]
    searched = {m: methods[m] for m in sets() if methods.get(m, {}).keys() == methods[USUAL].keys()}
    if len(searched) > 1:
        seeds = list(methods[USUAL])
        if len(seeds) > 1:
            others = {s: best(searched, [o for o in seeds if o != s]) for s in seeds}
            found.append(
                (f"set that is best in the other cut-outs ({_names(others.values())})",
                 {s: searched[m][s] for s, m in others.items()})
            )  # fmt: skip
        own = {s: best(searched, [s]) for s in seeds}
        found.append(("search over the sets, in hindsight", {s: searched[m][s] for s, m in own.items()}))
    return found


def best(methods: Mapping[str, Mapping[int, Row]], seeds: Sequence[int]) -> str:
    """The set with the least distance from the timed point in these cut-outs, of those with no more losses
    than the fixed set."""
    limit = sum(methods[USUAL][s].losses for s in seeds)
    allowed = [m for m, rows in methods.items() if sum(rows[s].losses for s in seeds) <= limit]
    return min(allowed, key=lambda m: sum(methods[m][s].deviation_m for s in seeds))


def _names(methods: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(methods))


def _cells(rows: Mapping[int, Row], usual: Mapping[int, Row]) -> list[str]:
    distance = [row.deviation_m for row in rows.values()]
    apart = [row.deviation_m - usual[seed].deviation_m for seed, row in rows.items()]
    count = len(rows)
    age = sum(row.age_s or 0.0 for row in rows.values()) / count
    unheard = sum(row.unheard or 0.0 for row in rows.values()) / count
    sent = [sum(getattr(row, name) for row in rows.values()) / count for name in ("ble4", "ble5", "wifi")]
    hours = sum(row.flight_h for row in rows.values())
    return [
        _interval(distance, ""),
        _interval(apart, "+") if rows is not usual else "-",
        f"{sum(row.losses for row in rows.values())}, {hours:.0f}",
        f"{age:.2f}",
        f"{unheard:.0%}",
        ", ".join(f"{rate:.1f}" for rate in sent),
    ]


def _interval(values: Sequence[float], sign: str) -> str:
    found = mean(values)
    assert found is not None
    shown = f"{found.value:{sign}.2f}"
    return (
        shown
        if not math.isfinite(found.high)
        else f"{shown} ({found.low:{sign}.2f} to {found.high:{sign}.2f})"
    )
