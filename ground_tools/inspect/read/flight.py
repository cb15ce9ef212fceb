"""Figures of one aircraft's flight: arming, distance, speeds, modes, authority, alerts, faults."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from companion.avoidance.alerts import Level
from companion.events import (
    AlertChanged,
    AuthorityChanged,
    BroadcastChanged,
    EstimatorState,
    FenceRefused,
    Heartbeat,
    MissionRefused,
    ModeRefused,
    RadioState,
    RemoteIdModule,
    Say,
    Severity,
    TrackFlagged,
    VehicleText,
)
from ground_tools.inspect.read.flown import MAX_GAP_S, to_ned
from ground_tools.inspect.read.modes import mode_name
from ground_tools.inspect.read.read_run import AircraftRecord
from ground_tools.inspect.read.spill import BLOCK, release

_ENDED = frozenset({"fault", "yielded"})
_REBOOT = "its clock started again from 0, so it restarted"


def flight(record: AircraftRecord, offset_s: float) -> dict[str, Any]:
    """Return the figures of a flight, ready for JSON. `offset_s` is added to times; None means unknown."""
    fixes = record.facts.fixes
    speed: float | None = None
    distance: float | None = None
    if len(fixes):
        speed = distance = 0.0
        for at in range(0, len(fixes), BLOCK):
            rows = fixes[at : at + BLOCK + 1]
            speed = max(speed, float(np.hypot(rows[:, 4], rows[:, 5]).max()))
            places = to_ned(rows[:, 1:4], (fixes[0, 1], fixes[0, 2], fixes[0, 3]))
            steps, passed = np.linalg.norm(np.diff(places, axis=0), axis=1), np.diff(rows[:, 0])
            distance += float(steps[passed <= MAX_GAP_S].sum())
            release(fixes)
    beats = [(now_s, what) for now_s, what in record.facts.rare if isinstance(what, Heartbeat)]
    armed = _spans(beats, record.facts.end_s, lambda beat: beat.armed)
    armed = [(a, b, words) for a, b, words in armed if words]
    return {
        "start_s": record.facts.start_s + offset_s,
        "end_s": record.facts.end_s + offset_s,
        "armed_s": sum(b - a for a, b, _ in armed) if beats else None,
        "armed": [{"from_s": a + offset_s, "to_s": b + offset_s} for a, b, _ in armed],
        "distance_m": distance,
        "max_speed_mps": speed,
        "max_height_m": record.facts.max_height_m,
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


def faults(record: AircraftRecord, offset_s: float) -> list[dict[str, Any]]:
    """Return what went wrong, in order of time: lost authority, refused requests, doubted tracks, reboots,
    warnings."""
    found = [(now_s, words) for now_s, what in record.facts.rare if (words := _fault(what)) is not None]
    if record.link is not None:
        found += [(now_s, ("vehicle", _REBOOT)) for now_s in record.link.reboots_s.tolist()]
    found.sort(key=lambda row: row[0])
    return [{"time_s": now_s + offset_s, "what": what, "text": text} for now_s, (what, text) in found]


def _fault(what: object) -> tuple[str, str] | None:
    match what:
        case AuthorityChanged(state=state, reason=reason) if state in _ENDED:
            return f"authority: {state}", reason
        case ModeRefused(mode=mode, reason=reason):
            return f"mode {mode.value} refused", reason
        case MissionRefused(reason=reason):
            return "mission refused", reason
        case FenceRefused(reason=reason):
            return "fence refused", reason
        case TrackFlagged(track_id=track, flag=flag, text=text):
            return f"track {track}: {flag}", text
        case BroadcastChanged(legal=False, reason=reason):
            return "Remote ID not legal", reason
        case RadioState(text=text) if text:
            return "radio", text
        case RemoteIdModule(ready=False, text=text):
            return "Remote ID module not ready", text
        case EstimatorState(usable=False):
            return "estimator", "it does not know its position"
        case VehicleText(severity=severity, text=text) if severity <= Severity.WARNING:
            return "vehicle", text
        case Say(severity=severity, text=text) if severity <= Severity.WARNING:
            return "companion", text
        case _:
            return None


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
    if not any(isinstance(what, Heartbeat) for _, what in facts.rare):
        found.append("heartbeats are missing, so arming and modes are not known")
    if facts.utc_offset_s is None:
        found.append("UTC is missing, so latencies are not known")
    if record.header is not None and not facts.sent:
        found.append("no Remote ID was sent")
    if record.header is not None and not facts.heard:
        found.append("no Remote ID was heard")
    return found
