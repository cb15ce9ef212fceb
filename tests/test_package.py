"""What the wheel and the source archive hold, and the import name `dmuca`."""

import importlib
import re
import shlex
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

import companion
import dmuca
from companion.commands import cli as companion_cli
from ground_tools import cli as tools_cli
from sitl_mocks import cli as mocks_cli
from tests import installed
from tests.support.encounter_models import NAMES

ROOT = Path(__file__).parents[1]
PACKAGES = ("dmuca", "companion", "sitl_mocks", "ground_tools")
SHIPPED = ("config/channel", "config/policies", "config/regions", "config/scenarios", "results")
CONFIGURATIONS = ("ardupilot-serial", "ardupilot-udp", "companion", "fence", "px4-udp", "trajectory")


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """Wheel and source archive, built from this checkout."""
    out = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (wheel,), (source,) = out.glob("*.whl"), out.glob("*.tar.gz")
    with tarfile.open(source) as archive:
        return zipfile.ZipFile(wheel).namelist(), [name.partition("/")[2] for name in archive.getnames()]


def kept(top):
    """Files of a folder of the checkout that belong to the project."""
    files = (p for p in (ROOT / top).rglob("*") if p.is_file() and "__pycache__" not in p.parts)
    made_anew = {f"results/city-paper/{name}" for name in ("city.png", "runs.parquet", "table.csv")}
    made_anew |= {"results/atmc/closed-loop.png", "results/city-separation/city-separation.png"}
    return {str(p.relative_to(ROOT)) for p in files} - made_anew


def test_the_wheel_holds_all_code_and_all_data(archives):
    wheel, _ = archives
    code = set().union(*(kept(package) for package in PACKAGES))
    data = set().union(*(kept(top) for top in SHIPPED)) | {f"config/{name}.toml" for name in CONFIGURATIONS}
    assert len(data) > 60
    inside = {name for name in wheel if not name.startswith("dmuca-")}
    assert inside == code | {f"dmuca/{name}" for name in data}


def test_the_wheel_takes_named_files_only_from_the_folder_that_users_edit():
    """A checkout's config folder may hold keys and the user's own configurations."""
    build = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]
    assert "config" not in build["targets"]["wheel"]["only-include"]
    assert {"*.pem", "*.key"} <= set(build["exclude"])


def test_the_source_archive_holds_what_a_wheel_is_built_from(archives):
    _, source = archives
    for top in (*PACKAGES, *SHIPPED, "docs", "tests", "deploy"):
        assert kept(top) <= set(source)
    assert {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md"} <= set(source)


def test_the_project_has_one_version():
    assert dmuca.__version__ == companion.__version__ == metadata.version("dmuca")


def test_the_guessable_name_leads_to_the_public_rooms():
    assert set(dmuca.ROOMS) <= set(dir(dmuca))
    for name, module in dmuca.ROOMS.items():
        assert getattr(dmuca, name).__name__ == module
    with pytest.raises(AttributeError, match="its rooms are remote_id, traffic"):
        dmuca.no_such_room  # noqa: B018 - the access itself is tested


@pytest.mark.parametrize(("name", "module"), dmuca.ROOMS.items())
def test_a_room_is_imported_by_its_short_name_as_one_module(name, module):
    """`from dmuca.remote_id import encode` is what a user writes first."""
    short, long = importlib.import_module(f"dmuca.{name}"), importlib.import_module(module)
    assert short is long
    assert getattr(dmuca, name) is long


def test_the_name_alone_loads_nothing_heavy():
    code = "import dmuca, sys; print(dmuca.__version__, *sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True
    )
    assert loaded.stdout.startswith(dmuca.__version__)
    assert not {"numpy", "numba", "torch"} & set(loaded.stdout.split())


def test_every_command_of_the_docs_is_tried_in_an_empty_environment_or_known_to_need_more():
    """What `python -m tests.installed` runs; a pattern that no command needs any more is a mistake."""
    commands = installed.commands_of_the_docs()
    tried = [command for command in commands if installed.untried(command) is None]
    assert len(tried) > 90
    for pattern in installed.UNTRIED:
        assert any(re.search(pattern, command) for command in commands), pattern
    for pattern, _ in installed.SMALLER:
        assert any(re.search(pattern, command) for command in commands), pattern
    left = [c for c in map(installed.smaller, tried) if re.search(r"\b(NAME|OTHER|FILE|DIR|RUN|CASES)\b", c)]
    assert not left, "placeholders without a file"


HERE = {
    "my.toml",
    "companion.toml",
    "watch.toml",
    "guard.toml",
    "capture.pcapng",
    "super8.scn",
    "wall.scn",
    "Flight_intention_very_low_40_8_W1.csv",
    *(f"{name}.txt" for name in NAMES),
    "00000042.BIN",
    "flight.ulg",
    "drone1.ulg",
    "drone2.ulg",
    "incident.toml",
}
"""Files that `python -m tests.installed` makes before or while it runs the commands."""
READ = r"(?<!\S)(?!RUN_FOLDER)(?:[\w./-]+/)?[\w.-]+\.(?:toml|tlog|BIN|ulg|scn|csv|txt|pcapng)(?!\S)"


def test_what_a_tried_command_reads_is_there():
    commands = filter(lambda command: installed.untried(command) is None, installed.commands_of_the_docs())
    for command in map(installed.smaller, commands):
        for file in re.findall(READ, command):
            assert file in HERE or file.startswith("config/"), command
            assert file in HERE or (ROOT / file).is_file(), command


MAINS = {"companion": companion_cli, "sitl-mocks": mocks_cli, "ground-tools": tools_cli}


@pytest.mark.parametrize(
    "page", sorted({*installed.PAGES, ROOT / "docs" / installed.FOLLOWED}), ids=lambda p: p.stem
)
def test_every_command_line_of_a_page_is_one_that_its_parser_takes(page, monkeypatch):
    """Also of those that need hardware or hours, which nothing runs."""
    for module in MAINS.values():
        monkeypatch.setattr(module, "run_command", lambda parser, argv: parser.parse_args(argv))
    for command in installed.commands_of([page]):
        command = re.sub(r"^echo .* \| | \[[^]]*\]| \d?[<>].*| &$", "", command)
        name, *words = shlex.split(command)
        MAINS[name].main(words)


def test_the_citation_is_of_this_version():
    lines = (ROOT / "CITATION.cff").read_text().splitlines()
    assert f"version: {dmuca.__version__}" in lines
