"""The reports of `ground-tools results` on kept files."""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace

import msgspec
import pytest

from companion.errors import ConfigError
from companion.shipped import shipped
from ground_tools import cli
from ground_tools.campaign import tables
from ground_tools.campaign.encounters import command as encounters
from ground_tools.campaign.encounters import table
from ground_tools.common import provenance, table_file
from ground_tools.common.kept_lines import read_lines
from ground_tools.paper.closed_loop.flights import Row
from ground_tools.results import command, kept, samples
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


def test_a_file_that_was_changed_by_hand_is_not_todays(some, capsys):
    entry, _ = some
    assert cli.main(["results", "record", "--made"]) == 0
    entry.path.write_text("2")
    for options in ((), ("--sample",)):
        code, out = verify(capsys, *options)
        assert code == 1
        assert f"{NAME}: its content is not the one that was recorded\n" in out
    assert cli.main(["results", "record"]) == 1
    assert "--made says that" in capsys.readouterr().out
    assert provenance.read(entry.path).content != provenance.content_of(entry.path)
    assert cli.main(["results", "record", "--made"]) == 0
    assert verify(capsys)[0] == 0


@pytest.mark.parametrize("text", ["", "1 "])
def test_an_empty_file_and_one_more_byte_are_noticed(some, capsys, text):
    entry, _ = some
    assert cli.main(["results", "record", "--made"]) == 0
    entry.path.write_text(text)
    assert verify(capsys)[0] == 1


def test_a_file_that_is_gone_is_not_todays_and_is_not_recorded(some, capsys):
    entry, _ = some
    assert cli.main(["results", "record", "--made"]) == 0
    entry.path.unlink()
    for options in ((), ("--sample",)):
        code, out = verify(capsys, *options)
        assert code == 1
        assert f"{NAME}: there is no such file\n" in out
    assert cli.main(["results", "record", "--made"]) == 1
    assert "not recorded: there is no such file" in capsys.readouterr().out


def test_a_record_without_the_content_is_no_proof_of_it(some, capsys):
    """Such a record is written before the first row of the file."""
    entry, _ = some
    provenance.write(entry.path, entry.now())
    code, out = verify(capsys)
    assert code == 1
    assert "its content was not recorded" in out
    assert cli.main(["results", "record"]) == 0
    assert verify(capsys)[0] == 0


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


def test_without_a_package_that_made_it_no_sample_is_made(some, monkeypatch, capsys):
    """An installed copy has neither torch nor the library of the cross-check."""
    entry, _ = some
    monkeypatch.setattr(kept, "entries", lambda: [replace(entry, packages=("numpy", "no_such_package"))])
    code, out = verify(capsys, "--sample")
    assert code == 1
    assert out.splitlines()[1] == "    no sample was made: no_such_package is not installed"


def test_without_a_sample_the_record_decides_and_none_is_written(some, monkeypatch, capsys):
    """A sample may need a library or files that are not part of the project."""
    entry, _ = some

    def missing(path):
        raise provenance.CannotSampleError("the library is not installed")

    monkeypatch.setattr(kept, "entries", lambda: [replace(entry, remake=missing)])
    assert cli.main(["results", "record"]) == 1
    assert "not recorded: no sample of it can be made: the library is not inst" in capsys.readouterr().out
    code, out = verify(capsys, "--sample")
    assert (code, out.splitlines()[:2]) == (
        1,
        [f"{NAME}: made by unknown code", "    no sample was made: the library is not installed"],
    )
    assert cli.main(["results", "record", "--made"]) == 0
    capsys.readouterr()
    code, out = verify(capsys, "--sample")
    assert (code, out) == (
        0,
        f"{NAME}: made by today's code and data\n    no sample was made: the library is not installed\n",
    )


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


def test_the_command_of_a_table_flies_the_seeds_that_the_file_holds():
    for name in tables.TABLES:
        (entry,) = [e for e in kept.entries() if e.name == f"results/campaign/{name}.json"]
        first, last = table_file.read(entry.path, tables.Kept).seeds
        assert f" --seeds {first}-{last} " in entry.command


@pytest.mark.parametrize("name", ["encounters", "encounters-range"])
def test_the_command_of_crewed_encounters_names_what_the_file_holds(name):
    (entry,) = (entry for entry in kept.entries() if entry.path.stem == name)
    parser = argparse.ArgumentParser()
    encounters.add_arguments(parser)
    args = parser.parse_args(entry.command.split()[3:])
    combinations = itertools.product(args.range, args.altitude, args.own, (path.stem for path in args.model))
    file = table_file.read(entry.path, table.Kept)
    of_file = [(x.cell.range_m, x.cell.altitude, x.cell.own, x.cell.model) for x in file.lines]
    assert list(combinations) == of_file
    assert args.seeds == "{}-{}".format(*file.seeds)


# ---------------------------------------------------------------- samples


@pytest.fixture
def twins(tmp_path, monkeypatch):
    """A copy of a small table, whose flights are not flown again."""
    path = tmp_path / "twins.json"
    table = table_file.read(shipped("results/campaign/twins.json"), tables.Kept)
    firsts = {line.cell: line.first for line in table.lines}
    monkeypatch.setattr(samples.campaign, "fly", lambda cell, seeds: [firsts[cell]])
    table_file.write(path, table)
    return path, table


def test_a_table_is_equal_to_itself(twins):
    assert samples.campaign_table(twins[0]) == []


def test_a_table_without_lines_is_no_equal_sample(twins):
    path, table = twins
    table_file.write(path, msgspec.structs.replace(table, lines=()))
    assert samples.campaign_table(path) == ["the file holds no line"]


def test_a_table_that_lacks_a_line_or_flights_differs(twins):
    path, table = twins
    table_file.write(path, msgspec.structs.replace(table, lines=table.lines[:-1]))
    (word,) = samples.campaign_table(path)
    assert "it has 1 of 2" in word
    short = msgspec.structs.replace(table.lines[0], found=table.lines[0].found | {"runs": 999})
    table_file.write(path, msgspec.structs.replace(table, lines=(short, *table.lines[1:])))
    (word,) = samples.campaign_table(path)
    assert "999 flights" in word


def test_a_first_flight_that_comes_out_otherwise_differs(twins):
    path, table = twins
    line = table.lines[0]
    other = msgspec.structs.replace(line.first, separation_m=line.first.separation_m + 1.0)
    table_file.write(
        path,
        msgspec.structs.replace(table, lines=(msgspec.structs.replace(line, first=other), *table.lines[1:])),
    )
    (word,) = samples.campaign_table(path)
    assert "least separation" in word


@pytest.mark.parametrize(
    ("left_out", "missing"), [(slice(1, 2), 1), (slice(100, 201), 101), (slice(1, None), 200)]
)
def test_a_file_of_the_closed_loop_that_lacks_rows_differs(tmp_path, monkeypatch, left_out, missing):
    lines = shipped("results/atmc/closed-loop/sparse-rule.jsonl").read_text().splitlines(keepends=True)
    path = tmp_path / "sparse-rule.jsonl"
    path.write_text("".join(lines))
    first = read_lines(path, Row)[1][0]
    monkeypatch.setattr(samples, "rows_of", lambda flight: [first])
    assert samples.closed_loop_cell(path) == []
    del lines[left_out]
    path.write_text("".join(lines))
    assert samples.closed_loop_cell(path) == [f"{missing} of 200 encounters are missing"]
