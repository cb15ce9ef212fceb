"""When a receiver's scan meets a sender's schedule: the matching sets of section "Packet Reception Model".

All times are whole slots. A sender begins at phase t0 of the receiver's scan cycle and repeats its event with
a period that shares no factor with the cycle. The paper finds the slots in which a packet falls into a scan
window by the Chinese remainder theorem, window slot by window slot. Within one GNSS period it is less work to
check every event, and the sets are the same.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from companion.arrays import Integers
from companion.remote_id.transports import BLE4, BLE5
from sitl_mocks.channel.parameters import ChannelParameters, Slots, check_rate


@dataclass(frozen=True, slots=True)
class Scan:
    """Scan pattern of a receiver in one mode, and the packets that must fit into its windows."""

    cycle: int
    """Slots after which the scan repeats (3 S_I, or 3 (T_S + C_T))."""
    window_starts: tuple[int, int, int]
    """First slot of the window on each of the three channels."""
    slack: int
    """A packet is received completely if it begins at most this many slots after the start of the window (S_W
    - A_P, T_S - B_D).
    """
    packet_offsets: tuple[int, ...]
    """Slots from the beginning of an event to its packet on each channel. Wi-Fi has one channel only."""
    duration: int
    """Duration of one such packet in slots."""


def scan_of(mode: str, parameters: ChannelParameters) -> Scan:
    """The scan of a mode in whole slots."""
    slots = Slots(parameters)
    offsets: tuple[int, ...] = (0,)
    if mode in (BLE4, BLE5):
        ble = parameters.ble4 if mode == BLE4 else parameters.ble5
        interval, packet, gap = (slots.of(x) for x in (ble.scan_interval_ms, ble.packet_ms, ble.gap_ms))
        step = packet + gap
        window, offsets = slots.of(ble.scan_window_ms), (0, step, 2 * step)
    else:
        wifi = parameters.wifi
        window, packet = slots.of(wifi.scan_ms), slots.of(wifi.beacon_ms)
        interval = window + slots.of(wifi.switch_ms)
    return Scan(3 * interval, (0, interval, 2 * interval), window - packet, offsets, packet)


def coprime_period(period: int, cycle: int) -> int:
    """The integer nearest to `period` and coprime to `cycle` (A-hat, B-hat), the lower one on a tie.

    Raises:
        ValueError: `period` or `cycle` is less than 1.
    """
    if period < 1 or cycle < 1:
        raise ValueError(f"period {period}, cycle {cycle}: expected at least 1 slot each")
    # The search ends because 1 shares no factor with any number.
    return next(
        near
        for away in range(period + 1)
        for near in (period - away, period + away)
        if near >= 1 and math.gcd(near, cycle) == 1
    )


def event_period(mode: str, rate: int, parameters: ChannelParameters) -> int:
    """A-hat or B-hat (slots): the coprime approximation of T_GNSS / psi.

    Raises:
        ConfigError: the rate is less than 1 or more than the mode's largest.
    """
    check_rate(mode, rate, parameters)
    return coprime_period(Slots(parameters).gnss_period // rate, scan_of(mode, parameters).cycle)


@dataclass(frozen=True, slots=True)
class Matches:
    """Packets of one GNSS period that fall completely into a scan window, for every phase; one row each."""

    phase: Integers
    """t0, from 0 to below the scan cycle."""
    slot: Integers
    """Slots after t0 at which the packet begins."""
    channel: Integers
    """Index of the channel on which it is received."""


def matching_packets(
    mode: str, rate: int, parameters: ChannelParameters, *, wifi_channel: int = 0
) -> Matches:
    """The sets M(t0) of all three channels (BLE), or of one (Wi-Fi), for all phases t0 at once.

    Args:
        wifi_channel: index of the channel that a Wi-Fi sender uses.

    Raises:
        ConfigError: the rate is less than 1 or more than the mode's largest.
    """
    period = event_period(mode, rate, parameters)
    return coincidences(scan_of(mode, parameters), period, Slots(parameters).gnss_period, wifi_channel)


def coincidences(scan: Scan, period: int, horizon: int, wifi_channel: int = 0) -> Matches:
    """All slots up to `horizon` at which a packet begins and is received completely, for all phases at once.

    Two congruences hold at such a slot t, one modulo the sender's period and one modulo the receiver's cycle.
    By the Chinese remainder theorem (the paper's T) one t in period x cycle solves both. There are far fewer
    events than slots in a window, so the solutions are found by checking each event.

    Args:
        period: slots from one event to the next.

    Raises:
        ValueError: the period is less than 1 or shares a factor with the cycle, so that some phases never
            meet.
    """
    if period < 1 or (shared := math.gcd(period, scan.cycle)) != 1:
        why = "expected at least 1" if period < 1 else f"both are multiples of {shared}; they must be coprime"
        raise ValueError(f"period {period}, scan cycle {scan.cycle} slots: {why}")
    phases = np.arange(scan.cycle, dtype=np.int64)
    found = []
    for index, offset in enumerate(scan.packet_offsets):
        channel = index if len(scan.packet_offsets) > 1 else wifi_channel
        for begun in range(offset, horizon + 1, period):
            late = (phases + begun - scan.window_starts[channel]) % scan.cycle
            heard = np.flatnonzero(late <= scan.slack)
            found.append((heard, np.full(len(heard), begun), np.full(len(heard), channel)))
    phase, slot, channels = (np.concatenate(part).astype(np.int64) for part in zip(*found, strict=True))
    order = np.lexsort((slot, phase))
    return Matches(phase[order], slot[order], channels[order])


def heard_packets(
    mode: str, phase: float, parameters: ChannelParameters, *, wifi_channel: int = 0
) -> tuple[int, ...]:
    """Packets of one event that fall completely into a window if the event begins at this scan phase (slots).

    The result holds indices into `Scan.packet_offsets`.
    """
    scan = scan_of(mode, parameters)
    heard = []
    for index, offset in enumerate(scan.packet_offsets):
        channel = index if len(scan.packet_offsets) > 1 else wifi_channel
        if (phase + offset - scan.window_starts[channel]) % scan.cycle <= scan.slack:
            heard.append(index)
    return tuple(heard)


def meeting_chances(mode: str, parameters: ChannelParameters) -> tuple[tuple[float, float, float], float]:
    """Reception of a Bluetooth event that begins at a uniformly random scan phase, with exact durations.

    Returns:
        Probability that exactly 1, 2 and 3 of its packets fall completely into a window; and the mean time
        (ms) from its beginning until the message is complete, if it is received.
    """
    ble = parameters.ble4 if mode == BLE4 else parameters.ble5
    slack, cycle = ble.scan_window_ms - ble.packet_ms, 3.0 * ble.scan_interval_ms
    offsets = [channel * (ble.packet_ms + ble.gap_ms) for channel in range(3)]
    # Event phases from which each packet can be received. Between two edges the number of such packets is
    # constant.
    opens = [(channel * ble.scan_interval_ms - offset) % cycle for channel, offset in enumerate(offsets)]
    edges = sorted({0.0, cycle, *opens, *((x + slack) % cycle for x in opens)})
    chance, complete = [0.0, 0.0, 0.0], 0.0
    for low, high in itertools.pairwise(edges):
        heard = [o for x, o in zip(opens, offsets, strict=True) if ((low + high) / 2.0 - x) % cycle < slack]
        if heard:
            share = (high - low) / cycle
            chance[len(heard) - 1] += share
            complete += share * (heard[0] + ble.packet_ms)
    if mode == BLE5:
        ble5 = parameters.ble5
        complete = ble5.auxiliary_offset_ms + ble5.auxiliary_uncertainty_ms + ble5.auxiliary_ms
    elif any(chance):
        complete /= sum(chance)
    return (chance[0], chance[1], chance[2]), complete
