"""Faults of one aircraft, separated from ordinary events that look like faults.

Ordinary events are the start-up messages that old firmware sends with the highest severities, and a pilot who
takes over while nothing is being avoided.
"""

from __future__ import annotations

import re
from typing import Any, Final

from companion.authority.table import State, Trigger
from companion.events import (
    AuthorityChanged,
    BroadcastChanged,
    EstimatorState,
    FenceRefused,
    MissionRefused,
    ModeRefused,
    RadioState,
    RemoteIdModule,
    Say,
    Severity,
    TrackFlagged,
    VehicleText,
)
from companion.traffic.plausibility import Flag
from ground_tools.inspect.read.read_run import AircraftRecord

_ENDED: Final = frozenset({State.FAULT.value, State.YIELDED.value})
_REBOOT: Final = "its clock started again from 0, so it restarted"
_CLEARED: Final = "no longer: "
"""Beginning of the text that withdraws a flag."""
_START_UP: Final = re.compile(
    r"(initiali[sz]ing apm|ground start|(calibrating|beginning) (barometer|ins|gyro)"
    r"|(barometer|ins|gyro)( \d)? calibration complete|ready to (fly|drive)|apm:"
    r"|ardu(copter|plane|rover|sub|pilot) v|px4(v\d)?: |nuttx: |chibios: |frame: )",
    re.IGNORECASE,
)
"""Start-up messages of firmware, with any severity. ArduPilot releases before 2015 used another scale, on
which such messages have the number of today's ALERT."""
_STATES_SAID: Final = re.compile(r"DMUCA (" + "|".join(state.value for state in State) + "): ")
"""Texts with which the companion reports changes of authority. These changes have separate rows."""
_MEANING: Final = {
    Flag.REMOTE_ID_FAILURE.value: "; a companion reports this while it has no position to send"
}
"""Possible cause of a flag, appended to its text."""


def faults(record: AircraftRecord, offset_s: float) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the faults and the ordinary events, each in order of time and ready for JSON.

    Args:
        record: the aircraft.
        offset_s: added to times.

    Returns:
        Rows with `time_s`, `until_s` (of a doubt that was withdrawn, else None), `what` and `text`.
    """
    bad: list[dict[str, Any]] = []
    ordinary: list[dict[str, Any]] = []
    open_flags: dict[tuple[str, str], dict[str, Any]] = {}
    for now_s, what in record.facts.rare:
        if isinstance(what, TrackFlagged) and what.text.startswith(_CLEARED):
            if (row := open_flags.pop((what.track_id, what.flag), None)) is not None:
                row["until_s"] = now_s + offset_s
            continue
        if (words := _ordinary(what)) is not None:
            ordinary.append(_row(now_s + offset_s, *words))
        elif (words := _fault(what)) is not None:
            bad.append(_row(now_s + offset_s, *words))
            if isinstance(what, TrackFlagged):
                open_flags[what.track_id, what.flag] = bad[-1]
    if record.link is not None:
        bad += [_row(now_s + offset_s, "vehicle", _REBOOT) for now_s in record.link.reboots_s.tolist()]
    bad.sort(key=lambda row: row["time_s"])
    return bad, ordinary


def _row(time_s: float, what: str, text: str) -> dict[str, Any]:
    return {"time_s": time_s, "until_s": None, "what": what, "text": text}


def _ordinary(what: object) -> tuple[str, str] | None:
    match what:
        case VehicleText(severity=severity, text=text) if severity <= Severity.WARNING and _START_UP.match(
            text
        ):
            return "vehicle starts", text
        case AuthorityChanged(
            previous=previous, state=State.YIELDED.value, trigger=trigger, reason=reason
        ) if trigger == Trigger.PILOT.value and previous != State.AVOIDING.value:
            return "pilot took over", reason
        case _:
            return None


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
            return f"track {track}: {flag}", text + _MEANING.get(flag, "")
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
            return None if _STATES_SAID.match(text) else ("companion", text)
        case _:
            return None
