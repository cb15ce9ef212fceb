"""A run in figures: closest approaches, what each aircraft sent, heard and decided, what is damaged."""

from __future__ import annotations

from typing import Any

import msgspec

from companion.avoidance.alerts import Level
from companion.errors import ConfigError
from companion.events import AlertChanged, AuthorityChanged
from ground_tools.inspect.flown import Separation, flown, separations
from ground_tools.inspect.read_run import AircraftRecord, Run
from ground_tools.inspect.timeline import time_line


def describe(run: Run) -> dict[str, Any]:
    """Figures of a run, ready for JSON; without any position there are no separations in them."""
    ways = None
    pairs: list[Separation] = []
    unknown: tuple[str, ...] = ()
    try:
        ways = flown(run)
        pairs, unknown = separations(ways.paths), ways.problems
    except ConfigError as error:
        unknown = (str(error),)
    air, air_problems = _air(run.summary)
    return {
        "run": run.name,
        "clock": time_line(run).words,
        "positions": ways.positions if ways else None,
        "aircraft": [_aircraft(record) for record in run.aircraft],
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
        "air": air,
        "notes": list(run.notes),
        "problems": [*run.problems, *unknown, *air_problems],
    }


def text(figures: dict[str, Any]) -> str:
    """The figures of `describe` as lines a person reads."""
    lines = [
        f"{figures['run']}: {len(figures['aircraft'])} aircraft; time line: {figures['clock']}; "
        f"distances by {figures['positions'] or 'no positions'}"
    ]
    lines += [_aircraft_line(one) for one in figures["aircraft"]]
    lines += [_pair_line(pair) for pair in figures["separations"]]
    lines += [_air_line(row) for row in figures["air"]]
    lines += [f"  note: {note}" for note in figures["notes"]]
    lines += [f"  problem: {problem}" for problem in figures["problems"]]
    return "\n".join(lines)


def _aircraft_line(one: dict[str, Any]) -> str:
    return (
        f"  {one['name']}: {one['duration_s']:.1f} s, {one['broadcasts']} broadcasts sent, "
        f"{one['heard']} frames heard, {one['decisions']} decisions "
        f"({one['conflicts']} with a conflict, {one['infeasible']} infeasible), "
        f"{one['cautions']} cautions, {one['warnings']} warnings, "
        f"authority {one['authority'] or 'never changed'}"
    )


def _pair_line(pair: dict[str, Any]) -> str:
    names = " - ".join(pair["pair"])
    if pair["minimum_m"] is None:
        return f"  {names}: positions never known at one time"
    verdict = "kept" if pair["kept"] else "LOST"
    return (
        f"  {names}: closest {pair['minimum_m']:.2f} m at {pair['minimum_time_s']:.2f} s "
        f"({pair['required_m']:g} m {verdict})"
    )


def _air_line(row: dict[str, Any]) -> str:
    words = f"  {row['sender']} > {row['receiver']}: {row['delivered']} of {row['sent']} frames delivered"
    if row["information_age_mean_s"] is None:
        return f"{words}, age of information unknown"
    return (
        f"{words}, age of information {row['information_age_mean_s']:.2f} s on average, "
        f"{row['information_age_max_s']:.2f} s at most"
    )


def _air(summary: dict[str, Any] | None) -> tuple[list[dict[str, Any]], list[str]]:
    """What the run's own summary tells of the air, by ordered pair, and what of it cannot be read."""
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
        return [], ["summary.json: air: not as a run writes it"]


def _aircraft(record: AircraftRecord) -> dict[str, Any]:
    facts = record.facts
    authority = [what.state for _, what in facts.rare if isinstance(what, AuthorityChanged)]
    levels = [what.level for _, what in facts.rare if isinstance(what, AlertChanged)]
    return {
        "name": record.name,
        "steps": facts.steps,
        "duration_s": facts.duration_s,
        "broadcasts": sum(len(times) for times in facts.sent.values()),
        "heard": sum(len(heard.now_s) for heard in facts.heard.values()),
        "decisions": len(facts.decisions.now_s),
        "conflicts": int(facts.decisions.conflict.sum()),
        "cautions": levels.count(Level.CAUTION),
        "warnings": levels.count(Level.WARNING),
        "infeasible": int((~facts.decisions.feasible).sum()),
        "oldest_track_s": max((float(track.age_s.max()) for track in facts.tracks.values()), default=None),
        "authority": authority[-1] if authority else None,
    }
