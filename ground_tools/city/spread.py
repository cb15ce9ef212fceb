"""Flies city runs in parallel: in processes of this machine, or on a Ray cluster.

A run is the smallest unit of work. One city is not split over workers; docs/city.md says how many aircraft
one process holds.
"""

from __future__ import annotations

import argparse
import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Final, TypeVar

import numba
import numpy as np
from rich.console import Console

from ground_tools.city.cells import CHANNEL, POLICY, ROOTS, City, fly
from ground_tools.city.traffic.demand import Demand
from ground_tools.common import provenance
from ground_tools.common.cluster import on_ray
from ground_tools.common.run_options import add_ray, processes_unless_ray
from ground_tools.common.workers import in_parallel

Item = TypeVar("Item")
Result = TypeVar("Result")

DATA: Final = (CHANNEL, POLICY, "config/regions/us.toml", "config/regions/eu.toml")
"""Data files on which runs depend, by their paths in the checkout."""
_THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_SMALL: Final = City(demand=Demand(per_km2=3.0, north_m=1000.0, east_m=1000.0), duration_s=10.0, settle_s=0.0)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options `--jobs` and `--ray`."""
    parser.add_argument("--jobs", type=int, metavar="N", help="runs at the same time (default: one per core)")
    add_ray(parser)


def jobs_of(args: argparse.Namespace) -> int | None:
    """Number of runs at the same time; None on a cluster, which uses all of its CPUs.

    Raises:
        ConfigError: the number is out of range, or both options are given.
    """
    return processes_unless_ray(args.jobs, args.ray, "jobs")


def in_any_order(
    function: Callable[[Item], Result], items: Sequence[Item], args: argparse.Namespace, words: Console
) -> Iterator[tuple[Item, Result]]:
    """Yield each item with its result, in the order in which they finish.

    Args:
        function: the work for one item, a top-level function of a module.
        args: options of `add_options`.
        words: console for messages about lost workers and about Ctrl-C.

    Raises:
        ConfigError: an option is wrong, the cluster cannot be used, or a worker was killed from outside.
    """
    jobs = jobs_of(args)
    # A policy's matrices are small: with several NumPy threads, which wait for each other, it took four times
    # the CPU time. Worker processes obey these variables. A single worker runs in this process, whose NumPy
    # has read them before.
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    if jobs is not None:
        return in_parallel(function, items, jobs, words)
    return on_ray(function, items, args.ray, state, words)


def state() -> str:
    """All software and data on which runs depend, as text, equal on all nodes of a cluster that give the same
    runs. Also compiles the loop once, so that the cached result serves the other workers of the machine."""
    fly(_SMALL, 1)
    now = provenance.now("", ROOTS, DATA, ())
    software = hashlib.sha256(repr((now.sources, now.data)).encode()).hexdigest()[:12]
    return f"city {software}, numba {numba.__version__}, numpy {np.__version__}"
