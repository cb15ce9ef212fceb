"""The code that a result depends on, and its digest."""

from __future__ import annotations

import shutil

import pytest

from ground_tools.common import sources
from ground_tools.results import kept


def tree(root, **files):
    for name, text in files.items():
        path = root / "companion" / f"{name.replace('__', '/')}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def test_imports_are_followed_through_packages_to_where_a_name_is_defined(tmp_path):
    root = tree(
        tmp_path,
        top="from companion.room import useful\nimport os\n",
        room__useful_file="def useful():\n    from companion.room import deep\n",
        room__deep="X = 1\n",
        room__other="Y = 1\n",
    )
    init = "from companion.room.useful_file import useful\nfrom companion.room.other import Y\n"
    (root / "companion" / "room" / "__init__.py").write_text(init)
    found = sources.digests(["companion.top"], root)
    assert sorted(found) == ["companion.room.deep", "companion.room.useful_file", "companion.top"]


def test_imports_for_type_checkers_do_not_count(tmp_path):
    root = tree(
        tmp_path,
        top="from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from companion.a import A\n",
        a="A = int\n",
    )
    assert sorted(sources.digests(["companion.top"], root)) == ["companion.top"]


def test_a_module_that_is_missing_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"no module companion\.nothing"):
        sources.digests(["companion.nothing"], tmp_path)


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ('"""Other words."""\nX = 1\n', True),
        ("# A comment.\n\n\nX = 1  # another\n", True),
        ('X = 1\n"""What X is."""\n', True),
        ("X = 2\n", False),
        ('X = 1\nY = "# no comment"\n', False),
    ],
)
def test_only_code_counts(text, same):
    assert (sources.code_of(text) == sources.code_of("X = 1\n")) is same


def test_a_docstring_on_the_line_of_its_definition_counts_as_code():
    assert sources.code_of('class A(int): "Words."\n') != sources.code_of('class A(str): "Words."\n')


def test_a_number_sign_in_a_string_is_code():
    assert sources.code_of('Y = "#a"\n') != sources.code_of('Y = "#b"\n')


def test_a_changed_constant_of_the_law_affects_only_flown_results(tmp_path):
    """The campaign's tables, the closed loop and the city depend on the kernels; policies do not."""
    for package in ("companion", "ground_tools", "sitl_mocks"):
        shutil.copytree(
            sources.ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    entries = kept.entries()
    before = [sources.digests(entry.roots) for entry in entries]
    changed = tmp_path / "companion" / "avoidance" / "kernels" / "hard_planes.py"
    text = changed.read_text()
    assert "_STEPS = 40" in text
    changed.write_text(text.replace("_STEPS = 40", "_STEPS = 41"))
    after = [sources.digests(entry.roots, tmp_path) for entry in entries]
    hit = {entry.name for entry, old, new in zip(entries, before, after, strict=True) if old != new}
    flown = ("campaign/", "closed-loop/", "city-paper/", "city-policy/", "city-separation/")
    assert hit == {e.name for e in entries if any(name in e.name for name in flown)}
    assert len(hit) == 51
