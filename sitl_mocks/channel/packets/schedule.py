"""Sending times of each aircraft: the events of a whole run and their packets."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.arrays import Bools, Floats, Indices
from sitl_mocks.channel.packets.access import defer
from sitl_mocks.channel.packets.reception import FIRST_PRIMARY, FIRST_WIFI, Packets
from sitl_mocks.channel.packets.timing import BLE4, BLE5, WIFI, Assumptions, Durations, coprime_interval
from sitl_mocks.channel.parameters import SECONDARY_CHANNELS, ChannelParameters


@dataclass(frozen=True, slots=True)
class Events:
    """Advertising events and beacons, arrays of shape (events,). Times in slots."""

    transmitter: Indices
    mode: Indices
    begin: Floats
    sample: Indices
    """Number of the transmitter's GNSS sample that the event carries, from 0."""
    parts: Indices
    """Number of packets sent: all of `Durations.parts`, or only the first ones."""
    channel: Indices
    """Channel index of the beacon or of the auxiliary packet; unused for BLE 4."""
    auxiliary_delay: Floats
    """Delay of the auxiliary packet beyond A_Offset (slots)."""
    scan_row: Indices
    """See `Packets.scan_row`."""

    def select(self, which: slice | Indices) -> Events:
        """Select some of the events, in the given order."""
        return Events(
            self.transmitter[which],
            self.mode[which],
            self.begin[which],
            self.sample[which],
            self.parts[which],
            self.channel[which],
            self.auxiliary_delay[which],
            self.scan_row[which],
        )


def packets_of(events: Events, durations: Durations) -> Packets:
    """The packets of events; an event's number is its position in `events`."""
    event = np.repeat(np.arange(len(events.parts)), events.parts)
    part = np.arange(len(event)) - np.repeat(np.cumsum(events.parts) - events.parts, events.parts)
    mode = events.mode[event]
    auxiliary = part == 3
    primary = (mode != WIFI) & ~auxiliary
    delay = np.where(auxiliary, events.auxiliary_delay[event], 0.0)
    begin = events.begin[event] + durations.offset[mode, part] + delay
    return Packets(
        event=event,
        transmitter=events.transmitter[event],
        place=events.transmitter[event],
        mode=mode,
        channel=np.where(primary, FIRST_PRIMARY + part, events.channel[event]),
        begin=begin,
        end=begin + durations.length[mode, part],
        scan_row=events.scan_row[event],
    )


def draw_schedule(
    parameters: ChannelParameters,
    durations: Durations,
    assumptions: Assumptions,
    rates: Indices,
    wifi_channel: Indices,
    clock: Floats,
    first_sample: Floats,
    end: float,
    rng: np.random.Generator,
) -> tuple[Events, Indices]:
    """Draw all events that begin before `end`, sorted by time, and the mode of each scan row.

    Args:
        rates: shape (nodes, 3): psi, or 0 for a mode that is off.
        wifi_channel: shape (nodes,): index into `WIFI_CHANNELS`.
        clock: shape (nodes,): rate of each aircraft's clock.
        first_sample: shape (nodes,): time of GNSS sample 0, before which an aircraft does not send (slots).
        end: end of the schedule (slots).
    """
    schedule = _paper_schedule if assumptions.advertiser == "paper" else _standard_schedule
    period = durations.gnss_period
    pieces: list[Events] = []
    row_modes: list[int] = [] if assumptions.phases == "redrawn" else [0, 1, 2]
    for mode in range(3):
        for node in np.nonzero(rates[:, mode])[0]:
            begin, sample, parts = schedule(
                parameters, durations, assumptions, mode, int(rates[node, mode]), end - first_sample[node],
                clock[node], rng,
            )  # fmt: skip
            events = len(begin)
            delay, channel = np.zeros(events), np.full(events, FIRST_WIFI + wifi_channel[node])
            if mode == BLE5:
                channel = rng.integers(0, SECONDARY_CHANNELS, events)
                delay = durations.uniform(durations.uncertainty, events, rng)
            row = np.full(events, mode)
            if assumptions.phases == "redrawn":
                row = len(row_modes) + sample
                row_modes += [mode] * math.ceil((end - first_sample[node]) / period)
            pieces.append(
                Events(
                    np.full(events, node),
                    np.full(events, mode),
                    first_sample[node] + begin,
                    sample,
                    parts,
                    channel,
                    delay,
                    row,
                )
            )
    fields = ("transmitter", "mode", "begin", "sample", "parts", "channel", "auxiliary_delay", "scan_row")
    whole = Events(*(np.concatenate([getattr(p, name) for p in pieces]) for name in fields))
    order = np.argsort(whole.begin, kind="stable")
    return whole.select(order), np.array(row_modes, np.intp)


def sense_carrier(events: Events, durations: Durations, hears: Bools, rng: np.random.Generator) -> Events:
    """Delay beacons while the medium is busy (see `packets.access`) and sort the events by time again.

    A beacon carries the sample that it would have carried without waiting. A beacon that still waits when its
    aircraft wants to send the next one is never sent and is left out.

    Args:
        hears: shape (nodes, nodes): the aircraft in the column senses beacons of the transmitter in the row.
    """
    wifi = np.nonzero(events.mode == WIFI)[0]
    begin = events.begin.copy()
    begin[wifi] = defer(
        events.begin[wifi], events.transmitter[wifi], events.channel[wifi], float(durations.length[WIFI, 0]),
        hears, 1000.0 * durations.slot_s, rng,
    )  # fmt: skip
    order = np.argsort(begin, kind="stable")
    # NaN marks beacons that were never sent; it sorts last.
    return replace(events, begin=begin).select(order[: len(order) - int(np.isnan(begin).sum())])


def _paper_schedule(
    parameters: ChannelParameters,
    durations: Durations,
    assumptions: Assumptions,
    mode: int,
    rate: int,
    end: float,
    clock: float,
    rng: np.random.Generator,
) -> tuple[Floats, Indices, Indices]:
    """Start times from GNSS sample 0 on, samples and parts. Each sample restarts the schedule."""
    interval = coprime_interval(rate, mode, parameters)
    # Packets begin up to t0 + T_GNSS inclusive, as in the matching sets, so the last event of BLE 4 may lack
    # some packets. BLE 5 has psi auxiliary packets.
    in_cycle = rate if mode == BLE5 else math.floor(durations.gnss_period / interval) + 1
    cycles = math.ceil(end / durations.gnss_period)
    since_sample = np.tile(np.arange(in_cycle) * float(interval), (cycles, 1))
    if assumptions.random_delay:
        since_sample += durations.uniform(durations.random_delay[mode], since_sample.shape, rng)
    parts = np.full(since_sample.shape, durations.parts[mode])
    if mode == BLE4:
        in_time = since_sample[:, :, None] + durations.offset[BLE4, :3] <= durations.gnss_period
        parts = np.sum(in_time, axis=2)
    begin = (np.arange(cycles) * durations.gnss_period)[:, None] + since_sample * clock
    sample = np.repeat(np.arange(cycles), in_cycle)
    kept = (begin.ravel() < end) & (parts.ravel() > 0)
    return begin.ravel()[kept], sample[kept], parts.ravel()[kept]


def _standard_schedule(
    parameters: ChannelParameters,
    durations: Durations,
    assumptions: Assumptions,
    mode: int,
    rate: int,
    end: float,
    clock: float,
    rng: np.random.Generator,
) -> tuple[Floats, Indices, Indices]:
    """Start times from GNSS sample 0 on, samples and parts, at a free-running interval."""
    mean = durations.gnss_period / rate
    half_delay = durations.random_delay[mode] / 2.0
    if durations.slotted:
        mean, half_delay = float(math.floor(mean)), float(math.floor(half_delay))
    if not assumptions.random_delay:
        half_delay = 0.0
    # A radio ends one event before it begins the next.
    shortest = max(mean - half_delay, durations.span[mode])
    intervals = np.full(math.ceil(end / (shortest * clock)) + 1, mean - half_delay)
    if assumptions.random_delay:
        intervals += durations.uniform(durations.random_delay[mode], len(intervals), rng)
    intervals = np.maximum(intervals, durations.span[mode]) * clock
    begin = durations.phase(mean, 1, rng) + np.concatenate([[0.0], np.cumsum(intervals)])
    begin = begin[begin < end]
    sample = np.floor(begin / durations.gnss_period).astype(np.intp)
    return begin, sample, np.full(len(begin), durations.parts[mode])
