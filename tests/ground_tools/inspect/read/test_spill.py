"""Rows in temporary files: the same values as in memory, released memory, and a full disk."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from companion.errors import ConfigError
from companion.event_record import Step
from companion.events import GlobalPosition
from ground_tools.inspect.read import facts
from ground_tools.inspect.read.facts import gather
from ground_tools.inspect.read.spill import Spill, release, spilled

SIZE = 500_000


def _resident_mb() -> float:
    words = Path("/proc/self/statm").read_text().split()
    return int(words[1]) * 4096 / 1e6


def _blocks() -> Iterator[np.ndarray]:
    for at in range(0, SIZE, 1000):
        yield np.arange(3.0 * at, 3.0 * (at + 1000)).reshape(-1, 3)


def test_blocks_come_back_as_one_table() -> None:
    table = spilled(_blocks(), columns=3)
    assert table.shape == (SIZE, 3)
    assert (table.ravel() == np.arange(3.0 * SIZE)).all()


def test_released_rows_take_no_memory_and_can_be_read_again() -> None:
    table = spilled(_blocks(), columns=3)
    before = _resident_mb()
    total = sum(float(table[at : at + 1000].sum()) for at in range(0, SIZE, 1000))
    assert _resident_mb() - before > 10.0, "12 MB were not read"
    release(table[5:, 1])  # a view is sufficient
    assert _resident_mb() - before < 2.0
    assert sum(float(table[at : at + 1000].sum()) for at in range(0, SIZE, 1000)) == total


def test_a_single_block_and_none_stay_in_memory() -> None:
    one = np.ones((4, 3))
    assert spilled(iter([one]), columns=3) is one
    assert spilled(iter([]), columns=3).shape == (0, 3)
    release(one)
    assert (one == 1.0).all()


def _fixes(count: int) -> Iterator[Step]:
    for index in range(count):
        # Every third fix comes twice at the same time; the last one counts.
        for height in (0.0, 1.0) if index % 3 == 0 else (2.0,):
            fix = GlobalPosition(
                time_boot_s=0.1 * index,
                lat_deg=47.0 + 1e-6 * index,
                lon_deg=8.0,
                alt_msl_m=500.0 + height,
                height_above_home_m=height,
                velocity_ned_mps=(1.0, 2.0, float(index)),
            )
            yield Step(now_s=0.1 * index, events=(fix,), commands=())


def test_fixes_of_a_long_flight_are_those_of_one_kept_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = gather(_fixes(1000)).fixes
    monkeypatch.setattr(facts, "BLOCK", 10)
    long = gather(_fixes(1000)).fixes
    assert not isinstance(kept.base.base, np.memmap)
    assert isinstance(long.base.base, np.memmap)
    assert kept.shape == (1000, 8)
    assert (long == kept).all()


def test_a_full_disk_is_reported_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with Path("/dev/full").open("wb", buffering=0) as full:
        monkeypatch.setattr(tempfile, "TemporaryFile", lambda: full)
        with pytest.raises(ConfigError, match=r"a temporary file cannot be written: No space left.*TMPDIR"):
            Spill(3).write(np.zeros((10, 3)).data)
