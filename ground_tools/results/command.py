"""The command `ground-tools results`: reports which kept results the present software still makes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal

import msgspec
from rich.console import Console

from companion.errors import ConfigError
from companion.shipped import CHECKOUT, given
from ground_tools.common import provenance
from ground_tools.common.progress import progress
from ground_tools.results import kept
from ground_tools.results.kept import Entry

Status = Literal["current", "unchanged", "changed", "outdated", "unknown", "unsealed", "edited", "missing"]
_WORDS: Final = {
    "current": "made by today's code and data",
    "unchanged": "made by other code or data; a sample made again is the same",
    "changed": "made by other code or data; --sample tells whether a sample is still the same",
    "outdated": "not what today's software makes",
    "unknown": "made by unknown code",
    "unsealed": "made by today's code and data, but its content was not recorded",
    "edited": "its content is not the one that was recorded",
    "missing": "there is no such file",
}
_GOOD: Final = frozenset({"current", "unchanged"})
_SHOWN: Final = 3
"""Most changed sources, or differences of a sample, that are shown for each file."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools results`."""
    parser.description = "Find out which of the kept results today's software still makes."
    actions = parser.add_subparsers(dest="action", required=True, metavar="COMMAND")
    verify = actions.add_parser(
        "verify",
        help="compare the code and data that made each file with today's",
        description="Compare the code and data that made each kept file with today's. Exit code 1 if a file "
        "is not known to be what today's software makes.",
        epilog="examples: ground-tools results verify; ground-tools results verify --sample results/campaign",
    )
    record = actions.add_parser(
        "record",
        help="record today's code and data for files that were just made",
        description="Record today's code and data beside each file, after a sample of it was made again and "
        "was the same. Nothing is recorded for the others; exit code 1 if there are any.",
    )
    for command in (verify, record):
        command.add_argument("paths", nargs="*", type=given, metavar="PATH",
                             help="files, or folders that hold them (default: all kept files)")  # fmt: skip
    verify.add_argument("--sample", action="store_true", help="make a sample of each file again and compare")
    record.add_argument(
        "--made", action="store_true", help="today's software made the whole files, not only a sample"
    )
    verify.set_defaults(run=run_verify)
    record.set_defaults(run=run_record)


def run_verify(args: argparse.Namespace) -> int:
    """Run `ground-tools results verify`. Returns 0 if all files are current or unchanged, else 1.

    Raises:
        ConfigError: a path names no kept file, or a record cannot be read.
    """
    words, worst = Console(), 0
    chosen = chosen_of(args.paths)
    with progress("files", len(chosen)) as advance:
        for entry in chosen:
            status, why = status_of(entry, sample=args.sample)
            words.print(f"{entry.name}: {_WORDS[status]}", soft_wrap=True, highlight=False)
            for line in why[:_SHOWN]:
                words.print(f"    {line}", soft_wrap=True, highlight=False)
            if len(why) > _SHOWN:
                words.print(f"    and {len(why) - _SHOWN} more", highlight=False)
            if status not in _GOOD:
                words.print(f"    make it again: {entry.command}", soft_wrap=True, highlight=False)
                worst = 1
            advance()
    return worst


def run_record(args: argparse.Namespace) -> int:
    """Run `ground-tools results record`. Returns 0 if every file was recorded, else 1.

    Raises:
        ConfigError: the software does not run from a checkout, a path names no kept file, or a record cannot
            be written.
    """
    if CHECKOUT is None:
        raise ConfigError("record: this is an installed copy; results are recorded in a checkout only")
    words, worst = Console(), 0
    for entry in chosen_of(args.paths):
        why = _refusal(entry, made=args.made)
        if why is not None:
            worst = 1
            words.print(f"{entry.name}: not recorded: {why}", soft_wrap=True, highlight=False)
            continue
        evidence: Literal["made", "sample"] = "made" if args.made else "sample"
        content = provenance.content_of(entry.path)
        provenance.write(entry.path, msgspec.structs.replace(entry.now(), evidence=evidence, content=content))
        words.print(f"{entry.name}: recorded", soft_wrap=True, highlight=False)
    return worst


def _refusal(entry: Entry, *, made: bool) -> str | None:
    """Why a file must not be recorded, as text; None if it may be."""
    if not entry.path.is_file():
        return _WORDS["missing"]
    record = provenance.read(entry.path)
    # A sample shows nothing about the rest of the file, so that part must be what was once made.
    if not made and record is not None and record.content not in (None, provenance.content_of(entry.path)):
        return f"{_WORDS['edited']}; --made says that today's software made the whole file"
    try:
        return next(iter(entry.differences()), None)
    except provenance.CannotSampleError as why:
        return None if made else f"no sample of it can be made: {why}"


def chosen_of(paths: Sequence[Path]) -> list[Entry]:
    """The kept files that are named or lie in the named folders; all kept files if none is named.

    Raises:
        ConfigError: a path names no kept file.
    """
    entries = kept.entries()
    if not paths:
        return entries
    chosen = []
    for path in map(Path.resolve, paths):
        inside = [entry for entry in entries if entry.path == path or path in entry.path.parents]
        if not inside:
            raise ConfigError(f"{path}: this is no kept result; allowed: the files that `verify` lists")
        chosen += inside
    return list(dict.fromkeys(chosen))


def status_of(entry: Entry, *, sample: bool) -> tuple[Status, list[str]]:
    """Whether the present software makes this file, and the reasons if not, as text.

    Args:
        sample: make a sample of the file again even if its record shows no change.

    Raises:
        ConfigError: a file cannot be read.
    """
    if not entry.path.is_file():
        return "missing", []
    record = provenance.read(entry.path)
    if record is not None and record.content not in (None, provenance.content_of(entry.path)):
        return "edited", []
    changed = [] if record is None else provenance.changes(record, entry.now())
    notes: list[str] = []
    if sample:
        try:
            differences = entry.differences()
        except provenance.CannotSampleError as why:
            notes = [f"no sample was made: {why}"]
        else:
            if differences:
                return "outdated", differences
            sealed = record is not None and record.content is not None
            return ("current", []) if sealed and not changed else ("unchanged", changed)
    if record is None:
        return "unknown", notes
    if changed:
        return "changed", [*notes, *(f"changed since: {name}" for name in changed)]
    return ("unsealed" if record.content is None else "current"), notes
