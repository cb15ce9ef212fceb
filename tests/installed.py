"""`python -m tests.installed` runs the commands of the docs from the wheel, in an empty environment.

Nothing of the checkout is in reach of these commands: each runs with the interpreter of the environment, in
a folder of its own, which is a copy of one with the files that the docs name. What the docs count in hours is
run with small numbers instead (`SMALLER`). `UNTRIED` has the commands that need what such an environment
lacks; `tests/test_package.py` holds that each command of the docs is either run or in that list.

Two commands run at a time. Beside them run those that wait for something, one after the other, because
their ports are fixed. Commands that lack something here, as an extra or a Bluetooth controller, run to the
line in which they say so (`FAILS`), so that their options are read. Nothing is left running: each command
is a process group, which is killed when the command has ended and when this program is interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import venv
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from tests.support import read_files

ROOT: Final = Path(__file__).parents[1]
EXTRAS: Final = "inspect,search"
SMALLER: Final = (
    (r"--seeds \d+-\d+", "--seeds 1-2"),
    (r"--samples \d+", "--samples 4"),
    (r"--encounters \d+", "--encounters 1"),
    (r"--cases \d+", "--cases 12"),
    (r"--seeds \S+ --evaluations \d+", "--seeds 1-1 --evaluations 10"),
    (r"--hours 24", "--hours 0.06"),
    (r"--worst 3", "--seeds 1-2 --worst 1"),
    (r"--aircraft 10", "--aircraft 2"),
    (r"^(sitl-mocks demo)(?!.*--(scenario|aircraft))", r"\1 --scenario head_on"),
    (
        r"--scenario \S+packets\.toml --policy (\S+)",
        r"--scenario head_on --policy \1 "
        "--channel packets --parameters config/channel/standard.toml",
    ),
    (r"^(sitl-mocks demo .*(?:packets|atmc)\.toml)", r"\1 --aircraft 2"),
    (r" \[[^]]*\]", ""),
    (r"^companion init", "companion init --force"),
    (r"--out /etc/dmuca/", "--out "),
    (r"^(ground-tools paper (?:readings|dmuca))(?!.*--samples)", r"\1 --samples 4"),
    (r"^(ground-tools paper closed-loop)(?!.*--policy|.*--conditions)", r"\1 --conditions sparse"),
    (r"^(ground-tools paper closed-loop)(?=.*--policy)", r"\1 --conditions dense --crowd 2 --methods atmc"),
    (r"^(ground-tools paper closed-loop)(?!.*--encounters)", r"\1 --encounters 1"),
    (r"^(ground-tools channel (?:table|plot))(?!.*--samples)", r"\1 --samples 4"),
    (r"^(ground-tools channel compare)", r"\1 --seconds 30 --environments 10"),
    (r"^(ground-tools city .*)--size \d+ \d+", r"\1--size 1 1 --minutes 0.2 --settle 2"),
    (r"^(ground-tools paper city-separation)(?!.*--methods)", r"\1 --density 30 --methods policy perfect"),
    (r"^(ground-tools paper city\S*)", r"\1 --aircraft 12 --minutes 0.5 --settle 10"),
    (r"^(ground-tools paper city .*)--densities [\d ]+", r"\1--densities 8 "),
    (r"^(ground-tools paper city-policy .*)--densities [\d ]+", r"\1--methods policy city-1 --densities 10 "),
    (r"^(ground-tools paper city )(?!.*--densities)", r"\1--densities 8 --methods fixed perfect "),
    (r"^(ground-tools paper city-separation)", r"\1 --separations 10 20"),
    (r"^(ground-tools paper city.*?)(?: --seeds \S+)?$", r"\1 --seeds 1-2"),
    (r"^(ground-tools campaign (?:encounters|peers|scenarios)(?!.*--seeds).*)", r"\1 --seeds 1-2"),
    (r"--(file|picture) \S*/", r"--\1 "),
    (r"^(ground-tools paper .*?) --out results/\S+", r"\1"),
    (r"--run runs/NAME", "--run flown"),
    (r"runs/atmc/RUN", "runs/atmc/one"),
    (r"RUN/(DMUCA002)", r"\1"),
    (r"^(sitl-mocks swarm .*--faults) --seed 7$", r"\1"),
    (
        r"^(sitl-mocks swarm )(.*)",
        r"\1\2 --aircraft 2 --duration 10; ls runs/*-swarm/*-DMUCA002/*.events",
    ),
    (r"--real \d+", "--real 2"),
    (r"runs/(NAME|A)\b", "RUN_FOLDER"),
    (r"runs/(OTHER|B)\b", "OTHER_FOLDER"),
    (r"(FLIGHT|flight)\.tlog", "RUN_FOLDER/DMUCA001.tlog"),
    (r"\bDIR\b", "tables"),
    (r"\bFILE\.kml", "flight.kml"),
    (r"--policy FILE", "--policy config/policies/atmc.safetensors"),
    (r"CASES\.json", "cases.json.gz"),
    (r"vectors\.json", "vectors.json.gz"),
    (r"--child \S+ --child-key \S+", "--child CHILD_TAG --child-key CHILD_KEY"),
)
"""Pairs of a pattern in a command of the docs and what stands there instead when it is tried.

A swarm's verdict needs an idle machine; here it has to fly and to record.
"""
SERVES: Final = (
    r"sitl-mocks (serve|ether)",
    r"companion (run|display|status)",
    r"companion remote-id listen",
    r"ground-tools inspect .*(--web|--live)",
)
"""Commands that go on until Ctrl-C, which is pressed a few seconds after their first words."""
UNTRIED: Final = {
    r"--law daidalus": "NASA's library, compiled by docs/examples/plugin-daidalus/build.sh",
    r"paper dmuca --sweep": "20 minutes of a core, whatever is asked for",
    r"results verify --sample": "ten minutes of a core; tests/ground_tools makes these samples",
    r"paper all": "minutes; its parts are tried one by one",
}
"""Patterns of commands that are not tried, and what each would need."""
MORE: Final = (
    "python -c 'import dmuca; print(dmuca.__version__, dmuca.remote_id.encode, dmuca.channel.Analytic)'",
    "ground-tools paper convergence",
    "ground-tools paper decision-time --samples 4",
    "ground-tools paper system-delay --samples 4",
    "ground-tools paper uav-delay --samples 4",
    "ground-tools paper fixed-modes --samples 4",
    "ground-tools picture RUN_FOLDER --out picture.png",
    "sitl-mocks demo --scenario incident.toml",
    "companion remote-id --help",
)
"""Commands beside those of the docs."""
FAILS: Final = {
    r"companion bench-test (bench|watch|guard|pair)": "FAILED  kind of run: 'sitl-mocks demo'",
    r"companion check": "check: NOT ready",
    r"companion remote-id listen .*hci=": "companion: radio[0]: radio.channel: ",
    r"companion (status|display)": "--socket",
    r"ground-tools atmc": "to install it, run: pip install 'dmuca[",
    r"ground-tools fly": "to install it, run: pip install 'dmuca[fly]'",
    r"ground-tools results record": "results are recorded in a checkout only",
    r"ground-tools results verify": "make it again",
    r"sitl-mocks demo .*--law paper": "were not back on their paths at the end",
    r"sitl-mocks takeover --real": ": 0 broke a rule",
}
"""Commands that may end with exit code 1 or 2 here, and what they say then."""
FOLLOWED: Final = "getting-started.md"
"""Page whose commands belong together; tests/integration/test_getting_started.py runs them."""
PAGES: Final = (
    *sorted(path for path in (ROOT / "docs").glob("*.md") if path.name != FOLLOWED),
    ROOT / "README.md",
    ROOT / "results" / "README.md",
)
_WAITS: Final = (*SERVES, r"companion (check|bench-test bench)", r"sitl-mocks (swarm|takeover --real)")
"""Commands that hardly compute: they wait for a vehicle, a browser or Ctrl-C, or fly in real time."""
_AFTER_FIRST_WORDS_S: Final = 6.0
_MOST_S: Final = 600.0


def commands_of_the_docs() -> list[str]:
    """Each command line of the docs once, in the order of the pages."""
    return commands_of(PAGES)


def commands_of(pages: Sequence[Path]) -> list[str]:
    """Each command line of some pages once, without its comment."""
    found: dict[str, None] = {}
    for page in pages:
        text = re.sub(r"\s*\\\n\s*", " ", page.read_text())
        line_of_one = r"^    ((?:echo .* \| )?(?:companion|sitl-mocks|ground-tools) .*)"
        for line in re.findall(line_of_one, text, re.MULTILINE):
            found[re.sub(r"\s+#.*", "", line).strip()] = None
    return list(found)


def untried(command: str) -> str | None:
    """What a command would need beside the installed wheel; None if it is tried."""
    return next((why for pattern, why in UNTRIED.items() if re.search(pattern, command)), None)


def smaller(command: str) -> str:
    """The command as it is tried."""
    for pattern, instead in SMALLER:
        command = re.sub(pattern, instead, command)
    return command


def first_things() -> Iterator[str]:
    """What makes the files that later commands read."""
    yield "sitl-mocks demo --scenario config/scenarios/head_on.toml --runs first"
    yield "sitl-mocks demo --scenario config/scenarios/head_on.toml --seed 2 --runs second"
    yield "companion init --px4 --radio ether=127.0.0.1:14640 --region us --out my.toml"
    yield "companion init --ardupilot"
    yield "companion init --px4 --out watch.toml"
    yield "companion init --px4 --use guard --radio ether=127.0.0.1:14640 --out guard.toml"
    yield "mkdir flown; cp RUN_FOLDER/DMUCA001.events RUN_FOLDER/*.json flown"
    yield "companion remote-id key hda.pem --raa 16376 --hda 10"
    yield "companion remote-id key child.pem --raa 16376 --hda 10 > child.txt"
    yield "ground-tools export RUN_FOLDER --scenario incident.toml"


def chains(commands: Iterable[str]) -> tuple[list[str], list[list[str]]]:
    """The commands that wait, and lists of the others, the longest first.

    The commands of a list compile the same kernels, so they run one after the other and compile them once.
    """
    waiting: list[str] = []
    lists: dict[str, list[str]] = {}
    for command in commands:
        words = _program(command).split()
        if _is_one_of(_WAITS, command):
            waiting.append(command)
        elif "city" in command:
            lists.setdefault("city", []).append(command)
        else:
            lists.setdefault(" ".join(words[:2]), []).append(command)
    return waiting, sorted(lists.values(), key=len, reverse=True)


@dataclass(frozen=True, slots=True)
class Tried:
    """What came of a command."""

    command: str
    good: bool
    seconds: float
    text: str

    def told(self) -> bool:
        """Print what came of it. Returns whether it is good."""
        line = f"{'ok    ' if self.good else 'FAILED'} {self.seconds:5.0f} s  {self.command}"
        print("\n    ".join((line, *([] if self.good else self.text.splitlines()[-12:]))), flush=True)
        return self.good


@dataclass(slots=True)
class Place:
    """An empty environment with the wheel, and a folder far from the checkout."""

    folder: Path
    environment: Path
    _running: set[int] = field(default_factory=set)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _stopped: bool = False

    def run(self, command: str, folder: Path | None = None) -> Tried:
        """Run a command as a user would, in the folder or in another one."""
        began_s = time.monotonic()
        folder = folder or self.folder
        log = folder / "output.txt"
        path = f"{self.environment / 'bin'}:{os.environ['PATH']}"
        with log.open("w") as output, self._lock:
            if self._stopped:
                raise InterruptedError
            process = subprocess.Popen(
                ["bash", "-c", _named(command, folder)],
                cwd=folder,
                env=os.environ | {"PATH": path, "PYTHONPATH": "", "RUNTIME_DIRECTORY": str(folder)},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            self._running.add(process.pid)
        try:
            serves = _is_one_of(SERVES, command)
            code = _served(process, log) if serves else process.wait(_MOST_S)
        except subprocess.TimeoutExpired:
            code = None
        finally:
            with self._lock:
                self._running.discard(process.pid)
            _kill(process.pid)
            process.wait()
        if self._stopped:
            raise InterruptedError
        text = log.read_text()
        expected = next((words for pattern, words in FAILS.items() if re.match(pattern, command)), None)
        good = code == 0 or (serves and code in (130, -signal.SIGINT))
        good = good or (expected is not None and code in (1, 2) and expected in text)
        return Tried(command, good and "Traceback" not in text, time.monotonic() - began_s, text)

    def run_in_copies(self, commands: Sequence[str]) -> Iterator[Tried]:
        """Run commands one after the other, each in a copy of the folder as it is now."""
        for command in commands:
            with tempfile.TemporaryDirectory(prefix="away-", dir=self.folder.parent) as copy:
                shutil.copytree(self.folder, copy, dirs_exist_ok=True)
                yield self.run(command, Path(copy))

    def stop(self) -> None:
        """Kill what runs, and start nothing more."""
        with self._lock:
            self._stopped = True
            for group in self._running:
                _kill(group)


def _program(command: str) -> str:
    """The command without what writes its input."""
    return re.sub(r"^echo .* \| ", "", command)


def _is_one_of(patterns: Sequence[str], command: str) -> bool:
    return any(re.match(pattern, _program(command)) for pattern in patterns)


def _kill(group: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)


def _served(process: subprocess.Popen[bytes], log: Path) -> int:
    """Press Ctrl-C some seconds after the first words of a command. Returns its exit code."""
    give_up_s = time.monotonic() + _MOST_S
    while not log.stat().st_size and process.poll() is None and time.monotonic() < give_up_s:
        time.sleep(0.2)
    with contextlib.suppress(subprocess.TimeoutExpired):
        return process.wait(_AFTER_FIRST_WORDS_S)
    os.killpg(process.pid, signal.SIGINT)
    return process.wait(60.0)


def _named(command: str, folder: Path) -> str:
    """The command with the names of what the first commands made."""
    for name, runs in (("RUN_FOLDER", "first"), ("OTHER_FOLDER", "second")):
        if (made := sorted((folder / runs).glob("*"))) and name in command:
            command = command.replace(name, str(made[0].relative_to(folder)))
    if "CHILD" in command:
        child = (folder / "child.txt").read_text()
        for name, words in (("CHILD_TAG", "DRIP entity tag"), ("CHILD_KEY", "public key")):
            (value,) = re.findall(rf"^{words} +(\S+)$", child, re.MULTILINE)
            command = command.replace(name, value)
    return command


def install(folder: Path, extras: str) -> Place:
    """Install the wheel and that of an example plug-in in an empty environment below the folder."""
    environment, dist, away = folder / "environment", folder / "dist", folder / "away"
    shutil.rmtree(dist, ignore_errors=True)
    for project in (ROOT, ROOT / "docs" / "examples" / "plugin-law"):
        build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(dist)]
        subprocess.run(build, cwd=project, check=True)
    (wheel,) = dist.glob("dmuca-*.whl")
    (plugin,) = dist.glob("dmuca_sidestep-*.whl")
    pip = [str(environment / "bin" / "pip"), "install", "--quiet", "--disable-pip-version-check"]
    if environment.exists():  # kept from before: only the wheels are new
        subprocess.run([*pip, "--force-reinstall", "--no-deps", str(wheel), str(plugin)], check=True)
        shutil.rmtree(away, ignore_errors=True)
    else:
        venv.create(environment, with_pip=True)
        subprocess.run([*pip, f"{wheel}[{extras}]" if extras else str(wheel)], check=True)
        subprocess.run([*pip, "--no-deps", str(plugin)], check=True)
    away.mkdir()
    read_files.write(away)
    return Place(away, environment)


def run_all(place: Place, commands: Sequence[str]) -> int:
    """Run the first commands, then all others, two and one that waits at a time. Returns how many failed."""
    failed = [place.run(command).told() for command in first_things()].count(False)
    waiting, lists = chains(dict.fromkeys(commands))

    def fails_of(chain: Sequence[str]) -> int:
        return [tried.told() for tried in place.run_in_copies(chain)].count(False)

    with ThreadPoolExecutor(2) as computing, ThreadPoolExecutor(1) as beside:
        futures = [beside.submit(fails_of, waiting), *(computing.submit(fails_of, chain) for chain in lists)]
        try:
            return failed + sum(future.result() for future in as_completed(futures))
        except BaseException:
            place.stop()
            for future in futures:
                future.cancel()
            raise


def main() -> int:
    """Install, run all commands and tell which failed. Returns 1 if one did."""
    parser = argparse.ArgumentParser(prog="python -m tests.installed", description=__doc__)
    parser.add_argument(
        "--extras",
        default=EXTRAS,
        help="extras to install (default: %(default)s); with train, hours are trained",
    )
    parser.add_argument("--only", metavar="PATTERN", help="run only the first commands and those that match")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="install there, and leave it there")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    # A shell without job control lets its background processes ignore Ctrl-C, and what they start as well.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    commands = [smaller(c) for c in commands_of_the_docs() if untried(c) is None]
    commands = [c for c in (*commands, *MORE) if re.search(arguments.only or "", c)]
    began_s = time.monotonic()
    try:
        with tempfile.TemporaryDirectory(prefix="dmuca-") as temporary:
            place = install(arguments.keep or Path(temporary), arguments.extras)
            print(f"installed in {time.monotonic() - began_s:.0f} s", flush=True)
            failed = run_all(place, commands)
    except subprocess.CalledProcessError as error:
        print(f"FAILED to install; pip needs a package index: {shlex.join(map(str, error.cmd))}")
        return 1
    except KeyboardInterrupt:
        print("interrupted")
        return 130
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    took_s, busy_s = time.monotonic() - began_s, usage.ru_utime + usage.ru_stime
    print(f"{failed} failed; {took_s:.0f} s, {busy_s:.0f} s of processor time")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
