"""CPU time of the gate in one step of the loop: three events, an empty input, and the release of a setpoint.

The fence has eight edges. It is measured far from the fence, near it, and so near that every edge is checked
in every step. The last column is the part of the release, in which the gate parses a frame and judges it.
"""

from __future__ import annotations

import math
import time

import numpy as np

from bench.measuring.figures import least_of_each, target
from bench.measuring.place import FRAME
from companion.autopilot.encoders import velocity_setpoint
from companion.autopilot.wire import MavlinkWriter
from companion.config import Config, FlightConfig, IdentityConfig, LimitsConfig
from companion.events import (
    Event,
    FenceArea,
    Firmware,
    FlightMode,
    GlobalPosition,
    Heartbeat,
    Landed,
    LandedState,
)
from companion.gate.gate import Gate

STEPS, ROUNDS = 4_000, 5
MOST_US = 30.0
"""Target of the median."""


def octagon(radius_m: float) -> FenceArea:
    """A fence with eight edges around the start."""
    turns = [math.pi / 4.0 * k for k in range(8)]
    corners = [(radius_m * math.cos(turn), radius_m * math.sin(turn)) for turn in turns]
    points = tuple(FRAME.to_geodetic(*corner, 0.0)[:2] for corner in corners)
    return FenceArea(inclusion=True, points=points)


def step_events(now_s: float, place: tuple[float, float], speed_mps: float) -> list[Event]:
    """The events of a step: position, mode and landed state."""
    return [
        GlobalPosition(
            time_boot_s=now_s,
            lat_deg=place[0],
            lon_deg=place[1],
            alt_msl_m=500.0,
            height_above_home_m=50.0,
            velocity_ned_mps=(speed_mps, 0.0, 0.0),
        ),
        Heartbeat(
            system_id=1,
            firmware=Firmware.ARDUPILOT,
            vehicle_type=2,
            custom_mode=4,
            mode=FlightMode.EXTERNAL,
            armed=True,
        ),
        LandedState(landed=Landed.IN_AIR),
    ]


def measure(radius_m: float, speed_mps: float) -> tuple[list[float], list[float]]:
    """CPU time (s) of each step, and of the release in it."""
    gate = Gate(
        Config(
            identity=IdentityConfig(uas_id="BENCH"),
            flight=FlightConfig(use="fly", take_in_flight=True),
            limits=LimitsConfig(floor_height_m=10.0, ceiling_height_m=120.0),
            fence=(octagon(radius_m),),
        )
    )
    writer = MavlinkWriter(1, 191)
    places = [FRAME.to_geodetic(-0.02 * k, 0.0, 0.0)[:2] for k in range(100)]
    steps, releases = [], []
    for tick in range(STEPS):
        now_s = 0.05 * tick
        events = step_events(now_s, places[tick % 100], speed_mps)
        frame = writer.pack_payload(*velocity_setpoint((speed_mps, 0.0, 0.0), 0.0, 0, 1))
        began = time.thread_time()
        for event in events:
            gate.hear(event, now_s)
        gate.emptied(now_s)
        gate.decided(now_s)
        released_s = time.thread_time()
        left = gate.release(frame, now_s)
        ended = time.thread_time()
        if tick > 20:
            if left != frame:
                raise RuntimeError(f"the gate refused the setpoint: {gate.broken()}")
            steps.append(ended - began)
            releases.append(ended - released_s)
    return steps, releases


def main() -> None:
    """Print the table."""
    print(f"{'distance to octagonal fence':28}{'median us':>12}{'p99 us':>10}{'of 50 ms':>10}{'release':>10}")
    for name, radius_m, speed_mps in (
        ("2 km away, 3 m/s", 2000.0, 3.0),
        ("12 m away, 3 m/s", 12.0, 3.0),
        ("6 m away, 3 m/s", 6.0, 3.0),
    ):
        rounds = [measure(radius_m, speed_mps) for _ in range(ROUNDS)]
        steps, releases = (least_of_each(part) for part in zip(*rounds, strict=True))
        median, p99 = np.percentile(steps, [50, 99]) * 1e6
        share = float(np.median(releases)) * 1e6 / median
        print(f"{name:28}{median:12.1f}{p99:10.1f}{median / 500:9.3f}%{share:10.0%}")
        target(f"gate, {name}, median", median, "us", most=MOST_US)


if __name__ == "__main__":
    main()
