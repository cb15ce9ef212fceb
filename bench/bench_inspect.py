"""A run converted to a recording, figures and a report: CPU time, size and memory.

A run of 500 s with 5 aircraft is read, written and verified. A run ten times as long should need hardly more
memory. Onboard logs of a gigabyte, which repeat a short flight, are read too. Each memory figure is the peak
of a separate process (`bench.measuring.memory`).
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import msgspec

from bench.commands import big_log
from bench.measuring.figures import target
from companion import event_record
from companion.config import Config
from companion.event_record import Header, Step
from companion.events import AnyEvent, VehicleTime
from sitl_mocks.encounters import scenario_file
from sitl_mocks.encounters.lockstep import fly
from tests.support import onboard_logs

LONGER = 10
MOST_S, MOST_MB, MOST_FACTOR = 10.0, 50.0, 1.2
"""Targets: CPU time to write and verify a recording, its size, and the memory of the longer run as a multiple
of the shorter run's."""
LOG_MB, MOST_LOG_MB = 1074, 400.0
"""Size of an onboard log, and target of the memory that it needs."""
LOGS = {"copter.bin": onboard_logs.sampled_copter, "px4.ulg": onboard_logs.sampled_px4}
KINDS = ("recording", "summary", "report")


def flown(folder: Path) -> float:
    """Fly the default scenario and write its event records to `folder`. Returns its duration (s)."""
    end_s = 0.0

    def recorder(name: str, config: Config) -> Callable[[Step], None]:
        stream = (folder / f"{name}.events").open("wb")
        header = Header(aircraft=name, software="bench", config=config)
        stream.write(event_record.MAGIC + event_record.encode(header))

        def take(step: Step) -> None:
            nonlocal end_s
            end_s = step.now_s
            stream.write(event_record.encode(step))

        return take

    folder.mkdir()
    fly(scenario_file.DEFAULT, 1, record=recorder)
    return end_s


def repeated(source: Path, target: Path, length_s: float) -> None:
    """Write records of the same flight LONGER times, one after the other, to `target`."""
    target.mkdir()
    for path in source.glob("*.events"):
        with path.open("rb") as read, (target / path.name).open("wb") as written:
            written.write(event_record.MAGIC)
            for turn in range(LONGER):
                read.seek(0)
                for entry in event_record.read(read, path.name):
                    if isinstance(entry, Step):
                        written.write(event_record.encode(_later(entry, turn * length_s)))
                    elif turn == 0:
                        written.write(event_record.encode(entry))


def _later(step: Step, by_s: float) -> Step:
    def moved(event: AnyEvent) -> AnyEvent:
        if isinstance(event, VehicleTime) and event.utc_s is not None:
            return msgspec.structs.replace(event, utc_s=event.utc_s + by_s)
        return event

    return Step(now_s=step.now_s + by_s, events=tuple(map(moved, step.events)), commands=step.commands)


def cpu_s(*command: str | Path) -> tuple[float, str]:
    """CPU time (s) of a process, including its imports, and its output."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, printed


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as scratch:
        once, longer = Path(scratch) / "once", Path(scratch) / "longer"
        length_s = flown(once)
        repeated(once, longer, length_s + 0.05)
        print(
            f"{'':8}{'flown (s)':>9}{'records (MB)':>14}{'CPU (s)':>8}{'written (MB)':>14}{'peak (MB)':>11}"
        )
        peaks: dict[str, list[float]] = {kind: [] for kind in KINDS}
        for folder, times in ((once, 1), (longer, LONGER)):
            records = sum(file.stat().st_size for file in folder.glob("*.events"))
            for kind, found in peaks.items():
                path = folder / f"inspect.{'html' if kind == 'report' else 'rrd'}"
                path.unlink(missing_ok=True)
                took, printed = cpu_s(sys.executable, "-m", "bench.commands.convert_run", kind, folder, path)
                found.append(float(printed))
                size = path.stat().st_size if path.exists() else 0
                print(
                    f"{kind:9}{times * length_s:8.0f}{records / 1e6:14.1f}{took:8.1f}{size / 1e6:14.1f}"
                    f"{found[-1]:11.0f}"
                )
                if kind == "recording":
                    check, _ = cpu_s(Path(sys.executable).with_name("rerun"), "rrd", "verify", path)
                    print(f"{'  verification':31}{check:8.1f}")
                    if times == 1:
                        target("recording and verification", took + check, "s", most=MOST_S)
                        target("size of the recording", size / 1e6, "MB", most=MOST_MB)
        for kind, (first, other) in peaks.items():
            what = f"peak memory of the {kind}, {LONGER} times as long a run"
            target(what, other / first, "times that of the short run", most=MOST_FACTOR)
        for name, write in LOGS.items():
            log = Path(scratch) / name
            big_log.main(str(write(log.with_stem("flight"))), str(log), str(LOG_MB))
            for kind in ("summary", "report"):
                command = (
                    sys.executable,
                    "-m",
                    "bench.commands.convert_run",
                    kind,
                    log,
                    log.with_suffix(".html"),
                )
                took, printed = cpu_s(*command)
                print(f"{kind:17}{log.stat().st_size / 1e6:14.1f}{took:8.1f}{'':14}{float(printed):11.0f}")
                target(f"peak memory of the {kind}, {name}", float(printed), "MB", most=MOST_LOG_MB)
            log.unlink()


if __name__ == "__main__":
    main()
