"""Work in parallel processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time

import pytest
from rich.console import Console

from companion.errors import ConfigError
from ground_tools.workers import in_parallel


def square(number: int) -> int:
    return number * number


def killed(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_every_item_comes_with_its_result():
    assert sorted(in_parallel(square, range(5), 2, Console())) == [(n, n * n) for n in range(5)]
    assert list(in_parallel(square, (), 2, Console())) == []


def test_a_worker_that_is_killed_is_said():
    with pytest.raises(ConfigError, match="a worker process was killed"):
        list(in_parallel(killed, range(3), 2, Console()))


def wrong(number: int) -> int:
    if number == 0:
        raise ConfigError("number 0 is wrong")
    time.sleep(600)
    return number


def test_what_is_wrong_with_one_ends_all():
    with pytest.raises(ConfigError, match="number 0 is wrong"):
        list(in_parallel(wrong, range(5), 2, Console()))
    for child in multiprocessing.active_children():
        child.join(30)
        assert child.exitcode is not None
