"""What the documents show is what the software takes."""

from __future__ import annotations

import importlib
import inspect
import re
import runpy
import textwrap
from pathlib import Path

import pytest

from companion import config as configuration
from companion.atmc.actions import SET_ACTIONS
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


def test_every_block_of_code_is_one_that_a_test_runs():
    """TOML is loaded and Python run here, test_extending.py applies differences, and drawings are not run."""
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
    kinds = {path.name: re.findall(r"^```(\w+)", path.read_text(), re.MULTILINE) for path in pages}
    run = {"toml", "python", "diff", "mermaid"}
    assert not {name: found for name, found in kinds.items() if set(found) - run}
    assert {name for name, found in kinds.items() if "diff" in found} == {"extending.md"}
    assert {name for name, found in kinds.items() if "python" in found} == {
        "install.md",
        "library.md",
        "plug-ins.md",
    }


def test_the_classes_of_the_page_on_plug_ins_can_be_written_so():
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "plug-ins.md").read_text(), re.DOTALL)
    assert len(blocks) == 3
    names: dict[str, object] = {"SET_ACTIONS": SET_ACTIONS}
    for block in blocks:
        exec(block, names)
    assert {"Sidestep", "Quiet", "TestUdp"} <= set(names)


def test_every_page_is_in_the_navigation_of_the_site_once():
    navigation = (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2]
    named = re.findall(r"- (\S+\.md)$", navigation, re.MULTILINE)
    assert len(named) == len(set(named))
    pages = {path.name for path in (ROOT / "docs").glob("*.md")}
    assert pages == {name for name in named if (ROOT / "docs" / name).exists()}


@pytest.fixture(scope="module")
def reference():
    """The generated pages of the reference."""
    return runpy.run_path(str(ROOT / "docs" / "site" / "reference.py"))


def test_the_reference_has_every_key_of_the_example_configuration(reference):
    page = reference["configuration"]()
    text = (ROOT / "config" / "companion.toml").read_text()
    keys = set(re.findall(r"^(?:# )?([a-z_0-9]+) = ", text, re.MULTILINE))
    assert len(keys) > 80
    for key in keys:
        assert f"| `{key}` |" in page, key
    for section in re.findall(r"^(?:# )?(\[+[a-z_]+\]+)", text, re.MULTILINE):
        assert f"## {section}" in page, section
    assert "any value" not in page.replace("table of any value", "")


def test_the_reference_has_ranges_and_defaults(reference):
    page = reference["configuration"]()
    assert "| `wait_s` | number, above 0, at most 600 | `10.0` | How long to wait" in page
    assert '| `use` | `"fly"`, `"guard"`, `"watch"` | `"watch"` |' in page
    assert "| `uas_id` | text (1 to 40) | must be given |" in page


def test_the_reference_has_every_public_name(reference):
    pages = reference["public_names"]()
    for name, module in reference["ROOM_PAGES"].items():
        for public in importlib.import_module(module).__all__:
            assert f"::: {module}.{public}\n" in pages[name]


def test_the_index_has_every_word_key_name_and_message_in_order(reference, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs" / "site")
    page = runpy.run_path(str(ROOT / "docs" / "site" / "alphabetical.py"))["page"]()
    for word in re.findall(r"\*\*(.+?)\*\* \|", (ROOT / "docs" / "glossary.md").read_text()):
        assert f"- {word.split(', ')[0]}: [glossary]" in page, word
    for key in re.findall(r"^(?:# )?([a-z_0-9]+) = ", (ROOT / "config" / "companion.toml").read_text(), re.M):
        assert f"- `{key}`: [configuration" in page, key
    for name, module in reference["ROOM_PAGES"].items():
        for public in importlib.import_module(module).__all__:
            assert f"- `{public}`: [{module}]({name}.md)" in page
    assert "- GLOBAL_POSITION_INT (33): [messages](messages.md)" in page
    headings = re.findall(r"^## (.+)$", page, re.MULTILINE)
    assert headings == sorted(set(headings))
    assert page.index("- `encode`:") < page.index("- gate: ") < page.index("- track: ")


def test_the_reference_has_the_messages(reference):
    page = reference["messages"]()
    assert "| GLOBAL_POSITION_INT (33) | 10/s |" in page
    assert "SET_POSITION_TARGET_LOCAL_NED (84)" in page
    assert "| `DMUCA: this flight is not recorded` |" in page
    assert len(reference["pilot_texts"]()) > 20


def test_the_figures_of_the_readme_are_those_of_the_table_of_peers():
    """Sums and ranges over the ten kinds of encounters, the first rows of the table."""
    page = (ROOT / "docs" / "peers-results.md").read_text()
    lines = iter(page.partition("## Encounters\n")[2].splitlines())
    heads = next(line for line in lines if line.startswith("| encounter |")).strip("| ").split(" | ")
    next(lines)
    rows = [next(lines).strip("| ").split(" | ") for _ in range(10)]
    readme = (ROOT / "README.md").read_text()
    for law, words in (
        ("none", "none"),
        ("fly-away", "ArduPilot's"),
        ("paper", "the published"),
        ("orca-constant:radius_m=22,horizon_s=20", "ORCA"),
        ("dmuca", "this"),
    ):
        column = [row[heads.index(law)].split(" / ") for row in rows]
        deviations = [float(entry[2]) for entry in column]
        found = re.search(rf"^\| {words}.* \| ([\d,]+) \| (.*?) ?\|$", readme, re.MULTILINE)
        assert int(found[1].replace(",", "")) == sum(int(entry[0]) for entry in column)
        if law != "none":
            assert found[2] == f"{min(deviations):.0f} to {max(deviations):.0f} m"
    lost = {law: sum(int(row[n].split(" / ")[0]) for row in rows) for n, law in enumerate(heads) if n > 0}
    fewest = min((law for law in lost if law != "dmuca"), key=lost.__getitem__)
    assert fewest == "orca-constant:radius_m=22,horizon_s=20"  # the readme calls it the peer that lost fewest
