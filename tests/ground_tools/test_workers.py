"""Work in parallel processes."""

from __future__ import annotations

import os
import signal

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
