"""`python -m tests.installed` runs the commands of the docs from the wheel, in an empty environment.

Nothing of the checkout is in reach of these commands: they run in a folder of their own, with the interpreter
of the environment. What the docs count in hours is run with small numbers instead (`SMALLER`). `UNTRIED` has
the commands that need what such an environment lacks; `tests/test_package.py` holds that each command of the
docs is either run or in that list.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tests.support import onboard_logs

ROOT: Final = Path(__file__).parents[1]
EXTRAS: Final = "inspect"
SMALLER: Final = (
    (r"--seeds \d+-\d+", "--seeds 1-2"),
    (r"--samples \d+", "--samples 4"),
    (r"--encounters \d+", "--encounters 1"),
    (r"--cases \d+", "--cases 20"),
    (r"--duration \d+", "--duration 10"),
    (r"--evaluations \d+", "--evaluations 2"),
    (r"--hours 24", "--hours 0.01"),
    (r"--real \d+ --jobs 3", "--real 1 --jobs 1"),
    (r"--worst 3", "--worst 1"),
    (r"--seconds \d+", "--seconds 2"),
    (r"--aircraft 10", "--aircraft 3"),
    (r"^(sitl-mocks demo)(?!.*(--aircraft|head_on|incident))", r"\1 --aircraft 2"),
    (r" \[[^]]*\]", ""),
    (r"^companion init", "companion init --force"),
    (r"--out /etc/dmuca/", "--out "),
    (r"paper (all|readings)(?!.*--samples)", r"paper \1 --samples 4"),
    (r"paper closed-loop(?!.*--out|.*--encounters)", "paper closed-loop --encounters 1"),
    (r"paper closed-loop --encounters", "paper closed-loop --crowd 2 --out runs/loop --encounters"),
    (r"^(ground-tools channel (table|plot))(?!.*--samples)", r"\1 --samples 4"),
    (r"^(ground-tools city .*)--size \d+ \d+", r"\1--size 1 1 --minutes 0.2 --settle 2"),
    (r"runs/(NAME|A)", "RUN_FOLDER"),
    (r"runs/(OTHER|B)", "OTHER_FOLDER"),
    (r"(FLIGHT|flight)\.tlog", "RUN_FOLDER/DMUCA001.tlog"),
    (r"\bDIR\b", "tables"),
    (r"\bFILE\.kml", "flight.kml"),
    (r"--policy FILE", "--policy config/policies/atmc.safetensors"),
    (r"CASES\.json", "cases.json.gz"),
    (r"vectors\.json", "vectors.json.gz"),
    (r"--child \S+ --child-key \S+", "--child 2001:3f:fe00:a05:260e:d437:6b25:6e28 --child-key CHILD_KEY"),
)
"""Pairs of a pattern in a command of the docs and what stands there instead when it is tried."""
SERVES: Final = (
    r"sitl-mocks (serve|ether)",
    r"companion run",
    r"companion status",
    r"companion remote-id listen",
    r"ground-tools inspect .*(--web|--live)",
)
"""Commands that go on until Ctrl-C, which is pressed after a few seconds."""
UNTRIED: Final = {
    r"--law (sidestep|daidalus)": "a plug-in; tests/packaging/try_plugins.sh tries the former",
    r"--scn |encounters --model": "files of others, which are downloaded",
    r"bench-test (bench|watch|guard|pair)": "the run of a stage; its tests are in tests/companion/commands",
    r"listen .*hci=": "a radio",
    r"companion remote-id decode capture": "a capture",
    r"ground-tools fly": "a vehicle, and the extra fly",
    r"ground-tools atmc (train|evaluate|freeze|sweep|crosscheck)": "the extra train, and hours",
    r"campaign (attacks|table|fences|peers)": "many minutes even with the smallest numbers",
    r"--sweep": "many minutes even with the smallest numbers",
    r"--schedule": "a file that only a failed examination writes",
    r"results (verify --sample|record)": "a checkout, or the extra train",
    r"sitl-mocks (soak|swarm .*--faults|takeover .*(--trouble|--real|--only))": "many minutes",
    r"paper city": "an hour of CPU time; a small one is among `MORE`",
    r"paper (dmuca|all)": "minutes; the parts of `paper all` are tried one by one",
}
"""Patterns of commands that are not tried, and what each would need."""
MORE: Final = (
    "python -c 'import dmuca; print(dmuca.__version__, dmuca.remote_id.encode, dmuca.channel.Analytic)'",
    "ground-tools paper convergence",
    "ground-tools paper decision-time --samples 4",
    "ground-tools paper system-delay --samples 4",
    "ground-tools paper uav-delay --samples 4",
    "ground-tools paper fixed-modes --samples 4",
    "ground-tools paper city --densities 8 --aircraft 12 --minutes 0.5 --settle 10 --methods fixed perfect",
    "ground-tools picture RUN_FOLDER --out picture.png",
    "sitl-mocks demo --scenario incident.toml",
    "companion remote-id --help",
)
"""Commands beside those of the docs."""
FAILS: Final = {
    r"companion check": "check: NOT ready",
    r"companion (status|display)": "no companion runs on this computer",
    r"ground-tools results verify": "make it again",
}
"""Commands that end with exit code 1 or 2 here, and what they say."""
FOLLOWED: Final = "getting-started.md"
"""Page whose commands belong together; tests/integration/test_getting_started.py runs them."""
PAGES: Final = (
    *sorted(path for path in (ROOT / "docs").glob("*.md") if path.name != FOLLOWED),
    ROOT / "README.md",
    ROOT / "results" / "README.md",
)
_SERVED_S: Final = 12.0
_MOST_S: Final = 900.0


def commands_of_the_docs() -> list[str]:
    """Each command line of the docs once, in the order of the pages."""
    return commands_of(PAGES)


def commands_of(pages: Sequence[Path]) -> list[str]:
    """Each command line of some pages once, without its comment."""
    found: dict[str, None] = {}
    for page in pages:
        text = re.sub(r"\s*\\\n\s*", " ", page.read_text())
        for line in re.findall(r"^    ((?:companion|sitl-mocks|ground-tools) .*)", text, re.MULTILINE):
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
    yield "companion remote-id key hda.pem --raa 16376 --hda 10"


@dataclass(frozen=True, slots=True)
class Place:
    """An empty environment with the wheel, and a folder far from the checkout."""

    folder: Path
    environment: Path

    def run(self, command: str) -> tuple[bool, str]:
        """Run a command as a user would. Returns whether it did what it should, and its output."""
        log = self.folder / "output.txt"
        path = f"{self.environment / 'bin'}:{os.environ['PATH']}"
        with log.open("w") as output:
            process = subprocess.Popen(
                ["bash", "-c", self._named(command)],
                cwd=self.folder,
                env=os.environ | {"PATH": path, "PYTHONPATH": ""},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            serves = any(re.match(pattern, command) for pattern in SERVES)
            try:
                code: int | None = process.wait(_SERVED_S if serves else _MOST_S)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGINT)
                code = process.wait(30.0) if serves else None
        text = log.read_text()
        expected = next((words for pattern, words in FAILS.items() if re.match(pattern, command)), None)
        if expected is not None and code in (1, 2):
            return expected in text, text
        good = code == 0 or (serves and code in (130, -signal.SIGINT))
        return good and "Traceback" not in text, text

    def _named(self, command: str) -> str:
        for name, runs in (("RUN_FOLDER", "first"), ("OTHER_FOLDER", "second")):
            if (made := sorted((self.folder / runs).glob("*"))) and name in command:
                command = command.replace(name, str(made[0].relative_to(self.folder)))
        return command.replace("CHILD_KEY", "82ab" * 16)


def install(folder: Path, extras: str) -> Place:
    """Build the wheel, and install it in an empty environment below the folder."""
    environment, dist, away = folder / "environment", folder / "dist", folder / "away"
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(dist)]
    subprocess.run(build, cwd=ROOT, check=True)
    (wheel,) = dist.glob("*.whl")
    pip = [str(environment / "bin" / "pip"), "install", "--quiet", "--disable-pip-version-check"]
    if environment.exists():  # kept from before: only the wheel is new
        subprocess.run([*pip, "--force-reinstall", "--no-deps", str(wheel)], check=True)
        shutil.rmtree(away, ignore_errors=True)
    else:
        venv.create(environment, with_pip=True)
        subprocess.run([*pip, f"{wheel}[{extras}]" if extras else str(wheel)], check=True)
    away.mkdir()
    law = (ROOT / "docs" / "examples" / "plugin-law" / "dmuca_sidestep.py").read_text()
    (away / "mine.py").write_text(law.replace("Sidestep", "Law"))
    for name in ("orca_cases.json.gz", "vectors.json.gz"):
        shutil.copy(ROOT / "tests" / "data" / name, away / name.removeprefix("orca_"))
    onboard_logs.copter(away / "00000042.BIN")
    for name in ("flight.ulg", "drone1.ulg", "drone2.ulg"):
        onboard_logs.px4(away / name)
    return Place(away, environment)


def main() -> int:
    """Install, run all commands and tell which failed. Returns 1 if one did."""
    parser = argparse.ArgumentParser(prog="python -m tests.installed", description=__doc__)
    parser.add_argument("--extras", default=EXTRAS, help="extras to install (default: %(default)s)")
    parser.add_argument("--only", metavar="PATTERN", help="run only the first commands and those that match")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="install there, and leave it there")
    arguments = parser.parse_args()
    commands = [smaller(c) for c in commands_of_the_docs() if untried(c) is None]
    commands = [c for c in (*commands, *MORE) if re.search(arguments.only or "", c)]
    with tempfile.TemporaryDirectory(prefix="dmuca-") as temporary:
        place = install(arguments.keep or Path(temporary), arguments.extras)
        failed = 0
        for command in dict.fromkeys((*first_things(), *commands)):
            began_s = time.monotonic()
            good, text = place.run(command)
            took_s = time.monotonic() - began_s
            print(f"{'ok    ' if good else 'FAILED'} {took_s:5.0f} s  {command}", flush=True)
            if not good:
                failed += 1
                print("    " + "\n    ".join(text.splitlines()[-12:]), flush=True)
    print(f"{failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
