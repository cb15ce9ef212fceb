"""Packet-level channel for the frames that the companions really send (see `packets.reception`).

Every frame is placed on the time line as its packets, at the time at which its radio sends it. Receivers scan
on their own clocks, a radio that sends does not receive, and packets that overlap are lost. Wi-Fi stations
listen before they send (see `packets.access`).

When an outcome is certain: no frame is sent before the time of an earlier call, and no packet begins before
its frame is sent. So at `settle(now_s)` every packet that may still come begins at or after `now_s`. Access
to the medium until then is decided, and no later packet overlaps an event that has ended. An event that has
ended is therefore decided for good, together with exactly those events that share some of its time. Deciding
draws no random numbers. This holds in lock-step too, where the frames of a tick are sent after the air was
settled at that tick: they begin at or after it.

When a radio sends: each radio sends at its own time. Companions hand frames over at ticks. In lock-step all
companions do so at the same ticks, and processes of one machine share its clock. Radios of aircraft have
schedules of their own, which drift against each other by clock errors and, on Bluetooth, by the random delays
R_D, which accumulate. Without that drift, two aircraft that once send at the same time would do so forever
and never receive each other.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from companion.arrays import Bools, Floats, Indices
from sitl_mocks.channel.air import Outcome, Transmission
from sitl_mocks.channel.air_links import AirLinks, Kept, mode_of
from sitl_mocks.channel.packets.access import BACKOFF_SLOT_MS, DIFS_MS, MAX_BACKOFF, Beacon, WifiAccess
from sitl_mocks.channel.packets.background import Background
from sitl_mocks.channel.packets.reception import FIRST_WIFI, Coverage, Scanners, arrivals, decide
from sitl_mocks.channel.packets.schedule import Events, packets_of
from sitl_mocks.channel.packets.timing import BLE5, REAL, WIFI, Durations
from sitl_mocks.channel.parameters import MODES, SECONDARY_CHANNELS, ChannelParameters

MAX_BACKLOG_S = 1.0
"""A radio that is busy for longer than this drops the frame, because its content is out of date."""


@dataclass(slots=True)
class _Radio:
    """One aircraft's radio. Its random values are drawn once."""

    phase: Floats
    """Shape (3,): start of its scan cycle of each mode (slots of its own clock)."""
    clock: float
    offset_s: list[float]
    """By mode: time from hand-over to sending, without clock error, modulo the spread."""
    background: Background
    bluetooth_free_s: float = -math.inf
    wifi_free_s: float = -math.inf


@dataclass(frozen=True, slots=True)
class _Event:
    """One frame as its radio sends it. Times in slots."""

    number: int
    """Number of the transmission."""
    sender: str
    mode: int
    begin: float
    end: float
    channel: int
    auxiliary_delay: float
    path_loss_db: dict[str, float]
    """Path loss to each receiver (dB), by name."""
    radios: dict[str, _Radio]
    """Radios of the sender and all receivers, by name."""


class PacketChannel:
    """A `Channel` that decides about a frame when its last packet has ended.

    Args:
        parameters: parameters of the channel.
        spread_s: longest time from a frame's hand-over to its radio's own sending time. The position within
            it is drawn for each aircraft and mode, and drifts. With 0, radios send at once, on Bluetooth up
            to R_D later.
    """

    def __init__(self, parameters: ChannelParameters, spread_s: float = 0.0) -> None:
        self._parameters = parameters
        self._durations = Durations.of(parameters, slotted=False)
        self._spread_s = spread_s
        self._links = AirLinks(parameters)
        self._radios: Kept[str, _Radio] = Kept()
        self._open: list[tuple[float, int, tuple[str, ...], _Event | None]] = []
        self._around: list[_Event] = []
        slot_ms = parameters.slot_ms
        self._access = WifiAccess(DIFS_MS / slot_ms, BACKOFF_SLOT_MS / slot_ms)
        self._wanting: dict[int, _Event] = {}
        """Wi-Fi frames whose start is not decided yet, by number."""
        self._settled_s = -math.inf

    def transmit(self, transmission: Transmission, rng: np.random.Generator) -> None:
        """See `Channel.transmit`.

        Raises:
            ValueError: the frame is sent before the time of the last `settle`.
        """
        sent_s, sender = transmission.sent_s, transmission.sender
        if sent_s < self._settled_s:
            raise ValueError(
                f"sent at {sent_s} s, but everything is already decided until {self._settled_s} s"
            )
        mode, durations = mode_of(transmission.transport), self._durations
        radios = {name: self._radio(name, sent_s, rng) for name in (sender, *transmission.distance_m)}
        wifi_channel = self._links.wifi_channel(sender, transmission.transport, rng)
        loss_db = self._links.path_loss_db(sender, transmission.distance_m, rng)
        # Draw the same numbers for every frame in every mode, so that the draws do not depend on other
        # aircraft's choices.
        random_delay, uncertainty = rng.random(2).tolist()
        secondary, backoff = int(rng.integers(SECONDARY_CHANNELS)), int(rng.integers(1 + MAX_BACKOFF))
        random_delay_s = random_delay * float(durations.random_delay[mode]) * durations.slot_s
        begin_s = self._begin_s(radios[sender], mode, sent_s, random_delay_s)
        if begin_s is None:
            lost = (sent_s, transmission.number, tuple(transmission.distance_m), None)
            heapq.heappush(self._open, lost)
            return
        auxiliary_delay = float(uncertainty * durations.uncertainty) if mode == BLE5 else 0.0
        begin = begin_s / durations.slot_s
        event = _Event(
            number=transmission.number,
            sender=sender,
            mode=mode,
            begin=begin,
            end=begin + float(durations.span[mode]),
            channel=FIRST_WIFI + wifi_channel if mode == WIFI else secondary,
            auxiliary_delay=auxiliary_delay,
            path_loss_db=loss_db,
            radios=radios,
        )
        if mode != WIFI:
            self._lay(event)
            return
        self._wanting[event.number] = event
        hears = frozenset(name for name, loss in loss_db.items() if loss <= self._links.thresholds_db[WIFI])
        self._access.want(
            Beacon(event.number, sender, event.channel, begin, event.end - begin, hears, backoff)
        )

    def _lay(self, event: _Event) -> None:
        """Put an event on the time line."""
        self._around.append(event)
        # One slot is added because times in seconds and in slots may differ by rounding.
        certain_s = (event.end + 1.0) * self._durations.slot_s
        heapq.heappush(self._open, (certain_s, event.number, tuple(event.path_loss_db), event))

    def settle(self, now_s: float, rng: np.random.Generator) -> list[Outcome]:
        """See `Channel.settle`. Outcomes are in the order in which the events end."""
        self._settled_s = max(self._settled_s, now_s)
        slot_s = self._durations.slot_s
        for number, begin in self._access.advance(self._settled_s / slot_s):
            event = self._wanting.pop(number)
            if begin is not None:
                self._lay(replace(event, begin=begin, end=begin + event.end - event.begin))
            else:  # a newer frame of the same sender replaced it
                lost = (event.begin * slot_s, number, tuple(event.path_loss_db), None)
                heapq.heappush(self._open, lost)
        over = []
        while self._open and self._open[0][0] <= now_s:
            over.append(heapq.heappop(self._open))
        arrival_s = self._arrivals_s([event for *_, event in over if event is not None])
        outcomes = [
            Outcome(number, receiver, arrival_s.get((number, receiver)))
            for _, number, receivers, _ in over
            for receiver in receivers
        ]
        self._forget(now_s)
        return outcomes

    def next_s(self) -> float | None:
        """See `Channel.next_s`."""
        begins = self._access.next_time()
        times = []
        if begins is not None:
            # A beacon that begins then becomes certain when it has ended, as in `_lay`.
            times.append((begins + float(self._durations.span[WIFI]) + 1.0) * self._durations.slot_s)
        return min([*times, *(entry[0] for entry in self._open[:1])], default=None)

    def _radio(self, name: str, now_s: float, rng: np.random.Generator) -> _Radio:
        def draw() -> _Radio:
            return _Radio(
                phase=rng.uniform(0.0, 3.0 * self._durations.dwell),
                clock=1.0 + float(rng.uniform(-1.0, 1.0)) * REAL.clock_ppm * 1e-6,
                offset_s=rng.uniform(0.0, self._spread_s, len(MODES)).tolist(),
                background=Background(self._parameters, 1, now_s / self._durations.slot_s, rng),
            )

        return self._radios.get(name, draw)

    def _begin_s(self, radio: _Radio, mode: int, sent_s: float, random_delay_s: float) -> float | None:
        """When a radio would begin to send (s), one event after the other. None if it drops the frame."""
        wait_s = random_delay_s
        if self._spread_s > 0.0:
            radio.offset_s[mode] += random_delay_s
            wait_s = (radio.offset_s[mode] + (radio.clock - 1.0) * sent_s) % self._spread_s
        earliest_s = sent_s + wait_s
        begin_s = max(earliest_s, radio.wifi_free_s if mode == WIFI else radio.bluetooth_free_s)
        if begin_s - earliest_s > MAX_BACKLOG_S:
            return None
        free_s = begin_s + float(self._durations.span[mode]) * self._durations.slot_s
        if mode == WIFI:
            # A station's next frame follows after a backoff of its own.
            radio.wifi_free_s = free_s + (DIFS_MS + MAX_BACKOFF * BACKOFF_SLOT_MS) / 1000.0
        else:
            radio.bluetooth_free_s = free_s
        return begin_s

    def _arrivals_s(self, ended: Sequence[_Event]) -> dict[tuple[int, str], float]:
        """Arrival times of frames (s), by number and receiver. Lost frames are left out."""
        if not any(event.path_loss_db for event in ended):
            return {}
        begin, end = min(event.begin for event in ended), max(event.end for event in ended)
        around = [event for event in self._around if event.begin < end and begin < event.end]
        radios: dict[str, _Radio] = {}
        for one in sorted(ended, key=lambda event: -event.number):
            for name, radio in one.radios.items():
                radios.setdefault(name, radio)
        for one in around:
            radios.setdefault(one.sender, one.radios[one.sender])
        index = {name: number for number, name in enumerate(radios)}
        # One row for each frame, because senders move between frames.
        loss_db = np.full((len(around), len(radios)), np.nan)
        for row, one in zip(loss_db, around, strict=True):
            for receiver, loss in one.path_loss_db.items():
                if receiver in index:
                    row[index[receiver]] = loss
        packets = packets_of(_events(around, index, self._durations), self._durations)
        packets = replace(packets, place=packets.event)
        outcome = decide(
            packets,
            Coverage.of_places(loss_db, self._parameters),
            Scanners(
                np.stack([radio.phase for radio in radios.values()], axis=1),
                np.array([radio.clock for radio in radios.values()]),
            ),
            self._durations,
            REAL,
            _Backgrounds([radio.background for radio in radios.values()]),
        )
        heard = arrivals(packets, outcome.received, len(around)) * self._durations.slot_s
        numbers = {event.number for event in ended}
        names = list(index)
        return {
            (around[row].number, names[column]): float(heard[row, column])
            for row, column in zip(*np.nonzero(~np.isnan(heard)), strict=True)
            if around[row].number in numbers
        }

    def _forget(self, now_s: float) -> None:
        """Drop events that no open or future event can overlap, and equally old foreign bursts."""
        now = now_s / self._durations.slot_s - 1.0
        since = min([now, *(event.begin for *_, event in self._open if event is not None)])
        for event in self._around:
            if event.end <= since:
                for radio in event.radios.values():
                    radio.background.forget(since - float(self._durations.span.max()))
        self._around = [event for event in self._around if event.end > since]


class _Backgrounds(Background):
    """Foreign transmissions at several receivers, drawn independently for each."""

    def __init__(self, receivers: Sequence[Background]) -> None:
        self._receivers = receivers

    def overlaps(self, mode: Indices, begin: Floats, end: Floats) -> Bools | None:
        """See `Background.overlaps`."""
        columns = [receiver.overlaps(mode, begin, end) for receiver in self._receivers]
        met = [column for column in columns if column is not None]
        # All receivers have the same parameters, so either all of them have a background or none has.
        return np.concatenate(met, axis=1) if met else None


def _events(events: Sequence[_Event], index: dict[str, int], durations: Durations) -> Events:
    mode = np.array([event.mode for event in events], np.intp)
    return Events(
        transmitter=np.array([index[event.sender] for event in events], np.intp),
        mode=mode,
        begin=np.array([event.begin for event in events]),
        sample=np.zeros(len(events), np.intp),
        parts=durations.parts[mode],
        channel=np.array([event.channel for event in events], np.intp),
        auxiliary_delay=np.array([event.auxiliary_delay for event in events]),
        scan_row=mode,
    )
