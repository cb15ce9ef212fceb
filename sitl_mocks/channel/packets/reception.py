"""Decides which receiver receives which packet: reach, scan window, half-duplex, collisions and background.

Implements sections "Packet Reception Model" and "Packet Collision Model" of the paper packet by packet,
without randomness. Times are in slots. A channel is an index: 0-39 are the BLE channels, 40-42 the Wi-Fi
channels 1, 6, 11.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.arrays import Bools, Floats, Indices
from sitl_mocks.channel.link_budget import thresholds_db
from sitl_mocks.channel.packets.background import Background
from sitl_mocks.channel.packets.timing import BLE5, WIFI, Assumptions, Durations
from sitl_mocks.channel.parameters import WIFI_CHANNELS, ChannelParameters

FIRST_PRIMARY = 37
FIRST_WIFI = 40
_WIFI_HALF_WIDTH_MHZ = 10.0
_PAIR_CELLS = 1 << 24
"""Maximum of pairs times nodes that are processed at once. It limits memory."""


def _frequencies_mhz() -> Floats:
    """Centre frequency of each channel index: BLE 0-10, 11-36, then 37, 38, 39, then Wi-Fi."""
    data = [*range(2404, 2425, 2), *range(2428, 2479, 2)]
    return np.array([*data, 2402, 2426, 2480, *(2407 + 5 * c for c in WIFI_CHANNELS)], float)


def _overlap() -> Bools:
    """Whether two channels interfere: the same channel, or Wi-Fi and BLE less than 10 MHz apart."""
    mhz = _frequencies_mhz()
    wifi = np.arange(len(mhz)) >= FIRST_WIFI
    mixed = wifi[:, None] != wifi
    apart = np.abs(mhz[:, None] - mhz)
    return np.asarray(np.where(mixed, apart < _WIFI_HALF_WIDTH_MHZ, apart == 0.0), bool)


CHANNELS_OVERLAP = _overlap()
"""Whether two channels interfere, shape (43, 43)."""


@dataclass(frozen=True, slots=True)
class Packets:
    """Packets on the air, arrays of shape (packets,), in any order. Times in slots."""

    event: Indices
    """Index of the event to which the packet belongs, from 0 to below the number of events."""
    transmitter: Indices
    place: Indices
    """Row of the coverage that applies to the packet. It is the transmitter's row if no aircraft moves."""
    mode: Indices
    """Column of `parameters.MODES`."""
    channel: Indices
    begin: Floats
    end: Floats
    scan_row: Indices
    """Row of `Scanners.phase` that applies to the packet."""


@dataclass(frozen=True, slots=True)
class Coverage:
    """Which transmitters reach which receivers."""

    path_loss_db: Floats
    """Shape (places, nodes), from row to column; inf from a node to itself."""
    reach: Bools
    """Shape (3, places, nodes): mode, place of sending, receiver. A transmitter does not reach itself."""
    transmit_power_dbm: Floats
    """Transmit power of each mode, shape (3,)."""

    @staticmethod
    def of(path_loss_db: Floats, parameters: ChannelParameters) -> Coverage:
        """Coverage from path losses, shape (nodes, nodes). NaN and the diagonal count as out of reach."""
        loss = np.array(path_loss_db, float)
        np.fill_diagonal(loss, np.inf)
        return Coverage.of_places(loss, parameters)

    @staticmethod
    def of_places(path_loss_db: Floats, parameters: ChannelParameters) -> Coverage:
        """Coverage from path losses, shape (places, nodes). NaN counts as out of reach."""
        loss = np.where(np.isnan(path_loss_db), np.inf, path_loss_db)
        modes = (parameters.ble4, parameters.ble5, parameters.wifi)
        return Coverage(
            path_loss_db=loss,
            reach=loss <= thresholds_db(parameters)[:, None, None],
            transmit_power_dbm=np.array([m.transmit_power_dbm for m in modes]),
        )


@dataclass(frozen=True, slots=True)
class Scanners:
    """Scan patterns of the receivers. Bluetooth 4, Bluetooth 5 and Wi-Fi scan at the same time."""

    phase: Floats
    """Shape (rows, nodes): a time on the receiver's own clock at which a scan cycle begins (slots).
    A packet's `scan_row` selects the row. With free phases, row m is mode m.
    """
    clock: Floats
    """Shape (nodes,): rate of the receiver's clock, 1 + its error."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Fate of each packet at each receiver. Both arrays have shape (packets, nodes)."""

    hearable: Bools
    """The packet reaches the receiver within its scan window, and the receiver does not send. An auxiliary
    packet needs a hearable pointer of its event instead of a scan window.
    """
    received: Bools
    """The packet is hearable and undisturbed. An auxiliary packet also needs a received pointer."""


def decide(
    packets: Packets,
    coverage: Coverage,
    scanners: Scanners,
    durations: Durations,
    assumptions: Assumptions,
    background: Background | None = None,
) -> Outcome:
    """Decide which receiver received which packet, given all packets on the air.

    The result for an event is correct if all of its packets and all packets that overlap one of them are
    passed. A caller that processes time piece by piece also passes the neighbouring packets and ignores their
    results.
    """
    auxiliary = (packets.mode == BLE5) & (packets.channel < FIRST_PRIMARY)
    disturbed, deaf = _overlaps(packets, coverage, assumptions)
    hearable = np.asarray(coverage.reach[packets.mode, packets.place] & ~deaf, bool)
    scanned = np.nonzero(~auxiliary)[0]
    hearable[scanned] &= _in_window(packets, scanned, scanners, durations)
    if background is not None and len(packets.begin):
        bursts = background.overlaps(packets.mode, packets.begin, packets.end)
        if bursts is not None:
            disturbed |= bursts
    received = hearable & ~disturbed
    followed = np.nonzero(auxiliary)[0]
    hearable[followed] &= _any_pointer(packets, hearable)[packets.event[followed]]
    received[followed] &= _any_pointer(packets, received)[packets.event[followed]]
    return Outcome(hearable, received)


def arrivals(packets: Packets, received: Bools, events: int) -> Floats:
    """Arrival time of each event's message at each node (slots), shape (events, nodes); NaN if lost.

    The message arrives at the end of the first PDU (BLE 4), of the auxiliary packet (BLE 5) or of the beacon
    (Wi-Fi).
    """
    times = np.full((events, received.shape[1]), np.nan)
    content = carries_message(packets)
    # An event has at most one packet in each of these groups, and an earlier group overwrites a later one.
    for channel in (FIRST_PRIMARY + 2, FIRST_PRIMARY + 1, FIRST_PRIMARY, None):
        if channel is None:
            group = content & ((packets.channel < FIRST_PRIMARY) | (packets.channel >= FIRST_WIFI))
        else:
            group = content & (packets.channel == channel)
        rows = np.nonzero(group)[0]
        event = packets.event[rows]
        times[event] = np.where(received[rows], packets.end[rows, None], times[event])
    return times


def carries_message(packets: Packets) -> Bools:
    """Which packets carry the message itself: all except pointers."""
    return np.asarray((packets.mode != BLE5) | (packets.channel < FIRST_PRIMARY), bool)


def _in_window(packets: Packets, rows: Indices, scanners: Scanners, durations: Durations) -> Bools:
    """Whether packets begin and end while the receiver listens to their channel, shape (rows, nodes)."""
    mode, channel = packets.mode[rows], packets.channel[rows]
    dwell = durations.dwell[mode]
    turn = np.where(mode == WIFI, channel - FIRST_WIFI, channel - FIRST_PRIMARY)
    into_cycle = packets.begin[rows, None] / scanners.clock - scanners.phase[packets.scan_row[rows]]
    into_window = np.mod(into_cycle - (turn * dwell)[:, None], (3.0 * dwell)[:, None])
    latest = durations.window[mode] - (packets.end[rows] - packets.begin[rows])
    return np.asarray(into_window <= latest[:, None], bool)


def _overlaps(packets: Packets, coverage: Coverage, assumptions: Assumptions) -> tuple[Bools, Bools]:
    """Packets disturbed by others, and packets during which the receiver sends, both (packets, nodes)."""
    disturbed = np.zeros((len(packets.begin), coverage.reach.shape[2]), bool)
    deaf = np.zeros_like(disturbed)
    victim, other = _overlapping_pairs(packets)
    apart = packets.transmitter[victim] != packets.transmitter[other]
    victim, other = victim[apart], other[apart]
    if assumptions.half_duplex:
        same_radio = (packets.mode[victim] == WIFI) == (packets.mode[other] == WIFI)
        deaf[victim[same_radio], packets.transmitter[other[same_radio]]] = True
    together = CHANNELS_OVERLAP[packets.channel[victim], packets.channel[other]]
    victim, other = victim[together], other[together]
    order = np.argsort(victim, kind="stable")
    victim, other = victim[order], other[order]
    step = max(1, _PAIR_CELLS // disturbed.shape[1])
    for low in range(0, len(victim), step):
        some, others = victim[low : low + step], other[low : low + step]
        hit = _hits(packets, some, others, coverage, assumptions.capture_db)
        victims, first = np.unique(some, return_index=True)
        disturbed[victims] |= np.logical_or.reduceat(hit, first, axis=0)
    return disturbed, deaf


def _hits(
    packets: Packets, victim: Indices, other: Indices, coverage: Coverage, capture_db: float | None
) -> Bools:
    """Where the other packet destroys the victim, shape (pairs, nodes)."""
    hit: Bools = coverage.reach[packets.mode[other], packets.place[other]]
    if capture_db is not None:
        power_dbm = _power_dbm(packets, victim, coverage)
        hit &= power_dbm < _power_dbm(packets, other, coverage) + capture_db
    return hit


def _overlapping_pairs(packets: Packets) -> tuple[Indices, Indices]:
    """All ordered pairs of packets that share some time. Packets that only touch share none."""
    order = np.argsort(packets.begin, kind="stable")
    begin = packets.begin[order]
    position = np.arange(len(order))
    later = np.searchsorted(begin, packets.end[order], side="left") - position - 1
    first = np.repeat(position, later)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(later) - later, later)
    one, two = order[first], order[second]
    return np.concatenate([one, two]), np.concatenate([two, one])


def _power_dbm(packets: Packets, rows: Indices, coverage: Coverage) -> Floats:
    """Received power of packets at every node (dBm), shape (rows, nodes)."""
    sent = coverage.transmit_power_dbm[packets.mode[rows], None]
    return np.asarray(sent - coverage.path_loss_db[packets.place[rows]], float)


def _any_pointer(packets: Packets, flag: Bools) -> Bools:
    """Whether the flag holds for any pointer of each event, shape (events, nodes)."""
    events = int(packets.event.max()) + 1 if len(packets.event) else 0
    found = np.zeros((events, flag.shape[1]), bool)
    for channel in range(FIRST_PRIMARY, FIRST_WIFI):
        rows = np.nonzero((packets.mode == BLE5) & (packets.channel == channel))[0]
        # One pointer per event and channel: no index occurs twice.
        found[packets.event[rows]] |= flag[rows]
    return found
