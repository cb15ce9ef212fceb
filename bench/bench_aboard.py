"""Resources that `companion run` uses: memory, processor time, start-up time, lateness of ticks.

The real process flies the mock vehicle at 20 Hz over loopback and hears 20 aircraft once a second, on a ring
of 150 m. It counts as ready when it commands its first setpoint; the kernels were compiled before. The
measurement is repeated with every core busy, at normal priority and, if this process may use it, with
real-time scheduling.
"""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.bench_core import NEIGHBOURS, heard
from bench.measuring.figures import target
from bench.measuring.memory import memory_mb
from bench.measuring.place import FRAME
from companion.radio.ether import datagrams
from companion.radio.ether.datagrams import Heard, Welcome
from companion.radio.frames_io import FrameSender, radio_address
from companion.remote_id.messages import Location

SECONDS = 20.0
SETTLE_S = 3.0
PATIENCE_S = 120.0
PRIORITY = 20
MOST_MB, MOST_CORE, MOST_READY_S = 150.0, 10.0, 5.0
"""Targets of the flight on an otherwise idle computer: resident memory (10^6 bytes), percent of one core,
start-up time."""

_PATH = f"""altitude = "home"
waypoint = [
  {{ t_s = 0.0, lat_deg = {FRAME.lat_deg}, lon_deg = {FRAME.lon_deg}, alt_m = 50.0 }},
  {{ t_s = 600.0, lat_deg = {FRAME.lat_deg + 0.01618:.5f}, lon_deg = {FRAME.lon_deg}, alt_m = 50.0 }},
]
"""
_CONFIG = """[identity]
uas_id = "BENCH"
[vehicle]
link = "udpout:127.0.0.1:{vehicle}"
[flight]
use = "fly"
trajectory = "path.toml"
take_in_flight = true
[record]
folder = "{folder}"
name = "bench"
[[radio]]
backend = "ether"
address = "127.0.0.1:{air}"
"""


class Air:
    """Replaces the simulated air: every client that joins hears each aircraft once a second."""

    def __init__(self, neighbours: int = NEIGHBOURS) -> None:
        self._neighbours = neighbours
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(1.0 / self._neighbours)
        self.port = self._socket.getsockname()[1]
        self._client: tuple[str, int] | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        senders = [FrameSender(radio_address(f"UAS{number}")) for number in range(self._neighbours)]
        began_s, number = time.monotonic(), 0
        due_s = began_s
        while not self._ended.is_set():
            try:
                self._client = self._socket.recvfrom(2048)[1]
                self._socket.sendto(datagrams.encode(Welcome(self._neighbours + 1)), self._client)
            except (TimeoutError, ConnectionError):
                pass
            if self._client is None or time.monotonic() < due_s:
                continue
            due_s += 1.0 / self._neighbours
            flown_s = time.monotonic() - began_s
            messages = heard(number, flown_s, self._neighbours).messages
            stamp_s = round(time.time() % 3600.0, 1)
            dated = tuple(
                type(m)(**{**{f: getattr(m, f) for f in m.__struct_fields__}, "timestamp_s": stamp_s})
                if isinstance(m, Location)
                else m
                for m in messages
            )
            address = radio_address(f"UAS{number}")
            for frame in senders[number].frames("wifi", dated):
                self._socket.sendto(datagrams.encode(Heard("wifi", address, frame)), self._client)
            number = (number + 1) % self._neighbours

    def close(self) -> None:
        """Stop the thread and close the socket."""
        self._ended.set()
        self._thread.join()
        self._socket.close()


@contextmanager
def process(log: Path, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run `python -m ARGUMENTS` with its output in a file and its status socket beside that file."""
    environment = os.environ | {"RUNTIME_DIRECTORY": str(log.parent)}
    command = [sys.executable, "-u", "-m", *arguments]
    with log.open("wb") as out:
        child = subprocess.Popen(command, stdout=out, stderr=out, env=environment)
        try:
            yield child
        finally:
            if child.poll() is None:
                child.terminate()
            child.wait()


def wait_for(log: Path, pattern: str) -> re.Match[str]:
    """Wait until the output in a log file matches a pattern.

    Raises:
        RuntimeError: it did not match within `PATIENCE_S`.
    """
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if found := re.search(pattern, log.read_text()):
            return found
        time.sleep(0.01)
    raise RuntimeError(f"{pattern!r} did not appear in the log:\n{log.read_text()}")


def processor_s(pid: int) -> float:
    """Processor time (s) that a process has used, from /proc/PID/stat."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def flight(folder: Path, neighbours: int) -> Iterator[tuple[int, float]]:
    """Run `companion run` with the mock vehicle; yields at its first setpoint.

    Args:
        folder: holds the logs, the status socket, and the records in the folder `runs`.
        neighbours: number of aircraft that are heard once a second.

    Yields:
        The process's id, and the seconds from its start to its first setpoint.
    """
    air = Air(neighbours)
    vehicle_log, log = folder / "vehicle.log", folder / "companion.log"
    serve = ("sitl_mocks.cli", "serve", "--firmware", "px4", "--airborne", "50", "--mode", "hold")
    try:
        with process(vehicle_log, *serve, "--link", "udpin:127.0.0.1:0"):
            port = wait_for(vehicle_log, r"link udpin:127\.0\.0\.1:(\d+)")[1]
            wait_for(vehicle_log, "ready")
            (folder / "path.toml").write_text(_PATH)
            (folder / "c.toml").write_text(_CONFIG.format(vehicle=port, air=air.port, folder=folder / "runs"))
            began_s = time.monotonic()
            with process(log, "companion.commands.cli", "run", "--config", str(folder / "c.toml")) as child:
                wait_for(log, "standby -> guarding")
                yield child.pid, time.monotonic() - began_s
    finally:
        air.close()


def fly(folder: Path) -> dict[str, float]:
    """Measure one flight. Returns its figures."""
    with flight(folder, NEIGHBOURS) as (pid, ready_s):
        began_s = time.monotonic()
        time.sleep(SETTLE_S)
        used_s, at_s = processor_s(pid), time.monotonic()
        time.sleep(SECONDS)
        share = (processor_s(pid) - used_s) / (time.monotonic() - at_s)
        figures = {
            "ready_s": ready_s,
            "core": share,
            "rss": memory_mb("VmRSS", pid),
            "anon": memory_mb("RssAnon", pid),
            "peak": memory_mb("VmHWM", pid),
        }
    (summary,) = (folder / "runs").glob("*/summary.json")
    flown_h = (time.monotonic() - began_s) / 3600.0
    figures["mb_an_hour"] = sum(path.stat().st_size for path in summary.parent.iterdir()) / 1e6 / flown_h
    found = json.loads(summary.read_text())
    figures |= {name: found["tick_lateness_ms"][name] for name in ("median", "p99", "worst")}
    return figures | {"missed": found["late_ticks"], "ticks": found["ticks"], "heard": found["frames_heard"]}


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Run the given number of processes that each keep one core busy."""
    spin = [sys.executable, "-c", "while True: pass"]
    children = [subprocess.Popen(spin) for _ in range(count)]
    try:
        yield
    finally:
        for child in children:
            child.kill()
            child.wait()


@contextmanager
def real_time() -> Iterator[bool]:
    """Start processes with real-time scheduling inside this context, as the service does. Yields False if
    this is not allowed."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except PermissionError:
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def line(name: str, f: dict[str, float]) -> None:
    """Print a flight's figures."""
    print(
        f"{name:26}{f['ready_s']:9.1f}{f['rss']:8.0f}{f['anon']:8.0f}{f['peak']:8.0f}{100 * f['core']:8.1f}"
        f"{f['median']:9.1f}{f['p99']:8.1f}{f['worst']:8.1f}{f['missed']:8.0f}{f['ticks']:8.0f}{f['mb_an_hour']:8.0f}",
        flush=True,
    )


def main() -> None:
    """Print the table."""
    cores = len(os.sched_getaffinity(0))
    heads = (
        "RSS MB",
        "anon MB",
        "peak MB",
        "core %",
        "late ms",
        "p99 ms",
        "worst",
        "missed",
        "ticks",
        "MB/h",
    )
    print(f"{'':26}{'ready s':>9}" + "".join(f"{h:>{9 if h == 'late ms' else 8}}" for h in heads))
    with tempfile.TemporaryDirectory() as folder:
        for name in ("idle", "busy", "real"):
            (Path(folder) / name).mkdir()
        fly_in = Path(folder)
        unloaded = fly(fly_in / "idle")
        line("unloaded, default", unloaded)
        target("resident memory", unloaded["rss"], "MB", most=MOST_MB)
        target("processor", 100.0 * unloaded["core"], "% of a core", most=MOST_CORE)
        target("ready after", unloaded["ready_s"], "s", most=MOST_READY_S)
        with busy(2 * cores):
            line(f"{2 * cores} busy processes", fly(fly_in / "busy"))
            with real_time() as allowed:
                if allowed:
                    line("also real-time priority", fly(fly_in / "real"))
                else:
                    print("not measured: this process may not use real-time scheduling")


if __name__ == "__main__":
    main()
