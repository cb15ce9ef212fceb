"""`ground-tools fly ADDRESS...`: upload, take off, start and land, with one vehicle at each address.

The steps always run in this order, independent of the order of the options: upload, take off, start, wait,
land. The command never sends setpoints; in flight, the companion sends them.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from companion.errors import ConfigError
from companion.events import MissionItem
from companion.geometry import Vec3
from companion.shipped import given
from ground_tools.fly import missions
from ground_tools.fly.fleet import Fleet
from ground_tools.fly.vehicle import Vehicle, VehicleError, load_mavsdk
from sitl_mocks.encounters import scenario_file
from sitl_mocks.encounters.lockstep import paths_of
from sitl_mocks.signals import end_signals

_CONNECT_S = 30.0
_EXAMPLES = """examples:
  ground-tools fly udpin://0.0.0.0:14550 --takeoff 30 --mission survey.plan --start --land
  ground-tools fly udpout://127.0.0.1:14550 udpout://127.0.0.1:14551 --takeoff 30 \\
      --scenario config/scenarios/head_on.toml --start --land
  ground-tools fly tcpout://127.0.0.1:5760 --land

After a failure, Ctrl-C or a closed terminal, vehicles in the air hold their position (BRAKE on ArduPilot,
HOLD on PX4), and the command says so. It disarms no vehicle in the air. Exit codes: 0 done, 1 a vehicle
refused or was lost, 2 wrong input, 130 Ctrl-C.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools fly`."""
    parser.description = (
        "Upload missions to one or more vehicles, take off, start the missions and land, in this order."
    )
    parser.epilog = _EXAMPLES
    add = parser.add_argument
    add("address", nargs="+", metavar="ADDRESS", help="address of a vehicle: udpin://HOST:PORT, "
        "udpout://HOST:PORT, tcpout://HOST:PORT or serial://DEVICE:BAUD")  # fmt: skip
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--mission", type=Path, action="append", metavar="FILE",
                      help="mission to upload (.plan or QGC WPL 110); once for each ADDRESS")  # fmt: skip
    what.add_argument("--scenario", type=partial(given, kind="scenarios"), metavar="FILE",
                      help="upload the scenario's paths as missions, around the first vehicle's home; "
                      "ADDRESS k gets the path of aircraft k, and --start starts all together")  # fmt: skip
    add("--seed", type=int, default=1, help="seed of the scenario's random paths (default: 1)")
    add("--takeoff", type=float, metavar="HEIGHT", help="arm, and take off to this height above home in m")
    add("--start", action="store_true", help="start the missions")
    add("--wait", action="store_true", help="with --start: wait until the missions are finished")
    add("--land", action="store_true", help="land; with --start, land when the missions are finished")
    add("--json", action="store_true", help="print the result as one JSON object, and the progress to stderr")


def run(args: argparse.Namespace) -> int:
    """Run the steps. Returns 0 if all are done, 1 if a vehicle refused or was lost, 130 after Ctrl-C.

    Raises:
        ConfigError: An option, an address or a file is wrong, or mavsdk is missing.
    """
    _check(args)
    missions_at = _missions(args)
    load_mavsdk()
    began_s = time.monotonic()

    def say(text: str) -> None:
        print(
            f"[{time.monotonic() - began_s:5.1f} s] {text}",
            file=sys.stderr if args.json else sys.stdout,
            flush=True,
        )

    vehicles: list[Vehicle] = []
    error: str | None = None
    left: dict[str, str] = {}
    ended: list[int] = []
    try:
        for number, address in enumerate(args.address, start=1):
            vehicles.append(Vehicle.connect(f"vehicle {number}", address, _CONNECT_S))
            say(_introduction(vehicles[-1], address))
        # From here on, Ctrl-C takes effect between two actions, and vehicles are left in a safe state.
        with end_signals() as ended:
            fleet = Fleet(vehicles, say, ended)
            try:
                _fly(fleet, args, missions_at)
            except BaseException as trouble:
                error = _tell(trouble)
                left = fleet.make_safe()
                for name, what in left.items():
                    say(f"{name} {what}")
                if not isinstance(trouble, VehicleError | KeyboardInterrupt):
                    raise
    except VehicleError as trouble:
        error = _tell(trouble)
    finally:
        report = _report(args, vehicles, error, left)
        for vehicle in vehicles:
            vehicle.close()
    if args.json:
        print(json.dumps(report | {"seconds": round(time.monotonic() - began_s, 1)}))
    return 130 if ended else 0 if error is None else 1


def _fly(
    fleet: Fleet,
    args: argparse.Namespace,
    missions_at: Callable[[Vec3], Sequence[tuple[MissionItem, ...]]] | None,
) -> None:
    """Run the steps in order."""
    if missions_at is not None:
        fleet.wait_for_home()
        fleet.upload(missions_at(fleet.vehicles[0].home))
    if args.takeoff is not None:
        fleet.take_off(args.takeoff)
    if args.start:
        fleet.start()
        if args.scenario is not None:
            fleet.gather()
        if args.wait or args.land:
            fleet.wait()
    if args.land:
        fleet.land()


def _tell(trouble: BaseException) -> str:
    """Print why the command ends. A closed terminal must not prevent the steps that follow."""
    error = str(trouble) or "interrupted"
    with contextlib.suppress(OSError):
        print(f"ground-tools fly: {error}", file=sys.stderr, flush=True)
    return error


def _check(args: argparse.Namespace) -> None:
    """Check the options. Raises ConfigError if one is invalid or options do not fit together."""
    if not (args.mission or args.scenario or args.takeoff is not None or args.start or args.land):
        raise ConfigError("there is nothing to do; give --mission, --scenario, --takeoff, --start or --land")
    if len(set(args.address)) < len(args.address):
        raise ConfigError("ADDRESS: an address is given twice; allowed: each address once")
    if args.takeoff is not None and not 1.0 <= args.takeoff <= 500.0:
        raise ConfigError(f"--takeoff: {args.takeoff:g} is out of range; allowed: 1 to 500 (m)")
    if args.wait and not args.start:
        raise ConfigError("--wait is allowed only with --start")
    if args.seed < 0:
        raise ConfigError(f"--seed: {args.seed} is out of range; allowed: 0 or more")


def _missions(args: argparse.Namespace) -> Callable[[Vec3], Sequence[tuple[MissionItem, ...]]] | None:
    """The missions as a function of the first vehicle's home. Checks the files before any connection."""
    count = len(args.address)
    if args.mission is not None:
        if len(args.mission) != count:
            raise ConfigError(
                f"--mission: {len(args.mission)} files for {count} vehicles; allowed: one for each vehicle"
            )
        read = [missions.load(path) for path in args.mission]
        return lambda _: read
    if args.scenario is None:
        return None
    if not args.scenario.exists():
        raise ConfigError(f"--scenario: {args.scenario}: no such file; see config/scenarios for examples")
    scenario = scenario_file.load(args.scenario)
    paths = len(paths_of(scenario, args.seed))
    if paths != count:
        raise ConfigError(
            f"--scenario: {args.scenario}: {paths} aircraft for {count} vehicles; "
            "allowed: one aircraft for each vehicle"
        )
    missions.scenario_missions(scenario, args.seed, (0.0, 0.0, 0.0))  # Errors show at any origin.
    return lambda home: missions.scenario_missions(scenario, args.seed, home)


def _introduction(vehicle: Vehicle, address: str) -> str:
    where = "on the ground" if vehicle.on_ground else f"in the air at {vehicle.height_m:.1f} m"
    armed = "armed" if vehicle.armed else "disarmed"
    kind = f"{vehicle.firmware.value}, system {vehicle.system_id}"
    return f"{vehicle.name}: {address}, {kind}, {where}, {armed}, {vehicle.mode}"


def _report(
    args: argparse.Namespace, vehicles: Sequence[Vehicle], error: str | None, left: dict[str, str]
) -> dict[str, object]:
    """The object that --json prints."""
    return {
        "ok": error is None,
        "error": error,
        "vehicles": [
            {
                "address": address,
                "firmware": vehicle.firmware.value,
                "system_id": vehicle.system_id,
                "mode": vehicle.mode,
                "armed": vehicle.armed,
                "on_ground": vehicle.on_ground,
                "height_m": vehicle.height_m,
                "left": left.get(vehicle.name),
            }
            for address, vehicle in zip(args.address, vehicles, strict=False)
        ],
    }
