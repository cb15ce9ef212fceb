"""Plots of a run as SVG to embed in a page.

They show paths, separation, heights, speeds, ages, rates, lanes, and the velocity space of a manoeuvre.
Text remains text in the SVG, which keeps the file small and the print sharp. Names come from logs. They are
not parsed as mathematical text, and matplotlib escapes them.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.arrays import Floats
from companion.avoidance.alerts import Level
from companion.events import AlertChanged, BroadcastChanged, TransportsChosen
from ground_tools.common.figure import styled
from ground_tools.inspect.explain.manoeuvres import Manoeuvre
from ground_tools.inspect.read.flown import Flown, Separation, crossing, least_of
from ground_tools.inspect.read.read_run import AircraftRecord, Run
from ground_tools.inspect.report.terminal import plain
from ground_tools.inspect.viewer.palette import LIMIT, colour, hexadecimal
from ground_tools.inspect.viewer.watch import HELD_S

MOST_LINES = 12
"""Most pairs, aircraft or tracks drawn individually in one plot. If there are more pairs, the closest are
drawn."""
MOST_POINTS = 1200
"""Most points of one line. More cannot be distinguished on paper."""
_OVER = 5
"""Number of broadcasts over which a rate is computed."""
_MAX_SILENCE_S = 3.0
"""Ages farther apart in time are not joined by a line."""
_HALF_WIDTH_M = 120.0
_TOP_OF_REQUIRED = 6.0
_LIMIT = hexadecimal(LIMIT)
_WORDS = 9.0
_SVG = {
    "svg.fonttype": "none",
    "svg.hashsalt": "dmuca",
    "text.parse_math": False,
    "font.size": _WORDS,
    "axes.titlesize": _WORDS + 1.0,
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "lines.linewidth": 1.2,
}
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
_MODES = ("#bcd7ee", "#d8c9e8", "#cfe8c9", "#f0d9b8", "#e0e0e0")


def svg(size_in: tuple[float, float], draw: Callable[[Any], None]) -> str:
    """Call `draw` on an empty figure and return the result as an <svg> element.

    Raises:
        ConfigError: matplotlib is not installed.
    """
    with styled(size_in, **_SVG) as figure:
        draw(figure)
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]


def shade(index: int) -> str:
    """Return the colour of the aircraft or pair with this index."""
    return hexadecimal(colour(index))


def thin(time: Floats, *rows: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Keep every n-th sample of a line, so that about `MOST_POINTS` remain."""
    step = max(len(time) // MOST_POINTS, 1)
    return tuple(row[::step] for row in (time, *rows))


def lowest(time: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Thin a line to the smallest value of every n samples, so that no minimum is lost."""
    step = max(len(time) // MOST_POINTS, 1)
    if step == 1:
        return time, values
    whole = len(time) // step * step
    rows = np.where(np.isnan(values[:whole]), np.inf, values[:whole]).reshape(-1, step)
    best = rows.argmin(axis=1)
    least = rows[np.arange(len(rows)), best]
    return time[:whole].reshape(-1, step)[np.arange(len(rows)), best], np.where(
        np.isinf(least), np.nan, least
    )


def paths(ways: Flown, pairs: list[Separation]) -> str:
    """Plot the paths from above: the whole run, and the area where the pairs come closest."""

    def draw(figure: Any) -> None:
        whole, *near = np.atleast_1d(figure.subplots(1, 2 if pairs else 1))
        for index, path in enumerate(ways.paths):
            _, north, east = thin(path.time_s, path.position_ned_m[:, 0], path.position_ned_m[:, 1])
            for axes in (whole, *near):
                axes.plot(east, north, color=shade(index), label=plain(path.name))
                axes.plot(east[0], north[0], "o", color=shade(index), mfc="white", ms=5)
                axes.plot(east[-1], north[-1], "s", color=shade(index), ms=4)
        whole.set(title="Whole run (o start, ■ end)", aspect="equal", xlabel="east (m)", ylabel="north (m)")
        whole.set_adjustable("datalim")
        for axes in near:
            _around(axes, ways, pairs)
        _legend(figure, whole)

    return svg((9.4, 5.4), draw)


def _around(axes: Any, ways: Flown, pairs: list[Separation]) -> None:
    """Zoom to where the pairs come closest."""
    for pair in pairs[:MOST_LINES]:
        if pair.minimum_m is not None and pair.minimum_m < pair.required_m:
            _mark(axes, ways, pair)
    centre = crossing(ways, pairs)
    least_m = min((pair.minimum_m for pair in pairs if pair.minimum_m is not None), default=0.0)
    half_m = max(_HALF_WIDTH_M, 0.75 * least_m)
    axes.set(
        title="Around the closest approaches",
        xlim=(centre[1] - half_m, centre[1] + half_m),
        ylim=(centre[0] - half_m, centre[0] + half_m),
        aspect="equal",
        xlabel="east (m)",
    )


def _mark(axes: Any, ways: Flown, pair: Separation) -> None:
    """Mark where a pair lost its separation."""
    for path in ways.paths:
        if path.name in (pair.first, pair.second):
            n, e = (
                np.interp(pair.minimum_time_s or 0.0, path.time_s, path.position_ned_m[:, c]) for c in (0, 1)
            )
            axes.plot(e, n, "x", color=_LIMIT, ms=9, mew=2.5)


def separation(pairs: list[Separation]) -> str:
    """Plot the separation of the closest pairs over time, with the limit."""
    shown = pairs[:MOST_LINES]

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for index, pair in enumerate(shown):
            time, distance = lowest(pair.time_s, pair.distance_m)
            axes.plot(
                time, distance, color=shade(index), lw=1.0, label=plain(f"{pair.first} - {pair.second}")
            )
        time, least = lowest(*least_of(pairs))
        axes.plot(time, least, color="#222222", lw=1.8, label="minimum of all pairs")
        required = max(pair.required_m for pair in pairs)
        axes.axhline(required, color=_LIMIT, lw=1.6, ls="--", label=f"limit {required:g} m")
        top = max(_TOP_OF_REQUIRED * required, 1.5 * float(np.nanmin(least)))
        axes.axhspan(0.0, required, color=_LIMIT, alpha=0.08, lw=0)
        near = time[least <= top]
        if len(near):
            axes.set_xlim(near[0] - 5.0, near[-1] + 5.0)
        axes.set(ylim=(0.0, top), xlabel="time (s)", ylabel="slant distance (m)")
        _legend(figure, axes)

    return svg((9.4, 3.9), draw)


def heights(ways: Flown) -> str:
    """Plot the heights above the frame's origin."""

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for index, path in enumerate(ways.paths):
            time, down = thin(path.time_s, path.position_ned_m[:, 2])
            axes.plot(time, -down, color=shade(index), label=plain(path.name))
        axes.set(xlabel="time (s)", ylabel=f"height above {ways.origin[2]:.0f} m MSL (m)")
        _legend(figure, axes)

    return svg((9.4, 2.9), draw)


def speeds(run: Run, ways: Flown) -> str | None:
    """Plot the wanted, commanded and flown speed of each aircraft with decisions; None if there are none."""
    deciding = [record for record in run.aircraft if len(record.facts.decisions.now_s)][:MOST_LINES]
    if not deciding:
        return None

    def draw(figure: Any) -> None:
        rows = figure.subplots(len(deciding), 1, sharex=True, squeeze=False)[:, 0]
        for axes, record in zip(rows, deciding, strict=True):
            found, offset = record.facts.decisions, ways.offsets_s[record.name]
            time, speeds = thin(found.now_s + offset, found.speeds_mps)
            for column, (words, tint, width) in enumerate(
                (("flown", "#9a9a9a", 1.6), ("wanted", "#0072b2", 1.1), ("commanded", _LIMIT, 1.1))
            ):
                axes.plot(time, speeds[:, column], color=tint, lw=width, label=words)
            axes.set_title(plain(record.name), fontsize=_WORDS)
            axes.set(ylim=(0.0, None), ylabel="m/s")
        rows[-1].set_xlabel("time (s)")
        _legend(figure, rows[0])

    return svg((9.4, 0.9 + 1.15 * len(deciding)), draw)


def ages(run: Run, ways: Flown) -> str | None:
    """Plot the largest age of the information about each track in every second; None without tracks."""
    shown = [
        (record.name, track, facts)
        for record in run.aircraft
        for track, facts in sorted(record.facts.tracks.items())
        if len(facts.now_s)
    ]
    if not shown:
        return None
    names = list(dict.fromkeys(name for name, _, _ in shown))

    def draw(figure: Any) -> None:
        rows = figure.subplots(len(names), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for axes, name in zip(rows, names, strict=True):
            mine = sorted((f for f in shown if f[0] == name), key=lambda f: -float(f[2].age_s.max()))
            for index, (_, track, facts) in enumerate(mine[:MOST_LINES]):
                time, age = thin(facts.now_s + ways.offsets_s[name], facts.age_s)
                age = np.where(np.diff(time, prepend=time[0]) > _MAX_SILENCE_S, np.nan, age)
                axes.plot(time, age, lw=0.8, color=shade(index), label=plain(track))
            axes.set_title(plain(f"tracks of {name}"), fontsize=_WORDS)
            axes.set(ylim=(0.0, None), ylabel="age (s)")
            axes.legend(fontsize=6.5, ncols=6, frameon=False, loc="upper left")
        rows[-1].set_xlabel("time (s)")

    return svg((9.4, 0.9 + 1.3 * len(names)), draw)


def rates(run: Run, ways: Flown) -> str | None:
    """Plot the broadcasts per second on each transport, over the last `_OVER`; None if there are too few."""
    lanes = [
        (record.name, transport, times + ways.offsets_s[record.name])
        for record in run.aircraft
        for transport, times in sorted(record.facts.sent.items())
        if len(times) > _OVER
    ]
    if not lanes:
        return None

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        styles = dict(zip(sorted({t for _, t, _ in lanes}), ("-", "--", ":", "-."), strict=False))
        for index, (name, transport, times) in enumerate(lanes[: 2 * MOST_LINES]):
            time, rate = thin(times[_OVER:], _OVER / np.maximum(times[_OVER:] - times[:-_OVER], 1e-3))
            look = {"color": shade(index), "ls": styles.get(transport, "-")}
            axes.plot(time, rate, label=plain(f"{name} {transport}"), **look)
        axes.set(ylim=(0.0, None), xlabel="time (s)", ylabel="broadcasts per second")
        _legend(figure, axes)

    return svg((9.4, 2.7), draw)


def lanes(run: Run, ways: Flown, aircraft: list[dict[str, Any]]) -> str | None:
    """Plot authority, mode, events and the highest alert over time; None if nothing is known."""
    rows: list[tuple[str, list[tuple[float, float, str]]]] = []
    marks: dict[int, dict[str, list[float]]] = {}
    """Times of the markers, by row and kind."""
    used: dict[str, str] = {}
    modes = list(dict.fromkeys(span["mode"] for one in aircraft for span in one["flight"]["modes"]))
    for one, record in zip(aircraft, run.aircraft, strict=True):
        for key, what in (("authority", "state"), ("modes", "mode")):
            spans = []
            for span in one["flight"][key]:
                known = key == "authority" or len(modes) <= len(_MODES)
                tint = _STATES.get(span[what], "#eeeeee") if key == "authority" else _MODES[-1]
                if key == "modes" and known:
                    tint = _MODES[modes.index(span[what])]
                used[f"{'mode ' if key == 'modes' else ''}{span[what]}"] = tint
                spans.append((span["from_s"], span["to_s"] - span["from_s"], tint))
            if spans:
                rows.append((f"{one['name']} {'who flew' if key == 'authority' else 'mode'}", spans))
        alarms = _alarms(record.facts.rare, ways.offsets_s[record.name], one["flight"]["end_s"])
        told = _happened(record, one, ways.offsets_s[record.name])
        if told:
            marks[len(rows)] = told
            rows.append((f"{one['name']} events", []))
        if alarms:
            rows.append((f"{one['name']} alert", [(a, b - a, _LEVELS[level]) for a, b, level in alarms]))
            used |= {f"alert {level.name.lower()}": _LEVELS[level] for _, _, level in alarms}
    if not rows:
        return None

    def draw(figure: Any) -> None:
        _lanes(figure, rows, marks, used)

    return svg((9.4, 1.1 + 0.24 * len(rows)), draw)


def _lanes(
    figure: Any,
    rows: list[tuple[str, list[tuple[float, float, str]]]],
    marks: dict[int, dict[str, list[float]]],
    used: dict[str, str],
) -> None:
    """Draw the rows of `lanes`.

    Args:
        rows: name of each row, and its spans: start, length (s) and colour.
        marks: times of the markers (s), by row and kind.
        used: colour of each word in the legend.
    """
    axes = figure.subplots()
    for index, (_, spans) in enumerate(rows):
        axes.broken_barh(
            [(a, max(b, 0.05)) for a, b, _ in spans],
            (index - 0.4, 0.8),
            facecolors=[c for _, _, c in spans],
        )
    for kind, (shape, tint, size) in _MARKS.items():
        points = [(time, row) for row, told in marks.items() for time in told.get(kind, ())]
        if points:
            axes.plot(*zip(*points, strict=True), shape, color=tint, ms=size, label=kind)
    axes.set_yticks(range(len(rows)), [plain(name) for name, _ in rows], fontsize=7.0)
    axes.set(xlabel="time (s)", ylim=(len(rows) - 0.4, -0.6))
    for name, tint in used.items():
        axes.plot([], [], "s", color=tint, ms=7, label=plain(name))
    _legend(figure, axes)


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


def velocities(one: Manoeuvre, speed_mps: float) -> str | None:
    """Plot the velocity space at a manoeuvre's start from above; None without alternatives.

    It shows which horizontal velocities the half-spaces allow at the vertical speed that the law found.
    """
    if not one.alternatives:
        return None
    found = one.alternatives[0].velocity_ned_mps
    reach = 1.15 * speed_mps

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        around = np.linspace(0.0, 2.0 * np.pi, 120)
        axes.plot(speed_mps * np.sin(around), speed_mps * np.cos(around), color="#999999", lw=0.9, ls=":")
        _half_spaces(axes, one, found[2], reach)
        for velocity, words, tint in (
            (one.decision.velocity_ned_mps, "own velocity", "#9a9a9a"),
            (one.decision.wanted_ned_mps, "wanted", "#111111"),
            (found, "chosen by the law", _LIMIT),
        ):
            axes.annotate(
                "", velocity[1::-1], (0.0, 0.0), arrowprops={"arrowstyle": "-|>", "color": tint, "lw": 1.8}
            )
            axes.plot([], [], color=tint, lw=2, label=words)
        for number, other in enumerate(one.alternatives[2:], start=1):
            n, e, _ = other.velocity_ned_mps
            mark = "x" if other.excluded_by else "o"
            axes.plot(e, n, mark, color="#222222", ms=4)
            axes.annotate(str(number), (e, n), (3, 3), textcoords="offset points", fontsize=7)
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        axes.set(xlabel="east (m/s)", ylabel="north (m/s)")
        axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), fontsize=7.5, frameon=False)

    return svg((5.6, 3.6), draw)


def _half_spaces(axes: Any, one: Manoeuvre, down_mps: float, reach: float) -> None:
    """Draw where each half-space forbids a horizontal velocity, at this vertical speed."""
    grid = np.linspace(-reach, reach, 9)  # a coarse grid is exact for planes
    east, north = np.meshgrid(grid, grid)
    index = 0
    shown: list[str] = []
    for space in one.half_spaces:
        n, e, d = space.normal_ned
        if n == e == d == 0.0 or np.hypot(n, e) < 1e-6:
            continue
        kept = n * north + e * east + d * down_mps - space.least_mps
        if kept.min() > 0.0 or kept.max() < 0.0:
            continue
        tint = shade(index) if space.active else "#b5b5b5"
        index += space.active
        axes.contour(east, north, kept, [0.0], colors=[tint], linewidths=1.5 if space.active else 0.8)
        axes.contourf(east, north, kept, [kept.min(), 0.0], colors=[tint], alpha=0.14)
        name = space.cause if space.active else "others, which do not bound the velocity"
        if name not in shown and len(shown) < MOST_LINES:
            shown.append(name)
            axes.plot([], [], color=tint, label=plain(name))


def _legend(figure: Any, axes: Any) -> None:
    """Draw the legend below the plots, where it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=7.5, frameon=False)
