"""Other aircraft that one aircraft received: by which means, when, and how near they came by their own
reports."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import Any

import numpy as np

from companion.arrays import Floats
from ground_tools.inspect.read.flown import Path, at, between, on_ground
from ground_tools.inspect.read.read_run import AircraftRecord

ADSB = "ADS-B"


def heard(record: AircraftRecord, of_the_run: Container[str], offset_s: float) -> list[dict[str, Any]]:
    """Return a row for each aircraft that was heard, ready for JSON, the nearest first.

    The nearest approach is the one while the receiver was in the air. If it heard that aircraft only on the
    ground, it is the one there: whoever stands beside it at the start would otherwise be nearer than anyone
    in flight.

    Args:
        record: the aircraft that received them.
        of_the_run: identities of the aircraft that have records in this run; their rows are marked.
        offset_s: added to times.
    """
    ground = on_ground(record)
    rows = [*_by_remote_id(record, ground), *_by_adsb(record, ground)]
    for row in rows:
        row["of_the_run"] = row["identity"] in of_the_run
        row["beyond_record"] = False
        row["first_s"] += offset_s
        row["last_s"] += offset_s
        if row["nearest"] is not None:
            row["nearest"]["time_s"] += offset_s
    return sorted(rows, key=_distance)


def mark_beyond(row: dict[str, Any], receiver: Path | None, others: Sequence[Path]) -> None:
    """Mark an aircraft of the run that was nearest when the positions of the two are not both known, as after
    its record was cut off. The separation of the pair then does not contain that approach.

    Args:
        row: one of `heard`, with times on the common time line.
        receiver: path of the aircraft that received it; None without positions.
        others: paths of the aircraft of that identity.
    """
    if not row["of_the_run"] or row["nearest"] is None:
        return
    time_s = row["nearest"]["time_s"]
    paths = [*others] if receiver is None else [receiver, *others]
    if any(_on_ground(path, time_s) for path in paths):
        return
    row["beyond_record"] = receiver is None or not (
        _known(receiver, time_s) and any(_known(path, time_s) for path in others)
    )


def _on_ground(path: Path, time_s: float) -> bool:
    return bool(((path.on_ground_s[:, 0] <= time_s) & (time_s <= path.on_ground_s[:, 1])).any())


def _known(path: Path, time_s: float) -> bool:
    """Whether the position is known at that time."""
    inside = path.time_s[0] <= time_s <= path.time_s[-1]
    near = between(path, time_s, time_s)
    return bool(inside and not np.isnan(at(near, np.array([time_s]))).any())


def _distance(row: dict[str, Any]) -> tuple[float, str]:
    return float("inf") if row["nearest"] is None else row["nearest"]["slant_m"], row["identity"]


def _by_remote_id(record: AircraftRecord, ground: Floats) -> list[dict[str, Any]]:
    """One row for each identity. Addresses without an identity have a row of their own."""
    own = None if record.header is None else record.header.config.identity.uas_id
    groups: dict[str, list[str]] = {}
    for address, one in record.facts.heard.items():
        for name in one.uas_ids or (address,):
            if name != own:
                groups.setdefault(name, []).append(address)
    rows = []
    for name, addresses in groups.items():
        parts = [record.facts.heard[address] for address in addresses]
        rows.append(
            {
                "identity": name,
                "callsign": "",
                "by": "Remote ID: " + ", ".join(sorted({t for one in parts for t in one.transports})),
                "messages": sum(len(one.now_s) for one in parts),
                "first_s": float(min(one.now_s[0] for one in parts)),
                "last_s": float(max(one.now_s[-1] for one in parts)),
                "nearest": _nearest(np.concatenate([one.near for one in parts]), ground, barometric=False),
            }
        )
    return rows


def _by_adsb(record: AircraftRecord, ground: Floats) -> list[dict[str, Any]]:
    own = None if record.header is None else record.header.config.identity.icao
    return [
        {
            "identity": icao,
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
        ground: (m, 2) start and end of each span on the ground.
        barometric: whether heights are barometric.
    """
    if not len(near):
        return None
    stands = ((ground[:, 0] <= near[:, :1]) & (near[:, :1] <= ground[:, 1])).any(axis=1)
    near = near if stands.all() else near[~stands]
    now_s, slant, aside, above = near[int(near[:, 1].argmin())].tolist()
    return {
        "time_s": now_s,
        "slant_m": slant,
        "aside_m": aside,
        "above_m": None if np.isnan(above) else above,
        "barometric": barometric and not np.isnan(above),
    }
