"""Old setpoints that still arrive after the far end of a link stalled, and the cost of reading a flood.

A real process at the far end of a `KeptLink` receives a frame of 65 bytes twenty times a second; each frame
contains the time at which it was sent. Then the far process is stopped (SIGSTOP), or continues to send
without reading ("deaf"), or, as root on Linux, sits behind a router that drops everything for a while. "old"
counts frames older than 250 ms when they are read, and "back" is the time from the end of the stall to the
first fresh frame. The argument is the length of the stall in seconds.
"""

from __future__ import annotations

import ctypes
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from companion.autopilot.wire import FrameScanner, MavlinkWriter, mavlink
from companion.runtime.links.byte_link import LinkTrouble
from companion.runtime.links.kept_link import KeptLink
from companion.runtime.links.udp_link import UdpLink

OLD_S = 0.25
STALL_S = 3.0
TICK_S = 0.05
BEFORE_S = 1.0
AFTER_S = 4.0
FRAME = 65
TALK_S = 0.1
FLOOD_S = 3.0
HEARTBEAT = b"\xfd and what follows in a beat"

# ---------------------------------------------------------------- far end


class Far:
    """The far process: it reads frames, notes their ages, and sends ten times a second."""

    def __init__(self, kind: str, buffer: int) -> None:
        self.ages: list[float] = []
        self.got_s: list[float] = []
        self.ends = 0
        self._reads = True
        self._rest: dict[int, bytes] = {}
        self._kind = kind
        self._peers: list[socket.socket] = []
        self._peer: object = None
        if kind == "pty":
            self._master, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(self._master, False)
            self.name = f"serial:{os.ttyname(slave)}:57600"
            self._slave = slave
            return
        self._socket = socket.socket(type=socket.SOCK_STREAM if kind == "tcp" else socket.SOCK_DGRAM)
        if buffer:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        self._socket.bind(("0.0.0.0", 0))
        self._socket.setblocking(False)
        if kind == "tcp":
            self._socket.listen(1)
        self.name = f"{'tcp' if kind == 'tcp' else 'udpout'}:HOST:{self._socket.getsockname()[1]}"

    def stop_reading(self, *_: object) -> None:
        self._reads = not self._reads

    def run(self) -> None:
        """Read and send until the standard input ends; then print the ages as JSON."""
        talk_s = time.monotonic()
        while not select.select([0], [], [], 0.005)[0]:
            if self._reads:
                self._read()
            if time.monotonic() >= talk_s:
                talk_s = time.monotonic() + TALK_S
                self._talk()
        print(json.dumps({"ages": self.ages, "got_s": self.got_s, "ends": self.ends}), flush=True)

    def _read(self) -> None:
        if self._kind == "pty":
            while data := self._try(lambda: os.read(self._master, 65536)):
                self._take(0, data)
        elif self._kind == "udp":
            while got := self._try(lambda: self._socket.recvfrom(65536)):
                data, self._peer = got
                self._rest.clear()
                self._take(0, data)
        else:
            if accepted := self._try(self._socket.accept):
                accepted[0].setblocking(False)
                self._peers.append(accepted[0])
            for peer in [*self._peers]:
                while data := self._try(lambda peer=peer: peer.recv(65536), peer):
                    self._take(peer.fileno(), data)

    def _try(self, call: Callable[[], Any], peer: socket.socket | None = None) -> Any:
        try:
            data = call()
        except BlockingIOError:
            return None
        except OSError:
            data = None
        if not data and peer is not None:
            self.ends += 1
            self._rest.pop(peer.fileno(), None)
            self._peers.remove(peer)
            peer.close()
        return data

    def _take(self, source: int, data: bytes) -> None:
        *lines, self._rest[source] = (self._rest.get(source, b"") + data).split(b"\n")
        now = time.monotonic()
        for line in lines:
            if len(line) == FRAME - 1:
                self.ages.append(now - float(line))
                self.got_s.append(now)

    def _talk(self) -> None:
        if self._kind == "pty":
            self._try(lambda: os.write(self._master, HEARTBEAT))
        elif self._kind == "udp" and self._peer is not None:
            self._try(lambda: self._socket.sendto(HEARTBEAT, self._peer))
        for peer in [*self._peers]:
            self._try(lambda peer=peer: peer.send(HEARTBEAT), peer)


# ---------------------------------------------------------------- network


def ip(*arguments: str) -> None:
    """Run `ip ARGUMENTS`, which must succeed."""
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


class Network:
    """Two namespaces and a router between them, which can drop everything."""

    near, router, far = (f"dmuca-bench-{name}" for name in ("near", "router", "far"))

    def __enter__(self) -> Network:
        for name in (self.near, self.router, self.far):
            ip("netns", "add", name)
            ip("-n", name, "link", "set", "lo", "up")
        for number, name in ((1, self.near), (2, self.far)):
            ends = ("netns", self.router, "type", "veth", "peer", "name", "eth0", "netns", name)
            ip("link", "add", f"to{number}", *ends)
            ip("-n", self.router, "addr", "add", f"10.9.{number}.1/24", "dev", f"to{number}")
            ip("-n", self.router, "link", "set", f"to{number}", "up")
            ip("-n", name, "addr", "add", f"10.9.{number}.2/24", "dev", "eth0")
            ip("-n", name, "link", "set", "eth0", "up")
            ip("-n", name, "route", "add", "default", "via", f"10.9.{number}.1")
        router = ["ip", "netns", "exec", self.router, "sysctl", "-qw", "net.ipv4.ip_forward=1"]
        subprocess.run(router, check=True)
        return self

    def drop(self, on: bool) -> None:
        """Drop all packets from now on, or forward all again."""
        for number in (1, 2):
            ip("-n", self.router, "route", "add" if on else "del", "blackhole", f"10.9.{number}.2/32")

    def __exit__(self, *_: object) -> None:
        for name in (self.near, self.router, self.far):
            ip("netns", "del", name)


@contextmanager
def inside(name: str | None) -> Iterator[None]:
    """Sockets that are opened inside this context belong to this network namespace."""
    if name is None:
        yield
        return
    enter = ctypes.CDLL(None, use_errno=True).setns
    with open("/proc/self/ns/net") as ours, open(f"/run/netns/{name}") as theirs:
        if enter(theirs.fileno(), 0):
            raise OSError(ctypes.get_errno(), "setns")
        try:
            yield
        finally:
            enter(ours.fileno(), 0)


# ---------------------------------------------------------------- stalls


def stall(kind: str, how: str, buffer: int, stall_s: float) -> dict[str, float]:
    """Measure one link through one stall. Returns, among others, how many frames arrived old, and how old."""
    with ExitStack() as stack:
        network = stack.enter_context(Network()) if how == "drops" else None
        prefix = ["ip", "netns", "exec", network.far] if network else []
        command = [*prefix, sys.executable, "-m", "bench.bench_links", "far", kind, str(buffer)]
        child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        stack.callback(child.kill)
        assert child.stdout is not None
        name = child.stdout.readline().strip().replace("HOST", "10.9.2.2" if network else "127.0.0.1")
        said: list[str] = []
        stack.enter_context(inside(network.near if network else None))
        kept = KeptLink(name, said.append)

        def switch(on: bool) -> None:
            if network is not None:
                network.drop(on)
            elif how == "stopped":
                child.send_signal(signal.SIGSTOP if on else signal.SIGCONT)
            elif how == "deaf":
                child.send_signal(signal.SIGUSR1)

        sent = send(kept, BEFORE_S)
        switch(True)
        sent += send(kept, stall_s)
        switch(False)
        on_s = time.monotonic()
        sent += send(kept, AFTER_S)
        time.sleep(0.2)
        kept.close()
        found = json.loads(child.communicate()[0])
    old = [(age, got) for age, got in zip(found["ages"], found["got_s"], strict=True) if age > OLD_S]
    fresh = [g for a, g in zip(found["ages"], found["got_s"], strict=True) if g > on_s and a <= OLD_S]
    return {
        "sent": sent,
        "came": len(found["ages"]),
        "old": len(old),
        "oldest": max((age for age, _ in old), default=0.0),
        "back": fresh[0] - on_s if fresh else float("inf"),
        "dropped": kept.trouble.dropped,
        "discarded": kept.trouble.discarded,
        "losses": kept.trouble.losses,
    }


def send(kept: KeptLink, seconds: float) -> int:
    """Exchange data for the given time (s) as a flight does. Returns the number of sent frames."""
    count, end = 0, time.monotonic() + seconds
    due = time.monotonic()
    while due < end:
        while (left := due - time.monotonic()) > 0:
            kept.wait(left)
            kept.receive(time.monotonic())
        kept.receive(time.monotonic())
        kept.send(b"%*.6f\n" % (FRAME - 1, time.monotonic()))
        count += 1
        due += TICK_S
    return count


# ---------------------------------------------------------------- floods


def flood() -> None:
    """Measure one receive call while a sender never stops, and the time to parse a full portion."""
    listening = UdpLink(("127.0.0.1", 0), LinkTrouble(), listen=True)
    with socket.socket(fileno=os.dup(listening.fileno())) as same:
        granted = same.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    print(f"receive buffer granted: {granted / 1024:.0f} KiB")
    writer = MavlinkWriter(1, 1)
    beat = writer.pack(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3))
    for name, datagram in (("heartbeats", beat), ("1400 bytes", 1400 * b"\xfd"), ("60 kB", 60_000 * b"\xfd")):
        code = (
            "import socket; s = socket.socket(type=socket.SOCK_DGRAM)\n"
            f"d = bytes.fromhex('{datagram[:64].hex()}') * {max(1, len(datagram) // 64)}\n"
            f"while True: s.sendto(d[:{len(datagram)}], ('127.0.0.1', {listening.port}))"
        )
        child = subprocess.Popen([sys.executable, "-c", code])
        try:
            costs, emptied = [], 0
            end = time.perf_counter() + FLOOD_S
            while time.perf_counter() < end:
                # Start with a full buffer, as after a stall.
                time.sleep(0.02)
                began = time.perf_counter()
                received = listening.receive(time.monotonic())
                costs.append(time.perf_counter() - began)
                emptied += received.emptied
        finally:
            child.kill()
            child.wait()
        while not listening.receive(time.monotonic()).emptied:
            pass
        costs.sort()
        print(
            f"UDP flood of {name:12} median {1e3 * costs[len(costs) // 2]:.2f} ms per call, "
            f"99 % {1e3 * costs[len(costs) * 99 // 100]:.2f}, worst {1e3 * costs[-1]:.2f}; "
            f"{emptied} of {len(costs)} calls emptied the buffer"
        )
    listening.close()
    portion = (beat * 1000)[: 16 * 1024]
    began = time.perf_counter()
    for _ in FrameScanner().frames(portion):
        pass
    print(f"scanning a full portion (16 KiB of heartbeats): {1e3 * (time.perf_counter() - began):.1f} ms")


def main(stall_s: float = STALL_S) -> None:
    """Print the tables."""
    flood()
    cases = [
        ("tcp", "none", 0),
        ("tcp", "stopped", 0),
        ("tcp", "stopped", 4096),
        ("tcp", "deaf", 0),
        ("tcp", "deaf", 4096),
        ("pty", "none", 0),
        ("pty", "stopped", 0),
        ("pty", "deaf", 0),
        ("udp", "none", 0),
        ("udp", "stopped", 0),
        ("udp", "stopped", 4096),
    ]
    if sys.platform == "linux" and os.geteuid() == 0:
        cases += [("tcp", "drops", 0), ("udp", "drops", 0)]
    heads = ("sent", "received", "old", "oldest s", "resumed s", "dropped", "discarded", "losses")
    print(f"\nstall of {stall_s:.1f} s\n{'':24}" + "".join(f"{head:>10}" for head in heads))
    for kind, how, buffer in cases:
        f = stall(kind, how, buffer, stall_s)
        label = f"{kind}, {how}" + (f", {buffer} B" if buffer else "")
        print(
            f"{label:24}" + "".join(f"{v:10.2f}" if isinstance(v, float) else f"{v:10}" for v in f.values())
        )


if __name__ == "__main__":
    if sys.argv[1:2] == ["far"]:
        far = Far(sys.argv[2], int(sys.argv[3]))
        signal.signal(signal.SIGUSR1, far.stop_reading)
        print(far.name, flush=True)
        far.run()
    else:
        main(*map(float, sys.argv[1:]))
