"""Work in parallel processes."""

from __future__ import annotations

import io
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Generator

import pytest
from rich.console import Console

import ground_tools.__main__
from companion.errors import ConfigError
from ground_tools.common.workers import in_parallel, rounds_in_parallel


def square(number: int) -> int:
    return number * number


def killed(number: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_every_item_comes_with_its_result():
    assert sorted(in_parallel(square, range(5), 2, Console())) == [(n, n * n) for n in range(5)]
    assert list(in_parallel(square, range(3), 1, Console())) == [(n, n * n) for n in range(3)]
    assert list(in_parallel(square, (), 2, Console())) == []


def sums(numbers: list[int], rounds: int) -> Generator[list[int], list[int], int]:
    total = 0
    for _ in range(rounds):
        total += sum((yield numbers))
    return total


@pytest.mark.parametrize("processes", [1, 3])
def test_works_in_rounds_receive_their_own_results(processes: int):
    works = [sums([1, 2], 3), sums([], 2), sums([5], 1), sums([1], 0)]
    found = dict(rounds_in_parallel(square, works, processes, Console()))
    assert found == {0: 15, 1: 0, 2: 25, 3: 0}


def test_a_worker_that_is_killed_in_a_round_is_reported():
    with pytest.raises(ConfigError, match="a worker process was killed"):
        list(rounds_in_parallel(killed, [sums([1], 1)], 2, Console()))


def test_a_killed_worker_is_reported():
    with pytest.raises(ConfigError, match="a worker process was killed"):
        list(in_parallel(killed, range(3), 2, Console()))


def wrong(number: int) -> int:
    if number == 0:
        raise ConfigError("number 0 is wrong")
    time.sleep(600)
    return number


def test_an_error_in_one_item_ends_all():
    """A thread of the pool that outlived it would race with the end of the interpreter, which then prints a
    traceback."""
    before = threading.enumerate()
    with pytest.raises(ConfigError, match="number 0 is wrong"):
        list(in_parallel(wrong, range(5), 2, Console()))
    assert multiprocessing.active_children() == []
    assert [thread.name for thread in threading.enumerate() if thread not in before] == []


def test_ctrl_c_waits_until_a_result_is_stored():
    """Otherwise it would end the caller's loop and not the pool, and nothing would be said about what is
    kept."""
    words, stored = Console(file=io.StringIO()), []
    before = signal.getsignal(signal.SIGINT)

    def store_all() -> None:
        for _, result in in_parallel(square, range(50), 2, words):
            signal.raise_signal(signal.SIGINT)
            stored.append(result)

    with pytest.raises(KeyboardInterrupt):
        store_all()
    assert len(stored) == 1
    assert "Interrupted. With --out, finished flights are kept" in words.file.getvalue()
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize(("given", "used"), [(None, "1"), ("3", "3")])
def test_numpy_multiplies_in_one_thread_unless_told_otherwise(monkeypatch, given, used):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    if given is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", given)
    found = []
    monkeypatch.setattr(
        ground_tools.__main__, "start", lambda _: found.append(os.environ["OPENBLAS_NUM_THREADS"]) or 0
    )
    ground_tools.__main__.main()
    assert found == [used]
