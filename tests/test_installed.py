"""The program that runs the commands of the docs: what counts as good, and that it leaves nothing running."""

import threading
from pathlib import Path

import pytest

from tests import installed
from tests.support import waiting


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A place whose `sitl-mocks` serves until Ctrl-C, and whose `companion` refuses."""
    monkeypatch.setattr(installed, "_AFTER_FIRST_WORDS_S", 0.1)
    programs = tmp_path / "environment" / "bin"
    programs.mkdir(parents=True)
    served = programs / "sitl-mocks"
    served.write_text("#!/bin/sh\ntrap 'echo bye; exit 0' INT\necho ready\nwhile true; do sleep 0.05; done\n")
    served.chmod(0o755)
    refused = programs / "companion"
    refused.write_text("#!/bin/sh\necho 'check: NOT ready'\nexit 1\n")
    refused.chmod(0o755)
    away = tmp_path / "away"
    away.mkdir()
    return installed.Place(away, programs.parent)


def gone(process):
    """Whether no process of that id runs; one that has ended may wait for its parent."""
    try:
        return "State:\tZ" in Path(f"/proc/{process}/status").read_text()
    except OSError:
        return True


def test_a_process_that_a_command_leaves_behind_is_killed(place):
    tried = place.run("sleep 300 >/dev/null 2>&1 & echo $!")
    assert tried.good
    left = int(tried.text)
    waiting.until(lambda: gone(left))


def test_a_command_that_serves_gets_ctrl_c_after_its_first_words(place):
    tried = place.run("sitl-mocks serve")
    assert (tried.good, tried.text) == (True, "ready\nbye\n")
    assert place.run("echo '{}' | sitl-mocks serve").good


@pytest.mark.parametrize(
    ("command", "good"),
    [
        ("true", True),
        ("false", False),
        ("echo Traceback", False),
        ("companion check", True),
        ("companion run", False),
    ],
)
def test_what_is_good(place, command, good):
    assert place.run(command).good is good


def test_what_stops_it_kills_what_runs_and_starts_nothing_more(place):
    pid = place.folder / "pid"
    stopped = []

    def run():
        with pytest.raises(InterruptedError):
            place.run(f"echo $$ >{pid}; sleep 300")
        stopped.append(True)

    thread = threading.Thread(target=run)
    thread.start()
    waiting.until(lambda: pid.exists() and pid.read_text())
    place.stop()
    thread.join(30.0)
    assert stopped
    waiting.until(lambda: gone(int(pid.read_text())))
    with pytest.raises(InterruptedError):
        place.run("true")


def test_each_command_is_in_one_list():
    commands = [installed.smaller(c) for c in installed.commands_of_the_docs() if not installed.untried(c)]
    once = list(dict.fromkeys(commands))
    waiting_ones, lists = installed.chains(once)
    assert sorted([*waiting_ones, *(c for chain in lists for c in chain)]) == sorted(once)
    assert {c.split()[0] for c in waiting_ones} == {"companion", "sitl-mocks", "ground-tools", "echo"}
