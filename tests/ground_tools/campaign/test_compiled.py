"""The campaign's functions are recompiled when any part of them changes."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from ground_tools.campaign import compiled, flight, outcome, powers, vehicles

PACKAGE = "ground_tools.campaign."


@pytest.mark.parametrize("module", [flight, outcome, powers, vehicles])
def test_the_cache_depends_on_all_compiled_files(module):
    tree = ast.parse(Path(module.__file__).read_text())
    used = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    campaign = {name.removeprefix(PACKAGE) for name in used if name.startswith(PACKAGE)} - {"compiled"}
    assert campaign
    assert campaign <= {path.stem for path in compiled.SOURCES}
