"""What the commands share, in a process of its own: standard streams that are closed or cannot be written."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from companion.commands import cli as companion_cli
from companion.commands import entry_point
from companion.commands.entry_point import start
from ground_tools import cli as ground_cli
from sitl_mocks import cli as mocks_cli

PROGRAM = """
import faulthandler, json, os, sys
from companion.commands.entry_point import parser_of, run_command

def work(arguments):
    faulthandler.dump_traceback_later(30.0)
    faulthandler.cancel_dump_traceback_later()
    with open(sys.argv[1], "w") as opened:
        opened.write(str(opened.fileno()))
    print("said", flush=True)
    print("complained", file=sys.stderr, flush=True)
    return 3

parser = parser_of("program", "", "")
parser.set_defaults(run=work)
sys.exit(run_command(parser, []))
"""


def run(tmp_path, redirections, *, unbuffered=False):
    """Exit code and complaints of the program; the number of the first file that it opened."""
    opened = tmp_path / "opened"
    python = [sys.executable, *(["-u"] if unbuffered else []), "-c", PROGRAM, str(opened)]
    shell = ["sh", "-c", f'exec "$@" {redirections}', "sh", *python]
    done = subprocess.run(shell, capture_output=True, text=True, timeout=60, check=False)
    return done.returncode, done.stderr, int(opened.read_text())


@pytest.mark.parametrize("closed", ["2>&-", ">&-", "<&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_streams_that_are_closed_are_done_without(tmp_path, closed):
    code, complaint, number = run(tmp_path, closed)
    assert code == 3
    assert complaint == ("" if "2>&-" in closed else "complained\n")
    # A link with the number of stderr would be sent what is printed.
    assert number > 2


@pytest.mark.parametrize("unbuffered", [False, True])
def test_a_full_disk_is_said_in_one_line(tmp_path, unbuffered):
    _, complaint, _ = run(tmp_path, ">/dev/full", unbuffered=unbuffered)
    assert complaint == "program: output cannot be written: No space left on device\n"


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("ground-tools fly udpin://0.0.0.0:1 --mission a b", "ground-tools fly [-h] [--mission FILE"),
        ("companion remote-id listen --radio ether=1 more", "companion remote-id listen [-h]"),
        ("sitl-mocks demo --nothing", "sitl-mocks demo [-h]"),
    ],
)
def test_what_a_subcommand_does_not_know_is_refused_under_its_own_usage(capsys, command, words):
    name, *arguments = command.split()
    modules = {"companion": companion_cli, "ground-tools": ground_cli, "sitl-mocks": mocks_cli}
    with pytest.raises(SystemExit, match="2"):
        modules[name].main(arguments)
    error = capsys.readouterr().err
    assert f"usage: {words}" in error
    assert "unrecognized arguments: " in error


@pytest.mark.usefixtures("kept_signals")
def test_ctrl_c_while_modules_are_imported_ends_quietly(tmp_path, monkeypatch):
    (tmp_path / "slow_to_import.py").write_text("raise KeyboardInterrupt")
    monkeypatch.syspath_prepend(tmp_path)
    assert start("slow_to_import") == 130


@pytest.mark.usefixtures("kept_signals")
@pytest.mark.parametrize("again", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("soon", [True, False])
def test_a_second_signal_soon_after_the_first_does_not_disturb_the_end(tmp_path, monkeypatch, again, soon):
    (tmp_path / "ended_twice.py").write_text(
        "import signal\nfrom pathlib import Path\n"
        "try:\n    signal.raise_signal(signal.SIGINT)\n"
        f"finally:\n    signal.raise_signal(signal.{again})\n    Path(__file__).with_name('tidy').touch()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    if not soon:
        monkeypatch.setattr(entry_point, "_ONE_WISH_S", 0.0)
    monkeypatch.delitem(sys.modules, "ended_twice", raising=False)
    assert start("ended_twice") == 130
    assert (tmp_path / "tidy").exists() == soon


def test_a_signal_at_the_very_end_leaves_the_exit_code(tmp_path):
    """Python restores its handlers before it takes the modules apart."""
    (tmp_path / "late.py").write_text(
        "import os, signal\n"
        "class Late:\n    def __del__(self, kill=os.kill, pid=os.getpid(), number=signal.SIGINT):\n"
        "        kill(pid, number)\n"
        "late = Late()\n"
        "def main():\n    return 130\n"
    )
    program = "import sys\nfrom companion.commands.entry_point import start\nsys.exit(start('late'))"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    done = subprocess.run([sys.executable, "-c", program], env=environment, timeout=60, check=False)
    assert done.returncode == 130


@pytest.mark.usefixtures("kept_signals")
def test_each_installed_command_is_there(monkeypatch, capsys):
    scripts = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]["scripts"]
    assert set(scripts) == {"companion", "ground-tools", "sitl-mocks"}
    for name, where in scripts.items():
        monkeypatch.setattr(sys, "argv", [name, "--help"])
        with pytest.raises(SystemExit, match="0"):
            EntryPoint(name, where, "console_scripts").load()()
        assert f"usage: {name} " in capsys.readouterr().out
