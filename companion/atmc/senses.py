"""Builds an observation from the tracks: which aircraft are heard, how near, on which transports, and how
well each transport works here."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from companion.arrays import AnyFloats
from companion.atmc.actions import TRANSPORTS
from companion.atmc.observation import conflict_weight, identity_of, neighbour_rows, own_row
from companion.ownship import Ownship
from companion.traffic.senders.reception import HEARD_S, Reception
from companion.traffic.track import Track
from companion.traffic.tracks import Traffic

SCAN_SHARE: Final = (0.203, 0.104, 0.213)
"""Share of a sender's transmissions that fall into the receiver's scan if nothing else is sent, by transport.
It is that of the receiver in `config/channel/standard.toml`, for which policies are trained. For BLE 4 and
BLE 5 that is 2 ms of 8 ms less the packet, on three channels in turn; for Wi-Fi 6 ms of 21 ms less the
beacon."""
NEAR_M: Final = 200.0
"""Senders within this distance reach us on every transport, so their losses are not due to range."""
FEWEST_SENDERS: Final = 3
"""Number of nearest senders to use if fewer are within `NEAR_M`."""
FEWEST_EXPECTED: Final = 40.0
"""Least number of sent messages for which a share is given: with fewer it is mostly chance."""
_ENOUGH_EXPECTED: Final = 200.0
"""Least number of sent messages for which a share can count as the best of this receiver."""
_SIGMAS: Final = 3.0
_BEST_MEMORY_S: Final = 3600.0


@dataclass(slots=True)
class SuccessMeter:
    """Measures the share of packets that survive on each transport.

    The share of sent messages that arrive is divided by this receiver's best share: `SCAN_SHARE`, or more if
    the receiver has achieved more (because it listens all the time). To guard against chance, a new best
    share is reduced by three standard deviations, and the best share fades slowly.
    """

    _best: list[float] = field(default_factory=lambda: list(SCAN_SHARE))
    _last_s: float = math.inf

    def measure(
        self, now_s: float, senders: Sequence[Sequence[tuple[str, Reception]]]
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Success (0 to 1) and whether it is measured (0 or 1), by transport.

        Args:
            senders: transports and receptions of each near sender, from `Traffic.receptions`.
        """
        fade = math.exp(-max(0.0, now_s - self._last_s) / _BEST_MEMORY_S)
        self._last_s = now_s
        success, measured = [], []
        for k, transport in enumerate(TRANSPORTS):
            sums = [r.arrivals(now_s) for sender in senders for name, r in sender if name == transport]
            arrived, expected = sum(a for a, _ in sums), sum(e for _, e in sums)
            best = self._best[k] = max(SCAN_SHARE[k], fade * self._best[k])
            share = arrived / expected if expected > 0.0 else 0.0
            if expected >= _ENOUGH_EXPECTED:
                surely = share - _SIGMAS * math.sqrt(max(0.0, share * (1.0 - share)) / expected)
                best = self._best[k] = max(best, surely)
            known = expected >= FEWEST_EXPECTED
            success.append(min(1.0, share / best) if known else 0.0)
            measured.append(1.0 if known else 0.0)
        return tuple(success), tuple(measured)


@dataclass(frozen=True, slots=True)
class Seen:
    """One observation."""

    own: AnyFloats
    """Shape (own columns,)."""
    rows: AnyFloats
    """Shape (heard neighbours, neighbour columns)."""


class Senses:
    """Builds observations for one aircraft, with the functions that the trainer uses."""

    def __init__(self, uas_id: str) -> None:
        self._identity = np.array(identity_of(uas_id))
        self._meter = SuccessMeter()

    def look(self, now_s: float, own: Ownship, traffic: Traffic, rates: Mapping[str, int]) -> Seen:
        """The observation for now. The own position must be known.

        Args:
            rates: own transports with their Locations per second.
        """
        tracks, receptions = _heard_lately(now_s, traffic)
        distance_m, closing_mps = _relative(now_s, own, tracks)
        heard = np.zeros((len(tracks), len(TRANSPORTS)))
        for row, parts in zip(heard, receptions, strict=True):
            for transport, reception in parts:
                if transport in TRANSPORTS:
                    k = TRANSPORTS.index(transport)
                    row[k] = max(row[k], reception.rate(now_s))
        nearest = np.argsort(distance_m, kind="stable")
        count = max(FEWEST_SENDERS, int((distance_m <= NEAR_M).sum()))
        success, measured = self._meter.measure(now_s, [receptions[i] for i in nearest[:count]])
        own_rates = np.array([float(rates.get(transport, 0)) for transport in TRANSPORTS])
        return Seen(
            own_row(np, own_rates, np.array(success), np.array(measured), self._identity),
            neighbour_rows(np, distance_m, conflict_weight(np, distance_m, closing_mps), heard),
        )


def _heard_lately(now_s: float, traffic: Traffic) -> tuple[list[Track], list[list[tuple[str, Reception]]]]:
    """Aircraft that are on the air, with new content or without, and the receptions of each.

    One aircraft may have several tracks, such as one from BLE 4 until its Basic ID arrives, and one from its
    Wi-Fi beacons. The law keeps clear of all of them. Here each identity, or radio address without one, is
    one neighbour at its newest position.
    """
    names = {
        key.partition("/")[2]: track.identity
        for track in traffic.tracks.values()
        if track.identity not in track.sources
        for key in track.sources
    }
    groups: dict[str, list[Track]] = {}
    for track in traffic.tracks.values():
        name = track.identity
        if name in track.sources:
            address = name.partition("/")[2]
            name = names.get(address, address)
        groups.setdefault(name, []).append(track)
    tracks, receptions = [], []
    for group in groups.values():
        parts = [part for track in group for part in traffic.receptions(track)]
        if now_s - max([t.received_s for t in group] + [r.heard_s for _, r in parts]) <= HEARD_S:
            tracks.append(max(group, key=lambda t: t.received_s))
            receptions.append(list({id(r): (transport, r) for transport, r in parts}.values()))
    return tracks, receptions


def _relative(now_s: float, own: Ownship, tracks: Sequence[Track]) -> tuple[AnyFloats, AnyFloats]:
    """Distance (m) of each track now, and the speed (m/s) at which it shrinks. Both are horizontal if the
    height of the track is not known."""
    shape = (len(tracks), 3)
    place = np.array([t.position_ned_m for t in tracks]).reshape(shape)
    velocity = np.array([t.velocity_ned_mps for t in tracks]).reshape(shape)
    age_s = np.array([max(0.0, now_s - t.sample_s) for t in tracks]).reshape(-1, 1)
    away = place + age_s * velocity - np.array(own.position_ned_m(now_s))
    moving = velocity - np.array(own.velocity_ned_mps)
    level = np.array([not t.vertical_known for t in tracks], bool)
    away[level, 2] = moving[level, 2] = 0.0
    distance_m = np.sqrt((away * away).sum(axis=1))
    return distance_m, -(away * moving).sum(axis=1) / np.maximum(distance_m, 1.0)
