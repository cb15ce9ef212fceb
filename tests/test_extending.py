"""The changes that docs/extending.md shows apply to this project, work, and touch no more than it says."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CHANGES = re.findall(
    r"```diff\n(.*?)```\n\nTried with: `pytest (\S+)`", (ROOT / "docs" / "extending.md").read_text(), re.S
)
CHANGED = [
    {"companion/radio/registry.py"},
    {"companion/laws.py"},
    {"companion/events/vehicle.py", "sitl_mocks/vehicle/firmware/behaviour.py"},
]
"""Files of the project that each change touches, beside those that it adds."""


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A copy of the project without the tests of others."""
    tree = tmp_path_factory.mktemp("extending")
    for folder in ("companion", "sitl_mocks", "tests/companion", "tests/support"):
        shutil.copytree(ROOT / folder, tree / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tree)
    return tree


def test_the_page_shows_three_changes():
    assert len(CHANGES) == len(CHANGED)


@pytest.mark.parametrize("number", range(len(CHANGED)), ids=["radio", "law", "firmware"])
def test_a_change_applies_and_works(tree, number):
    diff, test = CHANGES[number]
    assert set(re.findall(r"^--- a/(\S+)$", diff, re.M)) == CHANGED[number]
    # The copy is no repository, and must not be taken for a part of one that it may lie in.
    alone = os.environ | {"GIT_CEILING_DIRECTORIES": str(tree.parent)}
    tool = ["git", "apply"] if shutil.which("git") else ["patch", "-p1"]
    subprocess.run(tool, input=diff, text=True, check=True, cwd=tree, env=alone)
    # Compiling the kernels takes longer than running them uncompiled for these few decisions.
    flags = {"PYTHONPATH": str(tree), "NUMBA_DISABLE_JIT": "1"}
    words = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist", test]
    done = subprocess.run(words, cwd=tree, env=alone | flags, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
