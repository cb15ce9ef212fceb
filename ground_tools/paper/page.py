"""One page that compares all statements of the paper with this model's results, as Markdown, HTML and CSV."""

from __future__ import annotations

import csv
import html
import io
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from companion.errors import ConfigError
from ground_tools.paper.report import Report, json_rows, tables

TITLE: Final = "The paper's figures, tables and statements, computed anew"
_ABOUT: Final = (
    "Each section shows one figure of the paper as this software computes it, the paper's statements about "
    "it with the verdict, and its numbers beside the published ones. A statement that does not hold is a "
    "result. Trained networks and learning curves are kept results: results/README.md names the commands "
    "that make them, and `ground-tools results verify` checks them."
)
_STYLE: Final = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:72rem;margin:2rem auto;padding:0 1rem;color:#222;"
    "background:#fff}img{max-width:100%}table{border-collapse:collapse;font-size:.85rem;display:block;"
    "overflow-x:auto}td,th{border:1px solid #ccc;padding:.2rem .6rem;text-align:left;vertical-align:top}"
    "code{background:#eee;padding:.1rem .3rem}"
    "@media(prefers-color-scheme:dark){body{color:#ddd;background:#1b1b1b}td,th{border-color:#555}"
    "code{background:#333}img{background:#fff}}"
)


@dataclass(frozen=True, slots=True)
class Section:
    """One figure of the page."""

    name: str
    command: str
    """Command line that makes this section alone."""
    report: Report
    picture: Path
    """File of the picture, in the folder of the page."""


def write(folder: Path, sections: Sequence[Section]) -> tuple[Path, ...]:
    """Write `index.md`, `index.html` and a CSV file for each section with numbers. Returns both pages' paths.

    Raises:
        ConfigError: a file cannot be written.
    """
    pages = folder / "index.md", folder / "index.html"
    contents = {pages[0]: _page(sections, _Markdown()), pages[1]: _page(sections, _Html())}
    contents |= {folder / f"{s.name}.csv": _csv(s) for s in sections if tables(s.report)}
    for path, text in contents.items():
        try:
            path.write_text(text)
        except OSError as error:
            raise ConfigError(f"--out: {path}: cannot be written: {error.strerror}") from error
    return pages


class _Markdown:
    """Writes the parts of the page as Markdown."""

    def heading(self, level: int, text: str) -> str:
        return f"{'#' * level} {_cell(text)}\n"

    def paragraph(self, text: str) -> str:
        return f"{text}\n"

    def command(self, text: str) -> str:
        return f"    {text}\n"

    def picture(self, path: str, words: str) -> str:
        return f"![{words}]({path})\n"

    def table(self, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
        lines = [columns, ["---"] * len(columns), *rows]
        return "".join(f"| {' | '.join(map(_cell, line))} |\n" for line in lines)

    def whole(self, parts: Iterable[str]) -> str:
        return "\n".join(parts)


class _Html:
    """Writes the parts of the page as HTML."""

    def heading(self, level: int, text: str) -> str:
        return f"<h{level}>{html.escape(text)}</h{level}>"

    def paragraph(self, text: str) -> str:
        return f"<p>{html.escape(text)}</p>"

    def command(self, text: str) -> str:
        return f"<p><code>{html.escape(text)}</code></p>"

    def picture(self, path: str, words: str) -> str:
        return f'<p><img src="{html.escape(path)}" alt="{html.escape(words)}"></p>'

    def table(self, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
        head = "".join(f"<th>{html.escape(column)}</th>" for column in columns)
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(value)}</td>" for value in row) + "</tr>\n" for row in rows
        )
        return f"<table>\n<tr>{head}</tr>\n{body}</table>"

    def whole(self, parts: Iterable[str]) -> str:
        body = "\n".join(parts)
        return (
            f'<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<title>{TITLE}</title>\n'
            '<meta name="viewport" content="width=device-width">\n'
            f"<style>{_STYLE}</style>\n{body}\n</html>\n"
        )


def _page(sections: Sequence[Section], to: _Markdown | _Html) -> str:
    statements = [(section, one) for section in sections for one in section.report.statements]
    held = sum(one.holds for _, one in statements)
    parts = [
        to.heading(1, TITLE),
        to.paragraph(_ABOUT),
        to.paragraph(f"{held} of {len(statements)} statements hold under every condition that was checked."),
        to.table(
            ("figure", "published", "ours", "verdict"),
            [(section.name, one.published, one.ours, one.verdict) for section, one in statements],
        ),
    ]
    for section in sections:
        parts += [
            to.heading(2, f"{section.name}: {section.report.title}"),
            to.command(section.command),
            to.picture(section.picture.name, section.report.title),
            *map(to.paragraph, section.report.notes),
        ]
        for table in tables(section.report):
            if table.title:
                parts.append(to.paragraph(table.title))
            parts.append(to.table(table.columns, table.rows))
        if tables(section.report):
            parts.append(to.paragraph(f"All numbers of this section: {section.name}.csv."))
    return to.whole(parts)


def _cell(text: str) -> str:
    """A text on one line, with escapes so that no character ends a cell of a Markdown table."""
    return " ".join(text.split()).replace("|", "\\|")


def _csv(section: Section) -> str:
    """All statements and numbers of a section: a line for each, with the union of their keys as columns."""
    rows = json_rows(section.name, section.report)
    columns = list(dict.fromkeys(key for row in rows for key in row))
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow(columns)
    writer.writerows([_plain(row.get(key)) for key in columns] for row in rows)
    return out.getvalue()


def _plain(value: object) -> object:
    return json.dumps(value) if isinstance(value, dict | tuple | list) else value
