"""The picture of `ground-tools channel compare`: the equations as lines, the packet simulator as points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ground_tools.channel.comparison import Row
from ground_tools.channel.fixed_modes import NAMES
from ground_tools.channel.plot import COLOURS
from sitl_mocks.channel.parameters import MODES

SIZE_IN = (19.0, 6.4)
_EQUAL, _REAL = "as the equations", "real radios"
_MARKS = {_EQUAL: ("o", "none"), _REAL: ("D", "full")}


def draw(figure: Any, rows: Sequence[Row]) -> None:
    """Draw a panel for each study."""
    link, collision, fleet = figure.subplots(1, 3)
    _link(link, [r for r in rows if r.case.study == "link"])
    _collision(collision, [r for r in rows if r.case.study == "collision"])
    _fleet(fleet, [r for r in rows if r.case.study == "fleet"])


def _points(axes: Any, rows: Sequence[Row], x: Sequence[float], variant: str, label: str | None) -> None:
    mark, fill = _MARKS[variant]
    shade = COLOURS[rows[0].case.mode]
    below = [r.packets - r.packets_low for r in rows]
    above = [r.packets_high - r.packets for r in rows]
    axes.errorbar(
        x, [r.packets for r in rows], [below, above], fmt=mark, color=shade, label=label, capsize=3,
        markerfacecolor="white" if fill == "none" else shade, markersize=7,
    )  # fmt: skip


def _link(axes: Any, rows: list[Row]) -> None:
    axes.set_title("One sender, one receiver")
    for mode in MODES:
        for variant in (_EQUAL, _REAL):
            mine = [r for r in rows if r.case.mode == mode and r.case.variant == variant]
            if variant == _EQUAL:
                axes.plot(
                    [r.case.rate for r in mine],
                    [r.equations for r in mine],
                    color=COLOURS[mode],
                    linewidth=1.5,
                )
            _points(axes, mine, [r.case.rate for r in mine], variant, f"{NAMES[mode]}, {variant}")
    axes.set_yscale("log")
    axes.set_xlabel("message rate (1/s)")
    axes.set_ylabel("mean delay (ms)")
    axes.legend(fontsize=10.5, title="lines: equations; points: packet simulation", title_fontsize=10.5)


def _collision(axes: Any, rows: list[Row]) -> None:
    axes.set_title("Everybody hears everybody")
    for mode in MODES:
        for variant in (_EQUAL, _REAL):
            mine = [r for r in rows if r.case.mode == mode and r.case.variant == variant]
            if variant == _EQUAL:
                axes.plot([r.case.uavs for r in mine], [100 * r.equations for r in mine], color=COLOURS[mode])
            shares = [_percent(r) for r in mine]
            _points(
                axes,
                shares,
                [r.case.uavs * (1.03 if variant == _REAL else 0.97) for r in mine],
                variant,
                None,
            )
    axes.set_xscale("log")
    axes.set_xticks(
        sorted({r.case.uavs for r in rows}), [str(n) for n in sorted({r.case.uavs for r in rows})]
    )
    axes.set_xlabel("number of aircraft, at each mode's best rate")
    axes.set_ylabel("packets lost in collisions (%)")
    axes.set_ylim(bottom=0.0)


def _percent(row: Row) -> Row:
    return replace(
        row,
        packets=100.0 * row.packets,
        packets_low=100.0 * row.packets_low,
        packets_high=100.0 * row.packets_high,
    )


def _fleet(axes: Any, rows: list[Row]) -> None:
    axes.set_title("System delay of 10 aircraft")
    for mode in MODES:
        for variant in (_EQUAL, _REAL):
            mine = [r for r in rows if r.case.mode == mode and r.case.variant == variant]
            sides = [r.case.side_m or 0.0 for r in mine]
            if variant == _EQUAL:
                axes.plot(sides, [r.equations for r in mine], color=COLOURS[mode])
            _points(axes, mine, sides, variant, None)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("side of the square (m)")
    axes.set_ylabel("system delay (ms)")
