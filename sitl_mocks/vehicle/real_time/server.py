"""One mock vehicle in real time on UDP and TCP: `sitl-mocks serve`.

Only this module and `ports` use sockets, and only this module uses a clock and signals. The command prints
one line per link with its actual port ("link udpin:127.0.0.1:14550"), then "ready". At its end it prints one
JSON line with the final state of the vehicle. Stalls of the process go to standard error.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import selectors
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy

from companion.errors import ConfigError
from companion.events import Firmware
from sitl_mocks.signals import end_signals
from sitl_mocks.vehicle.firmware.behaviour import VehicleMode
from sitl_mocks.vehicle.mock_vehicle import STEP_S, MockVehicle
from sitl_mocks.vehicle.options import HOME, VehicleOptions
from sitl_mocks.vehicle.real_time.ports import Airframe, Port, open_port
from sitl_mocks.vehicle.real_time.trouble_input import TroubleInput
from sitl_mocks.vehicle.sensing import Obstacle, SensorOptions

_TRUTH_PERIOD_S = 0.1
_STALL_S = 0.25
"""A longer time without a turn is reported, as a companion reports its own stalls."""
_EXAMPLE = """examples:
  sitl-mocks serve --firmware px4 --link udpout:127.0.0.1:14540
  sitl-mocks serve --link tcpin:127.0.0.1:5760 --link udpin:127.0.0.1:0 --airborne 50 --gnss-sigma 1.5 2.5 0.1
"""


class VehicleServer:
    """A mock vehicle behind sockets. The caller passes in `now_s`, the seconds since the vehicle's start.

    Raises:
        ConfigError: a link cannot be opened. Sockets opened before it are released.
    """

    def __init__(self, options: VehicleOptions, links: list[str], rng: numpy.random.Generator) -> None:
        self.vehicle = MockVehicle(options, rng)
        self.vehicle.close_link(0)
        airframe = Airframe(self.vehicle)
        self._reboots = 0
        self._ports: list[Port] = []
        self._selector = selectors.DefaultSelector()
        try:
            for spec in links:
                self._ports.append(open_port(spec, airframe))
        except ConfigError:
            self.close()
            raise
        self._watch()

    @property
    def names(self) -> list[str]:
        """Names of the links with their actual ports."""
        return [port.name for port in self._ports]

    def wait(self, timeout_s: float) -> None:
        """Sleep until a socket can be read, at most for `timeout_s`."""
        self._selector.select(max(timeout_s, 0.0))

    def turn(self, now_s: float) -> None:
        """Fly up to `now_s`, process received bytes, send what is due."""
        self.vehicle.advance(now_s)
        for port in self._ports:
            port.receive(now_s)
        for port in self._ports:
            port.send()
        if self.vehicle.reboots != self._reboots:
            self._reboots = self.vehicle.reboots
            for port in self._ports:
                port.reboot()
        self._watch()

    def close(self) -> None:
        """Release every socket."""
        for port in self._ports:
            port.close()
        self._selector.close()

    def _watch(self) -> None:
        """Register new clients with the selector and unregister closed ones."""
        sockets = {sock.fileno(): sock for port in self._ports for sock in port.sockets()}
        watched = self._selector.get_map()
        for key in [key for key in watched.values() if sockets.get(key.fd) is not key.fileobj]:
            self._selector.unregister(key.fileobj)
        for number, sock in sockets.items():
            if number not in self._selector.get_map():
                self._selector.register(sock, selectors.EVENT_READ)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `sitl-mocks serve`."""
    parser.description = (
        "Simulates one MAVLink vehicle in real time that behaves like ArduPilot Copter or PX4. "
        "Stop it with Ctrl-C."
    )
    parser.epilog = _EXAMPLE
    add = parser.add_argument
    add(
        "--firmware",
        choices=[f.value for f in Firmware],
        default="ardupilot",
        help="autopilot to simulate (default: %(default)s)",
    )
    add(
        "--link",
        action="append",
        metavar="KIND:HOST:PORT",
        help="udpout, udpin or tcpin; may be repeated (udpin and tcpin: port 0 for any free port; "
        "default: udpout:127.0.0.1:14550)",
    )
    add("--system-id", type=int, default=1, help="MAVLink system id, 1 to 255 (default: %(default)s)")
    add(
        "--home",
        type=float,
        nargs=3,
        default=(HOME.lat_deg, HOME.lon_deg, HOME.alt_m),
        metavar=("LAT", "LON", "ALT"),
        help="home position: latitude and longitude (deg), altitude above mean sea level (m); default: "
        f"{HOME.lat_deg:g} {HOME.lon_deg:g} {HOME.alt_m:g}",
    )
    add(
        "--airborne",
        type=float,
        metavar="HEIGHT",
        help="start armed and in the air, at this height above home (m)",
    )
    add("--start", type=float, nargs=2, default=(0.0, 0.0), metavar=("NORTH", "EAST"),
        help="start position relative to home (m)")  # fmt: skip
    add(
        "--mode",
        choices=[m.value for m in VehicleMode],
        help="initial mode (default: hold if it starts in the air)",
    )
    add("--wind", type=float, nargs=2, default=(0.0, 0.0), metavar=("NORTH", "EAST"),
        help="velocity of the air (m/s); a positive NORTH blows to the north")  # fmt: skip
    add("--gnss-sigma", type=float, nargs=3, default=(0.0, 0.0, 0.0), metavar=("H", "V", "SPEED"),
        help="sigmas of the navigation errors: horizontal, vertical (m), velocity (m/s)")  # fmt: skip
    add(
        "--no-rc", action="store_true", help="no radio control is connected; ArduPilot's LOITER then descends"
    )
    add("--did", choices=["off", "enable", "require"], default="off", help="ArduPilot's Remote ID: "
        "relay its messages (enable), or also require it for arming (require)")  # fmt: skip
    add(
        "--param",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="initial value of a parameter; may be repeated",
    )
    add("--quirk", action="append", default=[], metavar="NAME=VALUE", help="change one behaviour of the "
        "firmware, for example nose_follows_velocity=false or loss_mode=hold; may be repeated")  # fmt: skip
    add("--sensor", choices=["scan", "points", "tracks", "proximity"], help="simulate a sensor that "
        "sees obstacles, and the message that it sends: OBSTACLE_DISTANCE, OBSTACLE_DISTANCE_3D, "
        "ADSB_VEHICLE, or DISTANCE_SENSOR of an ArduPilot to which it is wired")  # fmt: skip
    add("--sensor-range", type=float, default=SensorOptions().range_m, metavar="M",
        help="how far the sensor sees (default: %(default)g)")  # fmt: skip
    add("--obstacle", action="append", default=[], metavar="KIND:N,E,...",
        help="an obstacle that transmits nothing: pole:N,E, wall:N,E,N,E or aircraft:N,E,D,VN,VE,VD "
        "(m and m/s, from home, at the start); may be repeated")  # fmt: skip
    add("--seed", type=int, default=0, help="random seed of the navigation errors (default: %(default)s)")
    add("--troubles", action="store_true", help="read faults from standard input, one JSON object per line, "
        'for example {"answers": "disobeyed"} or {"gnss_lost": true}')  # fmt: skip
    add(
        "--truth",
        type=Path,
        metavar="FILE",
        help="write the true positions to this file (CSV, ten rows per second)",
    )


def options_of(args: argparse.Namespace) -> VehicleOptions:
    """Make the vehicle options from the arguments. Raises ConfigError."""
    height = args.airborne
    horizontal, vertical, speed = args.gnss_sigma
    return VehicleOptions(
        firmware=Firmware(args.firmware),
        system_id=args.system_id,
        home_lat_deg=args.home[0],
        home_lon_deg=args.home[1],
        home_alt_msl_m=args.home[2],
        airborne=height is not None,
        start_position_ned_m=(args.start[0], args.start[1], 0.0 if height is None else -height),
        start_mode=None if args.mode is None else VehicleMode(args.mode),
        rc_connected=not args.no_rc,
        parameters=_parameters(args.param),
        quirks=_quirks(args.quirk),
        did_enable=args.did != "off",
        did_require=args.did == "require",
        utc_at_zero_s=time.time(),
        wind_ned_mps=(args.wind[0], args.wind[1], 0.0),
        gnss_horizontal_sigma_m=horizontal,
        gnss_vertical_sigma_m=vertical,
        gnss_velocity_sigma_mps=speed,
        sensor=_sensor(args),
        obstacles=tuple(_obstacle(text) for text in args.obstacle),
    )


def _sensor(args: argparse.Namespace) -> SensorOptions | None:
    if args.sensor is None:
        return None
    try:
        return msgspec.convert({"message": args.sensor, "range_m": args.sensor_range}, SensorOptions)
    except msgspec.ValidationError as error:
        raise ConfigError(f"--sensor-range: {error}") from error


def _obstacle(text: str) -> Obstacle:
    kind, _, rest = text.partition(":")
    try:
        numbers = [float(part) for part in rest.split(",")]
        match kind, numbers:
            case "pole", [n, e]:
                return Obstacle(kind="pole", at_ned_m=(n, e, 0.0))
            case "wall", [n, e, to_n, to_e]:
                return Obstacle(kind="wall", at_ned_m=(n, e, 0.0), to_ned_m=(to_n, to_e, 0.0))
            case "aircraft", [n, e, d, vn, ve, vd]:
                return Obstacle(kind="aircraft", at_ned_m=(n, e, d), velocity_ned_mps=(vn, ve, vd))
    except ValueError as error:
        raise ConfigError(f"--obstacle: {text!r}: {error}") from error
    raise ConfigError(f"--obstacle: {text!r}; allowed: pole:N,E, wall:N,E,N,E or aircraft:N,E,D,VN,VE,VD")


def _parameters(given: list[str]) -> dict[str, float]:
    values = {}
    for text in given:
        name, _, value = text.partition("=")
        try:
            values[name] = float(value)
        except ValueError as error:
            raise ConfigError(f"--param: {text!r}; allowed: NAME=NUMBER") from error
    return values


def _quirks(given: list[str]) -> dict[str, object]:
    """Read quirks. A value is JSON (true, 2.5, null) or the name of a mode."""
    values: dict[str, object] = {}
    for text in given:
        name, _, value = text.partition("=")
        try:
            values[name] = json.loads(value)
        except ValueError:
            values[name] = value
    return values


def run(args: argparse.Namespace) -> int:
    """Run `sitl-mocks serve`: fly in real time until SIGINT or SIGTERM.

    Raises:
        ConfigError: an option is out of range, or a link cannot be opened.
    """
    if args.seed < 0:
        raise ConfigError(f"--seed: {args.seed} is out of range; allowed: 0 or more")
    links = args.link or ["udpout:127.0.0.1:14550"]
    with end_signals() as ended:
        server = VehicleServer(options_of(args), links, numpy.random.default_rng(args.seed))
        with contextlib.closing(server):
            for name in server.names:
                print(f"link {name}", flush=True)
            start_s, turned_s = time.monotonic(), 0.0
            print("ready", flush=True)
            troubles = TroubleInput(sys.stdin.fileno()) if args.troubles else None
            with _truth(args.truth) as truth:
                while not ended:
                    if troubles is not None:
                        troubles.read(server.vehicle.troubles)
                    now_s = time.monotonic() - start_s
                    server.wait(server.vehicle.now_s + STEP_S - now_s)
                    turns_s = time.monotonic() - start_s
                    if turns_s - turned_s > _STALL_S:
                        words = f"the program was stopped for {turns_s - turned_s:.1f} s"
                        print(f"{words}; the vehicle flew on without its links", file=sys.stderr, flush=True)
                    turned_s = turns_s
                    server.turn(turns_s)
                    truth(server.vehicle)
            print(json.dumps(_left(server.vehicle)), flush=True)
    return 0


@contextlib.contextmanager
def _truth(path: Path | None) -> Iterator[Callable[[MockVehicle], None]]:
    """Yield a function that writes a vehicle's true position, ten times a second.

    The columns are UTC (s), north, east and down (m). Without a path the function does nothing.
    """
    if path is None:
        yield lambda vehicle: None
        return
    try:
        file = path.open("w")
    except OSError as error:
        raise ConfigError(f"--truth: {path}: cannot be written: {error.strerror}") from error
    with file:
        file.write("utc_s,north_m,east_m,down_m\n")
        noted_s = -1.0

        def note(vehicle: MockVehicle) -> None:
            nonlocal noted_s
            if vehicle.now_s - noted_s >= _TRUTH_PERIOD_S:
                noted_s = vehicle.now_s
                utc_s = (vehicle.options.utc_at_zero_s or 0.0) + vehicle.now_s
                north, east, down = vehicle.position_ned_m
                file.write(f"{utc_s:.3f},{north:.3f},{east:.3f},{down:.3f}\n")

        yield note


def _left(vehicle: MockVehicle) -> dict[str, object]:
    return {
        "time_s": round(vehicle.now_s, 2),
        "position_ned_m": [round(value, 2) for value in vehicle.position_ned_m],
        "mode": vehicle.mode.value,
        "armed": vehicle.armed,
        "setpoints_received": vehicle.setpoints_received,
        "largest_setpoint_gap_s": round(vehicle.largest_setpoint_gap_s, 3),
        "setpoint_gaps_over_100ms": vehicle.setpoint_gaps_over_100ms,
    }
