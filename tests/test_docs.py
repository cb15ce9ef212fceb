"""What the documents show is what the software takes."""

from __future__ import annotations

import importlib
import inspect
import re
import textwrap
from pathlib import Path

import pytest

from companion import config as configuration
from sitl_mocks.encounters import scenario_file

ROOT = Path(__file__).parents[1]
IDENTITY = '[identity]\nuas_id = "1596B0000DMUCA01"\n'
BLOCKS = [
    (path.name, number, block)
    for path in sorted((ROOT / "docs").glob("*.md"))
    for number, block in enumerate(re.findall(r"```toml\n(.*?)```", path.read_text(), re.S))
]


@pytest.mark.parametrize(("name", "number", "block"), BLOCKS, ids=lambda v: str(v)[:24])
def test_configurations_in_the_documents_load(tmp_path, name, number, block):
    path = tmp_path / "c.toml"
    if "[air]" in block:  # a scenario
        path.write_text(block)
        scenario_file.load(path)
        return
    path.write_text(block if "[identity]" in block else IDENTITY + block)
    configuration.load(path)


def test_there_are_some():
    assert {name for name, _, _ in BLOCKS} >= {"channel.md", "radios.md"}


def test_relative_links_lead_somewhere():
    for path in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", path.read_text()):
            if "://" not in target:
                assert (path.parent / target).exists(), f"{path.name}: {target}"


@pytest.mark.parametrize(("page", "count"), [("library.md", 5), ("install.md", 1)])
def test_the_examples_of_a_page_print_what_it_shows(tmp_path, monkeypatch, capsys, page, count):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / page).read_text()
    examples = re.findall(r"```python\n(.*?)```\n\n((?:    [^\n]*\n)+)", text, re.S)
    assert len(examples) == text.count("```python") == count
    names: dict[str, object] = {}
    for code, printed in examples:
        exec(code, names)
        assert capsys.readouterr().out == textwrap.dedent(printed)


@pytest.mark.parametrize(
    "room",
    [
        "companion.remote_id",
        "companion.traffic",
        "companion.avoidance",
        "companion.atmc",
        "sitl_mocks.channel",
        "ground_tools.atmc",
    ],
)
def test_each_library_exports_documented_names(room):
    module = importlib.import_module(room)
    assert len(module.__all__) == len(set(module.__all__))
    for name in module.__all__:
        public = getattr(module, name)
        if inspect.isclass(public) or inspect.isfunction(public):
            assert public.__doc__, f"{room}.{name}"
    with pytest.raises(AttributeError):
        module.no_such_name  # noqa: B018 - the access itself is tested
