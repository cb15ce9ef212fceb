"""Settings for all tests, and the distribution of the suite over the workers of pytest-xdist."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

settings.register_profile("no wall clock", deadline=None)
settings.load_profile("no wall clock")


def pytest_configure(config: pytest.Config) -> None:
    """Apply settings to all processes: the workers and those that tests start.

    - Bytecode is written regardless of the environment. Otherwise every process would compile the same
      hundreds of modules again.
    - NumPy and PyTorch use one thread. Several would block each other by busy waiting on the shared cores.
    - SIGINT interrupts. A shell without job control lets its background processes ignore this signal.
    - The files keep their order. pytest-xdist would end with files of a few long tests, while other workers
      are idle.
    """
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(config.option, "loadscopereorder"):  # an option of pytest-xdist
        config.option.loadscopereorder = False


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Freeze the collected tests, so that the garbage collector never traverses them.

    Also collect less often than by default, because simulated flights allocate much and leave few cycles. A
    flight of `companion.runtime` calls `gc.unfreeze` at its end, after which each collection would traverse
    the whole suite; this call is therefore disabled.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.set_threshold(50_000, 20, 100)
        gc.freeze()
        gc.unfreeze = _nothing_to_unfreeze


def _nothing_to_unfreeze() -> None:
    """Replacement of `gc.unfreeze` that does nothing."""


def _waits(nodeid: str) -> bool:
    """Whether a test spends most of its time waiting for processes that it started."""
    return nodeid.startswith("tests/integration/test_")


TOGETHER = "tests/ground_tools/atmc/"
"""Folder whose files stay in one worker: the first optimizer in a process loads PyTorch's compiler."""
LONGEST = (
    "integration/test_getting_started",
    "integration/test_guard_and_fly",
    "ground_tools/test_cluster",
    "integration/test_fly",
    "viewer/test_browser",
    "test_a_companion_that_was_stopped",
    "integration/test_swarm",
)
"""The tests that wait longest on any machine. They start early, because they would otherwise end last."""
WAITING_FILES = (
    "ground_tools/test_cluster",
    "viewer/test_browser",
    "commands/test_bench_test",
    "commands/test_check",
    "commands/test_display",
    "runtime/test_flight",
    "runtime/test_troubles",
    "runtime/test_warm",
    "runtime/test_watchdog",
    "examinations/test_soak_real",
    "sitl_mocks/test_swarm_judge",
    "tests/test_bench",
)
"""Files outside `tests/integration` that spend most of their time waiting."""
MOST_WAITING = 3
"""Most workers that start with waiting tests."""
COMPILED_FIRST = ("ground_tools/campaign", "ground_tools/city")
"""Folders whose compiled functions may still be compiling while the first tests run. The cluster tests need
these functions too, but start later."""


def _unit(nodeid: str) -> str:
    """Name of the unit of tests that run one after another in one worker."""
    if _waits(nodeid):
        return nodeid
    return TOGETHER if nodeid.startswith(TOGETHER) else nodeid.partition("::")[0]


def _unit_waits(unit: str) -> bool:
    """Whether the tests of a unit leave a core idle for most of their time."""
    return _waits(unit) or any(part in unit for part in WAITING_FILES)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Order the tests: one waiting unit for every three computing units, and the many small files last."""

    def unit(item: pytest.Item) -> str:
        return _unit(item.nodeid)

    def length(name: str) -> int:
        return next((n for n, part in enumerate(LONGEST) if part in name), len(LONGEST))

    def rank(name: str) -> int:
        if name == TOGETHER or "sitl_mocks" in name:
            return 0
        if any(part in name for part in COMPILED_FIRST):
            return 2
        return 3 if "tests/companion" in name else 1

    units = list(dict.fromkeys(map(unit, items)))
    waiting = sorted(filter(_unit_waits, units), key=length)
    computing = [name for name in reversed(units) if not _unit_waits(name)]
    computing.sort(key=rank)
    turn = {name: 3 * n - 0.5 for n, name in enumerate(waiting)}
    turn |= {name: float(n) for n, name in enumerate(computing)}
    items.sort(key=lambda item: turn[unit(item)])


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One worker per core plus one for computing tests, which sometimes wait too, plus three for waiting
    tests."""
    return len(os.sched_getaffinity(0)) + 4


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """With `--dist loadfile`, distribute waiting tests one by one, to workers of their own.

    A worker receives its next unit before it finishes the present one. If every worker could receive any
    unit, computing files would queue behind waiting tests while a core is idle. A worker without units of its
    own kind takes units of the other kind.
    """
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Spread(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return _unit(nodeid)

        def _assign_work_unit(self, node: Any) -> None:
            waits = node in self.nodes[: min(MOST_WAITING, len(self.nodes) // 2)]
            own = next((unit for unit in self.workqueue if _unit_waits(unit) == waits), None)
            if own is not None:
                self.workqueue.move_to_end(own, last=False)
            super()._assign_work_unit(node)

    return Spread(config, log)


COMPILE = """
from ground_tools.campaign import cells
cells.fly(cells.Cell(generator="S2", aircraft=3), [1])
from ground_tools.city import cells
from ground_tools.city.traffic.demand import Demand
demand = Demand(pattern="inspections", per_km2=12.0, north_m=1000.0, east_m=1000.0)
cells.fly(cells.City(demand=demand, duration_s=2.0, settle_s=0.0), 2)
"""
"""A flight of a campaign and one of a city. They compile all functions that they call, unless the cache has
them."""


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Compile once what all workers and their processes would compile in a fresh clone.

    The kernels are compiled while the first worker collects the tests and thereby writes their bytecode. Then
    the other workers start, and the functions of campaign and city are compiled, which the first tests do not
    need.
    """
    if node.gateway.id != "gw1":
        return
    from companion.avoidance import kernels  # takes half a second; not for workers

    kernels.warm_up()
    compiling = subprocess.Popen([sys.executable, "-c", COMPILE], cwd=Path(__file__).parents[1])
    node.config.add_cleanup(compiling.wait)


@pytest.fixture
def hangup_ends() -> Iterator[None]:
    """Let SIGHUP end this process and those that it starts, even if the tests run under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)
