"""docs/getting-started.md, followed line by line: each file saved, each command run, in its order."""

from __future__ import annotations

import contextlib
import os
import random
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from tests.integration.conftest import stalled

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "getting-started.md").read_text()
PARTS = re.findall(r"Save this as `(\S+)`:\n\n```toml\n(.*?)```|((?:^    [^\n]*\n)+)", PAGE, re.S | re.M)
PORTS = ("14640", "14540", "14541")
PATIENCE_S = 500.0
FLIGHTS = 4
"""If a stall of the machine ends so many encounters, each about half a minute long, it cannot fly them."""
LAST_START_S = 250.0
"""An encounter that begins later may not end before the time is over, on a machine that is so slow."""


def script():
    """The page as a program for bash: what is saved, and what is typed."""
    lines = ["set -e"]
    for name, content, commands in PARTS:
        typed = re.sub("^    ", "", commands, flags=re.MULTILINE)
        lines.append(f"cat >{name} <<'END'\n{content}END" if name else typed)
    # A background job that was stopped on purpose is no error.
    return "\n".join(lines).replace("\nwait\n", "\nwait || true\n")


def free_ports(count):
    """UDP ports that are free now, below those that the system gives to the sockets of other tests."""
    first = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    found = []
    for port in random.sample(range(first // 2, first), 200):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one, contextlib.suppress(OSError):
            one.bind(("127.0.0.1", port))
            found.append(str(port))
        if len(found) == count:
            break
    return found


@pytest.fixture
def programs(tmp_path):
    """A folder with the three commands, which run this code."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name, module in (
        ("companion", "companion"),
        ("sitl-mocks", "sitl_mocks"),
        ("ground-tools", "ground_tools"),
    ):
        path = folder / name
        path.write_text(f'#!/bin/sh\nexec {sys.executable} -m {module} "$@"\n')
        path.chmod(0o755)
    return folder


def test_the_page_has_what_is_followed():
    assert [name for name, _, _ in PARTS if name] == ["south.toml", "north.toml"]
    typed = "".join(commands for _, _, commands in PARTS)
    for command in ("serve", "ether", "check", "run", "status", "inspect"):
        assert f" {command} " in typed, command
    assert all(port in PAGE for port in PORTS)


@pytest.fixture
def short_paths():
    """Makes folders with short paths: that of a socket in one has at most 107 bytes."""
    with contextlib.ExitStack() as stack:
        yield lambda: Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="dmuca-")))


def follow(folder, programs, give_up_s):
    """Follow the page in an empty folder. Returns the exit code; None if a stall of the machine prevented the
    encounter, which real time does not fly again."""
    text = script()
    for port, free in zip(PORTS, free_ports(len(PORTS)), strict=True):
        text = text.replace(f"127.0.0.1:{port}", f"127.0.0.1:{free}")
    environment = os.environ | {
        "PATH": f"{programs}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "HOME": str(folder),
    }
    with (folder / "output.txt").open("w") as file:  # a pipe stays open as long as anything in the background
        process = subprocess.Popen(
            ["bash", "-c", text],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            while process.poll() is None:
                vehicles = (folder / "output.txt").read_text()
                if any(stalled(path.read_text(), vehicles) for path in folder.glob("first-flight/*.log")):
                    return None
                assert time.monotonic() < give_up_s, logs(folder)
                time.sleep(0.2)
        finally:
            with contextlib.suppress(ProcessLookupError):  # whatever the page left running
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    return process.returncode


def logs(folder):
    """The ends of all output."""
    paths = [*folder.glob("*.txt"), *folder.glob("first-flight/*.log")]
    return "\n".join(f"{path.name}:\n{path.read_text()[-3000:]}" for path in paths)


def test_two_aircraft_meet_and_are_kept_apart(short_paths, programs):
    pytest.importorskip("matplotlib", reason="the report needs the extra inspect")
    began_s = time.monotonic()
    for _ in range(FLIGHTS):
        place = short_paths()
        code = follow(place, programs, began_s + PATIENCE_S)
        if code is not None or time.monotonic() > began_s + LAST_START_S:
            break
    if code is None:
        pytest.skip("a stall of this machine ended each encounter")
    output = (place / "output.txt").read_text()
    assert code == 0, output
    folder = place / "first-flight"
    for name in ("south", "north"):
        log = (folder / f"{name}.log").read_text()
        assert "guarding -> avoiding" in log, log
        assert "avoiding -> recovering" in log, log
    nearest = re.search(r"Separation kept by 1 of 1 pairs; .*: closest ([\d.]+) m", output)
    assert nearest is not None, output
    assert float(nearest[1]) > 10.0
    assert (folder / "report.html").stat().st_size > 10_000
