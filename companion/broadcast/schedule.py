"""When each message is sent on each transport (the paper's "observe": psi messages per GNSS cycle).

On BLE 5 and Wi-Fi every broadcast is a pack of all messages. BLE 4 carries one message a frame, so each kind
of message has a clock of its own there. The region's periods are kept at any requested rate, with a margin
and looking ahead by one step. A transport that is given up stays on the air with its successors for a while.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Set
from dataclasses import dataclass, field

from companion.broadcast.legal_floor import MARGIN, longest_period_s
from companion.remote_id.messages import BasicId, Location, Message, System
from companion.remote_id.region import Region
from companion.remote_id.transports import BLE4

GNSS_CYCLE_S = 1.0
"""T_GNSS of the paper."""
OVERLAP_S = 1.0
"""How long a transport that is given up stays on the air with its successors, so that every second is covered
by one of them."""
_OTHERS_PERIOD_S = 3.0
"""Period of Self ID and the other messages for which the region sets none."""
_NAMING_S = 3.0
_NAMING_PERIOD_S = 0.5
"""On BLE 4, Basic ID goes with every Location of the first `_NAMING_S`, and at least once a
`_NAMING_PERIOD_S`. Receivers cannot tell an aircraft that they know from another transport until they have
its name: if BLE 4 is given up before, they avoid a nameless second aircraft."""
_LONGEST_STEP_S = 0.3
_EPSILON_S = 1e-6


@dataclass(slots=True)
class _Lane:
    """Timing of one transport on the air."""

    rate: int
    began_s: float
    next_s: float
    """Time at which the requested rate makes the next Location due."""
    sent_s: dict[type[Message], float] = field(default_factory=dict)
    leaving_s: float | None = None
    """Time since which the transport is kept only until its successors are on the air; None if it is in
    use."""


class Schedule:
    """Timing of all transports.

    Args:
        identity: spreads the phases of aircraft that are switched on together.
    """

    def __init__(self, region: Region, identity: str) -> None:
        self._region = region
        self._phase = zlib.crc32(identity.encode()) / 2**32
        self._lanes: dict[str, _Lane] = {}
        self._last_s: float | None = None
        self._step_s = 0.0
        self._limits: dict[
            tuple[str, int | None, frozenset[type[Message]]], dict[type[Message], float | None]
        ] = {}
        """Results of `_limits_s`, which are the same at most steps."""

    @property
    def on_air(self) -> Set[str]:
        """Transports in use. Those that are about to leave are included."""
        return self._lanes.keys()

    def stop(self) -> None:
        """Take all transports off the air. They begin anew when they are wanted again."""
        self._lanes.clear()

    def due(
        self,
        rates: Mapping[str, int],
        can_send: frozenset[str],
        wifi_channel: int | None,
        kinds: frozenset[type[Message]],
        now_s: float,
    ) -> list[tuple[str, frozenset[type[Message]]]]:
        """Transports to send on now, each with the kinds of messages to send there.

        Args:
            rates: transports to be on the air, with their Locations a second.
            can_send: transports that work at all.
            wifi_channel: channel of the beacons; None while unknown.
            kinds: kinds of all messages that there are at this time, Location among them.
            now_s: not before the last call's.
        """
        if self._last_s is not None:
            # The longest recent step, with slow decay. Messages that become due before the next step are sent
            # now.
            self._step_s = min(max(now_s - self._last_s, 0.9 * self._step_s), _LONGEST_STEP_S)
        self._last_s = now_s
        self._change(rates, can_send, now_s)
        found = []
        for transport, lane in self._lanes.items():
            key = transport, wifi_channel, kinds
            if key not in self._limits:
                self._limits[key] = self._limits_s(*key)
            due = self._due_kinds(transport, lane, self._limits[key], now_s)
            if due:
                sent = frozenset(due) if transport == BLE4 else kinds
                lane.sent_s.update(dict.fromkeys(sent, now_s))
                found.append((transport, sent))
        self._leave(now_s)
        return found

    def _change(self, rates: Mapping[str, int], can_send: frozenset[str], now_s: float) -> None:
        for transport in [t for t in self._lanes if t not in can_send]:
            del self._lanes[transport]
        for transport, lane in self._lanes.items():
            if transport in rates:
                lane.leaving_s = None
            elif lane.leaving_s is None:
                lane.leaving_s = now_s
        for transport, rate in rates.items():
            if transport not in can_send:
                continue
            if transport not in self._lanes:
                self._lanes[transport] = _Lane(rate=rate, began_s=now_s, next_s=now_s)
            lane = self._lanes[transport]
            if lane.rate != rate:
                lane.rate = rate
                lane.next_s = min(lane.next_s, now_s + GNSS_CYCLE_S / rate)

    def _leave(self, now_s: float) -> None:
        """Take transports off the air when their successors, which began at once, have been there long
        enough."""
        over = [
            transport
            for transport, lane in self._lanes.items()
            if lane.leaving_s is not None and now_s - lane.leaving_s >= OVERLAP_S
        ]
        for transport in over:
            del self._lanes[transport]

    def _due_kinds(
        self, transport: str, lane: _Lane, limits_s: Mapping[type[Message], float | None], now_s: float
    ) -> set[type[Message]]:
        """Kinds of messages that are due. On a transport that sends packs, Location stands for the whole
        pack."""
        kinds: set[type[Message]] = set()
        if now_s >= lane.next_s - _EPSILON_S:
            kinds.add(Location)
            cycle_s = GNSS_CYCLE_S / lane.rate
            first = Location not in lane.sent_s
            # The rate holds over time. Only the first interval is shortened, by the aircraft's own phase.
            lane.next_s += cycle_s * (0.5 + 0.5 * self._phase) if first else cycle_s
            if lane.next_s <= now_s:
                lane.next_s = now_s + cycle_s
        elif self._late(lane, Location, limits_s[Location], now_s):
            kinds.add(Location)
            lane.next_s = now_s + GNSS_CYCLE_S / lane.rate
        if transport == BLE4:
            kinds |= {kind for kind, limit_s in limits_s.items() if self._late(lane, kind, limit_s, now_s)}
            naming = BasicId in limits_s and now_s - lane.began_s < _NAMING_S
            if naming and (Location in kinds or self._late(lane, BasicId, _NAMING_PERIOD_S, now_s)):
                kinds.add(BasicId)
        return kinds

    def _limits_s(
        self, transport: str, wifi_channel: int | None, kinds: frozenset[type[Message]]
    ) -> dict[type[Message], float | None]:
        """Time after which each kind of message must be sent again; None for no limit."""
        region = self._region
        legal: dict[type[Message], float | None] = {
            Location: longest_period_s(region, transport, wifi_channel),
            BasicId: region.basic_id_period_s,
            System: region.system_period_s,
        }
        with_margin = {kind: legal.get(kind, region.other_period_s) for kind in {*kinds, Location}}
        limits_s = {kind: None if t is None else MARGIN * t for kind, t in with_margin.items()}
        if transport == BLE4:
            for kind in kinds - {Location}:
                if limits_s[kind] is None:
                    limits_s[kind] = GNSS_CYCLE_S if kind in (BasicId, System) else _OTHERS_PERIOD_S
        else:
            limits_s[Location] = min((t for t in limits_s.values() if t is not None), default=None)
        return limits_s

    def _late(self, lane: _Lane, kind: type[Message], limit_s: float | None, now_s: float) -> bool:
        """Whether waiting for the next step would exceed the limit."""
        if limit_s is None:
            return False
        last_s = lane.sent_s.get(kind)
        return last_s is None or now_s + self._step_s > last_s + limit_s + _EPSILON_S
