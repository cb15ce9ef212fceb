"""Packet-level simulation of the radio channel, the reference for the channel equations.

Every aircraft's packets are placed on one time line, and each packet is decided at each receiver. The
simulation shares only the parameters and the link budget with the equations. Times are in slots inside and in
seconds in the result.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.arrays import Bools, Floats, Indices, Integers
from companion.errors import ConfigError
from sitl_mocks.channel.packets.background import Background
from sitl_mocks.channel.packets.reception import (
    Coverage,
    Packets,
    Scanners,
    arrivals,
    carries_message,
    decide,
)
from sitl_mocks.channel.packets.schedule import draw_schedule, packets_of, sense_carrier
from sitl_mocks.channel.packets.timing import WIFI, Assumptions, Durations
from sitl_mocks.channel.parameters import MODES, WIFI_CHANNELS, ChannelParameters, check_rate

_CELLS = 1 << 17
"""Maximum of events times nodes that are processed at once. It limits memory."""
_FEWEST = 1000
"""Fewest events that are processed at once, because their neighbours in time are processed with them."""


@dataclass(frozen=True, slots=True)
class Result:
    """Sent and received messages. Each aircraft's sample 0, and everything sent before 0 s, is warm-up."""

    duration_s: float
    gnss_period_s: float
    first_sample_s: Floats
    """Shape (nodes,): time of each aircraft's GNSS sample 0, between minus one period and 0."""
    carried: Bools
    """Shape (nodes, nodes, 3): the transmitter (row) uses the mode and reaches the receiver (column)."""
    transmitter: Indices
    """Index of the transmitter, shape (events,), in the order of time. The next four arrays have the same
    shape and order.
    """
    mode: Indices
    sample: Indices
    """Number of the GNSS sample that the event carries."""
    start_s: Floats
    """When sending began, after any wait for the medium. Beacons that were never sent are left out."""
    sample_s: Floats
    """Time of that GNSS sample."""
    heard_event: Indices
    """Index of the received event, shape (receptions,). The next two arrays have the same shape and order."""
    heard_by: Indices
    heard_s: Floats
    """Time at which the message was complete."""
    hearable: Integers
    """Shape (nodes, nodes, 3): number of packets (BLE 5: messages) that reached a listening receiver."""
    lost: Integers
    """Shape (nodes, nodes, 3): number of hearable packets lost to other packets or foreign transmissions."""

    def arrival_s(self) -> Floats:
        """Arrival time of each event's message (s), shape (events, nodes); NaN if lost. Can be large."""
        times = np.full((len(self.transmitter), len(self.first_sample_s)), np.nan)
        times[self.heard_event, self.heard_by] = self.heard_s
        return times


def simulate(
    parameters: ChannelParameters,
    assumptions: Assumptions,
    path_loss_db: Floats,
    rates: Indices,
    wifi_channel: Indices,
    duration_s: float,
    rng: np.random.Generator,
) -> Result:
    """Simulate aircraft at fixed positions and message rates.

    Args:
        path_loss_db: shape (nodes, nodes), from row to column; the diagonal is ignored, and NaN means out of
            reach.
        rates: shape (nodes, 3) in the order of `parameters.MODES`: psi, or 0 for a mode that is off.
        wifi_channel: shape (nodes,): index into `WIFI_CHANNELS`.
        duration_s: at least one slot.

    Raises:
        ConfigError: a rate, a Wi-Fi channel or the duration is not allowed.
        ValueError: shapes do not fit.
    """
    nodes = len(path_loss_db)
    _check(parameters, path_loss_db, rates, wifi_channel, duration_s)
    durations = Durations.of(parameters, assumptions.slotted)
    slot_s, period = durations.slot_s, durations.gnss_period
    end = duration_s / slot_s
    margin = float(durations.span.max())
    coverage = Coverage.of(path_loss_db, parameters)

    clock = 1.0 + rng.uniform(-1.0, 1.0, nodes) * assumptions.clock_ppm * 1e-6
    first_sample = durations.phase(period, nodes, rng) - period
    events, row_mode = draw_schedule(
        parameters, durations, assumptions, rates, wifi_channel, clock, first_sample, end + margin, rng
    )
    cycles = 3.0 * durations.dwell[row_mode]
    if assumptions.slotted:
        phase = rng.integers(0, cycles.astype(np.int64)[:, None], (len(cycles), nodes)).astype(float)
    else:
        phase = rng.uniform(0.0, cycles[:, None], (len(cycles), nodes))
    scanners = Scanners(phase, clock)
    background = Background(parameters, nodes, -period - margin, rng)
    if assumptions.carrier_sense:
        # Carrier sense draws its numbers last, so that all other draws are the same with and without it.
        events = sense_carrier(events, durations, coverage.reach[WIFI], rng)

    tally = _Tally(nodes)
    count = int(np.searchsorted(events.begin, end, side="left"))
    step = max(_FEWEST, _CELLS // nodes)
    for low in range(0, count, step):
        high = min(low + step, count)
        # Include all events that may overlap these; their own results are computed in their own turn.
        since = events.begin[low] - margin
        around = slice(
            int(np.searchsorted(events.begin, since, side="left")),
            int(np.searchsorted(events.begin, events.begin[high - 1] + margin, side="right")),
        )
        packets = packets_of(events.select(around), durations)
        background.forget(since)
        outcome = decide(packets, coverage, scanners, durations, assumptions, background)
        times = arrivals(packets, outcome.received, around.stop - around.start)
        tally.add_arrivals(low, times[low - around.start : high - around.start])
        own = (packets.event >= low - around.start) & (packets.event < high - around.start)
        tally.add_losses(
            packets, np.nonzero(own & carries_message(packets))[0], outcome.hearable, outcome.received
        )

    events = events.select(slice(0, count))
    return Result(
        duration_s=duration_s,
        gnss_period_s=period * slot_s,
        first_sample_s=first_sample * slot_s,
        carried=np.moveaxis(coverage.reach, 0, 2) & (rates > 0)[:, None, :],
        transmitter=events.transmitter,
        mode=events.mode,
        sample=events.sample,
        start_s=events.begin * slot_s,
        sample_s=(first_sample[events.transmitter] + events.sample * period) * slot_s,
        heard_event=np.concatenate(tally.event),
        heard_by=np.concatenate(tally.by),
        heard_s=np.concatenate(tally.time) * slot_s,
        hearable=tally.hearable.reshape(nodes, nodes, 3),
        lost=tally.lost.reshape(nodes, nodes, 3),
    )


class _Tally:
    """Sums over the pieces of a run."""

    def __init__(self, nodes: int) -> None:
        self._nodes = nodes
        self.event: list[Indices] = [np.zeros(0, np.intp)]
        self.by: list[Indices] = [np.zeros(0, np.intp)]
        self.time: list[Floats] = [np.zeros(0)]
        self.hearable = np.zeros(nodes * nodes * 3, np.int64)
        self.lost = np.zeros(nodes * nodes * 3, np.int64)

    def add_arrivals(self, first_event: int, times: Floats) -> None:
        event, by = np.nonzero(~np.isnan(times))
        self.event.append(first_event + event)
        self.by.append(by)
        self.time.append(times[event, by])

    def add_losses(self, packets: Packets, rows: Indices, hearable: Bools, received: Bools) -> None:
        packet, receiver = np.nonzero(hearable[rows])
        packet = rows[packet]
        link = (packets.transmitter[packet] * self._nodes + receiver) * 3 + packets.mode[packet]
        np.add.at(self.hearable, link, 1)
        np.add.at(self.lost, link[~received[packet, receiver]], 1)


def _check(
    parameters: ChannelParameters,
    path_loss_db: Floats,
    rates: Indices,
    wifi_channel: Indices,
    duration_s: float,
) -> None:
    nodes = len(path_loss_db)
    shapes = (path_loss_db.shape, rates.shape, wifi_channel.shape)
    if nodes == 0 or shapes != ((nodes, nodes), (nodes, 3), (nodes,)):
        raise ValueError(f"shapes {shapes}; expected (nodes, nodes), (nodes, 3), (nodes,)")
    for mode, name in enumerate(MODES):
        for rate in set(rates[:, mode].tolist()) - {0}:
            check_rate(name, rate, parameters)
    if not rates.any():
        raise ConfigError("rates: all are 0; at least one aircraft must send")
    if not np.isin(wifi_channel, np.arange(len(WIFI_CHANNELS))).all():
        raise ConfigError(
            f"wifi_channel: an index is out of range; allowed: 0 to {len(WIFI_CHANNELS) - 1}, "
            f"for channels {WIFI_CHANNELS}"
        )
    # The negated comparison also refuses NaN.
    if not parameters.slot_ms / 1000.0 <= duration_s < np.inf:
        raise ConfigError(
            f"duration_s: {duration_s:g} is out of range; allowed: finite values of at least one slot"
        )
