"""The example projects of plug-ins install from a wheel, without a network, pass the kit and fly."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "docs" / "examples"
PROJECTS = ("plugin-law", "plugin-policy", "plugin-radio", "plugin-firmware")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder into which all four projects are installed; `run` runs Python with it on the path."""
    folder = tmp_path_factory.mktemp("site")
    options = ["--quiet", "--disable-pip-version-check", "--no-index", "--no-deps", "--no-build-isolation"]
    projects = [str(EXAMPLES / name) for name in PROJECTS]
    command = [sys.executable, "-m", "pip", "install", *options, "--target", str(folder), *projects]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture
def run(site):
    """Runs Python with arguments in a folder, with the plug-ins installed."""

    def call(*words, cwd=ROOT):
        environment = os.environ | {"PYTHONPATH": f"{site}{os.pathsep}{ROOT}"}
        command = [sys.executable, *map(str, words)]
        return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)

    return call


def test_they_pass_the_kit(run, site):
    tests = [test for project in PROJECTS for test in (EXAMPLES / project).glob("test_*.py")]
    assert len(tests) == len(PROJECTS)
    alone = ["-p", "no:cacheprovider", "-c", os.devnull, "--rootdir", EXAMPLES]  # not this project's settings
    done = run("-m", "pytest", "-q", *alone, *tests, cwd=site)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "passed" in done.stdout
    assert "skipped" not in done.stdout


def test_the_law_has_at_most_thirty_lines_and_flies_the_demo(run, tmp_path):
    lines = (EXAMPLES / "plugin-law" / "dmuca_sidestep.py").read_text().splitlines()
    assert len(lines) <= 30
    head_on = ROOT / "config" / "scenarios" / "head_on.toml"  # a seventh of the time of the default scenario
    words = ["--law", "sidestep", "--scenario", head_on, "--json", "--runs", tmp_path]
    done = run("-m", "sitl_mocks", "demo", *words)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout)
    assert found["ok"]
    assert found["unavoided_min_separation_m"] < 10.0 < found["min_separation_m"]


def test_the_policy_is_evaluated(run):
    done = run(
        "-m",
        "ground_tools",
        "atmc",
        "evaluate",
        "--policy",
        "plugin:quiet",
        "--samples",
        "2",
        "--uavs",
        "3",
        "--json",
    )
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(done.stdout)
    assert (found["policy"], found["objective"]) == ("quiet", "awareness")


def test_a_configuration_with_all_four_is_checked_before_flight(run, tmp_path):
    file = tmp_path / "my.toml"
    file.write_text(
        '[identity]\nuas_id = "1596B0000DMUCA01"\n[vehicle]\nlink = "udpin:127.0.0.1:0"\ndialect = "heron"\n'
        'wait_s = 0.2\n[avoidance]\nlaw = "sidestep"\n[atmc]\npolicy = "plugin:quiet"\n'
        '[[radio]]\nbackend = "plugin"\nname = "udp"\noptions = { to = "127.0.0.1:9" }\n'
    )
    said = run("-m", "companion", "check", "--config", file, cwd=tmp_path).stdout
    assert 'plug-in: aircraft are avoided by the law "sidestep" (dmuca_sidestep:Sidestep of' in said
    assert 'transports are chosen by the policy "quiet" (dmuca_quiet:Quiet of dmuca-quiet 0.1)' in said
    assert "UDP to 127.0.0.1:9: 0 frames" in said


def test_a_misspelt_plug_in_is_refused_before_flight(run, tmp_path):
    file = tmp_path / "my.toml"
    file.write_text('[identity]\nuas_id = "1596B0000DMUCA01"\n[avoidance]\nlaw = "sidestp"\n')
    done = run("-m", "companion", "run", "--config", file, cwd=tmp_path)
    assert done.returncode == 2
    assert "avoidance.law: 'sidestp' is unknown; allowed: dmuca, paper, none, sidestep" in done.stderr


def test_a_run_sends_and_hears_with_the_radio_and_flies_nobody(run, tmp_path):
    """Without a vehicle it ends by itself, after everything else was opened."""
    file = tmp_path / "my.toml"
    file.write_text(
        '[identity]\nuas_id = "1596B0000DMUCA01"\n[vehicle]\nlink = "udpin:127.0.0.1:0"\nwait_s = 0.2\n'
        '[[radio]]\nbackend = "plugin"\nname = "udp"\noptions = { to = "127.0.0.1:9" }\n'
    )
    done = run("-m", "companion", "run", "--config", file, cwd=tmp_path)
    assert "remote ID: wifi 1/s" in done.stdout
    assert done.returncode == 2
    file.write_text(file.read_text().replace("to =", "too ="))
    done = run("-m", "companion", "run", "--config", file, cwd=tmp_path)
    assert "radio.options: too: unknown key; allowed: to, listen" in done.stderr
