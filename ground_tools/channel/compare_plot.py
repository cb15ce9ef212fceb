"""The picture of `ground-tools channel compare`: equations as lines, the packet-by-packet simulator as
points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ground_tools.figure import drawn
from ground_tools.inspect.palette import colour, hexadecimal
from sitl_mocks.channel.parameters import MODES

if TYPE_CHECKING:
    from ground_tools.channel.compare import Row

NAMES = {"ble4": "BLE 4", "ble5": "BLE 5", "wifi": "Wi-Fi"}
_EQUAL, _REAL = "as the equations", "real radios"
_MARKS = {_EQUAL: ("o", "none"), _REAL: ("D", "full")}


def draw(rows: Sequence[Row], path: Path) -> None:
    """Write the picture.

    Raises:
        ConfigError: `path` cannot be written, or matplotlib is not installed.
    """
    with drawn(path, (19, 6.4)) as figure:
        link, collision, fleet = figure.subplots(1, 3)
        _link(link, [r for r in rows if r.case.study == "link"])
        _collision(collision, [r for r in rows if r.case.study == "collision"])
        _fleet(fleet, [r for r in rows if r.case.study == "fleet"])


def _colour(mode: str) -> str:
    return hexadecimal(colour(MODES.index(mode)))


def _points(axes: Any, rows: Sequence[Row], x: Sequence[float], variant: str, label: str | None) -> None:
    mark, fill = _MARKS[variant]
    shade = _colour(rows[0].case.mode)
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
                    color=_colour(mode),
                    linewidth=1.5,
                )
            _points(axes, mine, [r.case.rate for r in mine], variant, f"{NAMES[mode]}, {variant}")
    axes.set_yscale("log")
    axes.set_xlabel("message rate (1/s)")
    axes.set_ylabel("mean delay (ms)")
    axes.legend(fontsize=10.5, title="line: equations; point: packets", title_fontsize=10.5)


def _collision(axes: Any, rows: list[Row]) -> None:
    axes.set_title("Everybody hears everybody")
    for mode in MODES:
        for variant in (_EQUAL, _REAL):
            mine = [r for r in rows if r.case.mode == mode and r.case.variant == variant]
            if variant == _EQUAL:
                axes.plot([r.case.uavs for r in mine], [100 * r.equations for r in mine], color=_colour(mode))
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
    axes.set_xlabel("aircraft, each at its mode's best rate")
    axes.set_ylabel("packets lost to others (%)")
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
                axes.plot(sides, [r.equations for r in mine], color=_colour(mode))
            _points(axes, mine, sides, variant, None)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("side of the square (m)")
    axes.set_ylabel("system delay (ms)")
