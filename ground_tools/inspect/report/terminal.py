"""Prints the figures of a run in the terminal.

Text from logs (identities, messages) is untrusted. It is printed as plain text without markup, and terminal
control characters are shown as their escape codes.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from ground_tools.inspect.report import headline

PIPED_WIDTH = 120
"""Characters per line if the output is not a terminal."""
_NAME = 24
"""The first column is wide enough for names of up to this many characters."""
_MOST_ROWS = 40
"""Most rows printed of one table. The number of omitted rows is printed, and --json has them all."""
_THINNED_PERCENT, _THINNED = 20.0, "thinned log?"
"""Text for a component that was never silent but of whose messages more than this share is missing: the
program that wrote the log probably left them out."""
_LONGEST_WORD = 40
"""A column is at least as wide as its longest word of up to this many characters."""
_SHARES = ("median_s", "p95_s", "worst_s")


def plain(text: object) -> str:
    """Replace every unprintable character in a text by its escape code."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(text))


def number(value: float | None, digits: int = 1) -> str:
    """Format a figure; "-" if it is unknown."""
    return "-" if value is None else f"{value:.{digits}f}"


def text(figures: dict[str, Any]) -> str:
    """Return the figures of `summary.describe` as text, `PIPED_WIDTH` characters wide and without colour."""
    return as_text(show, figures)


def as_text(show: Callable[[dict[str, Any], Console], None], figures: dict[str, Any]) -> str:
    """Return what `show` prints of the figures if the output is not a terminal."""
    stream = io.StringIO()
    show(figures, Console(file=stream, width=PIPED_WIDTH, color_system=None, force_terminal=False))
    return stream.getvalue().rstrip("\n")


def console() -> Console:
    """Return the console to print to: the terminal, or one of fixed width if the output is piped."""
    found = Console(highlight=False)
    return found if found.is_terminal else Console(highlight=False, width=PIPED_WIDTH, color_system=None)


def show(figures: dict[str, Any], console: Console) -> None:
    """Print the figures of `summary.describe`."""
    line(console, headline.head(figures), "bold")
    for words in headline.verdicts(figures):
        line(console, f"  {words}", "bold red" if headline.is_bad(words) else "")
    for words in headline.damage(figures):
        line(console, f"  {words}", "yellow")
    for words in headline.notes(figures):
        line(console, f"  {words}", "dim")
    console.print()
    for title, rows in sections(figures):
        show_table(console, title, rows)
    for one in figures["aircraft"]:
        for row in one["manoeuvres"]:
            line(console, f"{one['name']}, {row['start_s']:.1f} to {row['end_s']:.1f} s", "bold")
            for words in sentences(row):
                console.print(Padding(Text(plain(words)), (0, 0, 0, 2), expand=False))


def sentences(row: dict[str, Any]) -> list[str]:
    """Describe a manoeuvre: its reason, what was done, the outcome; then each alternative at its start."""
    found = [row[key] for key in ("why", "done", "came") if row[key]]
    return [*found, *(f"- alternative at the start: {words}" for words in row["instead"])]


Rows = list[list[str]]
"""Rows of a table. The first row is the header."""


def sections(figures: dict[str, Any]) -> list[tuple[str, Rows]]:
    """Return every table of a run as title and rows. Tables without rows are left out."""
    aircraft = figures["aircraft"]
    found = [
        ("Conflicts", _conflicts(figures["conflicts"])),
        ("Other aircraft that were heard", _traffic(aircraft)),
        ("Other pairs" if figures["conflicts"] else "Pairs", _separations(figures)),
        ("Faults and warnings", _events(aircraft, "faults")),
        ("Flights", _flights(aircraft)),
        ("GNSS and wind", _conditions(aircraft)),
        ("Decisions and alerts", _decisions(aircraft)),
        ("Modes", _spans(aircraft, "modes", "mode")),
        ("Authority", _spans(aircraft, "authority", "state", "reason")),
        ("Manoeuvres", _manoeuvres(aircraft)),
        ("Remote ID sent", _sent(aircraft)),
        ("Remote ID heard", _heard(aircraft)),
        ("Age of information at the decisions of the law", _ages(aircraft)),
        ("Pilots and start-ups", _events(aircraft, "ordinary")),
        ("Simulated radio channel, from the run's summary", _air(figures["air"])),
        ("Telemetry link (absent: gaps in the sequence numbers, lost or not logged)", _link(aircraft)),
    ]
    return [(title, rows) for title, rows in found if len(rows) > 1]


def kept(value: bool | None) -> str:
    """Return a verdict as text: "kept", "LOST", or "-" if unknown."""
    return {True: "kept", False: "LOST", None: "-"}[value]


def alarming(row: Sequence[str]) -> bool:
    """Return whether a row of a table reports a lost separation or a requirement that was not kept."""
    return any(cell.startswith(("LOST", "NOT ")) or cell == "NO" for cell in row)


def _conflicts(rows: Sequence[dict[str, Any]]) -> Rows:
    head = ["pair", "at (s)", "closest (m)", "limit (m)", "", "what was done"]
    return [head] + [
        [
            " - ".join(row["pair"]),
            number(row["time_s"]),
            number(row["minimum_m"], 2),
            number(row["required_m"]),
            kept(row["kept"]) if row["by"] == "positions" else row["by"],
            "; ".join(row["done"]),
        ]
        for row in rows
    ]


def _separations(figures: dict[str, Any]) -> Rows:
    """Rows of the pairs that are not in the table of conflicts."""
    told = [row["pair"] for row in figures["conflicts"]]
    return [["pair", "at (s)", "closest (m)", "limit (m)", ""]] + [
        [
            " - ".join(row["pair"]),
            number(row["minimum_time_s"]),
            number(row["minimum_m"], 2) if row["minimum_m"] is not None else "never known at the same time",
            number(row["required_m"]),
            kept(row["kept"]),
        ]
        for row in figures["separations"]
        if row["pair"] not in told
    ]


def _flights(aircraft: Sequence[dict[str, Any]]) -> Rows:
    head = ["aircraft", "record (s)", "armed (s)", "flown (m)", "fastest (m/s)", "highest (m)", "use", "law"]
    return [head] + [
        [
            one["name"],
            number(one["duration_s"]),
            number(one["flight"]["armed_s"]),
            number(one["flight"]["distance_m"], 0),
            number(one["flight"]["max_speed_mps"]),
            number(one["flight"]["max_height_m"]),
            one["use"] or "-",
            one["law"] or "-",
        ]
        for one in aircraft
    ]


def _conditions(aircraft: Sequence[dict[str, Any]]) -> Rows:
    """Rows of the aircraft that reported a GNSS fix or a wind."""
    head = ["aircraft", "GNSS reports", "without 3D fix (s)", "fewest satellites", "worst accuracy (m)"]
    rows = [[*head, "mean wind (m/s)", "from (deg)", "strongest (m/s)"]]
    for one in aircraft:
        gnss, wind = one["gnss"], one["wind"] or {}
        if gnss["reports"] or wind:
            rows.append(
                [
                    one["name"],
                    str(gnss["reports"]),
                    number(gnss["without_fix_s"]),
                    number(gnss["least_satellites"], 0),
                    number(gnss["worst_accuracy_m"], 2),
                    number(wind.get("mean_mps")),
                    number(wind.get("from_deg"), 0),
                    number(wind.get("max_mps")),
                ]
            )
    return rows


def _decisions(aircraft: Sequence[dict[str, Any]]) -> Rows:
    """Rows of the aircraft that made decisions or raised alerts."""
    keys = ("decisions", "conflicts", "infeasible", "cautions", "warnings")
    return [
        ["aircraft", "decisions", "in conflict", "without a feasible velocity", "cautions", "warnings"]
    ] + [[one["name"], *(str(one[key]) for key in keys)] for one in aircraft if any(one[key] for key in keys)]


def _each(
    head: list[str],
    aircraft: Sequence[dict[str, Any]],
    rows: Callable[[dict[str, Any]], Sequence[dict[str, Any]]],
    cells: Callable[[dict[str, Any]], list[str]],
) -> Rows:
    """Return a line for every row of every aircraft. Each line begins with the aircraft's name."""
    return [["aircraft", *head], *([one["name"], *cells(row)] for one in aircraft for row in rows(one))]


def _spans(aircraft: Sequence[dict[str, Any]], key: str, state: str, reason: str | None = None) -> Rows:
    words = [state, reason] if reason else [state]
    return _each(
        ["from (s)", "to (s)", *words],
        aircraft,
        lambda one: one["flight"][key],
        lambda row: [number(row["from_s"]), number(row["to_s"]), *(row[word] for word in words)],
    )


def _link(aircraft: Sequence[dict[str, Any]]) -> Rows:
    head = ["component", "frames", "absent", "absent (%)", "silences", "longest (s)", ""]
    return _each(
        head,
        aircraft,
        lambda one: one["link"],
        lambda row: [
            row["component"],
            str(row["frames"]),
            str(row["missing"]),
            number(row["missing_percent"], 2),
            str(row["silences"]),
            number(row["longest_silence_s"]),
            _THINNED if row["missing_percent"] > _THINNED_PERCENT and not row["silences"] else "",
        ],
    )


def _traffic(aircraft: Sequence[dict[str, Any]]) -> Rows:
    """Rows of the received aircraft that have no record in this run, or none of their nearest approach, the
    nearest first."""
    head = ["other", "by", "from (s)", "to (s)", "reports"]
    head += ["nearest (m)", "at (s)", "beside (m)", "above (m)"]

    def cells(row: dict[str, Any]) -> list[str]:
        near = row["nearest"] or {}
        above = number(near.get("above_m"), 0) + (" baro" if near.get("barometric") else "")
        return [
            f"{headline.who(row)} {row['callsign']}".strip(),
            row["by"],
            number(row["first_s"]),
            number(row["last_s"]),
            str(row["messages"]),
            number(near.get("slant_m"), 0),
            number(near.get("time_s")),
            number(near.get("aside_m"), 0),
            above,
        ]

    return _each(head, aircraft, lambda one: [r for r in one["traffic"] if headline.is_other(r)], cells)


def _manoeuvres(aircraft: Sequence[dict[str, Any]]) -> Rows:
    head = ["from (s)", "to (s)", "because of", "predicted closest (m)", "in (s)"]
    head += ["nearest (m)", "off the path (m)", "other limits", "feasible"]
    return _each(
        head,
        aircraft,
        lambda one: one["manoeuvres"],
        lambda row: [
            number(row["start_s"]),
            number(row["end_s"]),
            ", ".join(row["tracks"]) or ", ".join(row["limits"]),
            number(row["closest_m"]),
            number(row["time_to_closest_s"]),
            number(row["nearest"]["distance_m"]),
            number(row["deviation_m"]),
            ", ".join(row["limits"]) or "-",
            "yes" if row["feasible"] else "NO",
        ],
    )


def _sent(aircraft: Sequence[dict[str, Any]]) -> Rows:
    head = [
        "aircraft",
        "region",
        "transport",
        "message",
        "sent",
        "per second",
        "longest gap (s)",
        "legal limit (s)",
    ]
    rows = [
        [
            one["name"],
            one["remote_id"]["region"] or "-",
            row["transport"],
            row["message"],
            str(row["count"]),
            number(row["rate_hz"], 2),
            number(row["longest_s"], 2),
            number(row["legal_s"], 2),
            f"NOT kept: {row['over_legal']} times" if row["kept"] is False else kept(row["kept"]),
        ]
        for one in aircraft
        for row in one["remote_id"]["sent"]
    ]
    for one in aircraft:
        told = one["remote_id"]
        if told["not_legal_s"] > 0.0:
            because = "; ".join(told["not_legal_because"])
            words = f"NOT legal for {told['not_legal_s']:.1f} s: {because}"
            rows.append([one["name"], told["region"] or "-", "", "", "", "", "", "", words])
    return [[*head, ""], *rows]


def _heard(aircraft: Sequence[dict[str, Any]]) -> Rows:
    head = [
        "from",
        "transport",
        "frames",
        "lost",
        "longest gap (s)",
        "latency: median (s)",
        "95 % (s)",
        "worst (s)",
    ]

    def cells(row: dict[str, Any]) -> list[str]:
        late = row["latency"] or {}
        return [
            ", ".join(row["identities"]) or row["address"],
            row["transport"],
            str(row["frames"]),
            "unknown" if row["lost"] is None else f"{row['lost']} of {row['lost_of']}",
            number(row["longest_silence_s"], 2),
            *(number(late.get(key), 2) for key in _SHARES),
        ]

    return _each(head, aircraft, lambda one: one["remote_id"]["heard"], cells)


def _ages(aircraft: Sequence[dict[str, Any]]) -> Rows:
    return _each(
        ["track", "median (s)", "95 % (s)", "worst (s)"],
        aircraft,
        lambda one: one["remote_id"]["ages"],
        lambda row: [row["track"], *(number(row[key], 2) for key in _SHARES)],
    )


def _events(aircraft: Sequence[dict[str, Any]], key: str) -> Rows:
    """Rows of events. Repeated events share one row."""

    def told(one: dict[str, Any]) -> list[dict[str, Any]]:
        groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
        for row in one[key]:
            groups.setdefault((row["what"], row["text"]), []).append(row)
        return [{**rows[0], "count": len(rows), "last_s": rows[-1]["time_s"]} for rows in groups.values()]

    def cells(row: dict[str, Any]) -> list[str]:
        end_s = row["until_s"] if row["count"] == 1 else row["last_s"]
        return [number(row["time_s"]), number(end_s), str(row["count"]), row["what"], row["text"]]

    return _each(["at (s)", "until (s)", "times", "what", "text"], aircraft, told, cells)


def _air(rows: Sequence[dict[str, Any]]) -> Rows:
    found = [["from", "to", "frames", "delivered", "age: mean (s)", "age: worst (s)"]]
    for row in rows:
        ages = [number(row[key], 2) for key in ("information_age_mean_s", "information_age_max_s")]
        found.append([row["sender"], row["receiver"], str(row["sent"]), str(row["delivered"]), *ages])
    return found


def line(console: Console, words: str, style: str = "") -> None:
    """Print a line without wrapping it."""
    console.print(Text(plain(words), style=style), soft_wrap=True)


def _longest_word(cell: str) -> int:
    return min(max(map(len, plain(cell).split()), default=0), _LONGEST_WORD)


def show_table(console: Console, title: str, rows: Rows) -> None:
    """Print a table, limited to `_MOST_ROWS` rows."""
    shown = rows[: _MOST_ROWS + 1]
    table = Table(box=box.SIMPLE_HEAD, title=title, title_justify="left", title_style="bold", pad_edge=False)
    widths = [max(_longest_word(row[column]) for row in shown) for column in range(len(rows[0]))]
    widths[0] = max(widths[0], min(max(len(plain(row[0])) for row in shown), _NAME))
    for words, least in zip(rows[0], widths, strict=True):
        table.add_column(words, overflow="fold", min_width=least)
    for row in rows[1 : _MOST_ROWS + 1]:
        table.add_row(*(Text(plain(cell)) for cell in row), style="bold red" if alarming(row) else "")
    # A file or a pipe has no width limit: prefer a longer line to a broken word.
    needed = sum(widths) + 3 * len(widths)
    if not console.is_terminal and needed > console.width:
        console = Console(file=console.file, width=needed, highlight=False, color_system=None)
    console.print(table)
    if len(rows) > _MOST_ROWS + 1:
        line(console, f"  {len(rows) - 1 - _MOST_ROWS} more rows are left out; --json prints all")
