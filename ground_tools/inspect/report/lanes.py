"""The lanes of a run over time: authority, mode, events, and the highest alert."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from companion.avoidance.alerts import Level
from companion.events import AlertChanged, BroadcastChanged, TransportsChosen
from ground_tools.inspect.read.flown import Flown
from ground_tools.inspect.read.read_run import AircraftRecord, Run
from ground_tools.inspect.report import plots
from ground_tools.inspect.report.terminal import plain
from ground_tools.inspect.viewer.step_columns import HELD_S

Span = tuple[float, float, str, str, str]
"""Start and length (s), colour, hatching, and name of a span."""
_STATES = {
    "guarding": "#9fd3a8",
    "watching": "#cfe5f5",
    "avoiding": "#d55e00",
    "recovering": "#56b4e9",
    "standby": "#dddddd",
    "yielded": "#cc79a7",
    "fault": "#b00020",
}
_LEVELS = {Level.ADVISORY: "#f0e442", Level.CAUTION: "#e69f00", Level.WARNING: "#b00020"}
_MARKS = {
    "on the air switched": ("|", "#0072b2", 9.0),
    "transports chosen": ("|", "#8a8a8a", 6.0),
    "conflict begins": ("^", "#e69f00", 5.0),
    "manoeuvre begins": ("D", "#009e73", 3.5),
    "fault or warning": ("x", "#b00020", 5.0),
}
"""Shape, colour and size of the marker for each kind of event."""
_MODES = (
    *("#bcd7ee", "#f0d9b8", "#cfe8c9", "#d8c9e8", "#f4c7c3", "#c9e6e6", "#e6dfa6", "#c4c9f2", "#f2c4e4"),
    *("#b9d8b0", "#dcbfa8", "#a9c6d9", "#c2a8d8", "#d9d2b0", "#a8d9cb", "#e8b27f", "#9fb3c8", "#d6a8b6"),
)
"""Colours of modes, in the order in which they are first flown. Further modes reuse these colours with
hatching; their names are written in the lane."""
_LEAST_NAMED = 0.06
"""The name of a span is written in it if the span takes at least this share of the time."""


def lanes(run: Run, ways: Flown, aircraft: list[dict[str, Any]]) -> str | None:
    """Plot authority, mode, events and the highest alert over time; None if nothing is known."""
    rows: list[tuple[str, list[Span]]] = []
    marks: dict[int, dict[str, list[float]]] = {}
    """Times of the markers, by row and kind."""
    used: dict[str, str] = {}
    modes = list(dict.fromkeys(span["mode"] for one in aircraft for span in one["flight"]["modes"]))
    for one, record in zip(aircraft, run.aircraft, strict=True):
        for key, what in (("authority", "state"), ("modes", "mode")):
            spans: list[Span] = []
            for span in one["flight"][key]:
                name = span[what]
                tint, hatch = _STATES.get(name, "#eeeeee"), ""
                if key == "modes":
                    tint, hatch = _mode_look(modes.index(name))
                used[f"{'mode ' if key == 'modes' else ''}{name}"] = tint
                spans.append((span["from_s"], span["to_s"] - span["from_s"], tint, hatch, name))
            if spans:
                rows.append((f"{one['name']} {'who flew' if key == 'authority' else 'mode'}", spans))
        alarms = _alarms(record.facts.rare, ways.offsets_s[record.name], one["flight"]["end_s"])
        told = _happened(record, one, ways.offsets_s[record.name])
        if told:
            marks[len(rows)] = told
            rows.append((f"{one['name']} events", []))
        if alarms:
            spans = [(a, b - a, _LEVELS[level], "", level.name.lower()) for a, b, level in alarms]
            rows.append((f"{one['name']} alert", spans))
            used |= {f"alert {level.name.lower()}": _LEVELS[level] for _, _, level in alarms}
    if not rows:
        return None

    def draw(figure: Any) -> None:
        _lanes(figure, rows, marks, used)

    return plots.svg((9.4, 1.1 + 0.24 * len(rows)), draw)


def _mode_look(index: int) -> tuple[str, str]:
    """Colour and hatching of the mode with this index."""
    return _MODES[index % len(_MODES)], "////" if index >= len(_MODES) else ""


def _lanes(
    figure: Any,
    rows: list[tuple[str, list[Span]]],
    marks: dict[int, dict[str, list[float]]],
    used: dict[str, str],
) -> None:
    """Draw the rows of `lanes`.

    Args:
        rows: name of each row, and its spans.
        marks: times of the markers (s), by row and kind.
        used: colour of each word in the legend.
    """
    axes = figure.subplots()
    whole_s = max((a + b for _, spans in rows for a, b, *_ in spans), default=0.0)
    whole_s -= min((a for _, spans in rows for a, *_ in spans), default=0.0)
    for index, (_, spans) in enumerate(rows):
        for start_s, length_s, tint, hatch, name in spans:
            axes.broken_barh(
                [(start_s, max(length_s, 0.05))],
                (index - 0.4, 0.8),
                facecolors=tint,
                hatch=hatch,
                edgecolor="#777777" if hatch else "none",
                lw=0.0,
            )
            if length_s >= _LEAST_NAMED * whole_s > 0.0:
                middle = start_s + 0.5 * length_s
                look = {"fontsize": 5.5, "ha": "center", "va": "center", "color": plots.INK_ON_TINT}
                axes.text(middle, index, plain(name)[:16], clip_on=True, **look)
    for kind, (shape, tint, size) in _MARKS.items():
        points = [(time, row) for row, told in marks.items() for time in told.get(kind, ())]
        if points:
            axes.plot(*zip(*points, strict=True), shape, color=tint, ms=size, label=kind)
    axes.set_yticks(range(len(rows)), [plain(name) for name, _ in rows], fontsize=7.0)
    axes.set(xlabel="time (s)", ylim=(len(rows) - 0.4, -0.6))
    for name, tint in used.items():
        axes.plot([], [], "s", color=tint, ms=7, label=plain(name))
    plots.legend(figure, axes)


def _happened(record: AircraftRecord, figures: dict[str, Any], offset_s: float) -> dict[str, list[float]]:
    """Return the times of momentary events, by kind (of `_MARKS`)."""
    conflict = record.facts.decisions.now_s[record.facts.decisions.conflict] + offset_s
    rare = [(now_s + offset_s, what) for now_s, what in record.facts.rare]
    found = {
        "conflict begins": conflict[np.diff(conflict, prepend=-np.inf) > HELD_S].tolist(),
        "manoeuvre begins": [one["start_s"] for one in figures["manoeuvres"]],
        "on the air switched": [time for time, what in rare if isinstance(what, BroadcastChanged)],
        "transports chosen": [time for time, what in rare if isinstance(what, TransportsChosen)],
        "fault or warning": [one["time_s"] for one in figures["faults"]],
    }
    return {kind: times for kind, times in found.items() if times}


def _alarms(
    rare: Iterable[tuple[float, object]], offset_s: float, end_s: float
) -> list[tuple[float, float, Level]]:
    """Return the spans (start, end, level) of the highest alert level of any track, without level 0."""
    levels: dict[str, int] = {}
    found: list[tuple[float, float, Level]] = []
    since, highest = 0.0, 0
    for now_s, what in rare:
        if not isinstance(what, AlertChanged):
            continue
        levels[what.track_id] = min(max(what.level, 0), max(Level))
        if (now := max(levels.values())) != highest:
            if highest:
                found.append((since, now_s + offset_s, Level(highest)))
            since, highest = now_s + offset_s, now
    return [*found, (since, end_s, Level(highest))] if highest else found
