"""Figures of one aircraft's flight: arming, distance, speeds, modes, authority, alerts."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from companion.avoidance.alerts import Level
from companion.events import (
    AlertChanged,
    AuthorityChanged,
    Heartbeat,
)
from ground_tools.inspect.read.flown import MAX_GAP_S, began_in_flight, to_ned
from ground_tools.inspect.read.heights import spikes
from ground_tools.inspect.read.modes import mode_name
from ground_tools.inspect.read.read_run import AircraftRecord
from ground_tools.inspect.read.spill import BLOCK, release


def flight_figures(record: AircraftRecord, offset_s: float) -> dict[str, Any]:
    """Return the figures of a flight, ready for JSON. `offset_s` is added to times; None means unknown."""
    fixes = record.facts.fixes
    speed: float | None = None
    distance: float | None = None
    highest = -math.inf
    if len(fixes):
        speed = distance = 0.0
        for at in range(0, len(fixes), BLOCK):
            rows = fixes[at : at + BLOCK + 1]
            rows = rows[~spikes(rows[:, 0], rows[:, 7])]
            speed = max(speed, float(np.hypot(rows[:, 4], rows[:, 5]).max(initial=0.0)))
            places = to_ned(rows[:, 1:4], (fixes[0, 1], fixes[0, 2], fixes[0, 3]))
            steps, passed = np.linalg.norm(np.diff(places, axis=0), axis=1), np.diff(rows[:, 0])
            distance += float(steps[passed <= MAX_GAP_S].sum())
            highest = max(highest, float(rows[:, 7].max(initial=highest)))
            release(fixes)
    beats = [(now_s, what) for now_s, what in record.facts.rare if isinstance(what, Heartbeat)]
    armed = _spans(beats, record.facts.end_s, lambda beat: beat.armed)
    armed = [(a, b, words) for a, b, words in armed if words]
    return {
        "start_s": record.facts.start_s + offset_s,
        "end_s": record.facts.end_s + offset_s,
        "armed_s": sum(b - a for a, b, _ in armed) if beats and not began_in_flight(record) else None,
        "armed": [{"from_s": a + offset_s, "to_s": b + offset_s} for a, b, _ in armed],
        "distance_m": distance,
        "max_speed_mps": speed,
        "max_height_m": highest if math.isfinite(highest) else None,
        "modes": [
            {"from_s": a + offset_s, "to_s": b + offset_s, "mode": mode}
            for a, b, mode in _spans(beats, record.facts.end_s, mode_name)
        ],
        "authority": _authority(record, offset_s),
    }


def _spans(
    beats: list[tuple[float, Heartbeat]], end_s: float, of: Callable[[Heartbeat], Any]
) -> list[tuple[float, float, Any]]:
    """Return the spans (start, end, value) in which the value of `of` for the heartbeats stayed the same."""
    found: list[tuple[float, float, Any]] = []
    for now_s, beat in beats:
        if found and found[-1][2] == of(beat):
            continue
        if found:
            found[-1] = (found[-1][0], now_s, found[-1][2])
        found.append((now_s, end_s, of(beat)))
    return found


def _authority(record: AircraftRecord, offset_s: float) -> list[dict[str, Any]]:
    moves = [(now_s, what) for now_s, what in record.facts.rare if isinstance(what, AuthorityChanged)]
    ends = [now_s for now_s, _ in moves[1:]] + [record.facts.end_s]
    return [
        {
            "from_s": now_s + offset_s,
            "to_s": end_s + offset_s,
            "state": what.state,
            "reason": what.reason,
        }
        for (now_s, what), end_s in zip(moves, ends, strict=False)
    ]


def alerts(record: AircraftRecord, offset_s: float) -> list[dict[str, Any]]:
    """Return every change of an alert level, ready for JSON. Times are shifted by `offset_s`."""
    return [
        {
            "time_s": now_s + offset_s,
            "track": what.track_id,
            "level": Level(what.level).name.lower() if 0 <= what.level < len(Level) else str(what.level),
            "reason": what.reason,
        }
        for now_s, what in record.facts.rare
        if isinstance(what, AlertChanged)
    ]


def missing(record: AircraftRecord) -> list[str]:
    """Return what this record does not contain, as text."""
    facts, found = record.facts, []
    if record.header is None:
        found.append(
            "the log has no companion, so its configuration, decisions, alerts and Remote ID are not known; "
            "limits are the defaults"
        )
    elif not len(facts.decisions.now_s):
        use = record.header.config.flight.use
        found.append(f'the law made no decision: flight.use was "{use}", or the companion never took control')
    if not len(facts.fixes):
        found.append("the aircraft's own position is missing")
    elif len(gaps := np.flatnonzero(np.diff(facts.fixes[:, 0]) > MAX_GAP_S)):
        longest_s = float(np.diff(facts.fixes[:, 0])[gaps].max())
        found.append(
            f"the aircraft's own position is missing for more than {MAX_GAP_S:g} s in {len(gaps)} "
            f"{'places' if len(gaps) > 1 else 'place'}, at most for {longest_s:.1f} s; drawings show a gap"
        )
    if not any(isinstance(what, Heartbeat) for _, what in facts.rare):
        found.append("heartbeats are missing, so arming and modes are not known")
    if began_in_flight(record):
        found.append(
            "the log shows a flight but no arming, so it probably begins in the air; the aircraft counts as "
            "flying throughout"
        )
    if facts.utc_offset_s is None:
        found.append("UTC is missing, so latencies are not known")
    if facts.adsb_left_out:
        found.append(
            f"{facts.adsb_left_out} ADS-B reports are left out: there were more than {len(facts.adsb)} "
            "aircraft, and only the nearest are shown"
        )
    if facts.heard_left_out:
        found.append(
            f"{facts.heard_left_out} frames of Remote ID are left out: there were more than "
            f"{len(facts.heard)} radio addresses, and only the nearest are shown"
        )
    if record.header is not None and not facts.sent:
        found.append("no Remote ID was sent")
    if record.header is not None and not facts.heard:
        found.append("no Remote ID was heard")
    return found
