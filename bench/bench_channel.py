"""The radio channel: time of the equations, speed of the packet simulation, growth with the fleet.

The cost should grow nearly linearly with the number of links.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from bench.measuring.figures import target
from sitl_mocks.channel.equations.analytic import Analytic, Fleet, fixed_mode, system_delay_s
from sitl_mocks.channel.link_budget import all_links, draw_positions, near_links
from sitl_mocks.channel.packets.simulation import simulate
from sitl_mocks.channel.packets.timing import PAPER, REAL, Assumptions
from sitl_mocks.channel.parameters import MODES, ChannelParameters

REPEATS = 7
SECONDS = 100.0
FLEETS = (10, 30, 100, 300, 1000, 3000, 10_000)
DENSITIES = (1.0, 10.0)
"""Aircraft per square kilometre."""
MOST_MS, LEAST_TIMES = 50.0, 100.0
"""Targets: time to compute the system delay of 10 aircraft in 1,000 environments; speed of the packet
simulation of 10 aircraft, in multiples of real time."""
BEST_RATES = {"ble4": 9, "ble5": 10, "wifi": 10}


def cpu_s(work: Callable[[], object], repeats: int) -> float:
    """Median CPU time (s) of a function, over some calls."""
    took = []
    for _ in range(repeats):
        began = time.process_time()
        work()
        took.append(time.process_time() - began)
    return statistics.median(took)


def mixed(nodes: int, rng: np.random.Generator) -> Fleet:
    """A random mode, rate and Wi-Fi channel for every aircraft."""
    rates = np.zeros((nodes, len(MODES)), np.intp)
    rates[np.arange(nodes), rng.integers(len(MODES), size=nodes)] = rng.integers(1, 11, size=nodes)
    return Fleet(rates, rng.integers(3, size=nodes).astype(np.intp))


def environments(parameters: ChannelParameters, rng: np.random.Generator) -> None:
    """Time the equations for 10 aircraft in 1,000 environments at once, from positions to system delays."""
    model = Analytic(parameters)
    print(f"equations, 10 aircraft x 1,000 environments\n{'side (m)':>10}{'ms':>8}{'million links/s':>18}")
    slowest = 0.0
    for side_m in (100.0, 1000.0, 10_000.0):
        positions, fleet = draw_positions(1000, 10, side_m, rng), mixed(10_000, rng)

        def work(positions: np.ndarray = positions, fleet: Fleet = fleet) -> None:
            links = all_links(positions, parameters.propagation)
            system_delay_s(model.evaluate(links, fleet), 1000)

        work()
        took = cpu_s(work, REPEATS)
        slowest = max(slowest, took)
        print(f"{side_m:10.0f}{1000 * took:8.1f}{90_000 / took / 1e6:18.2f}")
    target("equations, slowest", 1000 * slowest, "ms", most=MOST_MS)


def packets(parameters: ChannelParameters, rng: np.random.Generator) -> None:
    """Time the packet simulation of 10 aircraft near each other, on one core."""
    print("\npacket simulation, 10 aircraft, one core")
    print(f"{'mode':>10}{'assumptions':>16}{'times real time':>18}")
    near, slowest = np.zeros((10, 10)), float("inf")
    for mode, rate in BEST_RATES.items():
        for name, assumptions in (("equations'", PAPER), ("real radios", REAL)):

            def work(fleet: Fleet, assumptions: Assumptions = assumptions) -> None:
                simulate(parameters, assumptions, near, fleet.rates, fleet.wifi_channel, SECONDS, rng)

            took = cpu_s(partial(work, fixed_mode(10, mode, rate, parameters)), 3)
            slowest = min(slowest, SECONDS / took)
            print(f"{mode:>10}{name:>16}{SECONDS / took:18.0f}")
    target("packets, slowest", slowest, "times real time", least=LEAST_TIMES)


def growth(parameters: ChannelParameters, rng: np.random.Generator) -> None:
    """Time one environment in which neighbours are found by range, from positions to delays."""
    model = Analytic(parameters)
    for density in DENSITIES:
        print(f"\nequations, {density:g} aircraft/km2, only neighbours in range")
        print(f"{'aircraft':>10}{'links':>12}{'ms':>10}{'us/link':>12}")
        for nodes in FLEETS:
            positions = draw_positions(1, nodes, 1000.0 * (nodes / density) ** 0.5, rng)[0]
            fleet = mixed(nodes, rng)
            links = near_links(positions, parameters)

            def work(positions: np.ndarray = positions, fleet: Fleet = fleet) -> None:
                model.evaluate(near_links(positions, parameters), fleet)

            work()
            count = len(links.transmitter)
            took = cpu_s(work, 3)
            print(f"{nodes:10}{count:12}{1000 * took:10.1f}{1e6 * took / max(count, 1):12.3f}")


def main() -> None:
    """Print the tables."""
    parameters, rng = ChannelParameters(), np.random.default_rng(1)
    environments(parameters, rng)
    packets(parameters, rng)
    growth(parameters, rng)


if __name__ == "__main__":
    main()
