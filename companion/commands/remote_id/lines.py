"""Works through text line by line and reports the faults of each line."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple

import msgspec

from companion.errors import PeerDataError

_SHOWN: Final = 40
"""Largest number of characters of a wrong line or value that an error text repeats."""


class Printed(NamedTuple):
    """Result of one input line: the lines to print, and what is wrong with it."""

    lines: Sequence[str]
    faults: Sequence[str] = ()


def each_line(name: str, lines: Iterable[str], work: Callable[[str], Printed]) -> int:
    """Print the result of `work` for every line. Returns the exit status.

    Faults of a line, including a ValueError or PeerDataError of `work`, are printed on stderr with `name`
    before the line's number; the remaining lines are still processed.
    """
    status = 0
    number = 0
    worked = False
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        worked = True
        try:
            printed = work(line.strip())
        except (ValueError, PeerDataError) as error:
            printed = Printed((), (str(error),))
        except RecursionError:
            printed = Printed((), ("nested too deeply",))
        for text in printed.lines:
            print(text, flush=True)
        for fault in printed.faults:
            print(f"{name}line {number}: {fault}", file=sys.stderr)
            status = 1
    if not worked:
        how_much = f"nothing to read in {number} lines" if number else "nothing to read: the input is empty"
        print(f"{name}{how_much}", file=sys.stderr)
        return 1
    return status


def as_json(content: object) -> str:
    """JSON as one line of ASCII, which every terminal and locale can show."""
    return json.dumps(msgspec.to_builtins(content), separators=(",", ":"))


def shown(content: object) -> str:
    """A wrong value for an error text, as JSON shortened to `_SHOWN` characters."""
    text = as_json(content)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
