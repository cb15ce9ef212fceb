"""A run as one HTML page with the summary's tables, plots and every manoeuvre. It opens offline and prints.

The page loads no resources and runs no scripts; its own Content-Security-Policy forbids both. Everything that
comes from logs is untrusted and is escaped.
"""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from companion.config import LimitsConfig
from companion.errors import ConfigError
from ground_tools.inspect.explain import manoeuvres
from ground_tools.inspect.explain.manoeuvres import Manoeuvre
from ground_tools.inspect.read.flown import GRID_S, flown, thinned
from ground_tools.inspect.read.read_run import Run
from ground_tools.inspect.report import headline, lanes, plots, terminal
from ground_tools.inspect.report.terminal import Rows, number, plain

MOST_DRAWN = 24
"""Most manoeuvres whose velocity space is drawn. The others are described in text only."""
_LONGEST_WORD = 20
"""A word with more characters may be broken anywhere."""
_POLICY = "default-src 'none'; style-src 'unsafe-inline'"
_STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --paper: #fff; --soft: #444; --line: #ddd; --edge: #555;
  --bad: #b00020; --gone: #fff6dd; }
@media screen and (prefers-color-scheme: dark) {
  :root { --ink: #e8e8e8; --paper: #16181b; --soft: #b9bdc3; --line: #3a3e44; --edge: #8a9099; --bad: #ff8a80;
    --gone: #3a3015; PLOTS }
  a { color: #8ab4f8; }
}
body { font: 15px/1.45 system-ui, "DejaVu Sans", sans-serif; color: var(--ink); background: var(--paper);
  max-width: 1060px; margin: 0 auto; padding: 1.2rem; }
nav { font-size: 12.5px; }
nav a { margin-right: .9rem; }
h1 { font-size: 1.5rem; margin: 0 0 .3rem; overflow-wrap: anywhere; }
h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; border-bottom: 2px solid #0072b2; break-after: avoid; }
h3 { font-size: 1rem; margin: 1.2rem 0 .3rem; break-after: avoid; overflow-wrap: anywhere; }
p, li { overflow-wrap: anywhere; }
.verdicts li { font-weight: 600; }
.bad { color: var(--bad); }
.gone { background: var(--gone); border-left: 4px solid #e69f00; padding: .5rem .8rem; }
.about { color: var(--soft); font-size: 12.5px; }
table { border-collapse: collapse; width: 100%; font-size: 12.5px; margin: .4rem 0 1rem; }
th { text-align: left; vertical-align: bottom; border-bottom: 1.5px solid var(--edge);
  padding: .2rem .5rem .2rem 0; }
td { border-bottom: 1px solid var(--line); padding: .2rem .5rem .2rem 0; vertical-align: top;
  font-variant-numeric: tabular-nums; }
td.long { overflow-wrap: anywhere; }
tr { break-inside: avoid; }
tbody tr:nth-child(-n+4), tbody tr:nth-last-child(-n+4):not(:last-child) { break-after: avoid; }
.wide { overflow-x: auto; }
figure { margin: .6rem 0; break-inside: avoid; }
figure svg { width: 100%; height: auto; }
figure svg text { fill: var(--ink); }
.manoeuvre figure svg { max-width: 34rem; }
figcaption { font-size: 12.5px; color: var(--soft); }
.manoeuvre { break-inside: avoid; }
.note { font-size: 12.5px; color: var(--soft); }
@media screen and (max-width: 640px) {
  body { padding: .7rem; }
  table { min-width: 40rem; }
  .wide > svg { min-width: 42rem; }
  .manoeuvre .wide > svg { min-width: 30rem; }
}
@page { size: A4; margin: 14mm; }
@media print {
  body { max-width: none; padding: 0; font-size: 10pt; }
  table { font-size: 8pt; }
  .page { break-before: page; }
  nav { display: none; }
  .wide { overflow: visible; }
  figure svg { max-height: 245mm; }
}
""".replace("PLOTS", " ".join(f"--plot-{name[1:]}: {dark};" for name, dark in plots.DARK.items()))


def write(run: Run, figures: dict[str, Any], path: Path) -> None:
    """Write the report of a run.

    Args:
        run: The run.
        figures: Its figures from `summary.describe`.
        path: HTML file to write.

    Raises:
        ConfigError: matplotlib is not installed, or `path` cannot be written.
    """
    text = page(run, figures)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"--report: {path}: cannot be written: {error.strerror}") from error


def page(run: Run, figures: dict[str, Any]) -> str:
    """Return the whole report as HTML."""
    told = [_section(title, _table(rows)) for title, rows in terminal.sections(figures)]
    # The first table, which lists the conflicts if there are any, is followed by the drawings.
    parts = [_head(run, figures), *told[:1], *_drawings(run, figures), *told[1:]]
    parts += _manoeuvres(run, figures)
    title = escaped(f"{figures['run']}: flight report")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join((parts[0], _contents(parts), *parts[1:]))
        + "\n</body>\n</html>\n"
    )


def escaped(text: object) -> str:
    """Escape a text for the page: no markup, and no invisible characters."""
    return html.escape(plain(text))


def _head(run: Run, figures: dict[str, Any]) -> str:
    manifest = run.manifest or {}
    facts = [
        f"{words} {manifest[key]}"
        for key, words in (
            ("what", "written by"),
            ("dmuca", "version"),
            ("git_commit", "commit"),
            ("seed", "seed"),
        )
        if manifest.get(key) is not None
    ]
    software = {one["software"] for one in figures["aircraft"] if one["software"] is not None}
    facts += [f"flown with version {version}" for version in sorted(software)]
    verdicts = "".join(
        f"<li{' class=bad' if headline.is_bad(words) else ''}>{escaped(words)}</li>"
        for words in headline.verdicts(figures)
    )
    damage, about = (
        "".join(f"<li>{escaped(words)}</li>" for words in lines)
        for lines in (headline.damage(figures), headline.notes(figures))
    )
    return (
        f"<h1>{escaped(figures['run'])}</h1>\n<p>{escaped(headline.head(figures))}</p>\n"
        + (f'<p class="note">{escaped("; ".join(facts))}</p>\n' if facts else "")
        + f'<ul class="verdicts">{verdicts}</ul>\n'
        + (f'<div class="gone"><strong>Damaged</strong><ul>{damage}</ul></div>' if damage else "")
        + (f'<div class="about"><strong>About this record</strong><ul>{about}</ul></div>' if about else "")
    )


def _drawings(run: Run, figures: dict[str, Any]) -> list[str]:
    try:
        ways = flown(run)
    except ConfigError:  # the run's problems already report it
        return []
    ends = [time for path in ways.paths for time in path.time_s[[0, -1]]]
    every_s = max((max(ends) - min(ends)) / plots.MOST_POINTS, GRID_S)
    pairs = [pair for pair in thinned(ways.paths, every_s) if pair.minimum_m is not None]
    found: list[tuple[str, str, str | None]] = [
        ("Paths from above", f"The paths are {ways.positions}.", plots.paths(ways, pairs)),
        (
            "Separation",
            f"The {min(len(pairs), plots.MOST_LINES)} closest of {len(pairs)} pairs, while any is near.",
            plots.separation(pairs) if pairs else None,
        ),
        ("Authority, modes, events and alerts", "", lanes.lanes(run, ways, figures["aircraft"])),
        ("Height", "As each vehicle reports it.", plots.heights(run, ways)),
        ("Speeds", "Speeds at every decision of the law.", plots.speeds(run, ways)),
        (
            "Age of information",
            "The greatest age in every second, at the decisions of the law.",
            plots.ages(run, ways),
        ),
        ("Broadcasts", "Each point is the mean rate over the last five broadcasts.", plots.rates(run, ways)),
    ]
    return [
        _section(title, f"<figure>{_scrolled(drawing)}<figcaption>{escaped(words)}</figcaption></figure>")
        for title, words, drawing in found
        if drawing is not None
    ]


def _manoeuvres(run: Run, figures: dict[str, Any]) -> list[str]:
    parts: list[str] = []
    drawn = 0
    for record, one in zip(run.aircraft, figures["aircraft"], strict=True):
        limits = LimitsConfig() if record.header is None else record.header.config.limits
        for found, row in zip(manoeuvres.find(record), one["manoeuvres"], strict=True):
            drawing = plots.velocities(found, limits.max_speed_mps) if drawn < MOST_DRAWN else None
            drawn += drawing is not None
            parts.append(_manoeuvre(one["name"], found, row, drawing))
    if not parts:
        return []
    note = (
        "<p class=note>The tables list alternatives at the start of each manoeuvre and where they would have "
        "led if every other aircraft had kept its velocity. The half-spaces are those of the law. In the "
        "drawings the tinted side of a line is excluded at the vertical speed that the law chose; "
        "x: excluded, o: allowed.</p>"
    )
    return [_section("All manoeuvres", note + "\n".join(parts), new_page=True)]


def _manoeuvre(name: str, one: Manoeuvre, row: dict[str, Any], drawing: str | None) -> str:
    words = "".join(f"<p>{escaped(row[key])}</p>" for key in ("why", "done", "came") if row[key])
    head = ["", "alternative at the start", "nearest aircraft", "distance (m)", "in (s)", "verdict"]
    rows = [head] + [
        [
            "" if index == 0 else str(index),
            other.name,
            other.closest_track or "-",
            number(other.closest_m),
            number(other.closest_in_s),
            manoeuvres.verdict(other),
        ]
        for index, other in enumerate(one.alternatives[1:])
    ]
    when = f"{row['start_s']:.1f} to {row['end_s']:.1f} s"
    return (
        f'<div class="manoeuvre"><h3>{escaped(name)}, {when}</h3>{words}'
        + _table(rows)
        + (f"<figure>{_scrolled(drawing)}</figure>" if drawing else "")
        + "</div>"
    )


def _section(title: str, body: str, new_page: bool = False) -> str:
    name = re.sub(r"[^a-z]+", "-", title.lower())
    kind = " class=page" if new_page else ""
    return f'<section{kind} id="{name}"><h2>{escaped(title)}</h2>\n{body}</section>'


def _contents(parts: Sequence[str]) -> str:
    """Links to all sections."""
    found = (re.match(r'<section[^>]* id="([^"]*)"><h2>(.*?)</h2>', part) for part in parts)
    links = "".join(f'<a href="#{one[1]}">{one[2]}</a> ' for one in found if one is not None)
    return f'<nav aria-label="Sections">{links}</nav>'


def _table(rows: Rows) -> str:
    head = "".join(f"<th>{escaped(cell)}</th>" for cell in rows[0])
    body = "".join(
        f"<tr{' class=bad' if terminal.alarming(row) else ''}>{''.join(map(_cell, row))}</tr>"
        for row in rows[1:]
    )
    return _scrolled(f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>")


def _scrolled(wide: str) -> str:
    """A box that scrolls if its content is wider. Its tabindex allows scrolling by keyboard."""
    return f'<div class="wide" tabindex="0">{wide}</div>'


def _cell(text: str) -> str:
    long = max(map(len, text.split()), default=0) > _LONGEST_WORD
    return f"<td{' class=long' if long else ''}>{escaped(text)}</td>"
