"""The notebooks in docs/examples/notebooks run, and print what they show.

They are Python files in the percent format: `# %%` begins a cell of code, `# %% [markdown]` one of text. What
a cell prints stands at the beginning of the text after it, indented by four.
"""

from __future__ import annotations

import re
import sys
import tempfile
from pathlib import Path

import pytest

from companion import plugins

NOTEBOOKS = sorted((Path(__file__).parents[1] / "docs" / "examples" / "notebooks").glob("*.py"))


def cells(text):
    """Kind and content of each cell; of text without the comment signs."""
    _, *parts = re.split(r"^# %%(.*)\n", text, flags=re.MULTILINE)
    for kind, content in zip(parts[::2], parts[1::2], strict=True):
        if "[markdown]" in kind:
            yield "text", re.sub(r"^# ?", "", content, flags=re.MULTILINE)
        else:
            yield "code", content


@pytest.fixture
def forgotten(tmp_path, monkeypatch):
    """What a notebook writes, imports and installs is gone afterwards."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = set(sys.modules)
    yield
    for name in {name for name in sys.modules if "." not in name} - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]
    plugins.load.cache_clear()


def test_there_are_some():
    assert [path.stem for path in NOTEBOOKS] == ["channel", "environment", "orca", "own_law", "remote_id"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_prints_what_it_shows(path, capsys, forgotten):
    if path.stem == "environment":
        pytest.importorskip("torch")
        pytest.importorskip("pettingzoo")
    names = {"__name__": "notebook"}
    expected = None
    for kind, content in cells(path.read_text()):
        if kind == "code":
            assert not expected, "a cell whose output is not shown"
            exec(compile(content, str(path), "exec"), names)
            expected = capsys.readouterr().out
        else:
            shown = re.match(r"(?:    .*\n)*", content)[0]
            assert re.sub("^    ", "", shown, flags=re.MULTILINE) == (expected or "")
            expected = None
    assert not expected
