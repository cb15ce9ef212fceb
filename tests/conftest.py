"""How the suite is spread over the workers of pytest-xdist, and what holds for all tests."""

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
    """Set what holds for all processes, the workers and those that tests start.

    - The bytecode of modules is kept, whatever the environment says. Without it every process would compile
      the same hundreds of modules again.
    - NumPy and PyTorch compute in one thread. Several would wait for each other, busily, on the cores that
      the workers share.
    - SIGINT interrupts. A shell without job control has what it starts in the background ignore it.
    - The files keep their order. pytest-xdist would begin with the files of many tests, and end with those of
      few long ones, during which other workers idle.
    """
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(config.option, "loadscopereorder"):  # of pytest-xdist
        config.option.loadscopereorder = False


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is collected stays, so that the garbage collector need not look through it, now or later.

    It also looks less often than by default: simulated flights allocate much, and leave few cycles. A flight
    of `companion.runtime` unfreezes everything at its end, and each one after it would look through the whole
    suite again.
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
    """Takes the place of `gc.unfreeze`."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A file of real processes, which wait, to every three that compute; many small ones come last.

    Those of `sitl_mocks` come first: they fly no campaign, whose flight may still be being compiled.
    """
    files = dict.fromkeys(item.path for item in items)
    waiting = [file for file in files if file.parent.name == "integration"]
    computing = [file for file in reversed(files) if file not in waiting]
    computing.sort(key=lambda file: "sitl_mocks" not in file.parts)
    turn = {file: 3 * n - 0.5 for n, file in enumerate(waiting)}
    turn |= {file: float(n) for n, file in enumerate(computing)}
    items.sort(key=lambda item: turn[item.path])


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Two more than cores, which are free while others wait."""
    return len(os.sched_getaffinity(0)) + 2


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Compile once what in a fresh clone all workers, and the processes that they start, would compile.

    While the first worker collects the tests, and so compiles them to bytecode, the kernels are compiled.
    Then the others start, and the campaign's flight is compiled, which the first tests do not need.
    """
    if node.gateway.id != "gw1":
        return
    from companion.avoidance import kernels  # not in the workers: it takes half a second to load

    kernels.warm_up()
    flight = "from ground_tools.campaign import cells as c; c.fly(c.Cell(generator='S2', aircraft=3), [1])"
    compiling = subprocess.Popen([sys.executable, "-c", flight], cwd=Path(__file__).parents[1])
    node.config.add_cleanup(compiling.wait)


@pytest.fixture
def hangup_ends() -> Iterator[None]:
    """SIGHUP ends this process and those that it starts, though the tests may run under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)
