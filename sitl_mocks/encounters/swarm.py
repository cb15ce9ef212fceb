"""`sitl-mocks swarm`: an encounter in real time. Every vehicle, every companion and the air is a process.

MAVLink and the air's datagrams use UDP on loopback. Positions come from the vehicles' own truth files, so
that the verdict does not depend on the companions' estimates. With `--faults` each companion is examined
while faults are injected (`swarm_faults`).
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

import msgspec
import numpy as np
import tomli_w
from rich.console import Console

from companion import config as configuration
from companion.config import EtherRadio, RecordConfig
from companion.errors import ConfigError
from companion.runtime.record.recorder import create_run_folder, write_json, write_manifest
from companion.toml_reader import without_none
from sitl_mocks.encounters import choosing, demo
from sitl_mocks.encounters.demo_report import command as command_here
from sitl_mocks.encounters.lockstep import HOME, Points, companion_config, names_of, paths_of, vehicle_options
from sitl_mocks.encounters.scenario_file import RANDOM, Scenario
from sitl_mocks.encounters.swarm_report import limit_m, report_of, show
from sitl_mocks.examinations import swarm_faults
from sitl_mocks.examinations.swarm_faults import Examination, schedule_of
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode

_EXAMPLE = (
    "example: sitl-mocks swarm --duration 120 --delay 0 1; sitl-mocks swarm --aircraft 3 --faults --seed 7"
)
START_S = 15.0
"""Time from starting the processes to the paths' time 0, in which interpreters and kernels load on few
cores.
"""
_END_S = 15.0
_ANYWHERE_M = 10_000.0
"""In an examination pilots may have flown the vehicle far away before the companion takes it again."""


@dataclass(slots=True)
class Process:
    """One child process and its output."""

    name: str
    child: subprocess.Popen[str]
    log: Path
    lines: list[str] = field(default_factory=list)

    def expect(self, pattern: str) -> str:
        """Read until a line matches, and return its first group.

        Raises:
            ConfigError: the process ended before a line matched.
        """
        assert self.child.stdout is not None
        for line in self.child.stdout:
            self.lines.append(line.rstrip())
            found = re.search(pattern, line)
            if found:
                return found.group(1) if found.groups() else found.group(0)
        self.child.wait()
        raise ConfigError(f"{self.name} ended with code {self.child.returncode}; see {self.log}")

    def last_json(self) -> dict[str, object]:
        """The JSON object on the last line; empty if there is none."""
        assert self.child.stdout is not None
        self.lines += [line.rstrip() for line in self.child.stdout]
        try:
            value = json.loads(self.lines[-1])
        except (IndexError, ValueError):
            return {}
        return value if isinstance(value, dict) else {}


class Swarm:
    """The processes of one run, and the examinations between them. `close` kills all that still run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.processes: list[Process] = []
        self.examinations: list[Examination] = []
        self._logs: list[IO[str]] = []

    def start(self, name: str, *arguments: str, piped: bool) -> Process:
        """Start one of our commands. Its errors (and its output, unless piped) go to NAME.log."""
        path = self.folder / f"{name}.log"
        log = path.open("w")
        self._logs.append(log)
        child = subprocess.Popen(
            [sys.executable, "-m", *arguments],
            stdout=subprocess.PIPE if piped else log,
            stderr=log,
            stdin=subprocess.DEVNULL,
            text=True,
            # Ctrl-C must reach only this process, which then ends the children in order, companions first.
            start_new_session=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        process = Process(name, child, path)
        self.processes.append(process)
        return process

    def end(self, processes: list[Process]) -> list[str]:
        """Ask processes to end and wait for them. Returns the names of those that did not end well."""
        for process in processes:
            if process.child.poll() is None:
                process.child.send_signal(signal.SIGINT)
        bad = []
        deadline = time.monotonic() + _END_S
        for process in processes:
            try:
                code = process.child.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.child.kill()
                code = process.child.wait()
            if code != 0:
                bad.append(f"{process.name} (exit code {code})")
        return bad

    def close(self) -> None:
        """Kill the remaining processes and close the logs."""
        for process in self.processes:
            if process.child.poll() is None:
                process.child.kill()
                process.child.wait()
            if process.child.stdout is not None:
                process.child.stdout.close()
        for log in self._logs:
            log.close()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sitl-mocks swarm`."""
    parser.epilog = _EXAMPLE
    demo.add_scenario_arguments(parser)
    parser.add_argument("--seed", type=int, default=1, help="what chance draws from (default 1)")
    parser.add_argument(
        "--duration",
        type=float,
        default=120.0,
        help="seconds flown around the middle of the paths (default 120)",
    )
    parser.add_argument(
        "--faults",
        action="store_true",
        help="an examination: stalled companions, bad links and pilots who take over, drawn from the seed; "
        "ends with 1 when a rule is broken, not when aircraft come close",
    )
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="where the run folder goes")
    parser.add_argument("--json", action="store_true", help="print the verdict as one JSON object")


def window(path: Points, duration_s: float) -> Points:
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
    if not 10.0 <= arguments.duration <= 3600.0:
        raise ConfigError(f"--duration: {arguments.duration:g}: allowed 10 to 3600")
    scenario = demo.scenario_of(arguments)
    if scenario.atmc.policy == RANDOM:
        raise ConfigError(f"--policy: {RANDOM}: goes with sitl-mocks demo; no companion chooses at random")
    policy = choosing.read_policy(scenario)
    console = Console(stderr=arguments.json)
    folder = create_run_folder(arguments.runs, "swarm", time.time())
    scenario = choosing.keep(folder, scenario, policy)
    (folder / "config.toml").write_text(tomli_w.dumps(without_none(msgspec.to_builtins(scenario))))
    names = names_of(scenario, arguments.seed)
    write_manifest(
        folder, "sitl-mocks swarm", seed=arguments.seed, aircraft=names, conflict_limit_m=limit_m(scenario)
    )
    swarm = Swarm(folder)
    try:
        report = _fly(swarm, scenario, arguments, console)
    finally:
        for examination in swarm.examinations:
            examination.close()
        swarm.close()
    write_json(folder / "summary.json", report)
    if arguments.json:
        print(json.dumps(report))
    else:
        show(report, console)
        if arguments.faults:
            swarm_faults.show(report["faults"], console)  # type: ignore[arg-type]
    console.print(f"run folder: {folder}", soft_wrap=True)
    console.print(f"look at it: {command_here('ground-tools')} inspect {folder} --summary", soft_wrap=True)
    return 0 if report["ok"] else 1


def _fly(
    swarm: Swarm, scenario: Scenario, arguments: argparse.Namespace, console: Console
) -> dict[str, object]:
    paths = [window(p, arguments.duration) for p in paths_of(scenario, arguments.seed)]
    names = names_of(scenario, arguments.seed)
    ether = swarm.start(
        "ether", "sitl_mocks.cli", "ether", "--listen", "127.0.0.1:0", "--seed", str(arguments.seed),
        *_ether_options(scenario, swarm.folder), piped=True,
    )  # fmt: skip
    radio = "127.0.0.1:" + ether.expect(r"ether on .*:(\d+)")
    links = 1 + arguments.faults
    vehicles = [_start_vehicle(swarm, scenario, n, name, paths[n], links) for n, name in enumerate(names)]
    ports = [[vehicle.expect(r"link udpin:.*:(\d+)") for _ in range(links)] for vehicle in vehicles]
    start_utc_s = time.time() + START_S
    if arguments.faults:
        _examine(swarm, scenario, arguments, paths, ports, start_utc_s)
        near_m = _ANYWHERE_M
        to_vehicles = [one.link_name for one in swarm.examinations]
    else:
        near_m = None
        to_vehicles = [f"udpout:127.0.0.1:{port}" for (port,) in ports]
    companions = []
    for name, path, link in zip(names, paths, to_vehicles, strict=True):
        config = companion_config(scenario, name, path, None)
        config = msgspec.structs.replace(
            config,
            vehicle=msgspec.structs.replace(config.vehicle, link=link),
            flight=msgspec.structs.replace(
                config.flight, start_utc_s=start_utc_s, start_within_m=near_m or config.flight.start_within_m
            ),
            radio=(EtherRadio(address=radio),),
            record=RecordConfig(folder=str(swarm.folder), name=name),
        )
        file = swarm.folder / f"{name}.toml"
        file.write_bytes(configuration.dump(config))
        companions.append(
            swarm.start(name, "companion.commands.cli", "run", "--config", str(file), piped=False)
        )
    for examination, companion in zip(swarm.examinations, companions, strict=bool(swarm.examinations)):
        examination.watch(companion.child)
    bad: list[str] = []
    try:
        interrupted = _watch(swarm, start_utc_s, arguments.duration, console)
    except ConfigError as error:
        if not arguments.faults:
            raise
        # In an examination this is a finding, not an error.
        interrupted, bad = False, [str(error)]
    for examination in swarm.examinations:
        examination.rest()
    bad += swarm.end(companions)
    faults = swarm_faults.end_all(swarm.examinations, swarm.folder)
    bad += swarm.end(vehicles) + swarm.end([ether])
    left = {name: vehicle.last_json() for name, vehicle in zip(names, vehicles, strict=True)}
    report = report_of(
        swarm.folder, scenario, left, ether.last_json(), bad, start_utc_s, interrupted=interrupted
    )
    return swarm_faults.judged(report, faults) if arguments.faults else report


def _examine(
    swarm: Swarm,
    scenario: Scenario,
    arguments: argparse.Namespace,
    paths: list[Points],
    ports: list[list[str]],
    start_utc_s: float,
) -> None:
    """Start an examination between each vehicle and its companion."""
    begins_s = time.monotonic() + start_utc_s - time.time()
    for number, name in enumerate(names_of(scenario, arguments.seed)):
        options = vehicle_options(scenario, number, paths[number])
        first, second = map(int, ports[number])
        examination = Examination(
            name,
            options.firmware,
            options.system_id,
            (first, second),
            scenario.limits,
            begins_s,
            schedule_of(arguments.seed, number, arguments.duration),
            arguments.seed,
            swarm.folder,
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
    swarm: Swarm, scenario: Scenario, number: int, name: str, path: Points, links: int
) -> Process:
    options = vehicle_options(scenario, number, path)
    north, east, down = options.start_position_ned_m
    return swarm.start(
        f"vehicle-{name}", "sitl_mocks.cli", "serve",
        "--firmware", options.firmware.value, "--system-id", str(options.system_id),
        *(["--link", "udpin:127.0.0.1:0"] * links),
        "--home", str(HOME.lat_deg), str(HOME.lon_deg), str(HOME.alt_m),
        "--mode", (options.start_mode or VehicleMode.HOLD).value, "--airborne", str(-down),
        "--start", str(north), str(east), "--seed", str(number),
        "--gnss-sigma", str(options.gnss_horizontal_sigma_m), str(options.gnss_vertical_sigma_m),
        str(options.gnss_velocity_sigma_mps), "--truth", str(swarm.folder / f"{name}.truth.csv"),
        piped=True,
    )  # fmt: skip


def _watch(swarm: Swarm, start_utc_s: float, duration_s: float, console: Console) -> bool:
    """Wait for the end. Returns True if interrupted by Ctrl-C.

    Raises:
        ConfigError: a process ended by itself.
    """
    told_s = -1e9
    try:
        while (now_s := time.time() - start_utc_s) < duration_s:
            for process in swarm.processes:
                if process.child.poll() is not None:
                    raise ConfigError(
                        f"{process.name} ended with code {process.child.returncode}; see {process.log}"
                    )
            if now_s - told_s >= 10.0:
                told_s = now_s
                word = (
                    f"starts in {-now_s:.0f} s" if now_s < 0 else f"{now_s:.0f} of {duration_s:.0f} s flown"
                )
                console.print(f"{len(swarm.processes)} processes; {word}")
            time.sleep(0.2)
    except KeyboardInterrupt:
        console.print("stopping")
        return True
    return False
