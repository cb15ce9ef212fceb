"""Time of an avoidance decision, of its kernels, of a crowd's step, and of a campaign's flights.

`python bench/bench_avoidance.py` prints four tables. The first shows one aircraft's decision from Python: the
whole decision (table of neighbours, kernel, report on every track), and the call of the kernel alone. The
second shows half-spaces and linear programs in a compiled loop, beside RVO2-3D in C++ (-O3, float32, one
thread); the reference figures were measured on another machine and are quoted. The third shows one step of a
crowd, including the search for neighbours, beside the same reference. The fourth shows a campaign's flights:
simulated seconds per second, on one core.
"""

from __future__ import annotations

import statistics
import time

import numpy as np
from numba import njit

from bench.measuring.figures import least_cpu_s, target
from companion.avoidance import kernels
from companion.avoidance.law import Law, Neighbour, Situation
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from ground_tools.campaign import cells as campaign
from ground_tools.campaign.cells import Cell
from ground_tools.campaign.crowd import Crowd

COUNTS = (1, 5, 10, 20, 50, 100)
DECIDE_SCENES, ROUNDS, DECISIONS = 11, 40, 10
"""For `decide()`: number of scenes, rounds per scene (the fastest one counts), and decisions per round."""
MOST_US = {20: 25.0}
"""Target of the CPU time of `decide()`, by number of neighbours."""
FLIGHTS, FLIGHT_ROUNDS = {5: 20, 10: 10, 20: 5}, 10
"""Flights of a campaign, by number of aircraft, and how often each is repeated; the fastest repetition
counts."""
LEAST_RATE = {5: 45_000.0, 20: 3_500.0}
"""Target of a campaign, in simulated seconds per second, by number of aircraft."""
REFERENCE_US = {
    "sparse": {1: 0.085, 5: 0.36, 10: 0.69, 20: 1.4, 50: 3.4, 100: 10.5},
    "dense": {10: 1.3, 20: 1.9, 50: 7.0, 100: 9.6},
}
REFERENCE_STEP_MS = {1_000: 3.5, 10_000: 55.0}
"""Least time (ms) of a step with RVO2-3D, by number of aircraft; like `REFERENCE_US`, quoted from another
machine."""
ROOM_M3 = 1_000.0
"""Volume per aircraft of a crowd: so small that nearly all have more neighbours in reach than are
considered."""
STEPS = 60
SPREAD_M = {"sparse": 300.0, "dense": 60.0}
SCENES, PLANES = 200, 10_000
"""Number of scenes, and planes built in one timed call: so many that the call from Python (2 us) is
negligible."""


def scene(count: int, spread_m: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Relative positions (m) and velocities (m/s) of neighbours that do not overlap, shape (count, 3)
    each."""
    direction = rng.normal(size=(count, 3)) * [1.0, 1.0, 0.3]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    distance = rng.uniform(12.0, spread_m, (count, 1))
    return direction * distance, rng.normal(0.0, 2.0, (count, 3))


def time_decide(count: int, rng: np.random.Generator) -> tuple[float, float, float]:
    """Times of `decide()` (us): CPU time (median of the scenes), 99th percentile of the elapsed time, and CPU
    time of the kernel call alone."""
    path = Trajectory([0.0, 1000.0], [(0.0, 0.0, -50.0), (2000.0, 0.0, -50.0)])
    took, passed = [], []
    for _ in range(DECIDE_SCENES):
        law = Law(AvoidanceConfig(), LimitsConfig(), path)
        positions, velocities = scene(count, SPREAD_M["sparse"], rng)
        others = [
            Neighbour(f"uas-{i}", (p[0], p[1], p[2] - 50.0), (v[0], v[1], v[2]), 0.5, 1.5)
            for i, (p, v) in enumerate(zip(positions.tolist(), velocities.tolist(), strict=True))
        ]
        least = float("inf")
        for round_number in range(ROUNDS):
            flown = [
                Situation(t, t, (2.0 * t, 0.0, -50.0), (2.0, 0.0, 0.0), 1.5, others, -20.0, -100.0)
                for t in (0.2 * (DECISIONS * round_number + step) for step in range(DECISIONS))
            ]
            at, began = time.perf_counter(), time.process_time()
            for own in flown:
                law.decide(own)
            least = min(least, (time.process_time() - began) / DECISIONS)
            passed.append((time.perf_counter() - at) / DECISIONS)
        took.append(least)
    own = (own.position_ned_m, own.velocity_ned_mps, own.sigma_m, own.now_s, own.path_time_s, -20.0, -100.0)
    given = (
        law._table, count, own, path.arrays, law._fence, (*law._settings,),
        ((*law._state.command,), *law._state[1:]), law._history, (*law._work,),
    )  # fmt: skip

    def alone() -> None:
        for _ in range(DECISIONS):
            kernels.decide_plain(*given)

    kernel_s = least_cpu_s(alone, ROUNDS) / DECISIONS
    return statistics.median(took) * 1e6, float(np.percentile(passed, 99)) * 1e6, kernel_s * 1e6


def time_flights(aircraft: int, flights: int) -> float:
    """Simulated seconds per second of processor time."""
    cell = Cell(generator="S2", aircraft=aircraft, delay_s=(1.0, 2.0))
    campaign.fly(cell, [0])
    seeds = range(1, flights + 1)
    took = sum(least_cpu_s(lambda seed=seed: campaign.fly(cell, [seed]), FLIGHT_ROUNDS) for seed in seeds)
    return flights * campaign.duration_s(cell) / took


@njit(error_model="numpy", _nrt=False)
def _repeat(
    positions: np.ndarray,
    velocities: np.ndarray,
    planes: np.ndarray,
    scratch: np.ndarray,
    out: np.ndarray,
    repeats: int,
) -> float:
    """Compute plain ORCA `repeats` times, for one aircraft that flies north at 2 m/s and wants to
    continue."""
    total = 0.0
    count = positions.shape[0]
    for repeat in range(repeats):
        own = kernels.Vector(2.0 + 1e-9 * repeat, 0.0, 0.0)  # prevents hoisting out of the loop
        for j in range(count):
            p = kernels.Vector(positions[j, 0], positions[j, 1], positions[j, 2])
            v = kernels.minus(own, kernels.Vector(velocities[j, 0], velocities[j, 1], velocities[j, 2]))
            n, s = kernels.half_space(p, v, 10.0, 20.0, 0.2)
            kernels.put_plane(planes, j, n, kernels.dot(n, own) + 0.5 * s)
        _, found = kernels.solve(planes, 0, count, 5.0, kernels.SLACK_MPS, own, scratch)
        out[0], out[1], out[2] = found.n, found.e, found.d
        total += found.n
    return total


def time_kernel(count: int, spread_m: float, rng: np.random.Generator) -> tuple[float, float]:
    """Median time (us), over scenes, of the planes and linear programs of one aircraft; and the share of
    infeasible scenes."""
    planes, scratch = np.zeros((count, 4)), np.zeros((count, 4))
    out, took, infeasible = np.zeros(3), [], 0
    repeats = PLANES // count
    for _ in range(SCENES):
        positions, velocities = scene(count, spread_m, rng)
        _repeat(positions, velocities, planes, scratch, out, 1)
        began = time.perf_counter()
        _repeat(positions, velocities, planes, scratch, out, repeats)
        took.append((time.perf_counter() - began) / repeats)
        infeasible += bool((planes[:, 3] - planes[:, :3] @ out).max() > 1e-6)
    return statistics.median(took) * 1e6, infeasible / SCENES


def time_crowd(aircraft: int, rng: np.random.Generator) -> tuple[float, float]:
    """Least and median time (ms) of a step of a crowd that flies through the middle of a cube.

    The parameters are those of RVO2-3D's example: a radius of 1.5 m each, up to 2 m/s, a horizon of 10 s,
    steps of 0.125 s, and the 10 most urgent neighbours within 15 m. The preferred velocity is 1 m/s towards
    the opposite point.
    """
    position = (rng.random((aircraft, 3)) - 0.5) * (aircraft * ROOM_M3) ** (1 / 3)
    goal, velocity, new, took = -position, np.zeros((aircraft, 3)), np.zeros((aircraft, 3)), []
    crowd = Crowd(
        aircraft, radius_m=3.0, speed_mps=2.0, horizon_s=10.0, overlap_s=0.125, reach_m=15.0, neighbours=10
    )
    for _ in range(STEPS):
        wish = goal - position
        wish /= np.maximum(np.linalg.norm(wish, axis=1, keepdims=True), 1.0)
        began = time.perf_counter()
        crowd.step(position, velocity, wish, new)
        took.append(time.perf_counter() - began)
        velocity[:] = new
        position += 0.125 * velocity
    return min(took) * 1e3, statistics.median(took) * 1e3


def main() -> None:
    """Print the tables."""
    rng = np.random.default_rng(1)
    kernels.warm_up()
    print("decide() called from Python (us); CPU time, and the time that passed")
    print("neighbours      CPU   passed, p99   kernel alone, CPU")
    for count in COUNTS:
        least, p99, alone = time_decide(count, rng)
        print(f"{count:10d} {least:8.1f} {p99:13.1f} {alone:19.1f}")
        if count in MOST_US:
            target(f"decide(), {count} neighbours", least, "us", most=MOST_US[count])
    print("\nplanes and linear programs, float64 (median, us); RVO2-3D: published, C++ -O3, float32")
    print("scene   neighbours     here  infeasible  RVO2-3D    ratio")
    for name, reference in REFERENCE_US.items():
        for count, quoted in reference.items():
            median, infeasible = time_kernel(count, SPREAD_M[name], rng)
            print(
                f"{name:7s} {count:10d} {median:8.3f} {infeasible:10.0%} {quoted:8.3f} {median / quoted:8.2f}"
            )
    print("\none step of a crowd with its neighbour search, one core (ms); RVO2-3D: published minima")
    print("  aircraft  minimum   median  RVO2-3D    ratio")
    for aircraft, quoted in REFERENCE_STEP_MS.items():
        least, median = time_crowd(aircraft, rng)
        print(f"{aircraft:10,d} {least:8.2f} {median:8.2f} {quoted:8.1f} {least / quoted:8.2f}")
    print("\nsimulation speed of a campaign (S2, delays 1 to 2 s), simulated seconds per second on one core")
    for aircraft, flights in FLIGHTS.items():
        rate = time_flights(aircraft, flights)
        print(f"{aircraft:10d} aircraft {rate:10,.0f}", flush=True)
        if aircraft in LEAST_RATE:
            target(f"campaign, {aircraft} aircraft", rate, "simulated s/s", least=LEAST_RATE[aircraft])


if __name__ == "__main__":
    main()
