"""A city: simulated time per CPU time on one core, by number of aircraft, and memory."""

from __future__ import annotations

import resource
import sys
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from bench.measuring.figures import target
from ground_tools.city.cells import City, simulation_of
from ground_tools.city.traffic.demand import Demand

_PER_KM2 = 10.0
_NUMBERS = (100, 1_000, 5_000)
_TARGETS = {1_000: 20.0, 10_000: 1.0}
_FLOWN_S = 20.0
_SETTLED_S = 4.0


def main(numbers: tuple[int, ...] = _NUMBERS) -> None:
    """Print the table. The first seconds, in which all aircraft appear, are not measured."""
    table = Table(title=f"A city of {_PER_KM2:g} aircraft per square kilometre, policy and channel, one core")
    for head in ("aircraft", "times real time", "us per aircraft and second", "MiB in all"):
        table.add_column(head, justify="right")
    ratios = {}
    for number in numbers:
        side_m = 1000.0 * float(np.sqrt(number / _PER_KM2))
        demand = Demand(per_km2=_PER_KM2, north_m=side_m, east_m=side_m)
        run, _ = simulation_of(City(demand=demand, duration_s=_SETTLED_S + _FLOWN_S), 1)
        run.fly(_SETTLED_S)
        began = time.process_time()
        run.fly(_FLOWN_S)
        took = time.process_time() - began
        ratios[number] = _FLOWN_S / took
        each = f"{1e6 * took / _FLOWN_S / number:.1f}"
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        table.add_row(f"{number:,}", f"{_FLOWN_S / took:.1f}", each, f"{memory:,.0f}")
    Console().print(table)
    for number, ratio in ratios.items():
        if number in _TARGETS:
            target(f"{number:,} aircraft", ratio, "times real time", least=_TARGETS[number])


if __name__ == "__main__":
    main(tuple(int(word) for word in sys.argv[1:]) or _NUMBERS)
