"""Remote ID of one aircraft: what it sent, compared with the legal minimum, and how well it received others.

The legal minimum is that of the region in the record's header (`companion.broadcast.legal_floor`). It applies
while a transport was meant to be on the air according to the log (`BroadcastChanged`). Losses are counted if
frames carry a counter, with the rules of `companion.traffic.senders.reception`. The latency of a message is
its time of arrival minus its own timestamp, by UTC of the autopilot. The age of information is the one that
the avoidance law used in its decisions.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Container
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from companion.broadcast.legal_floor import longest_period_s
from companion.config import Config
from companion.events import Broadcast, BroadcastChanged, Decision, RadioState, RemoteIdHeard
from companion.remote_id.messages import BasicId, Location, System
from ground_tools.inspect.read.read_run import AircraftRecord

SLACK_S = 1e-3
"""Tolerance for rounded times. A period that exceeds the legal limit by less is not counted as too long."""
_HOUR_S = 3600.0
_LATE_COUNTS = 8
_LONGEST_GAP_S = 10.0
_FASTEST, _STEP_SLACK = 20.0, 3.0


@dataclass(slots=True)
class _Sent:
    """Statistics of one kind of sent message on one transport."""

    count: int = 0
    first_s: float = math.inf
    last_s: float = -math.inf
    on_air_s: float = 0.0
    longest_s: float | None = None
    longest_at_s: float | None = None
    limit_s: float | None = None
    over: int = 0
    broken: bool = True
    """True if nothing was sent since the transport was put on the air. The next gap is then not counted."""

    def add_broadcast(self, now_s: float, limit_s: float | None) -> None:
        if not self.broken:
            gap = now_s - self.last_s
            self.on_air_s += gap
            if self.longest_s is None or gap > self.longest_s:
                self.longest_s, self.longest_at_s = gap, now_s
            self.over += limit_s is not None and gap > limit_s + SLACK_S
        self.limit_s = limit_s
        self.count += 1
        self.first_s, self.last_s, self.broken = min(self.first_s, now_s), now_s, False


@dataclass(slots=True)
class _From:
    """Statistics of the frames received from one radio address on one transport."""

    frames: int = 0
    last_s: float | None = None
    counter: int | None = None
    counted: bool = False
    arrived: int = 0
    expected: int = 0
    longest_s: float = 0.0
    latency: array[float] = field(default_factory=lambda: array("d"))
    names: set[str] = field(default_factory=set)

    def add_frame(self, event: RemoteIdHeard, now_s: float, utc_s: float | None) -> None:
        self.frames += 1
        gap = math.inf if self.last_s is None else now_s - self.last_s
        if self.last_s is not None:
            self.longest_s = max(self.longest_s, gap)
        self.last_s = now_s
        self._count(event.counter, gap)
        for message in event.messages:
            if isinstance(message, BasicId) and message.uas_id:
                self.names.add(message.uas_id)
            elif isinstance(message, Location) and message.timestamp_s is not None and utc_s is not None:
                late = (utc_s - message.timestamp_s) % _HOUR_S
                self.latency.append(late if late < 0.5 * _HOUR_S else late - _HOUR_S)

    def _count(self, counter: int | None, gap_s: float) -> None:
        before, self.counter = self.counter, counter
        if counter is None or before is None:
            return
        self.counted = True
        steps = (counter - before) & 0xFF
        if steps == 0:
            return
        if steps > 0xFF - _LATE_COUNTS:
            self.counter = before
            self.arrived = min(self.arrived + 1, self.expected)
        elif gap_s <= _LONGEST_GAP_S and steps <= _FASTEST * gap_s + _STEP_SLACK:
            self.arrived += 1
            self.expected += steps


class _Gatherer:
    def __init__(self, config: Config | None, utc_offset_s: float | None, kept: Container[str]) -> None:
        self.config, self.utc_offset_s = config, utc_offset_s
        self.kept = kept
        """Radio addresses whose receptions are counted."""
        self.channel: int | None = None
        self.own: tuple[str, ...] = ()
        self.rates: dict[str, float] | None = None
        self.sent: dict[tuple[str, str], _Sent] = {}
        self.senders: dict[tuple[str, str], _From] = {}
        self.ages: dict[tuple[bool, str], array[float]] = {}
        self.illegal_s = 0.0
        self.illegal_since: float | None = None
        self.reasons: dict[str, None] = {}
        self.end_s = 0.0

    def add_event(self, now_s: float, item: object) -> None:
        self.end_s = now_s
        match item:
            case RemoteIdHeard():
                if item.address not in self.own and item.address in self.kept:
                    utc_s = None if self.utc_offset_s is None else now_s + self.utc_offset_s
                    self.senders.setdefault((item.transport, item.address), _From()).add_frame(
                        item, now_s, utc_s
                    )
            case Broadcast():
                for kind in sorted({type(message).__name__ for message in item.messages}):
                    lane = self.sent.setdefault((item.transport, kind), _Sent())
                    lane.add_broadcast(now_s, self._limit_s(item.transport, kind))
            case RadioState():
                self.channel, self.own = item.wifi_channel, item.own_addresses
            case BroadcastChanged():
                self._changed(now_s, item)
            case Decision():
                for track in item.tracks:
                    key = (track.adsb, track.track_id)
                    self.ages.setdefault(key, array("d")).append(track.age_s)

    def _changed(self, now_s: float, item: BroadcastChanged) -> None:
        rates = dict(item.rates)
        for (transport, _), lane in self.sent.items():
            lane.broken = lane.broken or transport not in rates
        self.rates = rates
        self.legal(now_s, item.legal)
        if not item.legal:
            self.reasons[item.reason] = None

    def legal(self, now_s: float, legal: bool) -> None:
        if self.illegal_since is not None:
            self.illegal_s += now_s - self.illegal_since
        self.illegal_since = None if legal else now_s

    def _limit_s(self, transport: str, kind: str) -> float | None:
        if self.config is None or (self.rates is not None and transport not in self.rates):
            return None
        region = self.config.region
        if kind == Location.__name__:
            return longest_period_s(region, transport, self.channel)
        if kind == BasicId.__name__:
            return region.basic_id_period_s
        return region.system_period_s if kind == System.__name__ else region.other_period_s


def gather(record: AircraftRecord) -> dict[str, Any]:
    """Return the Remote ID figures of one aircraft, ready for JSON. Times are its own `now_s`.

    This takes at most one pass over the steps.
    """
    config = None if record.header is None else record.header.config
    found = _Gatherer(config, record.facts.utc_offset_s, record.facts.heard)
    # A log may be gigabytes long and contains only received messages, so skip it if there are none.
    nothing = record.log and not record.facts.heard
    for step in () if nothing else record.steps():
        for event in step.events:
            found.add_event(step.now_s, event)
        for command in step.commands:
            found.add_event(step.now_s, command)
    found.legal(found.end_s, True)
    return {
        "region": None if config is None else config.region.name,
        "not_legal_s": found.illegal_s,
        "not_legal_because": list(found.reasons),
        "sent": [_sent(transport, kind, lane) for (transport, kind), lane in sorted(found.sent.items())],
        "heard": [
            _heard(transport, address, one) for (transport, address), one in sorted(found.senders.items())
        ],
        "ages": [
            {"track": name, "adsb": adsb, **spread(ages)} for (adsb, name), ages in sorted(found.ages.items())
        ],
    }


def _sent(transport: str, kind: str, lane: _Sent) -> dict[str, Any]:
    return {
        "transport": transport,
        "message": kind,
        "count": lane.count,
        "rate_hz": (lane.count - 1) / lane.on_air_s if lane.on_air_s > 0.0 else None,
        "longest_s": lane.longest_s,
        "longest_at_s": lane.longest_at_s,
        "legal_s": lane.limit_s,
        "over_legal": lane.over,
        "kept": None if lane.limit_s is None else lane.over == 0,
    }


def _heard(transport: str, address: str, one: _From) -> dict[str, Any]:
    return {
        "transport": transport,
        "address": address,
        "identities": sorted(one.names),
        "frames": one.frames,
        "longest_silence_s": one.longest_s,
        "lost": one.expected - one.arrived if one.counted else None,
        "lost_of": one.expected if one.counted else None,
        "latency": spread(one.latency) if len(one.latency) else None,
    }


def spread(values: array[float]) -> dict[str, float]:
    """Return median, 95th percentile and maximum of one or more values."""
    found = np.array(values)
    return {
        "median_s": float(np.median(found)),
        "p95_s": float(np.percentile(found, 95)),
        "worst_s": float(found.max()),
    }
