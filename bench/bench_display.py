"""CPU time that `companion display` adds to the flight and uses itself, with 50 aircraft heard once a second.

The real processes on loopback: `companion run` flies the mock vehicle at 20 Hz, and `companion display`
serves its page. The kinds of clients take turns within one flight, so that other work on the machine affects
all alike. CPU time of each process is read from /proc/PID/stat, in percent of one core. A browser is Chromium
if it is installed, and otherwise a client that makes the page's requests. The browser's own time is not
counted, because it runs on another device.
"""

from __future__ import annotations

import contextlib
import socket
import statistics
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from bench.bench_aboard import SETTLE_S, flight, process, processor_s, wait_for
from bench.measuring.figures import target
from companion.commands.status import ask
from tests.browser import chromium

TRACKS = 50
RATE_HZ = 20
ROUNDS = 5
SECONDS = 12.0
"""Duration of each kind of client in each round."""
MANY = 16
"""Number of browsers at once; the display serves no more at a time."""
MOST_CORE = 5.0
"""Target of the CPU time, in percent of one core, that the display and one browser add in the flight and the
display process together."""
MOST_LATE = 1.0
"""Target of the late ticks that stopped browsers add, in percent of all ticks. Other work on the machine
makes a few late in any row."""
_PERIOD_S = 1.0
"""The page asks for the state this long after the last answer."""
_PATIENCE_S = 30.0


@contextlib.contextmanager
def clients(url: str, count: int = 1) -> Iterator[None]:
    """Run clients that request the state as the page does.

    Raises:
        RuntimeError: a request was not answered.
    """
    ended, failed = threading.Event(), []

    def look() -> None:
        while not ended.wait(_PERIOD_S):
            try:
                with urllib.request.urlopen(f"{url}state", timeout=_PATIENCE_S) as answer:
                    answer.read()
            except OSError as error:
                failed.append(error)

    threads = [threading.Thread(target=look, daemon=True) for _ in range(count)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        for thread in threads:
            thread.join()
    if failed:
        raise RuntimeError(f"{len(failed)} questions to the display failed; the first: {failed[0]}")


@contextlib.contextmanager
def browser(url: str) -> Iterator[None]:
    """Run Chromium with the page open.

    Raises:
        RuntimeError: the page does not draw all aircraft.
    """
    with chromium.opened(1200, 800) as opened:
        opened.page.goto(url)
        opened.page.wait_for_selector("svg g.track")
        drawn = opened.page.locator("svg g.track").count()
        if drawn < TRACKS:
            raise RuntimeError(f"the page draws {drawn} aircraft instead of {TRACKS}")
        yield


@contextlib.contextmanager
def stopped(url: str) -> Iterator[None]:
    """Run clients that stop in the middle of a request. Each is replaced when the display closes its
    connection."""
    port = int(url.rstrip("/").rpartition(":")[2])
    ended = threading.Event()

    def hold() -> None:
        while not ended.is_set():
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port)) as held:
                held.sendall(b"GET /state HTTP/1.1\r\n")
                held.settimeout(0.2)
                while not ended.is_set():
                    with contextlib.suppress(TimeoutError):
                        if not held.recv(65536):
                            break
            ended.wait(0.2)

    threads = [threading.Thread(target=hold, daemon=True) for _ in range(MANY)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        for thread in threads:
            thread.join()


class Shares:
    """Shares of one core that the flight and the display use, by the kind of clients."""

    def __init__(self, flight_pid: int, status: Path) -> None:
        self._flight_pid = flight_pid
        self._status = status
        self.flight: dict[str, list[float]] = {}
        self.display: dict[str, list[float]] = {}
        self.late: dict[str, int] = {}

    def measure(self, name: str, display_pid: int | None = None) -> None:
        """Measure for `SECONDS`, after a second in which the new clients settle."""
        time.sleep(1.0)
        pids = [self._flight_pid] + ([] if display_pid is None else [display_pid])
        late = ask(self._status).late_ticks
        used_s, began_s = [processor_s(pid) for pid in pids], time.monotonic()
        time.sleep(SECONDS)
        after_s, took_s = [processor_s(pid) for pid in pids], time.monotonic() - began_s
        shares = [100.0 * (b - a) / took_s for a, b in zip(used_s, after_s, strict=True)]
        self.late[name] = self.late.get(name, 0) + ask(self._status).late_ticks - late
        for kind, share in zip((self.flight, self.display), shares, strict=False):
            kind.setdefault(name, []).append(share)


ONE, NONE, STOPPED = "one browser", "no display", f"{MANY} stopped browsers"
WAYS: dict[str, Callable[[str], AbstractContextManager[None]]] = {
    "nobody looks": lambda url: contextlib.nullcontext(),
    ONE: browser if chromium.missing() is None else clients,
    f"{MANY} browsers": lambda url: clients(url, MANY),
    STOPPED: stopped,
}


def measured(folder: Path) -> Shares:
    """Measure one flight with each kind of client in turn.

    Raises:
        RuntimeError: the flight does not hold `TRACKS` tracks.
    """
    with flight(folder, TRACKS) as (pid, _):
        time.sleep(SETTLE_S)
        (status,) = folder.glob("*.sock")
        shares = Shares(pid, status)
        for number in range(ROUNDS):
            give_up_s = time.monotonic() + _PATIENCE_S
            while (held := ask(status).track_count) < TRACKS and time.monotonic() < give_up_s:
                time.sleep(0.2)
            if held < TRACKS:
                raise RuntimeError(f"the flight holds {held} tracks instead of {TRACKS}")
            shares.measure(NONE)
            log = folder / f"display-{number}.log"
            options = ("display", "--socket", str(status), "--port", "0")
            with process(log, "companion.commands.cli", *options) as display:
                url = wait_for(log, r"at (http://\S+/) until")[1]
                for name, look in WAYS.items():
                    with look(url):
                        shares.measure(name, display.pid)
    return shares


def main() -> None:
    """Print the table."""
    print(f"one browser: {'Chromium' if WAYS[ONE] is browser else 'a client that asks as the page does'}")
    with tempfile.TemporaryDirectory() as folder:
        shares = measured(Path(folder))
    heads = ("flight %", "from", "to", "added %", "display %", "late ticks")
    print(f"{'percent of one core':24}" + "".join(f"{head:>12}" for head in heads))
    none = statistics.mean(shares.flight[NONE])
    for name, values in shares.flight.items():
        mean, own = statistics.mean(values), shares.display.get(name)
        display = "-" if own is None else f"{statistics.mean(own):.2f}"
        added = "-" if name == NONE else f"{mean - none:.2f}"
        print(
            f"{name:24}{mean:12.2f}{min(values):12.2f}{max(values):12.2f}{added:>12}{display:>12}"
            f"{shares.late[name]:12}"
        )
    cost = statistics.mean(shares.flight[ONE]) - none + statistics.mean(shares.display[ONE])
    target("one browser, flight and display together", cost, "% of a core", most=MOST_CORE)
    late = 100.0 * (shares.late[STOPPED] - shares.late[NONE]) / (ROUNDS * SECONDS * RATE_HZ)
    target("late ticks that stopped browsers add", late, "% of all", most=MOST_LATE)


if __name__ == "__main__":
    main()
