"""Plots of a run as SVG to embed in a page.

They show paths, separation, heights, speeds, ages, rates, and the velocity space of a manoeuvre. `lanes` has
the lanes over time.
Text remains text in the SVG, which keeps the file small and the print sharp. Names come from logs. They are
not parsed as mathematical text, and matplotlib escapes them.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.arrays import Floats
from ground_tools.common.figure import styled
from ground_tools.inspect.explain.manoeuvres import Manoeuvre
from ground_tools.inspect.read.flown import Flown, Separation, crossing, fixes_of, gap_s, least_of, unbroken
from ground_tools.inspect.read.heights import spikes
from ground_tools.inspect.read.read_run import Run
from ground_tools.inspect.report.terminal import plain
from ground_tools.inspect.viewer.palette import LIMIT, colour, hexadecimal

MOST_LINES = 12
"""Most pairs, aircraft or tracks drawn individually in one plot. If there are more pairs, the closest are
drawn."""
MOST_POINTS = 1200
"""Most points of one line. More cannot be distinguished on paper."""
_OVER = 5
"""Number of broadcasts over which a rate is computed."""
_LEAST_SPAN_M = 10.0
"""Heights are drawn on an axis of at least this span, so that level flight looks level."""
_HALF_WIDTH_M = 120.0
_TOP_OF_REQUIRED = 6.0
_LIMIT = hexadecimal(LIMIT)
_WORDS = 9.0
DARK = {
    "#ffffff": "#16181b",
    "#000000": "#e8e8e8",
    "#111111": "#e8e8e8",
    "#222222": "#e8e8e8",
    "#e4e4e4": "#34383e",
    "#5a5a5a": "#a0a0a0",
    "#0072b2": "#2b8fd6",
    "#b00020": "#ff6b62",
}
"""Replacement colours for a dark page background. The other colours are legible on both backgrounds."""
INK_ON_TINT = "#1b1b1b"
"""Colour of text within a coloured span, on both backgrounds."""
_DRAWN = re.compile(f"(?<=: )#({'|'.join(name[1:] for name in DARK)})")
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


def svg(size_in: tuple[float, float], draw: Callable[[Any], None]) -> str:
    """Call `draw` on an empty figure and return the result as an <svg> element.

    A colour of `DARK`, such as #ffffff, is written as the variable `--plot-ffffff` with itself as the
    default, so that the style of a page may replace it.

    Raises:
        ConfigError: matplotlib is not installed.
    """
    with styled(size_in, **_SVG) as figure:
        draw(figure)
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    # In tags only: a name from a log may read like a colour, and its brackets are escaped.
    return re.sub("<[^>]*>", _themed, text[text.index("<svg") :])


def _themed(tag: re.Match[str]) -> str:
    return _DRAWN.sub(r"var(--plot-\1, #\1)", tag[0])


def shade(index: int) -> str:
    """Return the colour of the aircraft or pair with this index."""
    return hexadecimal(colour(index))


def open_at_gaps(time: Floats, *rows: Floats, extreme: bool = False) -> tuple[Floats, ...]:
    """Thin a line, and break it with a row of NaN at each gap in the data.

    Args:
        time: (n,) rising times.
        rows: (n,) values of the line.
        extreme: in the first of `rows`, keep the greatest and the least value of every n samples, so that no
            peak is lost.

    Returns:
        The times and the values of the line to draw.
    """
    step = max(len(time) // MOST_POINTS, 1)
    kept: list[NDArray[np.intp]] = []
    every = np.arange(len(time))
    for part in (every[span] for span in unbroken(time, gap_s(time))):
        blocks = [part[at : at + step] for at in range(0, len(part), step)]
        if extreme:
            chosen = [block[of(rows[0][block])] for block in blocks for of in (np.argmax, np.argmin)]
        else:
            chosen = [block[0] for block in blocks]
        kept += [np.unique([*chosen, *part[-1:]]), np.array([-1])]
    index = np.concatenate(kept[:-1])
    return tuple(np.where(index < 0, np.nan, row[index]) for row in (time, *rows))


def lowest(time: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Thin a line to the smallest value of every n samples, so that no minimum is lost."""
    step = max(len(time) // MOST_POINTS, 1)
    if step == 1:
        return time, values
    # The last row is filled up, so that the end of the line, which may be the least value, is not left out.
    fill = -len(time) % step
    rows = np.append(np.where(np.isnan(values), np.inf, values), np.full(fill, np.inf)).reshape(-1, step)
    best = rows.argmin(axis=1)
    least = rows[np.arange(len(rows)), best]
    return time[np.arange(len(rows)) * step + best], np.where(np.isinf(least), np.nan, least)


def paths(ways: Flown, pairs: list[Separation]) -> str:
    """Plot the paths from above: the whole run, and the area where the pairs come closest."""

    def draw(figure: Any) -> None:
        whole, *near = np.atleast_1d(figure.subplots(1, 2 if pairs else 1))
        for index, path in enumerate(ways.paths):
            _, north, east = open_at_gaps(path.time_s, path.position_ned_m[:, 0], path.position_ned_m[:, 1])
            for axes in (whole, *near):
                axes.plot(east, north, color=shade(index), label=plain(path.name))
                axes.plot(east[0], north[0], "o", color=shade(index), mfc="white", ms=5)
                axes.plot(east[-1], north[-1], "s", color=shade(index), ms=4)
        whole.set(title="Whole run (o start, ■ end)", aspect="equal", xlabel="east (m)", ylabel="north (m)")
        whole.set_adjustable("datalim")
        for axes in near:
            _around(axes, ways, pairs)
        legend(figure, whole)

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
        axes.plot(*open_at_gaps(time, least), color="#222222", lw=1.8, label="minimum of all pairs")
        required = max(pair.required_m for pair in pairs)
        axes.axhline(required, color=_LIMIT, lw=1.6, ls="--", label=f"limit {required:g} m")
        top = max(_TOP_OF_REQUIRED * required, 1.5 * float(np.nanmin(least)))
        axes.axhspan(0.0, required, color=_LIMIT, alpha=0.08, lw=0)
        near = time[least <= top]
        if len(near):
            axes.set_xlim(near[0] - 5.0, near[-1] + 5.0)
        axes.set(ylim=(0.0, top), xlabel="time (s)", ylabel="slant distance (m)")
        legend(figure, axes)

    return svg((9.4, 3.9), draw)


def heights(run: Run, ways: Flown) -> str | None:
    """Plot the height of each aircraft above its home; None if no aircraft reported a position.

    Samples that stand out (`heights.spikes`) are marked at the edge and do not stretch the axis.
    """
    shown = [
        (index, record, height)
        for index, record in enumerate(run.aircraft)
        if len(height := _above_home(fixes_of(record)))
    ]
    if not shown:
        return None

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        outside: list[tuple[float, float]] = []
        for index, record, height in shown:
            time = fixes_of(record)[:, 0] + ways.offsets_s[record.name]
            bad = spikes(time, height)
            outside += zip(time[bad].tolist(), height[bad].tolist(), strict=True)
            axes.plot(
                *open_at_gaps(time[~bad], height[~bad], extreme=True),
                color=shade(index),
                label=plain(record.name),
            )
        low, high = axes.get_ylim()
        middle, half = 0.5 * (low + high), 0.5 * max(high - low, _LEAST_SPAN_M)
        axes.set(xlabel="time (s)", ylabel="height above home (m)", ylim=(middle - half, middle + half))
        if outside:
            worst = max((height for _, height in outside), key=abs)
            edge = [middle + (0.97 if height > middle else -0.97) * half for _, height in outside]
            words = f"{len(outside)} outside, as far as {worst:.0f} m"
            axes.plot([time for time, _ in outside], edge, "x", color=_LIMIT, ms=6, label=words)
        legend(figure, axes)

    return svg((9.4, 2.9), draw)


def _above_home(fixes: Floats) -> Floats:
    """Height above home (n,) of fixes; above the first fix if they contain no height above home."""
    if not len(fixes) or not np.isnan(fixes[:, 7]).all():
        return fixes[:, 7]
    return np.asarray(fixes[:, 3] - fixes[0, 3])


def speeds(run: Run, ways: Flown) -> str | None:
    """Plot the wanted, commanded and flown speed of each aircraft with decisions; None if there are none."""
    deciding = [record for record in run.aircraft if len(record.facts.decisions.now_s)][:MOST_LINES]
    if not deciding:
        return None

    def draw(figure: Any) -> None:
        rows = figure.subplots(len(deciding), 1, sharex=True, squeeze=False)[:, 0]
        for axes, record in zip(rows, deciding, strict=True):
            found, offset = record.facts.decisions, ways.offsets_s[record.name]
            time = found.now_s + offset
            for column, (words, tint, width) in enumerate(
                (("flown", "#9a9a9a", 1.6), ("wanted", "#0072b2", 1.1), ("commanded", _LIMIT, 1.1))
            ):
                speed = found.speeds_mps[:, column].astype(np.float64)
                axes.plot(*open_at_gaps(time, speed, extreme=True), color=tint, lw=width, label=words)
            axes.set_title(plain(record.name), fontsize=_WORDS)
            axes.set(ylim=(0.0, None), ylabel="m/s")
        rows[-1].set_xlabel("time (s)")
        legend(figure, rows[0])

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
                line = open_at_gaps(facts.now_s + ways.offsets_s[name], facts.age_s, extreme=True)
                axes.plot(*line, lw=0.8, color=shade(index), label=plain(track))
            axes.set_title(plain(f"tracks of {name}"), fontsize=_WORDS)
            axes.set(ylabel="age (s)")
            axes.legend(fontsize=6.5, ncols=6, frameon=False, loc="upper left")
        # Set the limit last: the panels share one axis, and a limit also applies to data drawn later.
        rows[0].set_ylim(0.0, 1.05 * max(float(facts.age_s.max()) for _, _, facts in shown))
        rows[-1].set_xlabel("time (s)")

    return svg((9.4, 0.9 + 1.3 * len(names)), draw)


def rates(run: Run, ways: Flown) -> str | None:
    """Plot the broadcasts per second on each transport, over the last `_OVER`; None if there are too few.

    In a silence no line is drawn. The lowest rate is not lost.
    """
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
            rate = _OVER / np.maximum(times[_OVER:] - times[:-_OVER], 1e-3)
            time, rate = open_at_gaps(times[_OVER:], rate, extreme=True)
            look = {"color": shade(index), "ls": styles.get(transport, "-")}
            axes.plot(time, rate, label=plain(f"{name} {transport}"), **look)
        axes.set(ylim=(0.0, None), xlabel="time (s)", ylabel="broadcasts per second")
        legend(figure, axes)

    return svg((9.4, 2.7), draw)


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
        # Use a legend of the figure: the layout reserves room for it, so no text or label is cut off.
        figure.legend(loc="outside right upper", fontsize=7.5, frameon=False)

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


def legend(figure: Any, axes: Any) -> None:
    """Draw the legend below the plots, where it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=7.5, frameon=False)
