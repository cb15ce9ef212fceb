"""Chooses the frames that a crowded step uses, so that a flood costs a bounded time and hides no aircraft.

A step with at most `ALL` frames uses all of them. In a step with more:

- Frames of addresses that feed a track come first, up to `KNOWN`, beginning with the address whose tracks
  have waited longest. If an address sends more than `OF_ADDRESS` frames, the one that continues each of its
  tracks best is taken, and the rest are judged like frames of unknown addresses. An attacker who copies the
  address can therefore not use up a quota of it.
- Of all other frames with a position, `STRANGE` are taken: threats first, by the same rule as in a full table
  (`eviction`). One from each direction and class of time and range comes before the second of any, so a flood
  leaves out no threat that is alone in its direction.
- Of all other frames without a position, the first `NAMELESS` are taken.

Frames that are left out count as not received. The choice depends on numbers of frames, not on processing
time, so that a replay makes the same choice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import islice

import numpy as np

from companion.arrays import Floats
from companion.events import RemoteIdHeard
from companion.geometry import LocalFrame
from companion.remote_id.messages import Location
from companion.traffic.eviction import Judgement
from companion.traffic.fix import SIGMA_MOST_M, SIGMA_UNKNOWN_M
from companion.traffic.senders.source import Source
from companion.traffic.track import Track

ALL = 96
KNOWN, STRANGE, NAMELESS = 96, 32, 16
OF_ADDRESS = 8
"""Frames of one address in a step that are used without a choice. An honest sender sends at most one frame in
20 ms, and one Location in 50 ms."""
_M_PER_DEG = 111_194.9


def chosen(
    frames: Sequence[RemoteIdHeard],
    now_s: float,
    *,
    held: Callable[[str, str], Source | None],
    tracks_of: Callable[[Source], list[Track]],
    judgement: Judgement,
    frame: LocalFrame,
    separation_m: float | None,
) -> Sequence[RemoteIdHeard]:
    """The frames of a step that are used, in their order.

    Args:
        held: the source of a transport and address; None: it is not known.
        tracks_of: the tracks that a source feeds.
        frame, separation_m: as for `Traffic.hear`.
    """
    if len(frames) <= ALL:
        return frames
    places = _places(frames, frame, separation_m)
    senders: dict[tuple[str, str], list[int]] = {}
    for number, heard in enumerate(frames):
        senders.setdefault((heard.transport, heard.address), []).append(number)
    known: list[tuple[float, list[int], list[Track]]] = []
    strange: list[int] = []
    for (transport, address), mine in senders.items():
        source = held(transport, address)
        tracks = [] if source is None or not source.tracks else tracks_of(source)
        if not tracks:
            strange += mine
            continue
        best = mine
        if len(mine) > OF_ADDRESS:
            best = _continuing(mine, tracks, places, now_s)
            strange += [number for number in mine if number not in best]
        known.append((min(max(t.received_s, t.taken_s) for t in tracks), best, tracks))
    taken: list[int] = []
    for _, best, tracks in sorted(known, key=lambda entry: (entry[0], entry[1][0])):
        if len(taken) + len(best) > KNOWN:
            break
        taken += best
        for track in tracks:
            track.taken_s = now_s
    placed = [number for number in sorted(strange) if not math.isnan(places[number, 0])]
    taken += _urgent(placed, places, judgement)
    taken += islice((number for number in sorted(strange) if math.isnan(places[number, 0])), NAMELESS)
    return [frames[number] for number in sorted(taken)]


def _places(frames: Sequence[RemoteIdHeard], frame: LocalFrame, separation_m: float | None) -> Floats:
    """Position and velocity (NED, m and m/s) and declared error (m) of the first Location of each frame.

    All values are NaN for a frame without one. An unknown height is NaN, an unknown velocity 0. Positions are
    computed on a plane that touches a spherical Earth, which is accurate enough to compare urgencies.
    """
    rows: list[tuple[float, ...]] = []
    east = _M_PER_DEG * math.cos(math.radians(frame.lat_deg))
    for heard in frames:
        found = next((m for m in heard.messages if type(m) is Location), None)
        if found is None or found.lat_deg is None or found.lon_deg is None:
            rows.append((math.nan,) * 7)
            continue
        down = math.nan
        if found.alt_geodetic_m is not None and separation_m is not None:
            down = frame.alt_m + separation_m - found.alt_geodetic_m
        speed, course = found.speed_mps or 0.0, math.radians(found.direction_deg or 0.0)
        accuracy = found.horizontal_accuracy_m
        along_deg = found.lon_deg - frame.lon_deg
        if abs(along_deg) > 180.0:  # across the antimeridian
            along_deg -= math.copysign(360.0, along_deg)
        rows.append(
            (
                _M_PER_DEG * (found.lat_deg - frame.lat_deg),
                east * along_deg,
                down,
                speed * math.cos(course),
                speed * math.sin(course),
                -(found.vertical_speed_mps or 0.0),
                SIGMA_UNKNOWN_M if accuracy is None else min(accuracy, SIGMA_MOST_M),
            )
        )
    return np.array(rows)


def _continuing(mine: list[int], tracks: Sequence[Track], places: Floats, now_s: float) -> list[int]:
    """Of the frames of one address, those nearest to where its tracks are predicted, one for each track."""
    best: set[int] = set()
    for track in tracks:
        along = now_s - track.sample_s
        north, east = (track.position_ned_m[i] + along * track.velocity_ned_mps[i] for i in (0, 1))
        away = np.hypot(places[mine, 0] - north, places[mine, 1] - east)
        away[np.isnan(away)] = np.inf
        best.add(mine[int(away.argmin())])
    return sorted(best)


def _urgent(numbers: list[int], places: Floats, judgement: Judgement) -> list[int]:
    """The `STRANGE` most urgent of some frames."""
    if len(numbers) <= STRANGE:
        return numbers
    loss_s, away_m, sector, part = judgement.urgency(places[numbers])
    count = len(numbers)
    # Of each direction and class the earliest first; NumPy's last key is the first to count.
    kind = 100 * sector + part
    order = np.lexsort((away_m, loss_s, kind))
    first = np.searchsorted(kind[order], kind[order], side="left")
    turn = np.empty(count, dtype=np.int64)
    turn[order] = np.arange(count) - first
    crowd, direction = np.bincount(kind), np.bincount(sector)
    best = np.lexsort((away_m, loss_s, crowd[kind], direction[sector], turn, np.isinf(loss_s)))
    return [numbers[i] for i in best[:STRANGE].tolist()]
