"""The command `ground-tools city`: flies many aircraft over a city and reports losses, delays and channel
load."""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from rich.console import Console

from companion.errors import ConfigError
from companion.shipped import given
from ground_tools.channel import options
from ground_tools.city import cells, parquet, spread
from ground_tools.city.cells import TRANSPORTS, City, Row
from ground_tools.city.traffic.demand import PATTERNS, Demand
from ground_tools.common import provenance, sources
from ground_tools.common.kept_lines import Kept
from ground_tools.common.progress import progress
from ground_tools.common.run_options import seeds_of

EXAMPLE = "ground-tools city --density 10 --size 10 10 --transports policy --seeds 1-5 --out runs/city"
_MOST_AIRCRAFT = 20_000


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools city`."""
    command.formatter_class = argparse.RawDescriptionHelpFormatter
    command.epilog = f"example: {EXAMPLE}"
    add, city, drawn = command.add_argument, City(), Demand()
    add("--pattern", choices=PATTERNS, default=drawn.pattern,
        help=f"traffic pattern (default: {drawn.pattern})")  # fmt: skip
    add(
        "--density",
        type=float,
        default=drawn.per_km2,
        metavar="N",
        help=f"planned aircraft in the air per square kilometre (default: {drawn.per_km2:g})",
    )
    add("--size", type=float, nargs=2, default=(10.0, 10.0), metavar=("KM", "KM"),
        help="size of the city from south to north and from west to east (default: 10 10)")  # fmt: skip
    add("--heights", choices=("layers", "free"), default=drawn.heights,
        help=f"layers by direction of flight, or free heights (default: {drawn.heights})")  # fmt: skip
    add("--speed", type=float, default=drawn.speed_mps, metavar="M/S",
        help=f"greatest speed of each aircraft (default: {drawn.speed_mps:g})")  # fmt: skip
    add(
        "--flights",
        type=Path,
        metavar="FILE",
        help="fly flight intentions of Metropolis 2 (.csv) or a scenario of BlueSky (.scn) instead",
    )
    add("--from", type=float, default=0.0, metavar="S", dest="from_s",
        help="time in that file at which the run begins, in seconds (default: 0)")  # fmt: skip
    add("--minutes", type=float, default=city.duration_s / 60.0, metavar="N",
        help=f"length of a run (default: {city.duration_s / 60.0:g})")  # fmt: skip
    add("--settle", type=float, default=city.settle_s, metavar="S",
        help=f"simulated time at which counting begins (default: {city.settle_s:g})")  # fmt: skip
    add("--law", choices=("dmuca", "none"), default=city.law,
        help=f"avoidance law: the companion's, or none (default: {city.law})")  # fmt: skip
    add("--separation", type=float, default=city.separation_m, metavar="M",
        help="separation that the law is asked to keep; losses are counted below "
        f"{city.separation_m:g} m all the same (default: {city.separation_m:g})")  # fmt: skip
    add("--knows", choices=("radio", "given", "perfect"), default=city.knows,
        help="how aircraft learn of each other: by the channel equations, by messages with --delay and "
        f"--loss, or with perfect information (default: {city.knows})")  # fmt: skip
    add("--transports", choices=TRANSPORTS, default=city.transports,
        help=f"how transports are chosen (default: {city.transports})")  # fmt: skip
    add("--region", choices=("none", "us", "eu"), default=city.region,
        help=f"region whose rules limit the sets of transports (default: {city.region})")  # fmt: skip
    add("--load", type=float, default=city.load, metavar="SHARE",
        help="share of time of foreign transmissions on the Wi-Fi channel, below 1 (default: 0)")  # fmt: skip
    add(
        "--delay",
        type=float,
        nargs=2,
        default=city.delay_s,
        metavar=("A", "B"),
        help="with --knows given: delay of each message, from A to B seconds (default: 0 1)",
    )
    add("--loss", type=float, default=city.loss, metavar="SHARE",
        help="with --knows given: share of messages that are lost, 0 to 1 (default: 0)")  # fmt: skip
    add("--reach", type=float, default=city.reach_m, metavar="M",
        help=f"with --knows given: range of messages (default: {city.reach_m:g})")  # fmt: skip
    add("--seeds", default="1-1", metavar="FROM-TO", help="range of seeds, one run each (default: 1-1)")
    add(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="keep results in this folder, also as Parquet, and do not repeat runs that are there",
    )
    spread.add_options(command)
    add("--json", action="store_true", help="print one JSON object instead of text")
    command.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools city`. Returns 0.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read or written.
    """
    city, seeds = city_of(args), seeds_of(args.seeds)
    began = time.perf_counter()
    rows, flown = fly_missing(city, seeds, args, Console(stderr=True))
    found = summary(rows)
    found |= {"flown": flown, "wall_s": round(time.perf_counter() - began, 3)}
    if args.json:
        print(json.dumps(found, allow_nan=False))
        return 0
    words = Console()
    for line in lines(city, found):
        words.print(line, highlight=False, soft_wrap=True)
    return 0


def city_of(args: argparse.Namespace) -> City:
    """The cell that the options describe.

    Raises:
        ConfigError: an option is wrong.
    """
    _check(args)
    north_km, east_km = args.size
    low, high = args.delay
    try:
        wanted = msgspec.convert(
            {
                "pattern": args.pattern,
                "per_km2": args.density,
                "north_m": 1000.0 * north_km,
                "east_m": 1000.0 * east_km,
                "heights": args.heights,
                "speed_mps": args.speed,
            },
            Demand,
        )
        city = City(
            demand=wanted,
            flights=None if args.flights is None else str(given(str(args.flights))),
            from_s=args.from_s,
            duration_s=60.0 * args.minutes,
            settle_s=args.settle,
            law=args.law,
            separation_m=args.separation,
            knows=args.knows,
            transports=args.transports,
            region=args.region,
            load=args.load,
            delay_s=(low, high),
            loss=args.loss,
            reach_m=args.reach,
        )
        city = msgspec.convert(msgspec.to_builtins(city), City)
    except msgspec.ValidationError as error:
        raise ConfigError(f"the options are not allowed: {error}") from error
    if city.flights is None and wanted.aircraft > _MOST_AIRCRAFT:
        raise ConfigError(
            f"--density: {wanted.aircraft:,.0f} aircraft in the air; allowed: up to {_MOST_AIRCRAFT:,}"
        )
    return city


def _check(args: argparse.Namespace) -> None:
    """Refuse numbers that are out of range, which NaN always is, in the names and units of the options.

    Raises:
        ConfigError: names the option, its value and what is allowed.
    """
    (low, high), length_s = args.delay, 60.0 * args.minutes
    for option, value, good, allowed in (
        ("--density", args.density, 0.0 < args.density <= 200.0, "above 0, up to 200"),
        *(("--size", km, 1.0 <= km <= 20.0, "1 to 20") for km in args.size),
        ("--speed", args.speed, 5.0 <= args.speed <= 30.0, "5 to 30"),
        ("--from", args.from_s, math.isfinite(args.from_s), "any finite number"),
        ("--minutes", args.minutes, 10.0 <= length_s <= 86_400.0, "1/6 to 1440"),
        ("--settle", args.settle, 0.0 <= args.settle < length_s, "at least 0, below the run's length"),
        ("--separation", args.separation, 0.0 < args.separation <= 100.0, "above 0, up to 100"),
        ("--load", args.load, 0.0 <= args.load < 1.0, "at least 0, below 1"),
        ("--loss", args.loss, 0.0 <= args.loss <= 1.0, "0 to 1"),
        ("--reach", args.reach, 0.0 < args.reach < math.inf, "any finite number above 0"),
    ):
        if not good:
            raise ConfigError(f"{option}: {value:g} is out of range; allowed: {allowed}")
    if not 0.0 <= low <= high <= 15.0:
        raise ConfigError(f"--delay: {low:g} {high:g}; allowed: two rising numbers from 0 to 15")


def fly_missing(
    city: City, seeds: Sequence[int], args: argparse.Namespace, words: Console
) -> tuple[list[Row], int]:
    """Fly the seeds that are not in the folder. Returns the rows of all seeds, in their order, and the number
    flown.

    Args:
        args: options of the command. With `--out`, results are stored in that folder and looked up there.

    Raises:
        ConfigError: a file cannot be read or written, or a setting cannot be used.
    """
    spread.jobs_of(args)  # reports wrong options before a folder is made
    rows: dict[int, Row] = {}
    file, folder = None, args.out
    if folder is not None:
        options.make_folder(folder)
        parquet.check()
        file = kept(folder, city)
        rows = dict(file.rows)
    missing = [seed for seed in seeds if seed not in rows]
    works = [(city, seed) for seed in missing]
    with progress("runs", len(missing)) as advance:
        for (_, seed), (row, flights, losses) in spread.in_any_order(_fly, works, args, words):
            rows[seed] = row
            if file is not None:
                parquet.write(folder / f"{city.name}-{seed}-flights.parquet", flights)
                parquet.write(folder / f"{city.name}-{seed}-losses.parquet", losses)
                file.add([row])
            advance()
    found = [rows[seed] for seed in seeds]
    if folder is not None:
        parquet.write_runs(folder / f"{city.name}.parquet", city, list(rows.values()), EXAMPLE)
    return found, len(missing)


def kept(folder: Path, city: City) -> Kept[Row]:
    """The stored results of a cell, its rows by seed.

    Raises:
        ConfigError: the results come from another state of the software or its data, or from a file of
            flights with another content, or cannot be read.
    """
    data = provenance.now("", (), spread.DATA, ()).data
    if city.flights is not None:
        data[city.flights] = provenance.content_of(Path(city.flights))
    header = {**msgspec.to_builtins(city), "data": data, "software": sources.digest(cells.ROOTS)}
    header = msgspec.json.decode(msgspec.json.encode(header))
    return Kept(folder / f"{city.name}.jsonl", header, Row, attrgetter("seed"))


def _fly(work: tuple[City, int]) -> tuple[Row, parquet.Columns, parquet.Columns]:
    row, result = cells.fly(*work)
    return row, parquet.flights_of(result), parquet.losses_of(result)


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """The reported figures of some runs: sums of counts, and means of shares and times."""
    hours = sum(row.flight_h for row in rows)
    found: dict[str, Any] = {"runs": len(rows)}
    for name, kind in Row.__annotations__.items():
        values = [value for row in rows if (value := getattr(row, name)) is not None]
        if name == "seed":
            continue
        if name == "least_m":
            found[name] = min(values, default=None)
        elif kind == "int" or name == "flight_h":
            found[name] = round(sum(values), 4)
        else:
            found[name] = round(float(np.mean(values)), 5) if values else None
    for name in ("losses", "cruise_losses", "collisions"):
        found[f"{name}_per_flight_h"] = round(found[name] / hours, 6) if hours > 0.0 else None
    return found


def lines(city: City, found: dict[str, Any]) -> list[str]:
    """The report as lines of text."""
    heard = city.transports if city.knows == "radio" else city.knows
    text = [
        f"{city.demand.pattern if city.flights is None else city.flights}, law {city.law}, {heard}: "
        f"{found['runs']} runs, {found['flights']:,} flights, {found['flight_h']:,.1f} hours of flight",
        f"arrived {found['arrived']:,}, in the air at the end {found['in_the_air']:,}, waiting for departure "
        f"{found['waiting']:,}, not due {found['not_due']:,}",
        f"losses of separation {found['losses']:,} ({_of(found['losses_per_flight_h'])} an hour of flight), "
        f"in cruise {found['cruise_losses']:,}, collisions {found['collisions']:,}",
        f"distance from the timed point {found['deviation_m']:.1f} m on average, largest of a flight "
        f"{found['largest_deviation_m']:.1f} m in the median, delay {found['late_s']:.1f} s; "
        f"extra energy {found['extra_energy']:.1%}",
        f"decisions in conflict {found['conflict']:.1%}, without a velocity that keeps all planes "
        f"{found['infeasible']:.2%}",
    ]
    if found["age_s"] is not None:
        text.append(
            f"within 500 m: age of information {found['age_s']:.2f} s, older than 3 s {found['old']:.2%}, "
            f"unheard {found['unheard']:.2%}"
        )
    if found["wifi_load"] is not None:
        text.append(
            f"Wi-Fi load {found['wifi_load']:.2f}; Locations a second: BLE 4 {found['ble4']:.1f}, BLE 5 "
            f"{found['ble5']:.1f}, Wi-Fi {found['wifi']:.1f}; fall-back {found['refused']:.1%}"
        )
    text.append(f"{found['flown']} runs flown in {found['wall_s']:.1f} s")
    return text


def _of(rate: float | None) -> str:
    return "-" if rate is None or math.isnan(rate) else f"{rate:.4g}"
