"""The figures of a run.

These are the closest approaches and the reaction to them, each flight, manoeuvre and broadcast, faults, and
damaged or missing data.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np

from companion.authority.table import State
from companion.avoidance.alerts import Level
from companion.errors import ConfigError
from companion.events import AlertChanged, AuthorityChanged
from companion.events.sensed import is_sensed, thing_of
from companion.runtime.record.disk import RUN
from ground_tools.inspect.explain import air, manoeuvres, traffic
from ground_tools.inspect.explain.manoeuvres import Manoeuvre
from ground_tools.inspect.read import flight_figures
from ground_tools.inspect.read.conditions import wind_figures
from ground_tools.inspect.read.faults import faults
from ground_tools.inspect.read.flown import Path, Separation, closest, flown
from ground_tools.inspect.read.read_run import AircraftRecord, Run
from ground_tools.inspect.read.timeline import clock_set_s, time_line
from ground_tools.inspect.report.terminal import text as text

NEAR = 3.0
"""A pair is listed as a conflict if it was in conflict, or came within this many times its limit."""
_SAME_TIME_S, _FAR_OFF_M = 1.5, 5.0
_CONFLICT_S = 10.0
"""A conflict that the law saw longer than this before or after the closest approach is unrelated to it."""
_HEARD = "Remote ID, as heard"
_BEFORE_S = 60.0
"""A manoeuvre that ended longer than this before the closest approach is not related to it."""


def describe(run: Run) -> dict[str, Any]:
    """Return the figures of a run, ready for JSON. Without any position there are no separations.

    All times are on the common time line that `clock` describes.
    """
    line = time_line(run)
    ways = None
    pairs: list[Separation] = []
    unknown: tuple[str, ...] = ()
    try:
        ways = flown(run)
        pairs, unknown = closest(ways.paths), ways.problems
    except ConfigError as error:
        unknown = (*line.problems, str(error))
    air_rows, air_problems = _air(run.summary)
    done = {record.name: manoeuvres.find(record) for record in run.aircraft}
    offsets = line.offsets_s
    paths = {path.name: path for path in ways.paths} if ways else {}
    of_the_run: dict[str, list[Path]] = {}
    for record in run.aircraft:
        of_the_run.setdefault(_identity(record), []).extend(filter(None, [paths.get(record.name)]))
    aircraft = [
        {
            **_aircraft(record, done[record.name], offsets[record.name]),
            "traffic": traffic.heard(record, of_the_run, paths.get(record.name), offsets[record.name]),
        }
        for record in run.aircraft
    ]
    return {
        "run": run.name,
        "clock": line.words,
        "utc_at_zero_s": line.utc_at_zero_s,
        "positions": ways.positions if ways else None,
        "conflicts": _conflicts(run, pairs, done, offsets),
        "aircraft": aircraft,
        "separations": [
            {
                "pair": [pair.first, pair.second],
                "minimum_m": pair.minimum_m,
                "minimum_time_s": pair.minimum_time_s,
                "required_m": pair.required_m,
                "kept": None if pair.minimum_m is None else pair.minimum_m >= pair.required_m,
            }
            for pair in pairs
        ],
        "air": air_rows,
        "notes": list(run.notes),
        "problems": [
            *run.problems,
            *_cut_off(run, offsets),
            *unknown,
            *_links(run),
            *air_problems,
        ],
    }


def _links(run: Run) -> list[str]:
    """Report damage of the telemetry logs beside event records."""
    return [problem for record in run.aircraft if record.link is not None for problem in record.link.problems]


def _cut_off(run: Run, offsets: dict[str, float]) -> list[str]:
    """Report a companion's run without a summary, because a companion writes one when it ends normally."""
    if run.summary is not None or (run.manifest or {}).get("what") != RUN:
        return []
    return [
        f"{record.name}: the companion did not end normally (killed, hung, power lost), or it still runs; "
        f"nothing is known after {record.facts.end_s + offsets[record.name]:.1f} s"
        for record in run.aircraft
    ]


def _air(summary: dict[str, Any] | None) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the simulated radio channel's figures by ordered pair, from the run's summary, and problems."""
    rows = (summary or {}).get("air", [])
    wanted = {
        "sender": str,
        "receiver": str,
        "sent": int,
        "delivered": int,
        "information_age_mean_s": float | None,
        "information_age_max_s": float | None,
    }
    try:
        return [{key: msgspec.convert(row[key], kind) for key, kind in wanted.items()} for row in rows], []
    except (KeyError, TypeError, msgspec.ValidationError):
        return [], ["summary.json: air: the format is not that of a run"]


def _aircraft(record: AircraftRecord, done: tuple[Manoeuvre, ...], offset_s: float) -> dict[str, Any]:
    facts = record.facts
    bad, ordinary = faults(record, offset_s)
    authority = [what.state for _, what in facts.rare if isinstance(what, AuthorityChanged)]
    levels = [what.level for _, what in facts.rare if isinstance(what, AlertChanged)]
    return {
        "name": record.name,
        "software": None if record.header is None else record.header.software,
        "law": None if record.header is None else record.header.config.avoidance.law,
        "use": None if record.header is None else record.header.config.flight.use,
        "steps": facts.steps,
        "duration_s": facts.duration_s,
        "clock_set_s": clock_set_s(record),
        "broadcasts": sum(len(times) for times in facts.sent.values()),
        "heard": sum(len(heard.now_s) for heard in facts.heard.values()) + facts.heard_left_out,
        "decisions": len(facts.decisions.now_s),
        "conflicts": int(facts.decisions.conflict.sum()),
        "cautions": levels.count(Level.CAUTION),
        "warnings": levels.count(Level.WARNING),
        "infeasible": int((~facts.decisions.feasible).sum()),
        "oldest_track_s": max((float(track.age_s.max()) for track in facts.tracks.values()), default=None),
        "authority": authority[-1] if authority else None,
        "flight": flight_figures.flight_figures(record, offset_s),
        "gnss": facts.gnss.figures(),
        "wind": None if record.wind is None else wind_figures(record.wind),
        "manoeuvres": [_moved(manoeuvres.figures(one), offset_s) for one in done],
        "alerts": flight_figures.alerts(record, offset_s),
        "remote_id": _moved_sent(air.gather(record), offset_s),
        "link": _link(record),
        "faults": bad,
        "ordinary": ordinary,
        "missing": flight_figures.missing(record),
    }


def _link(record: AircraftRecord) -> list[dict[str, Any]]:
    """Return the telemetry link quality for each component; empty without a telemetry log."""
    return [
        {
            "component": f"{one.system_id}/{one.component_id}",
            "frames": one.frames,
            "missing": one.missing,
            "missing_percent": 100.0 * one.missing_share,
            "silences": len(one.gaps_s),
            "longest_silence_s": float(one.gaps_s[:, 1].max()) if len(one.gaps_s) else None,
        }
        for one in (record.link.components if record.link is not None else ())
    ]


def _moved(figures: dict[str, Any], offset_s: float) -> dict[str, Any]:
    """Shift a manoeuvre's times to the common time line."""
    for key in ("start_s", "end_s", "regained_s"):
        figures[key] = None if figures[key] is None else figures[key] + offset_s
    nearest = figures["nearest"]
    nearest["time_s"] = None if nearest["time_s"] is None else nearest["time_s"] + offset_s
    return figures


def _moved_sent(figures: dict[str, Any], offset_s: float) -> dict[str, Any]:
    for row in figures["sent"]:
        row["longest_at_s"] = None if row["longest_at_s"] is None else row["longest_at_s"] + offset_s
    return figures


# ---------------------------------------------------------------- conflicts


def _conflicts(
    run: Run,
    pairs: list[Separation],
    done: dict[str, tuple[Manoeuvre, ...]],
    offsets: dict[str, float],
) -> list[dict[str, Any]]:
    """Return pairs of the run that came near or were in conflict, and heard aircraft in conflict or with a
    caution or warning. The closest comes first."""
    rows = [*_pairs_near(run, pairs, done, offsets), *_heard_near(run, done, offsets)]
    return sorted(rows, key=lambda row: (row["minimum_m"], row["pair"]))


def _pairs_near(
    run: Run,
    pairs: list[Separation],
    done: dict[str, tuple[Manoeuvre, ...]],
    offsets: dict[str, float],
) -> Iterator[dict[str, Any]]:
    """Yield the pairs of the run that came near or were in conflict."""
    records = {record.name: record for record in run.aircraft}
    for pair in pairs:
        if pair.minimum_m is None or pair.minimum_time_s is None:
            continue
        seen = [
            (records[a], _identity(records[b]))
            for a, b in ((pair.first, pair.second), (pair.second, pair.first))
        ]
        conflicted = any(_in_conflict(record, track) for record, track in seen)
        if not conflicted and pair.minimum_m > NEAR * pair.required_m:
            continue
        yield {
            "pair": [pair.first, pair.second],
            "time_s": pair.minimum_time_s,
            "minimum_m": pair.minimum_m,
            "required_m": pair.required_m,
            "kept": pair.minimum_m >= pair.required_m,
            "by": "positions",
            "done": [
                _what_was_done(record, track, done[record.name], at_s)
                + _taken_to_be(record, track, at_s, pair.minimum_m)
                for record, track in seen
                for at_s in (pair.minimum_time_s - offsets[record.name],)
            ],
        }


def _heard_near(
    run: Run, done: dict[str, tuple[Manoeuvre, ...]], offsets: dict[str, float]
) -> Iterator[dict[str, Any]]:
    """Yield the heard aircraft that were in conflict or with a caution or warning."""
    own = {_identity(record) for record in run.aircraft}
    for record in run.aircraft:
        for track in sorted((record.facts.tracks.keys() | _warned_of(record)) - own):
            if not _in_conflict(record, track) and track not in _warned_of(record):
                continue
            closest = _closest_of(record, track)
            if closest is None:
                continue
            least, at_s, by = closest
            yield {
                "pair": [record.name, track],
                "time_s": at_s + offsets[record.name],
                "minimum_m": least,
                "required_m": None,
                "kept": None,
                "by": by,
                "done": [
                    _what_was_done(record, track, done[record.name], at_s)
                    + (_who_flew(record, at_s) if by == _HEARD else "")
                ],
            }


def _warned_of(record: AircraftRecord) -> set[str]:
    """Return the tracks for which there was a caution or warning."""
    return {
        thing_of(what.track_id)
        for _, what in record.facts.rare
        if isinstance(what, AlertChanged) and what.level >= Level.CAUTION
    }


def _closest_of(record: AircraftRecord, track: str) -> tuple[float, float, str] | None:
    """Return the smallest distance to a track, its time, and its source.

    The source is the law's prediction while the law decided. At other times, such as after a pilot took over,
    it is the received positions.
    """
    found = []
    facts = record.facts.tracks.get(track)
    if facts is not None:
        row = int(facts.distance_m.argmin())
        by = "ADS-B" if facts.adsb else "own sensor" if is_sensed(track) else "Remote ID"
        by = f"{by}, as predicted aboard"
        found.append((float(facts.distance_m[row]), float(facts.now_s[row]), by))
    decided_s = record.facts.decisions.now_s
    for heard in record.facts.heard.values():
        if track in heard.uas_ids:
            # Use received positions only if there is no decision shortly before or after them.
            first = np.searchsorted(decided_s, heard.near[:, 0] - _SAME_TIME_S)
            last = np.searchsorted(decided_s, heard.near[:, 0] + _SAME_TIME_S)
            alone = heard.near[first == last]
            found.extend((float(distance), float(now_s), _HEARD) for now_s, distance, _, _ in alone)
    return min(found, default=None)


def _who_flew(record: AircraftRecord, at_s: float) -> str:
    """Return the authority state at a time, and the reason for it, as text."""
    last = _state_at(record, at_s)
    return "" if last is None else f"; its state was {last.state}: {last.reason}"


def _state_at(record: AircraftRecord, at_s: float) -> AuthorityChanged | None:
    """Return the change of authority that led to the state at a time; None if there was none before it."""
    last = None
    for now_s, what in record.facts.rare:
        if isinstance(what, AuthorityChanged) and now_s <= at_s:
            last = what
    return last


def _identity(record: AircraftRecord) -> str:
    """Return the identity that the aircraft broadcasts."""
    return record.name if record.header is None else record.header.config.identity.uas_id


def _in_conflict(record: AircraftRecord, track: str) -> bool:
    facts = record.facts.tracks.get(track)
    return facts is not None and bool(facts.conflict.any())


def _what_was_done(record: AircraftRecord, track: str, done: tuple[Manoeuvre, ...], at_s: float) -> str:
    """Describe how one aircraft reacted to a track, around a time by its own clock."""
    near = [
        one
        for one in done
        if track in one.tracks and one.start_s <= at_s + manoeuvres.GAP_S and one.end_s >= at_s - _BEFORE_S
    ]
    if near:
        ways = "; ".join(
            f"{'left its mission: ' if one.guarded else ''}"
            f"{manoeuvres.change(one.strongest.wanted_ned_mps, one.strongest.chosen_ned_mps)} "
            f"for {one.end_s - one.start_s:.1f} s"
            for one in near
        )
        return f"{record.name} {ways}"
    others = [one for one in done if one.start_s - manoeuvres.GAP_S <= at_s <= one.end_s + manoeuvres.GAP_S]
    if others:
        because = ", ".join(dict.fromkeys(name for one in others for name in one.tracks or one.limits))
        return f"{record.name} was avoiding {because or 'something else'} at that time"
    if (state := _state_at(record, at_s)) is not None and state.state == State.AVOIDING.value:
        return f"{record.name} was avoiding at that time ({state.reason}), along its wanted velocity"
    return f"{record.name} {_why_nothing(record, track, at_s)}"


def _taken_to_be(record: AircraftRecord, track: str, at_s: float, distance_m: float) -> str:
    """Return the distance that the law assumed at that time, if it differs much from the actual distance."""
    facts = record.facts.tracks.get(track)
    if facts is None:
        return ""
    row = int(abs(facts.now_s - at_s).argmin())
    seen_m = float(facts.distance_m[row])
    if abs(float(facts.now_s[row]) - at_s) > _SAME_TIME_S or abs(seen_m - distance_m) < _FAR_OFF_M:
        return ""
    return f" (it assumed a distance of {seen_m:.1f} m)"


def _why_nothing(record: AircraftRecord, track: str, at_s: float) -> str:
    if record.header is None:
        return "has no record of a companion"
    config = record.header.config
    if config.flight.use == "watch":
        return "only watched"
    if config.avoidance.law == "none":
        return 'did nothing: law "none"'
    facts = record.facts.tracks.get(track)
    if facts is None:
        decided = abs(record.facts.decisions.now_s - at_s).min(initial=np.inf) <= _SAME_TIME_S
        return (
            "did nothing: its law had no track of the other"
            if decided
            else "did nothing: its law made no decision at that time"
        )
    then = facts.conflict[abs(facts.now_s - at_s) <= _CONFLICT_S]
    return (
        "did nothing although its law saw a conflict at that time"
        if then.any()
        else "did nothing: its law saw no conflict with it at that time"
    )
