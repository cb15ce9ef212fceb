"""The alphabetical index of the site: words of the glossary, pages, configuration keys, names, messages."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Final

import reference
from msgspec import inspect as types

from companion.autopilot.readers import READERS
from companion.autopilot.sensors import SENSOR_READERS
from companion.config.sections import Config

ROOT: Final = Path(__file__).parents[2]
Entry = tuple[str, str]
"""A word, and the link to where it is explained, both in Markdown."""


def page() -> str:
    """The page, with a heading for each initial."""
    parts = ["# Index", "Made from the code and the pages."]
    found = sorted(set(entries()), key=lambda entry: (_initial(entry), _sorted_as(entry[0]), entry[1]))
    for initial, some in groupby(found, key=_initial):
        parts += [f"## {initial}", "\n".join(f"- {word}: {link}" for word, link in some)]
    return "\n\n".join(parts) + "\n"


def entries() -> list[Entry]:
    """All entries, in no order."""
    return [*_words(), *_pages(), *_keys(), *_names(), *_messages()]


def _words() -> list[Entry]:
    text = (ROOT / "docs" / "glossary.md").read_text()
    words = [
        word for line in re.findall(r"^\| \*\*(.+?)\*\* \|", text, re.MULTILINE) for word in line.split(", ")
    ]
    return [(word, "[glossary](../glossary.md)") for word in words]


def _pages() -> list[Entry]:
    found = []
    for path in sorted((ROOT / "docs").glob("*.md")):
        title = re.search(r"^# (.+)$", path.read_text(), re.MULTILINE)
        if title is not None:
            found.append((title[1], f"[{path.name}](../{path.name})"))
    return found


def _keys() -> list[Entry]:
    found = []
    for field in reference._struct(Config).fields:
        if field.encode_name not in reference._LOADED:
            for kind in reference._structs(field.type):
                anchor = f"{field.encode_name}-{kind.tag}" if kind.tag else field.encode_name
                where = f"[[{field.encode_name}]] {kind.tag}" if kind.tag else f"[{field.encode_name}]"
                link = f"[configuration `{where}`](configuration.md#{anchor})"
                found += [(f"`{key}`", link) for key in _keys_of(kind)]
    return found


def _keys_of(kind: types.StructType) -> Iterator[str]:
    """The keys of a table and of the tables inside it."""
    if kind.tag_field is not None:
        yield kind.tag_field
    for field in kind.fields:
        yield field.encode_name
        for inner in reference._structs(field.type):
            yield from _keys_of(inner)


def _names() -> list[Entry]:
    return [
        (f"`{public}`", f"[{module}]({name}.md)")
        for name, module in reference.ROOM_PAGES.items()
        for public in importlib.import_module(module).__all__
    ]


def _messages() -> list[Entry]:
    numbers = dict.fromkeys((*READERS, *SENSOR_READERS))
    return [(reference._message(number), "[messages](messages.md)") for number in numbers]


def _sorted_as(word: str) -> str:
    return re.sub("^(a|an|the) ", "", word.strip("`*_ ").casefold())


def _initial(entry: Entry) -> str:
    first = _sorted_as(entry[0])[:1].upper()
    return first if first.isalpha() else "Numbers"
