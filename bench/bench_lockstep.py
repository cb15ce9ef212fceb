"""Lock-step simulation through real bytes, one core: simulated seconds per second, and where the time goes.

Each run is repeated, and the least CPU time of each tick counts.
"""

from __future__ import annotations

import cProfile
import pstats
import time
from itertools import pairwise

import msgspec

from bench.measuring.figures import least_of_each, target
from companion.avoidance import kernels
from sitl_mocks.encounters import scenario_file
from sitl_mocks.encounters.lockstep import TICK_S, fly
from sitl_mocks.encounters.scenario_file import Scenario

SECONDS = 20.0
RUNS = 5
TARGET, OF = 60.0, 5
"""Target speed as a multiple of real time, and the number of aircraft for which it applies."""
PARTS = {
    "mock vehicle: fly and send": ("sitl_mocks/vehicle/mock_vehicle.py", "advance"),
    "mock vehicle: receive": ("sitl_mocks/vehicle/mock_vehicle.py", "receive"),
    "companion: MAVLink in": ("companion/system.py", "receive"),
    "companion: step and MAVLink out": ("companion/system.py", "tick"),
    "of which the core": ("companion/core.py", "step"),
    "air": ("sitl_mocks/air/ether.py", "transmit"),
}


def tick_times(scenario: Scenario) -> list[float]:
    """CPU time (s) of every tick of a run."""
    at = [time.process_time()]
    fly(scenario, 1, watch=lambda _: at.append(time.process_time()))
    return [after - before for before, after in pairwise(at)]


def main() -> None:
    """Print the tables."""
    kernels.warm_up()
    scenario = msgspec.structs.replace(scenario_file.DEFAULT, duration_s=SECONDS)
    print(f"{'aircraft':>10}{'CPU s':>10}{'times real time':>18}")
    for aircraft in (2, 5, 10):
        fleet = msgspec.structs.replace(scenario, aircraft=aircraft)
        took = least_of_each(tick_times(fleet) for _ in range(RUNS))
        times = len(took) * TICK_S / sum(took)
        print(f"{aircraft:10}{sum(took):10.2f}{times:18.1f}", flush=True)
        if aircraft == OF:
            reached = times
    target(f"{OF} aircraft", reached, "times real time", least=TARGET)
    profile = cProfile.Profile()
    profile.runcall(fly, scenario, 1)
    stats = pstats.Stats(profile)
    total = stats.total_tt  # type: ignore[attr-defined]
    print("\nshare of the run time, 5 aircraft (profiled)")
    for name, (file, function) in PARTS.items():
        spent = sum(
            entry[3]
            for (path, _, called), entry in stats.stats.items()  # type: ignore[attr-defined]
            if path.endswith(file) and called == function
        )
        print(f"{name:34}{100 * spent / total:6.1f} %")


if __name__ == "__main__":
    main()
