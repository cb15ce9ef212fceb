"""`sitl-mocks swarm`: an encounter in real time. Every vehicle, every companion and the air is a process.

MAVLink and the air's datagrams use loopback. Positions come from the vehicles' own truth files, so that the
verdict does not depend on the companions' estimates. With `--faults` each companion is examined while faults
are injected (`sitl_mocks.examinations.swarm`).
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import tomli_w
from rich.console import Console

from companion import config as configuration
from companion.arrays import Floats
from companion.config import RecordConfig
from companion.errors import ConfigError
from companion.radio.ether.section import EtherRadio
from companion.runtime.record.recorder import create_run_folder, write_json, write_manifest
from companion.toml_reader import without_none
from sitl_mocks.encounters import choosing, demo
from sitl_mocks.encounters.demo_report import command as command_here
from sitl_mocks.encounters.lockstep import companion_config, names_of, paths_of, vehicle_options
from sitl_mocks.encounters.processes import Process, Swarm
from sitl_mocks.encounters.scenario_file import RANDOM, Scenario
from sitl_mocks.encounters.swarm_report import limit_m, report_of, show
from sitl_mocks.examinations.faults import Fault
from sitl_mocks.examinations.flights import BrokenRuleError
from sitl_mocks.examinations.modelled_link import KINDS
from sitl_mocks.examinations.shrink import moved, shortest
from sitl_mocks.examinations.swarm import verdict
from sitl_mocks.examinations.swarm.examination import Examination, ServedVehicle, end_all
from sitl_mocks.examinations.swarm.schedule import FIRST_S, AircraftSchedule, draw, from_file, to_file
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from sitl_mocks.vehicle.options import HOME

_EXAMPLES = """examples:
  sitl-mocks swarm --duration 120 --delay 0 1
  sitl-mocks swarm --aircraft 3 --duration 60 --faults --seed 7
  sitl-mocks swarm --schedule runs/20260101-120000-swarm/DMUCA002.shortest.json
"""
START_S = 15.0
"""Time from starting the processes to the paths' time 0. On few cores, interpreters and compiled kernels take
long to load.
"""
_START_WITHIN_M = 10_000.0
"""`flight.start_within_m` in an examination, where a pilot may have flown the vehicle far from its path
before the companion takes control again.
"""
_CLOCK_STOPS_S = 60.0
"""Time added to a schedule, because its clock stops while the vehicle is given back and taken again."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What one run flies."""

    scenario: Scenario
    seed: int
    duration_s: float
    numbers: tuple[int, ...]
    """Numbers of the aircraft that fly."""
    schedules: dict[int, AircraftSchedule]
    """Schedule of faults by aircraft number; empty without faults."""
    until_over: bool = False
    """Whether the run ends as soon as all schedules have ended."""
    policy: bytes | None = None
    """Content of the policy file that chooses the transports."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sitl-mocks swarm`."""
    parser.epilog = _EXAMPLES
    demo.add_scenario_arguments(parser)
    parser.add_argument("--seed", type=int, default=1, help="random seed (default: %(default)s)")
    parser.add_argument(
        "--duration",
        type=float,
        default=120.0,
        help="length of the flown section in the middle of the paths (s; default: %(default)g)",
    )
    parser.add_argument(
        "--faults",
        action="store_true",
        help="inject random faults: stalled companions, bad links, wrong answers to mode requests and "
        "pilots who take over; the exit code is 1 if a rule is broken, and does not depend on the separation",
    )
    parser.add_argument(
        "--link", choices=KINDS, help="link of every companion (with --faults; default: each kind in turn)"
    )
    parser.add_argument(
        "--tries",
        type=int,
        default=10,
        metavar="N",
        help="most flights to search for a shorter schedule that breaks the same rule (default: %(default)s)",
    )
    parser.add_argument(
        "--schedule", type=Path, metavar="FILE", help="fly only the aircraft in this file, with its faults"
    )
    parser.add_argument(
        "--runs",
        type=Path,
        default=Path("runs"),
        help="folder in which the run folder is created (default: %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print the verdict as one JSON object")


def window(path: Floats, duration_s: float) -> Floats:
    """The middle `duration_s` of a timed path, with its clock from 0; rows of time, north, east, down."""
    start = max(0.0, 0.5 * (float(path[-1, 0]) - duration_s))
    end = min(start + duration_s, float(path[-1, 0]))
    inside = path[(path[:, 0] > start) & (path[:, 0] < end), 0]
    times = np.concatenate([[start], inside, [end]])
    columns = [np.interp(times, path[:, 0], path[:, k]) for k in (1, 2, 3)]
    return np.column_stack([times - start, *columns])


def run(arguments: argparse.Namespace) -> int:
    """Fly in real time and judge. Returns 0 if all requirements held, else 1.

    Raises:
        ConfigError: an option or the scenario is wrong, or a process could not start.
    """
    plan = _plan_of(arguments)
    policy = choosing.read_policy(plan.scenario)
    console = Console(stderr=arguments.json)
    folder = create_run_folder(arguments.runs, "swarm", time.time())
    plan = replace(plan, scenario=choosing.keep(folder, plan.scenario, policy), policy=policy)
    report = _fly_in(folder, plan, console)
    if arguments.json:
        print(json.dumps(report))
    else:
        show(report, console)
        if plan.schedules:
            verdict.show(report["faults"], console)  # type: ignore[arg-type]
    if plan.schedules and arguments.schedule is None:
        _shorten(folder, plan, report["faults"], arguments.tries, console)  # type: ignore[arg-type]
    console.print(f"run folder: {folder}", soft_wrap=True)
    console.print(f"to inspect it: {command_here('ground-tools')} inspect {folder} --summary", soft_wrap=True)
    return 0 if report["ok"] else 1


def _plan_of(arguments: argparse.Namespace) -> Plan:
    if not 10.0 <= arguments.duration <= 3600.0:
        raise ConfigError(f"--duration: {arguments.duration:g} is out of range; allowed: 10 to 3600")
    if not 0 <= arguments.tries <= 1000:
        raise ConfigError(f"--tries: {arguments.tries} is out of range; allowed: 0 to 1000")
    if arguments.link is not None and not arguments.faults:
        raise ConfigError("--link is allowed only with --faults")
    if arguments.schedule is not None:
        return _alone(demo.scenario_of(arguments), read_schedule(arguments.schedule))
    scenario, seed, duration_s = demo.scenario_of(arguments), arguments.seed, arguments.duration
    if scenario.atmc.policy == RANDOM:
        raise ConfigError(
            f"--policy: {RANDOM} is allowed only with sitl-mocks demo; the companion has no random policy"
        )
    numbers = tuple(range(len(paths_of(scenario, seed))))
    schedules = {
        number: draw(seed, len(numbers), number, duration_s, arguments.link)
        for number in numbers
        if arguments.faults
    }
    return Plan(scenario, seed, duration_s, numbers, schedules)


def read_schedule(path: Path) -> AircraftSchedule:
    """Read a schedule that an earlier run has written: a shortest one, or a NAME.faults.json.

    Raises:
        ConfigError: the file cannot be read or is no schedule.
    """
    try:
        value = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"--schedule: {path}: {error}") from error
    if not isinstance(value, dict):
        raise ConfigError(f"--schedule: {path}: the file is not a JSON object")
    return from_file(value.get("schedule", value))


def _alone(scenario: Scenario, schedule: AircraftSchedule) -> Plan:
    """Plan of one aircraft of a swarm without the others."""
    if scenario.geometry is not None:
        scenario = msgspec.structs.replace(scenario, aircraft=schedule.aircraft)
    number = schedule.number
    if number >= len(paths_of(scenario, schedule.seed)):
        raise ConfigError(
            f"--schedule: the scenario has no aircraft {number}; give the --scenario of the original run"
        )
    duration_s = schedule.until_s + _CLOCK_STOPS_S
    return Plan(scenario, schedule.seed, duration_s, (number,), {number: schedule}, until_over=True)


def _shorten(folder: Path, plan: Plan, faults: dict[str, Any], tries: int, console: Console) -> None:
    """Search for the shortest schedule with which the first failing aircraft still breaks the same rule.

    Every try is a flight of this aircraft alone, in real time. Such flights are not reproducible, so a
    shorter schedule that could fail may be discarded. The schedule that is printed did fail.
    """
    names = names_of(plan.scenario, plan.seed)
    failed = [number for number in plan.numbers if faults[names[number]]["breaches"]]
    if not failed or not tries:
        return
    schedule, first = plan.schedules[failed[0]], faults[names[failed[0]]]["breaches"][0]
    error = BrokenRuleError(first["rule"], first["schedule_s"], first["words"])
    tried = 0

    def breaks(some: tuple[Fault, ...], until_s: float) -> BrokenRuleError | None:
        nonlocal tried
        tried += 1
        # Before the first fault, the companion only needs the time to take control of the vehicle.
        early_s = max(0.0, min(fault.at_s for fault in some) - FIRST_S[0])
        candidate = replace(schedule, faults=moved(some, -early_s), until_s=round(until_s - early_s, 3))
        console.print(f"shortening, try {tried} of {tries}: {len(some)} faults in {candidate.until_s:.1f} s")
        (report,) = fly_alone(folder / f"try-{tried}", plan.scenario, candidate).values()
        broken = [row for row in report["breaches"] if row["rule"] == first["rule"]]
        if not broken:
            return None
        return BrokenRuleError(first["rule"], broken[0]["schedule_s"] + early_s, broken[0]["words"])

    some, until_s = shortest(schedule.faults, error, breaks, tries=tries, earliest_s=())
    early_s = max(0.0, min((fault.at_s for fault in some), default=0.0) - FIRST_S[0])
    short = replace(schedule, faults=moved(some, -early_s), until_s=round(until_s - early_s, 3))
    path = folder / f"{names[failed[0]]}.shortest.json"
    write_json(path, to_file(short))
    console.print(
        f"shortest schedule found in {tried} flights that breaks the rule {first['rule']}: {short}",
        highlight=False,
    )
    console.print(f"sitl-mocks swarm --schedule {path}", soft_wrap=True, highlight=False)


def fly_alone(folder: Path, scenario: Scenario, schedule: AircraftSchedule) -> dict[str, Any]:
    """Fly one aircraft alone under a schedule. Returns the report of its faults, by its name."""
    folder.mkdir()
    report = _fly_in(folder, _alone(scenario, schedule), Console(quiet=True))
    found: dict[str, Any] = report["faults"]  # type: ignore[assignment]
    return found


def _fly_in(folder: Path, plan: Plan, console: Console) -> dict[str, object]:
    """Fly a plan, and write its report into the folder."""
    scenario = plan.scenario
    (folder / "config.toml").write_text(tomli_w.dumps(without_none(msgspec.to_builtins(scenario))))
    names = [names_of(scenario, plan.seed)[number] for number in plan.numbers]
    write_manifest(
        folder, "sitl-mocks swarm", seed=plan.seed, aircraft=names, conflict_limit_m=limit_m(scenario)
    )
    swarm = Swarm(folder)
    try:
        report = _fly(swarm, plan, names, console)
    finally:
        swarm.close()
    write_json(folder / "summary.json", report)
    return report


def _fly(swarm: Swarm, plan: Plan, names: list[str], console: Console) -> dict[str, object]:
    scenario, faults = plan.scenario, bool(plan.schedules)
    paths = [window(paths_of(scenario, plan.seed)[number], plan.duration_s) for number in plan.numbers]
    ether = swarm.start(
        "ether", "sitl_mocks.cli", "ether", "--listen", "127.0.0.1:0", "--seed", str(plan.seed),
        *_ether_options(scenario, swarm.folder), piped=True,
    )  # fmt: skip
    radio = "127.0.0.1:" + ether.expect(r"ether on .*:(\d+)")
    links = 1 + faults
    starts = zip(plan.numbers, names, paths, strict=True)
    vehicles = [_start_vehicle(swarm, scenario, *start, links) for start in starts]
    ports = [[int(vehicle.expect(r"link udpin:.*:(\d+)")) for _ in range(links)] for vehicle in vehicles]
    start_utc_s = time.time() + START_S
    to_vehicles = [f"udpout:127.0.0.1:{first}" for first, *_ in ports]
    if faults:
        _examine(swarm, plan, names, vehicles, ports, start_utc_s)
        to_vehicles = [one.link_name for one in swarm.examinations]
    companions = [
        _start_companion(swarm, plan, name, path, link, radio, start_utc_s)
        for name, path, link in zip(names, paths, to_vehicles, strict=True)
    ]
    for examination, companion in zip(swarm.examinations, companions, strict=faults):
        examination.set_companion(companion.child)
    bad: list[str] = []
    try:
        interrupted = _watch(swarm, plan, start_utc_s, console)
    except ConfigError as error:
        if not faults:
            raise
        # In an examination, a process that ended by itself is a result, not an error of the run.
        interrupted, bad = False, [str(error)]
    # Only the end of all schedules may end a flight early.
    flown_s = min(plan.duration_s, time.time() - start_utc_s) if plan.until_over else plan.duration_s
    for examination in swarm.examinations:
        examination.rest()
    bad += swarm.end(companions)
    results = end_all(swarm.examinations, swarm.folder)
    bad += swarm.end(vehicles) + swarm.end([ether])
    left = {name: vehicle.last_json() for name, vehicle in zip(names, vehicles, strict=True)}
    by_name = dict(zip(names, paths, strict=True))
    report = report_of(
        swarm.folder, scenario, left, ether.last_json(), bad, by_name, (start_utc_s, flown_s),
        interrupted=interrupted,
    )  # fmt: skip
    return verdict.judged(report, results) if faults else report


def _start_companion(
    swarm: Swarm, plan: Plan, name: str, path: Floats, link: str, radio: str, start_utc_s: float
) -> Process:
    number = names_of(plan.scenario, plan.seed).index(name)
    config = choosing.with_agent(companion_config(plan.scenario, name, path, None), plan.policy, number)
    near_m = _START_WITHIN_M if plan.schedules else config.flight.start_within_m
    config = msgspec.structs.replace(
        config,
        vehicle=msgspec.structs.replace(config.vehicle, link=link),
        flight=msgspec.structs.replace(config.flight, start_utc_s=start_utc_s, start_within_m=near_m),
        radio=(EtherRadio(address=radio),),
        record=RecordConfig(folder=str(swarm.folder.absolute()), name=name),
    )
    file = swarm.folder / f"{name}.toml"
    file.write_bytes(configuration.dump(config))
    return swarm.start(name, "companion.commands.cli", "run", "--config", str(file), piped=False)


def _examine(
    swarm: Swarm,
    plan: Plan,
    names: list[str],
    vehicles: list[Process],
    ports: list[list[int]],
    start_utc_s: float,
) -> None:
    """Start an examination between each vehicle and its companion."""
    begins_s = time.monotonic() + start_utc_s - time.time()
    paths = paths_of(plan.scenario, plan.seed)
    for number, name, process, (first, second) in zip(plan.numbers, names, vehicles, ports, strict=True):
        options = vehicle_options(plan.scenario, number, paths[number])
        troubles = process.child.stdin
        assert troubles is not None
        vehicle = ServedVehicle(name, options.firmware, options.system_id, (first, second), troubles)
        examination = Examination(
            vehicle, plan.scenario.limits, begins_s, plan.schedules[number], swarm.folder
        )
        swarm.examinations.append(examination)
        examination.start()


def _ether_options(scenario: Scenario, folder: Path) -> list[str]:
    """The scenario's air as options of `sitl-mocks ether`. Parameters go to a file in the run folder."""
    air = scenario.air
    options = ["--channel", air.model]
    if air.model == "interval":
        options += ["--delay", str(air.interval_s[0]), str(air.interval_s[1]), "--loss", str(air.loss or 0.0)]
        if air.range_m is not None:
            options += ["--range", str(air.range_m)]
    elif scenario.channel is not None:
        file = folder / "channel.toml"
        file.write_text(tomli_w.dumps(msgspec.to_builtins(scenario.channel)))
        options += ["--parameters", str(file)]
    return options


def _start_vehicle(
    swarm: Swarm, scenario: Scenario, number: int, name: str, path: Floats, links: int
) -> Process:
    options = vehicle_options(scenario, number, path)
    north, east, down = options.start_position_ned_m
    return swarm.start(
        f"vehicle-{name}", "sitl_mocks.cli", "serve",
        "--firmware", options.firmware.value, "--system-id", str(options.system_id),
        *(["--link", "udpin:127.0.0.1:0"] * links), *(["--troubles"] if links > 1 else []),
        "--home", str(HOME.lat_deg), str(HOME.lon_deg), str(HOME.alt_m),
        "--mode", (options.start_mode or VehicleMode.HOLD).value, "--airborne", str(-down),
        "--start", str(north), str(east), "--seed", str(number),
        "--gnss-sigma", str(options.gnss_horizontal_sigma_m), str(options.gnss_vertical_sigma_m),
        str(options.gnss_velocity_sigma_mps), "--truth", str(swarm.folder / f"{name}.truth.csv"),
        piped=True, told=links > 1,
    )  # fmt: skip


def _watch(swarm: Swarm, plan: Plan, start_utc_s: float, console: Console) -> bool:
    """Wait for the end. Returns True if interrupted by Ctrl-C.

    Raises:
        ConfigError: a process ended by itself.
    """
    told_s = -1e9
    try:
        while (now_s := time.time() - start_utc_s) < plan.duration_s:
            if plan.until_over and all(one.over for one in swarm.examinations):
                break
            for process in swarm.processes:
                if process.child.poll() is not None:
                    raise ConfigError(
                        f"{process.name} ended with exit code {process.child.returncode}; see {process.log}"
                    )
            if now_s - told_s >= 10.0:
                told_s = now_s
                flown = f"{now_s:.0f} of {plan.duration_s:.0f} s flown"
                word = f"starts in {-now_s:.0f} s" if now_s < 0 else flown
                console.print(f"{len(swarm.processes)} processes; {word}")
            time.sleep(0.2)
    except KeyboardInterrupt:
        console.print("stopping")
        return True
    return False
