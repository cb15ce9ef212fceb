"""Worker processes and the signals that end them."""

from __future__ import annotations

import multiprocessing
import signal
import time
from pathlib import Path

import pytest

from sitl_mocks.worker_pool import interrupts_held, worker_pool


def write_later(path: Path) -> None:
    time.sleep(3.0)
    path.touch()


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
