"""CPU time of one step of the core, with 20 neighbours heard once a second.

Steps with a decision (five a second) and steps that only repeat the command are timed separately. The same
flight is flown several times, and the least CPU time of each step counts.
"""

from __future__ import annotations

import math
import time

import numpy as np

from bench.measuring.figures import least_of_each, target
from bench.measuring.place import FRAME
from companion.authority.table import HOLDING
from companion.avoidance import kernels
from companion.config import Config, FlightConfig, IdentityConfig, TrajectoryFile, Waypoint
from companion.core import Companion
from companion.events import (
    Decision,
    Event,
    Firmware,
    FlightMode,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    Landed,
    LandedState,
    RemoteIdHeard,
    VehicleTime,
)
from companion.remote_id.messages import BasicId, IdType, Location, Status, UaType

UTC_S = 1_767_225_600.0
NEIGHBOURS = 20
SECONDS = 60
FLIGHTS = 10
MOST_MS = 0.2
"""Target of the median step with a decision."""


def own_events(now_s: float, *, slow: bool) -> list[Event]:
    """Events from the autopilot: its position ten times a second, everything else once."""
    lat, lon, _ = FRAME.to_geodetic(3.0 * now_s, 0.0, 0.0)
    events: list[Event] = [
        GlobalPosition(
            time_boot_s=now_s,
            lat_deg=lat,
            lon_deg=lon,
            alt_msl_m=450.0,
            height_above_home_m=50.0,
            velocity_ned_mps=(3.0, 0.0, 0.0),
        )
    ]
    if slow:
        fix = GnssFix(
            fix_type=3,
            lat_deg=lat,
            lon_deg=lon,
            alt_msl_m=450.0,
            alt_ellipsoid_m=497.0,
            horizontal_accuracy_m=1.0,
        )
        heartbeat = Heartbeat(
            system_id=1,
            firmware=Firmware.ARDUPILOT,
            vehicle_type=2,
            custom_mode=4,
            mode=FlightMode.EXTERNAL,
            armed=True,
        )
        time_of_day = VehicleTime(time_boot_s=now_s, utc_s=UTC_S + now_s)
        events += [fix, heartbeat, LandedState(landed=Landed.IN_AIR), time_of_day]
    return events


def heard(number: int, now_s: float, neighbours: int = NEIGHBOURS) -> RemoteIdHeard:
    """A neighbour that stays on a ring of 150 m around the aircraft, and reports a course to its middle."""
    angle = 2.0 * math.pi * number / neighbours
    lat, lon, _ = FRAME.to_geodetic(3.0 * now_s + 150.0 * math.cos(angle), 150.0 * math.sin(angle), 0.0)
    return RemoteIdHeard(
        transport="wifi",
        address=f"a{number}",
        messages=(
            BasicId(
                id_type=IdType.SERIAL_NUMBER,
                ua_type=UaType.HELICOPTER_OR_MULTIROTOR,
                uas_id=f"UAS{number}",
            ),
            Location(
                status=Status.AIRBORNE,
                lat_deg=lat,
                lon_deg=lon,
                alt_geodetic_m=497.0,
                direction_deg=(math.degrees(angle) + 180.0) % 360.0,
                speed_mps=3.0,
                vertical_speed_mps=0.0,
                horizontal_accuracy_m=3.0,
                timestamp_s=round(now_s % 3600.0, 1),
            ),
        ),
    )


def flight() -> list[tuple[float, list[Event]]]:
    """Time and events of every step of a flight."""
    steps = []
    for tick in range(20 * SECONDS):
        now_s = 0.05 * tick
        events = own_events(now_s, slow=tick % 20 == 0) if tick % 2 == 0 else []
        events += [heard(number, now_s) for number in range(NEIGHBOURS) if tick % 20 == number]
        steps.append((now_s, events))
    return steps


def companion() -> Companion:
    """The core, on a path to the north."""
    far = FRAME.to_geodetic(3000.0, 0.0, 0.0)
    path = TrajectoryFile(
        altitude="msl",
        waypoint=(
            Waypoint(t_s=0.0, lat_deg=FRAME.lat_deg, lon_deg=FRAME.lon_deg, alt_m=450.0),
            Waypoint(t_s=1000.0, lat_deg=far[0], lon_deg=far[1], alt_m=450.0),
        ),
    )
    flies = FlightConfig(use="fly", take_in_flight=True)
    return Companion(Config(identity=IdentityConfig(uas_id="BENCH"), flight=flies, path=path))


def fly(steps: list[tuple[float, list[Event]]]) -> tuple[list[float], list[float]]:
    """CPU time (s) of each step that decided, and of each that did not."""
    core = companion()
    deciding, others = [], []
    for now_s, events in steps:
        began = time.thread_time()
        commands = core.step(now_s, events)
        took = time.thread_time() - began
        if core.state in HOLDING and now_s > 5.0:
            (deciding if any(isinstance(c, Decision) for c in commands) else others).append(took)
    return deciding, others


def main() -> None:
    """Print the table."""
    kernels.warm_up()
    steps = flight()
    flown = [fly(steps) for _ in range(FLIGHTS)]
    print(f"{'step':34}{'count':>8}{'median us':>12}{'p99 us':>10}{'of 50 ms':>10}")
    for number, name in enumerate(("with a decision, 20 neighbours", "without a decision")):
        took = least_of_each(kinds[number] for kinds in flown)
        median, p99 = np.percentile(took, [50, 99]) * 1e6
        print(f"{name:34}{len(took):8}{median:12.0f}{p99:10.0f}{median / 500:9.2f}%")
        if number == 0:
            target("deciding step, median", median / 1e3, "ms", most=MOST_MS)


if __name__ == "__main__":
    main()
