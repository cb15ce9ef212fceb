"""Other aircraft that one aircraft received: by which means, when, and how near they came by their own
reports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from companion.arrays import Bools, Floats
from ground_tools.inspect.read.facts import Heard
from ground_tools.inspect.read.flown import Path, at, between, on_ground
from ground_tools.inspect.read.read_run import AircraftRecord
from ground_tools.inspect.read.spill import release

ADSB = "ADS-B"
ELSEWHERE_M = 100.0
"""A position that is sent with the identity of a recorded aircraft, but is farther than this from where that
aircraft was, is another sender's. Delays, clocks and navigation make less."""
_ELSEWHERE_S = 3
"""Number of seconds with such positions from which on another sender is told. A radio may repeat an old
message for a moment."""


def heard(
    record: AircraftRecord, of_the_run: Mapping[str, Sequence[Path]], receiver: Path | None, offset_s: float
) -> list[dict[str, Any]]:
    """Return a row for each aircraft that was heard, ready for JSON, the nearest first.

    The nearest approach is the one while the receiver was in the air. If it heard that aircraft only on the
    ground, it is the one there: whoever stands beside it at the start would otherwise be nearer than anyone
    in flight.

    Args:
        record: the aircraft that received them.
        of_the_run: the paths of the aircraft that have records in this run, by identity; their rows are
            marked. Who sends such an identity from elsewhere has a row of its own.
        receiver: path of `record`; None without positions.
        offset_s: added to times.
    """
    ground = on_ground(record)
    rows = [*_by_remote_id(record, of_the_run, receiver, offset_s, ground), *_by_adsb(record, ground)]
    for row in rows:
        row["of_the_run"] = row["identity"] in of_the_run
        row["first_s"] += offset_s
        row["last_s"] += offset_s
        if row["nearest"] is not None:
            row["nearest"]["time_s"] += offset_s
        row["beyond_record"] = _is_beyond(row, receiver, of_the_run.get(row["identity"], ()))
    return sorted(rows, key=_distance)


def _is_beyond(row: dict[str, Any], receiver: Path | None, others: Sequence[Path]) -> bool:
    """Return whether an aircraft of the run was nearest when the positions of the two are not both known, as
    after its record was cut off. The separation of the pair then does not contain that approach.

    Args:
        row: one of `heard`, with times on the common time line.
        receiver: path of the aircraft that received it; None without positions.
        others: paths of the aircraft of that identity.
    """
    if not row["of_the_run"] or row["elsewhere"] or row["nearest"] is None:
        return False
    time_s = row["nearest"]["time_s"]
    paths = [*others] if receiver is None else [receiver, *others]
    if any(_on_ground(path, time_s) for path in paths):
        return False
    return receiver is None or not (_known(receiver, time_s) and any(_known(path, time_s) for path in others))


def _on_ground(path: Path, time_s: float) -> bool:
    return bool(((path.on_ground_s[:, 0] <= time_s) & (time_s <= path.on_ground_s[:, 1])).any())


def _known(path: Path, time_s: float) -> bool:
    """Whether the position is known at that time."""
    inside = path.time_s[0] <= time_s <= path.time_s[-1]
    near = between(path, time_s, time_s)
    return bool(inside and not np.isnan(at(near, np.array([time_s]))).any())


def _distance(row: dict[str, Any]) -> tuple[float, str]:
    return float("inf") if row["nearest"] is None else row["nearest"]["slant_m"], row["identity"]


def _by_remote_id(
    record: AircraftRecord,
    of_the_run: Mapping[str, Sequence[Path]],
    receiver: Path | None,
    offset_s: float,
    ground: Floats,
) -> list[dict[str, Any]]:
    """One row for each identity. Addresses without an identity have a row of their own, and so have those
    that send an identity of the run from elsewhere."""
    own = None if record.header is None else record.header.config.identity.uas_id
    groups: dict[tuple[str, bool], list[Heard]] = {}
    for address, one in record.facts.heard.items():
        for name in one.uas_ids or (address,):
            if name == own:
                away = one.near[:, 2] > ELSEWHERE_M
            else:
                away = _away(one.near, receiver, of_the_run.get(name, ()), offset_s)
            foreign = int(away.sum()) >= _ELSEWHERE_S
            mostly = 2 * int(away.sum()) > len(away)
            if foreign:
                near = one.near if mostly else one.near[away]
                groups.setdefault((name, True), []).append(replace(one, near=near))
            if name != own and not (foreign and mostly):
                groups.setdefault((name, False), []).append(one)
    rows = []
    for (name, elsewhere), parts in groups.items():
        rows.append(
            {
                "identity": name,
                "elsewhere": elsewhere,
                "callsign": "",
                "by": "Remote ID: " + ", ".join(sorted({t for one in parts for t in one.transports})),
                "messages": sum(len(one.now_s) for one in parts),
                "first_s": float(min(one.now_s[0] for one in parts)),
                "last_s": float(max(one.now_s[-1] for one in parts)),
                "nearest": _nearest(np.concatenate([one.near for one in parts]), ground, barometric=False),
            }
        )
    return rows


def _away(near: Floats, receiver: Path | None, others: Sequence[Path], offset_s: float) -> Bools:
    """Mark the reported positions (n,) that are far from every recorded aircraft of that identity.

    The horizontal distance from the receiver is compared with the recorded one. Where one of the positions is
    not known, nothing is marked.
    """
    if receiver is None or not others or not len(near):
        return np.zeros(len(near), bool)
    time_s = near[:, 0] + offset_s
    mine = _places(receiver, time_s)
    off = [abs(near[:, 2] - np.linalg.norm((_places(path, time_s) - mine)[:, :2], axis=1)) for path in others]
    return np.asarray(np.min(off, axis=0) > ELSEWHERE_M)  # NaN compares as False


def _places(path: Path, time_s: Floats) -> Floats:
    """Return the positions (n, 3) at rising times; NaN where they are not known."""
    places = at(between(path, float(time_s[0]), float(time_s[-1])), time_s)
    places[(time_s < path.time_s[0]) | (time_s > path.time_s[-1])] = np.nan
    release(path.position_ned_m)
    return places


def _by_adsb(record: AircraftRecord, ground: Floats) -> list[dict[str, Any]]:
    own = None if record.header is None else record.header.config.identity.icao
    return [
        {
            "identity": icao,
            "elsewhere": False,
            "callsign": one.callsign,
            "by": ADSB,
            "messages": one.reports,
            "first_s": one.first_s,
            "last_s": one.last_s,
            "nearest": _nearest(one.near, ground, barometric=one.barometric),
        }
        for icao, one in record.facts.adsb.items()
        if own is None or icao != own.upper()
    ]


def _nearest(near: Floats, ground: Floats, *, barometric: bool) -> dict[str, Any] | None:
    """The closest approach; None if the positions of both were never known at the same time.

    Args:
        near: (n, 4) as `nearness.Approaches.rows`.
        ground: (m, 2) start and end of each span on the ground, in the order of time.
        barometric: whether heights are barometric.
    """
    if not len(near):
        return None
    # Only the last span that has begun can contain a time. If there is none, -1 selects the end at -inf.
    last = np.searchsorted(ground[:, 0], near[:, 0], side="right") - 1
    stands = near[:, 0] <= np.append(ground[:, 1], -np.inf)[last]
    near = near if stands.all() else near[~stands]
    now_s, slant, aside, above = near[int(near[:, 1].argmin())].tolist()
    return {
        "time_s": now_s,
        "slant_m": slant,
        "aside_m": aside,
        "above_m": None if np.isnan(above) else above,
        "barometric": barometric and not np.isnan(above),
    }
