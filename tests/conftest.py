"""How the suite is spread over the workers of pytest-xdist, and what holds for all tests."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from companion.avoidance import kernels

settings.register_profile("no wall clock", deadline=None)
settings.load_profile("no wall clock")


def pytest_configure(config: pytest.Config) -> None:
    """Keep the bytecode of modules, whatever the environment says, and the order of the files.

    Without bytecode every worker, and every process that a test starts, compiles the same hundreds of modules
    again. pytest-xdist would begin with the files of many tests, and end with those of few long ones, during
    which other workers idle.
    """
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    if hasattr(config.option, "loadscopereorder"):  # of pytest-xdist
        config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A file of real processes, which wait, to every three that compute; many small ones come last."""
    files = dict.fromkeys(item.path for item in items)
    waiting = [file for file in files if file.parent.name == "integration"]
    computing = [file for file in reversed(files) if file not in waiting]
    turn = {file: 3 * n - 0.5 for n, file in enumerate(waiting)}
    turn |= {file: float(n) for n, file in enumerate(computing)}
    items.sort(key=lambda item: turn[item.path])


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Two more than cores, which are free while others wait."""
    return len(os.sched_getaffinity(0)) + 2


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(config: pytest.Config) -> None:
    """Compile once what in a fresh clone all workers, and the processes that they start, would compile.

    While one core compiles the kernels, another one compiles the tests to bytecode, by collecting them.
    """
    collecting = None
    if not any(Path(kernels.__file__).parent.glob("__pycache__/*/")):
        command = [
            sys.executable,
            "-m",
            "pytest",
            "--collect-only",
            "-qq",
            "-p",
            "no:cacheprovider",
            *config.args,
        ]
        collecting = subprocess.Popen(
            command, cwd=config.invocation_params.dir, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
    from ground_tools.campaign import cells  # takes a second, which the workers do not need to spend

    kernels.warm_up()
    cells.fly(cells.Cell(generator="S2", aircraft=3), [1])
    if collecting is not None:
        collecting.wait()


@pytest.fixture
def hangup_ends() -> Iterator[None]:
    """SIGHUP ends this process and those that it starts, though the tests may run under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)
