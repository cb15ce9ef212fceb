"""A long onboard log needs hardly more memory than a short one."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from bench.commands import big_log
from tests.support import onboard_logs

SHORT_MB, LONG_MB = 10, 40
MOST_MORE_MB = 4.0
"""Four times the flights, each with its modes and warnings, need 1 MB more. Decoded messages, if they were
kept, would be 9 MB more, and the log 30 MB."""


def peak_mb(log: Path) -> float:
    """Peak memory of a process that reads the log."""
    command = (sys.executable, "-m", "bench.commands.convert_run", "summary", log, "-")
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


@pytest.mark.parametrize("write", [onboard_logs.sampled_copter, onboard_logs.sampled_px4])
def test_four_times_the_log_needs_hardly_more_memory(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    flight, log, peaks = write(tmp_path / "flight"), tmp_path / "log", []
    for megabytes in (SHORT_MB, LONG_MB):
        big_log.main(str(flight), str(log), str(megabytes))
        peaks.append(peak_mb(log))
    assert peaks[1] - peaks[0] < MOST_MORE_MB, peaks
