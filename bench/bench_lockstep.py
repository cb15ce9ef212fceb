"""Lock-step simulation through real bytes, one core: simulated seconds per second, and where the time goes.

Target: at least 20 times real time for 5 aircraft at flight rates.
"""

from __future__ import annotations

import cProfile
import pstats
import time

import msgspec

from companion.avoidance import kernels
from sitl_mocks.encounters import scenario_file
from sitl_mocks.encounters.lockstep import TICK_S, fly

SECONDS = 60.0
PARTS = {
    "mock vehicle: fly and send": ("sitl_mocks/vehicle/mock_vehicle.py", "advance"),
    "mock vehicle: receive": ("sitl_mocks/vehicle/mock_vehicle.py", "receive"),
    "companion: MAVLink in": ("companion/system.py", "receive"),
    "companion: step and MAVLink out": ("companion/system.py", "tick"),
    "of which the core": ("companion/core.py", "step"),
    "air": ("sitl_mocks/air/ether.py", "transmit"),
}


def main() -> None:
    """Print the tables."""
    kernels.warm_up()
    scenario = msgspec.structs.replace(scenario_file.DEFAULT, duration_s=SECONDS)
    print(f"{'aircraft':>10}{'CPU s':>10}{'times real time':>18}")
    for aircraft in (2, 5, 10):
        fleet = msgspec.structs.replace(scenario, aircraft=aircraft)
        began = time.process_time()
        ticks = len(fly(fleet, 1).time_s)
        took = time.process_time() - began
        print(f"{aircraft:10}{took:10.2f}{ticks * TICK_S / took:18.1f}")
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
