"""Worker processes and the signals that end them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import struct
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from companion.errors import ConfigError
from sitl_mocks.worker_pool import interrupts_held, worker_pool
from tests.support.waiting import until


def write_later(path: Path) -> None:
    time.sleep(3.0)
    path.touch()


def begin_a_result(path: Path) -> None:
    """Send the first part of a result, as a worker does that is ended while it sends a long one."""
    results = sys._getframe(1).f_locals["result_queue"]
    os.write(results._writer.fileno(), struct.pack("!i", 1000))
    path.touch()
    time.sleep(600.0)


@pytest.mark.timeout(60)
def test_the_rest_of_a_result_is_not_waited_for(tmp_path: Path) -> None:
    def work() -> None:
        with worker_pool(1) as pool:
            with interrupts_held():
                pool.submit(begin_a_result, tmp_path / "begun")
            until((tmp_path / "begun").exists, "the first part", 50.0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize("gone", ["_result_queue", "_writer"])
def test_another_kind_of_pool_is_refused_before_work_begins(
    monkeypatch: pytest.MonkeyPatch, gone: str
) -> None:
    """Without that attribute, a worker that is ended while it sends a result would hang the parent."""

    class Renamed(ProcessPoolExecutor):
        def __getattribute__(self, name: str) -> Any:
            if name == "_result_queue":
                if gone == name:
                    raise AttributeError(f"no attribute {name!r}")
                return object()
            return super().__getattribute__(name)

    monkeypatch.setattr("sitl_mocks.worker_pool.ProcessPoolExecutor", Renamed)
    with (
        pytest.raises(ConfigError, match=rf"^worker processes cannot be used with Python 3.*{gone}.*earlier"),
        worker_pool(1),
    ):
        raise AssertionError("work has begun")
    assert multiprocessing.active_children() == []


def test_each_worker_calls_the_initializer_and_ignores_ctrl_c(tmp_path: Path) -> None:
    with worker_pool(1, Path.touch, tmp_path / "begun") as pool:
        assert pool.submit(signal.getsignal, signal.SIGINT).result() is signal.SIG_IGN
    assert (tmp_path / "begun").exists()


def killed() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_killed_worker_is_reported() -> None:
    with pytest.raises(ConfigError, match="a worker process was killed"), worker_pool(1) as pool:
        pool.submit(killed).result()
    assert multiprocessing.active_children() == []


def test_a_second_ctrl_c_does_not_make_the_pool_wait_for_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes while the first one ends the workers."""
    children = multiprocessing.active_children

    def interrupted() -> list[multiprocessing.process.BaseProcess]:
        signal.raise_signal(signal.SIGINT)
        return children()

    def work() -> None:
        with worker_pool(1) as pool:
            with interrupts_held():
                pool.submit(write_later, tmp_path / "written")
            monkeypatch.setattr(multiprocessing, "active_children", interrupted)
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert children() == []
    assert list(tmp_path.iterdir()) == []


def test_an_ignored_signal_does_not_take_the_place_of_one_that_interrupts() -> None:
    """A shell without job control lets its background processes ignore Ctrl-C. A thread of a library takes it
    while the main thread blocks it."""
    begin = threading.Event()

    def press() -> None:
        begin.wait()
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)

    def hold() -> None:
        with interrupts_held():
            begin.set()
            library.join()
            signal.raise_signal(signal.SIGTERM)

    library = threading.Thread(target=press)
    library.start()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            hold()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
