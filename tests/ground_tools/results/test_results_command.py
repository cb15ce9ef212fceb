"""The reports of `ground-tools results` on kept files."""

from __future__ import annotations

import msgspec
import pytest

from companion.errors import ConfigError
from companion.shipped import shipped
from ground_tools import cli
from ground_tools.common import provenance
from ground_tools.results import command, kept
from ground_tools.results.kept import Entry

NAME = "results/some.json"


@pytest.fixture
def some(tmp_path, monkeypatch):
    """One kept file in a separate folder, whose sample has the differences `differs`."""
    monkeypatch.setattr(kept, "shipped", lambda name: tmp_path / name)
    (tmp_path / "results").mkdir()
    (tmp_path / NAME).write_text("1")
    differs = []
    entry = Entry(NAME, "make it", ("companion.errors",), lambda path: differs, packages=("numpy",))
    monkeypatch.setattr(kept, "entries", lambda: [entry])
    return entry, differs


def verify(capsys, *options):
    code = cli.main(["results", "verify", *options])
    return code, capsys.readouterr().out


def test_a_file_without_a_record_is_of_unknown_origin(some, capsys):
    code, out = verify(capsys)
    assert code == 1
    assert out == f"{NAME}: made by unknown code\n    make it again: make it\n"


def test_a_recorded_file_is_current_until_its_code_changes(some, capsys):
    entry, _ = some
    assert cli.main(["results", "record", "--made"]) == 0
    record = provenance.read(entry.path)
    assert record.evidence == "made"
    assert list(record.sources) == ["companion.errors"]
    assert verify(capsys)[0] == 0
    old = msgspec.structs.replace(record, sources={"companion.errors": "0", "companion.gone": "1"})
    provenance.write(entry.path, old)
    code, out = verify(capsys)
    assert code == 1
    assert "made by other code or data; --sample tells" in out
    assert "changed since: companion.errors\n    changed since: companion.gone\n" in out
    assert "make it again: make it" in out


def test_an_equal_sample_is_sufficient(some, capsys):
    code, out = verify(capsys, "--sample")
    assert (code, out) == (0, f"{NAME}: made by other code or data; a sample made again is the same\n")


def test_a_sample_that_differs_is_named_and_nothing_is_recorded(some, capsys):
    entry, differs = some
    differs += ["one", "two", "three", "four"]
    code, out = verify(capsys, "--sample")
    assert code == 1
    assert "    one\n    two\n    three\n    and 1 more\n" in out
    assert cli.main(["results", "record"]) == 1
    assert "not recorded: one" in capsys.readouterr().out
    assert provenance.read(entry.path) is None


def test_a_record_after_a_sample_says_so(some):
    entry, _ = some
    assert cli.main(["results", "record", str(entry.path)]) == 0
    assert provenance.read(entry.path).evidence == "sample"


def test_changed_data_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(provenance, "shipped", lambda name: tmp_path / name)
    data = tmp_path / "data.toml"
    data.write_text("a = 1")
    before = provenance.now("make it", (), ("data.toml",), ())
    data.write_text("# The first number.\na = 1  # m\n")
    assert not provenance.changes(before, provenance.now("make it", (), ("data.toml",), ()))
    data.write_text("a = 2")
    assert provenance.changes(before, provenance.now("make it", (), ("data.toml",), ())) == ["data.toml"]


def test_a_path_that_is_no_kept_file_is_refused(some, tmp_path):
    with pytest.raises(ConfigError, match="no kept result"):
        command.chosen_of([tmp_path / "other"])


def test_a_damaged_record_is_named(some, capsys):
    entry, _ = some
    provenance.beside(entry.path).write_text("{")
    assert cli.main(["results", "verify"]) == 2
    assert "some.json.made.json" in capsys.readouterr().err


def test_every_listed_file_is_there_and_every_kept_file_is_listed():
    entries = kept.entries()
    assert [e.name for e in entries if not e.path.is_file()] == []
    listed = {e.path for e in entries}
    text = {".md"}
    root = shipped("results")
    there = {p for p in root.rglob("*") if p.is_file() and p.suffix not in text and ".made." not in p.name}
    # The command makes these files from the kept runs, and git ignores them.
    there -= {root / "city-paper" / name for name in ("city.png", "runs.parquet", "table.csv")}
    there -= {root / "city-separation" / "city-separation.png"}
    assert there <= listed
