"""What deploy/ and docs/deploy.md name is there, and fits together."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from companion.commands import cli
from companion.config import RecordConfig, VehicleConfig
from companion.runtime import watchdog
from companion.runtime.status.service_manager import ping_period_s

ROOT = Path(__file__).parents[1]
UNIT = (ROOT / "deploy" / "dmuca-companion.service").read_text()
DOCUMENT = (ROOT / "docs" / "deploy.md").read_text()


def values(key):
    return re.findall(rf"^{key}=(.*)$", UNIT, re.M)


def test_the_service_runs_a_command_that_there_is():
    program, *arguments = values("ExecStart")[0].split()
    assert Path(program).name == "companion"
    parsed = cli._parser(arguments).parse_args(arguments)
    assert parsed.config == Path("/etc/dmuca/companion.toml")
    assert not parsed.dry_run
    assert values("ExecStartPre")[0].split()[1:] == ["-m", "companion.runtime.warm"]


def test_the_process_ends_itself_before_the_watchdog_does():
    """With a traceback; and a stall of 20 s that is over is not answered, whenever it begins."""
    assert values("Type") == ["notify"]
    limit_s = float(values("WatchdogSec")[0])
    assert limit_s > watchdog.PERIOD_S * watchdog.WAKE_UPS
    period_s = ping_period_s({"WATCHDOG_USEC": str(int(limit_s * 1e6))}, 1)
    assert period_s is not None
    assert limit_s - period_s > 20.0


def test_systemd_waits_for_a_vehicle_as_long_as_the_companion_may():
    """A companion that waits for its vehicle must not be killed and started again for ever."""
    hint = get_type_hints(VehicleConfig, include_extras=True)["wait_s"]
    longest_s = get_args(hint)[1].le
    assert float(values("TimeoutStartSec")[0]) >= longest_s + 180.0


@pytest.mark.parametrize(("status", "waits"), [("2", "8"), ("1", ""), ("0", ""), ("KILL", "")])
def test_only_a_companion_that_could_not_begin_waits_before_the_next_start(tmp_path, status, waits):
    """Starts cost processor time at real-time priority; one that crashed in flight starts again soon."""
    assert float(values("RestartSec")[0]) <= 2.0
    assert values("StartLimitIntervalSec") == ["0"]
    (command,) = values("ExecStopPost")
    program, option, text = shlex.split(command.removeprefix("-").replace("$$", "$"))
    sleep = tmp_path / "sleep"
    sleep.write_text(f'#!/bin/sh\necho "$1" >{tmp_path}/slept\n')
    sleep.chmod(0o755)
    environment = {"PATH": str(tmp_path), "EXIT_STATUS": status}
    subprocess.run([program, option, text], env=environment, check=True)
    slept = tmp_path / "slept"
    assert (slept.read_text().strip() if slept.exists() else "") == waits
    assert float(values("TimeoutStopSec")[0]) > float(waits or 0)


def test_short_of_memory_the_kernel_ends_others_first():
    assert float(values("OOMScoreAdjust")[0]) < 0
    assert values("MemorySwapMax") == ["0"]


def test_no_core_dump_holds_a_key_or_delays_a_restart():
    """systemd's watchdog ends the process with SIGABRT, which dumps core."""
    assert values("LimitCORE") == ["0"]
    assert "WatchdogSignal" not in UNIT


def test_a_refused_system_call_does_not_end_the_flight():
    assert values("SystemCallErrorNumber") == ["EPERM"]


def test_where_the_service_may_write_is_what_it_writes():
    environment = dict(part.split("=", 1) for line in values("Environment") for part in line.split())
    assert environment["NUMBA_CACHE_DIR"] == f"/var/cache/{values('CacheDirectory')[0]}"
    assert environment["TMPDIR"] == f"/run/{values('RuntimeDirectory')[0]}"
    assert values("WorkingDirectory") == [f"/var/lib/{values('StateDirectory')[0]}"]


def test_the_container_names_the_folder_of_its_records_as_systemd_does():
    text = (ROOT / "deploy/container/Dockerfile").read_text()
    assert f"STATE_DIRECTORY=/var/lib/{values('StateDirectory')[0]} " in text


@pytest.mark.parametrize("path", ["docs/deploy.md", "deploy/debian/postinst"])
def test_the_records_beside_the_configuration_are_those_of_the_service(path):
    text = (ROOT / path).read_text()
    folder = RecordConfig().folder
    state = f"/var/lib/{values('StateDirectory')[0]}"
    assert re.search(f"install -d -o dmuca .*{state}/{folder} ", text)
    assert re.search(f"ln -sf?n? {state}/{folder} /etc/dmuca/{folder}$", text, re.M)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")
@pytest.mark.parametrize("dropin", [False, True])
def test_systemd_takes_the_unit(tmp_path, dropin):
    path = tmp_path / "dmuca-companion.service"
    path.write_text(re.sub(r"(=-?)/opt/\S+", r"\1/bin/true", UNIT))
    if dropin:
        folder = tmp_path / "dmuca-companion.service.d"
        folder.mkdir()
        shutil.copy(ROOT / "deploy" / "radio.conf", folder)
    done = subprocess.run(["systemd-analyze", "verify", path], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")
def test_systemd_takes_what_brings_the_router_back(tmp_path):
    """And it says that the router is started for ever."""
    (tmp_path / "mavlink-router.service").write_text("[Service]\nExecStart=/bin/true\n")
    folder = tmp_path / "mavlink-router.service.d"
    folder.mkdir()
    restart = shutil.copy(ROOT / "deploy" / "mavlink-router-restart.conf", folder)
    done = subprocess.run(
        ["systemd-analyze", "verify", tmp_path / "mavlink-router.service"], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    lines = Path(restart).read_text().splitlines()
    assert {"StartLimitIntervalSec=0", "Restart=always"} <= set(lines)


def test_files_that_the_document_copies_are_in_the_project():
    named = set(re.findall(r"/opt/dmuca/((?:config|deploy)/\S+)", DOCUMENT))
    assert len(named) >= 5
    for name in named:
        assert (ROOT / name).exists(), name
    assert set((ROOT / "deploy").iterdir()) == {
        ROOT / "deploy" / name
        for name in (
            "99-dmuca.rules",
            "container",
            "debian",
            "dmuca-companion.service",
            "mavlink-router.conf",
            "mavlink-router-restart.conf",
            "radio.conf",
        )
    }


def test_the_router_speaks_to_where_the_profiles_listen():
    router = (ROOT / "deploy" / "mavlink-router.conf").read_text()
    (port,) = re.findall(r"Mode = Normal\nAddress = 127\.0\.0\.1\nPort = (\d+)", router)
    assert set(re.findall(r"^Address = (.*)", router, re.MULTILINE)) == {"127.0.0.1"}  # no port to a network
    for name in ("ardupilot-udp", "px4-udp"):
        assert f'link = "udpin:127.0.0.1:{port}"' in (ROOT / "config" / f"{name}.toml").read_text()
    device = 'SYMLINK+="autopilot"' in (ROOT / "deploy" / "99-dmuca.rules").read_text()
    assert device
    assert "Device = /dev/autopilot" in router
    assert "serial:/dev/autopilot:" in (ROOT / "config" / "ardupilot-serial.toml").read_text()
