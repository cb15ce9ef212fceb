"""`sitl-mocks demo`: fly an encounter in virtual time, with and without avoidance, and report the result."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import queue
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, as_completed
from contextlib import ExitStack, nullcontext
from functools import partial
from multiprocessing.queues import Queue
from pathlib import Path
from typing import BinaryIO

import msgspec
import tomli_w
from rich.console import Console
from rich.progress import Progress

from companion import __version__, event_record
from companion.avoidance.plugin_law import try_out
from companion.config import Config
from companion.errors import ConfigError
from companion.laws import LAWS, plugin_of
from companion.runtime.record.recorder import EventFile, create_run_folder, write_json, write_manifest
from companion.runtime.warm import warm_up
from companion.shipped import given, names
from companion.toml_reader import without_none
from sitl_mocks.air import air_settings
from sitl_mocks.encounters import choosing, scenario_file
from sitl_mocks.encounters.demo_report import Outcome, Verdict, pair_rows, seed_table, show
from sitl_mocks.encounters.lockstep import TICK_S, UTC_AT_START_S, Run, fly, paths_of
from sitl_mocks.encounters.scenario_file import RANDOM, Scenario
from sitl_mocks.encounters.verdict import deviations_of, on_path_limit_m, pairs_of
from sitl_mocks.vehicle.sensing import SensorOptions
from sitl_mocks.worker_pool import interrupts_held, worker_pool

_TRUTH_TICKS = 2
_EXAMPLE = "example: sitl-mocks demo --delay 1 2 --seed 7; sitl-mocks demo --seeds 1-20 --delay 2 3 --json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sitl-mocks demo`."""
    parser.epilog = _EXAMPLE
    add_scenario_arguments(parser)
    seeds = parser.add_mutually_exclusive_group()
    seeds.add_argument("--seed", type=int, default=1, help="random seed (default: %(default)s)")
    seeds.add_argument(
        "--seeds", metavar="A-B", help="range of seeds; runs on all cores and writes no run folder"
    )
    parser.add_argument(
        "--runs",
        type=Path,
        default=Path("runs"),
        help="folder in which the run folder is created (default: %(default)s)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object per seed, one per line")


def add_scenario_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that choose and change a scenario."""
    parser.add_argument(
        "--scenario",
        type=partial(given, kind="scenarios"),
        help="scenario file (TOML), or the name of a shipped one: "
        f"{', '.join(names('scenarios', '.toml'))}; default: S2 with five aircraft",
    )
    parser.add_argument("--aircraft", type=int, metavar="N", help="number of aircraft (2-100)")
    air_settings.add_arguments(parser)
    parser.add_argument(
        "--delay",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="bounds of the message delay (s); only for channel model interval",
    )
    parser.add_argument(
        "--law",
        metavar="NAME",
        help=f"avoidance law: {', '.join(LAWS)}, that of a plug-in, or MODULE:CLASS (default: the one in the "
        "scenario)",
    )
    parser.add_argument(
        "--sensor",
        type=float,
        metavar="RANGE",
        help="put a sensor aboard every aircraft that sees the scenario's obstacles and the other aircraft "
        "within this range (m); 0: none",
    )
    choosing.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Fly and judge. Returns 0 if every seed is ok, else 1.

    Raises:
        ConfigError: an option or the scenario file is wrong.
    """
    scenario = scenario_of(arguments)
    policy = choosing.read_policy(scenario)
    console = Console(stderr=arguments.json)
    seconds = warm_up()
    if seconds > 1.0:
        console.print(f"Compiled the avoidance kernels in {seconds:.1f} s (cached for later runs).")
    if plugin_of(scenario.avoidance.law) is not None:
        try_out(scenario.avoidance, scenario.limits)
    if arguments.seeds is not None:
        return _many(scenario, policy, _parse_seeds(arguments.seeds), console, as_json=arguments.json)
    folder = create_run_folder(arguments.runs, "demo", time.time())
    if scenario.atmc.policy == RANDOM:
        console.print("No event records are written: random choices cannot be replayed.")
    kept = choosing.keep(folder, scenario, policy)
    (folder / "config.toml").write_text(tomli_w.dumps(without_none(msgspec.to_builtins(kept))))
    verdict = next(_fly_all(scenario, policy, [arguments.seed], console, folder))
    write_manifest(
        folder,
        "sitl-mocks demo",
        seed=arguments.seed,
        aircraft=[d.name for d in verdict.avoided.deviations],
        conflict_limit_m=verdict.limit_m,
    )
    write_json(
        folder / "summary.json",
        {
            **verdict.as_dict(),
            "pairs": pair_rows(verdict),
            "air": verdict.avoided.air,
            "transports": {name: chosen.to_dict() for name, chosen in verdict.avoided.chosen.items()},
        },
    )
    if arguments.json:
        print(json.dumps(verdict.as_dict()))
    else:
        show(verdict, folder, console)
    return 0 if verdict.ok else 1


def scenario_of(arguments: argparse.Namespace) -> Scenario:
    """The scenario that the options select.

    Raises:
        ConfigError: an option or the scenario file is wrong.
    """
    if arguments.seed < 0:
        raise ConfigError(f"--seed: {arguments.seed} is out of range; allowed: 0 or more")
    scenario = scenario_file.DEFAULT if arguments.scenario is None else scenario_file.load(arguments.scenario)
    if arguments.aircraft is not None:
        if scenario.geometry is None:
            raise ConfigError("--aircraft cannot be combined with a scenario file that lists the paths")
        if not 2 <= arguments.aircraft <= 100:
            raise ConfigError(f"--aircraft: {arguments.aircraft} is out of range; allowed: 2 to 100")
        scenario = msgspec.structs.replace(scenario, aircraft=arguments.aircraft)
    air, channel = air_settings.with_options(scenario.air, scenario.channel, arguments)
    scenario = msgspec.structs.replace(scenario, air=air, channel=channel)
    if arguments.law is not None:
        avoidance = msgspec.structs.replace(scenario.avoidance, law=arguments.law)
        scenario = msgspec.structs.replace(scenario, avoidance=avoidance)
        try:
            plugin_of(arguments.law)
        except ConfigError as error:
            raise ConfigError(f"--law: {error}") from error
    if arguments.sensor is not None:
        scenario = _with_sensor(scenario, arguments.sensor)
    return choosing.with_options(scenario, arguments)


def _with_sensor(scenario: Scenario, range_m: float) -> Scenario:
    if range_m != 0.0 and not 1.0 <= range_m <= 600.0:
        raise ConfigError(f"--sensor: {range_m:g} is out of range; allowed: 0, or 1 to 600")
    sensor = scenario.sensor or SensorOptions()
    new = None if range_m == 0.0 else msgspec.structs.replace(sensor, range_m=range_m)
    return msgspec.structs.replace(scenario, sensor=new)


def _parse_seeds(text: str) -> list[int]:
    first, _, last = text.partition("-")
    if not first.isdigit() or (last and not last.isdigit()) or (last and int(last) < int(first)):
        raise ConfigError(f"--seeds: {text!r} is not a range of seeds; allowed: A-B, for example 1-20")
    return list(range(int(first), int(last or first) + 1))


def _many(
    scenario: Scenario, policy: bytes | None, seeds: list[int], console: Console, *, as_json: bool
) -> int:
    started = time.monotonic()
    verdicts = []
    for verdict in _fly_all(scenario, policy, seeds, console, None):
        verdicts.append(verdict)
        if as_json:
            print(json.dumps(verdict.as_dict()), flush=True)
    if not as_json:
        console.print(seed_table(verdicts))
    good = sum(v.ok for v in verdicts)
    simulated = sum(v.avoided.simulated_s + v.unavoided.simulated_s for v in verdicts)
    wall = time.monotonic() - started
    console.print(
        f"{good} of {len(verdicts)} seeds ok; {simulated:.0f} simulated seconds in {wall:.1f} s "
        f"({simulated / wall:.0f} times real time on {_workers(seeds)} processes)"
    )
    return 0 if good == len(verdicts) else 1


# ---------------------------------------------------------------- flying, by process

_progress: Queue[tuple[int, float]] | None = None


def _initialise(progress: Queue[tuple[int, float]]) -> None:
    global _progress
    _progress = progress


def _fly_one(
    scenario: Scenario,
    seed: int,
    task: int,
    *,
    avoided: bool,
    folder: Path | None,
    policy: bytes | None = None,
) -> Outcome:
    """Fly once, in a worker process."""
    started = time.monotonic()
    paths = paths_of(scenario, seed)

    def progress(share: float) -> None:
        if _progress is not None:
            _progress.put((task, share))

    with ExitStack() as files:

        def recorder(name: str, config: Config) -> Callable[[event_record.Step], None]:
            assert folder is not None
            header = event_record.Header(aircraft=name, software=__version__, config=config, policy=policy)
            file = EventFile(folder / f"{name}.events", header)
            files.callback(file.close)
            return file.step

        def tlog(name: str) -> BinaryIO:
            assert folder is not None
            return files.enter_context((folder / f"{name}.tlog").open("wb"))

        result: Run = fly(
            scenario,
            seed,
            law=None if avoided else "none",
            policy=policy,
            record=recorder if folder is not None and scenario.atmc.policy != RANDOM else None,
            tlog=tlog if folder is not None else None,
            progress=progress,
        )
    if folder is not None:
        _write_truth(folder, result)
    sent = sum(p.sent for p in result.air.values())
    return Outcome(
        seed=seed,
        avoided=avoided,
        pairs=pairs_of(result),
        deviations=deviations_of(result, paths, on_path_limit_m(scenario)),
        wall_s=time.monotonic() - started,
        simulated_s=len(result.time_s) * TICK_S,
        air=[{"sender": a, "receiver": b, **stats.to_dict()} for (a, b), stats in result.air.items()],
        messages={"sent": sent, "delivered": sum(p.delivered for p in result.air.values())},
        chosen=result.chosen,
        faults=result.faults,
    )


def _write_truth(folder: Path, result: Run) -> None:
    """Write `<aircraft>.truth.csv` of every aircraft in the format of a served vehicle: ten rows a second."""
    for aircraft in result.aircraft:
        with (folder / f"{aircraft.name}.truth.csv").open("w") as file:
            file.write("utc_s,north_m,east_m,down_m\n")
            for tick in range(0, len(aircraft.position_ned_m), _TRUTH_TICKS):
                north, east, down = aircraft.position_ned_m[tick]
                utc_s = UTC_AT_START_S + tick * TICK_S
                file.write(f"{utc_s:.3f},{north:.3f},{east:.3f},{down:.3f}\n")


def _workers(seeds: list[int]) -> int:
    return min(2 * len(seeds), os.cpu_count() or 1)


def _fly_all(
    scenario: Scenario, policy: bytes | None, seeds: list[int], console: Console, folder: Path | None
) -> Iterator[Verdict]:
    """Fly both flights of every seed on all cores. Yields verdicts in the order of the seeds."""
    with interrupts_held():
        shared: Queue[tuple[int, float]] = multiprocessing.get_context("spawn").Queue()
    waiting = list(seeds)
    bar = Progress(console=console, transient=True)
    with (
        # A bar that is only disabled prints an empty line (rich before 14.3).
        bar if console.is_terminal else nullcontext(),
        worker_pool(_workers(seeds), _initialise, shared) as pool,
    ):
        try:
            tasks: dict[Future[Outcome], int] = {}
            with interrupts_held():
                for seed in seeds:
                    for avoided in (True, False):
                        what = "with avoidance" if avoided else "without avoidance"
                        task = bar.add_task(f"seed {seed}, {what}", total=1.0, visible=len(seeds) <= 4)
                        where = folder if folder is None or avoided else folder / "unavoided"
                        if where is not None:
                            where.mkdir(exist_ok=True)
                        future = pool.submit(
                            _fly_one, scenario, seed, task, avoided=avoided, folder=where, policy=policy
                        )
                        tasks[future] = int(task)
            outcomes: dict[tuple[int, bool], Outcome] = {}
            for future in _completed(tasks, shared, bar):
                outcome = future.result()
                outcomes[outcome.seed, outcome.avoided] = outcome
                while waiting and {(waiting[0], True), (waiting[0], False)} <= outcomes.keys():
                    seed = waiting.pop(0)
                    yield Verdict(seed, scenario, outcomes[seed, True], outcomes[seed, False])
        except KeyboardInterrupt:
            above = " The results so far are above." if waiting != seeds else ""
            console.print(f"Interrupted.{above}")
            raise


def _completed(
    tasks: dict[Future[Outcome], int], shared: Queue[tuple[int, float]], bar: Progress
) -> Iterator[Future[Outcome]]:
    left = set(tasks)
    while left:
        try:
            for future in as_completed(left, timeout=0.2):
                bar.update(tasks[future], completed=1.0)  # type: ignore[arg-type]
                left.discard(future)
                yield future
        except TimeoutError:
            pass
        while True:
            try:
                task, share = shared.get_nowait()
            except queue.Empty:
                break
            bar.update(task, completed=share)  # type: ignore[arg-type]
