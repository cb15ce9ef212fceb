"""The paper's two drawings without numbers: the DMUCA framework, and the operation of the three radio modes.

The drawing of the radio modes is to scale: it is made from the channel's default parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from ground_tools.common.figure import drawn
from ground_tools.paper.report import Report
from sitl_mocks.channel.parameters import (
    WIFI_CHANNELS,
    Ble5Parameters,
    BleParameters,
    ChannelParameters,
    WifiParameters,
)

_BOXES: Final = {
    "Observe": (
        "Own position and velocity (GNSS).",
        "Remote ID on BLE 4, BLE 5 or Wi-Fi",
        "at a rate of psi messages a second.",
    ),
    "Orient": (
        "Tracks of other aircraft, predicted",
        "over the delay of their messages:",
        "position + delay x velocity.",
    ),
    "Decide": (
        "ORCA half-spaces of all neighbours:",
        "the nearest velocity that avoids them.",
        "Without conflict: back to the path.",
    ),
    "Act": (
        "Velocity setpoint to the autopilot.",
        "ATMC chooses transports and rates",
        "for the next period.",
    ),
}
_SENDS, _LISTENS, _HEARD = "#2a78d6", "#d9d9d9", "#e34948"
_SHOWN_MS: Final = 26.0
_EVENT_MS: Final = (0.6, 16.9)
"""Start times of the two advertising events that are drawn, one of which is received."""
_BEACONS_MS: Final = (2.2, 10.5, 17.8)


def framework_report() -> Report:
    """The report on the drawing of the framework."""
    return Report(
        title="The DMUCA framework: observe, orient, decide, act",
        notes=("A drawing without numbers. docs/architecture.md names the modules of each part.",),
    )


def modes_report() -> Report:
    """The report on the drawing of the radio modes."""
    p = ChannelParameters()
    return Report(
        title="Operation of BLE 4, BLE 5 and Wi-Fi as senders and receivers",
        notes=(
            "Drawn to scale from the parameters of the paper's table. Blue: packets. Grey: the receiver "
            "listens, on the channel that is named. Red: packets that lie wholly within a window of their "
            "channel.",
            f"BLE: windows of {p.ble4.scan_window_ms:g} ms every {p.ble4.scan_interval_ms:g} ms, packets of "
            f"{p.ble4.packet_ms:g} ms (BLE 4) and pointers of {p.ble5.packet_ms:g} ms (BLE 5), the auxiliary "
            f"packet of {p.ble5.auxiliary_ms:g} ms {p.ble5.auxiliary_offset_ms:g} ms after the event's "
            f"start. Wi-Fi: {p.wifi.scan_ms:g} ms on each channel, {p.wifi.switch_ms:g} ms to switch, "
            f"beacons of {p.wifi.beacon_ms:g} ms.",
        ),
    )


def draw_framework(path: Path) -> None:
    """Draw the four parts and the path of a message from one aircraft to another.

    Raises:
        ConfigError: matplotlib is missing, or the file cannot be written.
    """
    with drawn(path, (13.0, 4.6)) as figure:
        axes = figure.subplots()
        axes.set_axis_off()
        axes.set_xlim(0.0, 13.0)
        axes.set_ylim(0.0, 4.6)
        for place, (name, words) in enumerate(_BOXES.items()):
            left = 0.15 + 3.22 * place
            axes.text(left + 1.45, 3.0, name, ha="center", va="center", fontsize=15, fontweight="bold")
            axes.text(left + 1.45, 2.1, "\n".join(words), ha="center", va="center", fontsize=9.5)
            axes.plot([left, left + 2.9, left + 2.9, left, left], [1.4, 1.4, 3.4, 3.4, 1.4], color=_SENDS)
            if place:
                _arrow(axes, (left - 0.3, 2.4), (left - 0.02, 2.4))
        _arrow(axes, (11.3, 1.38), (11.3, 0.6))
        axes.plot([1.6, 11.3], [0.6, 0.6], color="black", lw=1.2)
        _arrow(axes, (1.6, 0.6), (1.6, 1.38))
        axes.text(6.5, 0.3, "the aircraft moves; the next period begins", ha="center", fontsize=10)
        _arrow(axes, (1.6, 4.25), (1.6, 3.42))
        axes.text(1.8, 4.1, "Remote ID of other aircraft, delayed and lost by the radio channel", fontsize=10)


def draw_modes(path: Path) -> None:
    """Draw packets and listening windows of the three modes over time.

    Raises:
        ConfigError: matplotlib is missing, or the file cannot be written.
    """
    p = ChannelParameters()
    with drawn(path, (13.0, 7.5)) as figure:
        panels = figure.subplots(3, 1, sharex=True)
        ble4 = [packet for begin in _EVENT_MS for packet in primary_packets(p.ble4, begin)]
        _panel(panels[0], "BLE 4: legacy advertising", ble4, ble_windows(p.ble4), ("37", "38", "39"))
        ble5 = [packet for begin in _EVENT_MS for packet in primary_packets(p.ble5, begin)]
        _panel(
            panels[1], "BLE 5: pointers and auxiliary packets", ble5, ble_windows(p.ble5), ("37", "38", "39")
        )
        for begin in _EVENT_MS:
            pointed = any(is_heard(packet, ble_windows(p.ble5)) for packet in primary_packets(p.ble5, begin))
            colour, at = _HEARD if pointed else _SENDS, begin + p.ble5.auxiliary_offset_ms
            panels[1].broken_barh([(at, p.ble5.auxiliary_ms)], (2.65, 0.7), color=colour)
        panels[1].set_yticks(range(4), ["37", "38", "39", "0-36"])
        wifi = [(begin, p.wifi.beacon_ms, 1) for begin in _BEACONS_MS]
        names = tuple(map(str, WIFI_CHANNELS))
        _panel(panels[2], "Wi-Fi: beacons on channel 6", wifi, wifi_windows(p.wifi), names)
        panels[2].set_xlabel("time (ms)")
        panels[2].set_xlim(0.0, _SHOWN_MS)


Span = tuple[float, float, int]
"""Start and duration (ms), and channel, counted from 0."""


def primary_packets(ble: BleParameters | Ble5Parameters, begin_ms: float) -> list[Span]:
    """The three packets of an advertising event."""
    step = ble.packet_ms + ble.gap_ms
    return [(begin_ms + channel * step, ble.packet_ms, channel) for channel in range(3)]


def ble_windows(ble: BleParameters | Ble5Parameters) -> list[Span]:
    """Listening windows on the primary channels in the time that is drawn."""
    count = int(_SHOWN_MS / ble.scan_interval_ms) + 1
    return [(i * ble.scan_interval_ms, ble.scan_window_ms, i % 3) for i in range(count)]


def wifi_windows(wifi: WifiParameters) -> list[Span]:
    """Listening times on the Wi-Fi channels in the time that is drawn."""
    cycle = wifi.scan_ms + wifi.switch_ms
    return [(i * cycle, wifi.scan_ms, i % len(WIFI_CHANNELS)) for i in range(int(_SHOWN_MS / cycle) + 1)]


def is_heard(packet: Span, windows: Sequence[Span]) -> bool:
    """Whether a packet lies wholly within a window of its channel."""
    begin, duration, channel = packet
    return any(
        on == channel and start <= begin and begin + duration <= start + length
        for start, length, on in windows
    )


def _panel(
    axes: Any, title: str, packets: Sequence[Span], windows: Sequence[Span], channels: Sequence[str]
) -> None:
    for begin, duration, channel in windows:
        axes.broken_barh([(begin, duration)], (channel - 0.45, 0.9), color=_LISTENS)
    for packet in packets:
        colour = _HEARD if is_heard(packet, windows) else _SENDS
        axes.broken_barh([packet[:2]], (packet[2] - 0.35, 0.7), color=colour)
    axes.set_title(title)
    axes.set_yticks(range(len(channels)), channels)
    axes.set_ylabel("channel")


def _arrow(axes: Any, start: tuple[float, float], end: tuple[float, float]) -> None:
    axes.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "-|>", "color": "black"})
