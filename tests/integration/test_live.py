"""A flying companion with `inspect --live` beside it: neither bridge nor viewer reaches the flight."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from companion import event_record
from companion.runtime import clock
from tests.integration.conftest import PATIENCE_S, Child, again_after_a_stall, stalled
from tests.integration.test_companion_run import NAME, fly
from tests.support import needs

pytestmark = needs.rerun

PART_S = 3.0
TICK_S = 0.05
STALL_S = 0.5
"""A pause of this test that took so much longer than asked for shows a stall of the machine."""


def opened_by(pid: int) -> dict[Path, int]:
    """Files a process has open, and how (O_ flags)."""
    found = {}
    for link in Path(f"/proc/{pid}/fd").iterdir():
        flags = Path(f"/proc/{pid}/fdinfo/{link.name}").read_text().split("flags:\t")[1].split()[0]
        found[Path(os.readlink(link))] = int(flags, 8)
    return found


def child_of(pid: int) -> int:
    """The only process that a process started."""
    (child,) = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return int(child)


def missed(times: list[float], start_s: float, end_s: float) -> float:
    """Share of the ticks of a time that did not come."""
    came = sum(start_s <= t <= end_s for t in times)
    return max(0.0, 1.0 - came * TICK_S / (end_s - start_s))


@again_after_a_stall
def test_the_loop_keeps_its_time_while_the_viewer_is_watched_hangs_and_dies(start, tmp_path):
    vehicle, companion = fly(start, tmp_path, "ardupilot")
    companion.must_not_stall = False  # the loop goes on after a stall, and it alone is what is measured
    (folder,) = (tmp_path / "runs").iterdir()
    parts: list[tuple[float, float]] = []

    def part() -> None:
        """Measure a part of the flight in which the machine does not stall."""
        begins_s = before_s = clock.now_s()
        while before_s - begins_s < PART_S:
            time.sleep(0.1)
            now_s = clock.now_s()
            if now_s - before_s > 0.1 + STALL_S:
                begins_s = now_s
            before_s = now_s
        parts.append((begins_s, before_s))

    part()
    live: Child = start("ground_tools.cli", "inspect", folder, "--live")
    live.wait_for("live at http://127.0.0.1:")
    viewer = child_of(live.process.pid)
    files = opened_by(live.process.pid)
    assert files[folder / f"{NAME}.events"] & os.O_ACCMODE == os.O_RDONLY
    assert {path for path in files if folder in path.parents} == {folder / f"{NAME}.events"}
    part()
    os.kill(viewer, signal.SIGSTOP)
    part()
    os.kill(viewer, signal.SIGKILL)
    assert live.process.wait(PATIENCE_S) == 2
    assert "rerun's web viewer ended with exit code -9" in live.output
    part()
    assert companion.end() == 0
    assert stalled(companion.output, vehicle.output) or "fault" not in companion.output

    with (folder / f"{NAME}.events").open("rb") as stream:
        times = [
            entry.now_s for entry in event_record.read(stream, "e") if isinstance(entry, event_record.Step)
        ]
    # Steps are stamped with the same clock as the parts.
    assert times[0] < parts[0][0] < parts[-1][1] < times[-1] + 1.0
    shares = [missed(times, begins_s, ends_s) for begins_s, ends_s in parts]
    # A loop that waited for the viewer would miss the ticks of a whole part. Single ones are missed on a busy
    # machine, with a viewer and without.
    assert max(shares[1:]) < shares[0] + 0.5, f"alone, watched, hung, after it: {shares}"
