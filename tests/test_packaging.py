"""The packages fit the project. Nothing is built here: `make packages` does that, in empty systems."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import dmuca
from companion.commands import cli

ROOT = Path(__file__).parents[1]
DOCKERFILE = (ROOT / "deploy" / "container" / "Dockerfile").read_text()
DEBIAN = ROOT / "deploy" / "debian"
SCRIPTS = sorted([*(ROOT / "tests" / "packaging").glob("*.sh"), *DEBIAN.glob("p*"), DEBIAN / "build.sh"])


def labels():
    """Labels of the image by name."""
    return dict(
        re.findall(r"(\w+)=(?:'|\")(.*?)(?:'|\")(?: \\)?$", DOCKERFILE.partition("\nLABEL ")[2], re.M)
    )


def test_the_image_is_of_this_version_and_its_labels_can_be_read():
    found = labels()
    assert found["version"] == dmuca.__version__
    for name in ("tags", "authors", "company", "links", "permissions"):
        json.loads(found[name])
    host = json.loads(found["permissions"])["HostConfig"]
    volumes = json.loads(re.search(r"^VOLUME (.*)$", DOCKERFILE, re.M)[1])
    assert {bind.partition(":")[2] for bind in host["Binds"]} == {*volumes, "/dev"}


def test_the_container_runs_commands_that_there_are_and_not_as_root():
    assert re.findall(r"^USER (.*)$", DOCKERFILE, re.M) == ["dmuca"]
    (program,) = json.loads(re.search(r"^ENTRYPOINT (.*)$", DOCKERFILE, re.M)[1])
    assert program == "companion"
    for key in ("CMD", r"    CMD"):
        for words in re.findall(rf"^{key} (\[.*\])$", DOCKERFILE, re.M):
            arguments = [word for word in json.loads(words) if word != program]
            cli._parser(arguments).parse_args(arguments)


def test_the_debian_package_stands_where_the_unit_expects_it():
    unit = (ROOT / "deploy" / "dmuca-companion.service").read_text()
    (program,) = re.findall(r"^ExecStart=(\S+)", unit, re.M)
    build = (DEBIAN / "build.sh").read_text()
    environment = "/opt/dmuca/.venv"
    assert program == f"{environment}/bin/companion"
    assert f"python3 -m venv {environment}" in build
    made = (DEBIAN / "postinst").read_text()
    for path in ("/var/lib/dmuca", "/var/cache/dmuca", "/etc/dmuca"):
        assert path in made
    assert set(re.findall("@[A-Z_]+@", (DEBIAN / "control").read_text())) == set(
        re.findall("@[A-Z_]+@", build)
    )


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.name)
def test_the_scripts_can_be_read_by_a_shell(script):
    subprocess.run(["sh", "-n", script], check=True)
    if shutil.which("shellcheck"):
        done = subprocess.run(["shellcheck", "-x", script], cwd=script.parent, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("script", ["try_plugins", "try_lowest", "try_install", "try_deb", "try_image"])
def test_a_script_that_cannot_run_says_what_it_lacks(tmp_path, script):
    for tool in ("dirname", "realpath", "id", "dpkg", "sh"):
        (tmp_path / tool).symlink_to(shutil.which(tool) or "/bin/false")
    wheel = tmp_path / "dmuca.whl"
    wheel.write_bytes(b"")
    done = subprocess.run(
        [shutil.which("sh"), ROOT / "tests" / "packaging" / f"{script}.sh", wheel],
        env={"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    in_systems = "mmdebstrap" if os.getuid() == 0 else "root"
    by_pip = dict.fromkeys(("try_plugins", "try_lowest"), "python3")
    missing = {**by_pip, "try_image": "podman"}.get(script, in_systems)
    assert done.returncode == 77, done.stderr
    assert re.match(rf"SKIPPED: .*{missing}", done.stdout), done.stdout
