"""The first lines about a run: separations, nearest aircraft, manoeuvres, Remote ID and faults."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, Final

from companion.events.sensed import is_sensed
from ground_tools.inspect.read.timeline import utc_words

_NAMED: Final = 3
"""Most names that a line lists, of kinds of faults or of aircraft that gave way."""
_FOREIGN: Final = "Identity used by ANOTHER sender, from elsewhere:"
"""Beginning of the line about foreign senders."""


def head(figures: dict[str, Any]) -> str:
    """Return a line with the run's name, its time line, and the source of its distances."""
    zero = figures["utc_at_zero_s"]
    return (
        f"{figures['run']}: {len(figures['aircraft'])} aircraft; time line: {figures['clock']}; "
        f"{f'at 0 s: {utc_words(zero)}; ' if zero is not None else ''}"
        f"distances from {figures['positions'] or 'no positions'}"
    )


def verdicts(figures: dict[str, Any]) -> list[str]:
    """Return the most important results, one line each: separation, the nearest other aircraft, foreign
    senders of an identity of the run, the nearest thing that a sensor aboard saw, Remote ID, manoeuvres,
    faults."""
    aircraft = figures["aircraft"]
    return [
        *_on_separation(figures),
        _on_traffic(figures),
        *_on_foreign_senders(aircraft),
        *_on_sensed(figures),
        *_on_remote_id(aircraft),
        _on_manoeuvres(aircraft),
        _on_faults(aircraft),
    ]


def is_bad(words: str) -> bool:
    """Return whether a line of `verdicts` reports a lost separation, a requirement that was not kept, or a
    foreign sender of an identity."""
    return words.startswith(("Separation LOST", _FOREIGN)) or (
        words.startswith("Remote ID") and "NOT kept by" in words
    )


def is_other(row: dict[str, Any]) -> bool:
    """Return whether a received aircraft is none of the run, whatever identity it sends, or came nearest at a
    time for which this run has no record of it."""
    return not row["of_the_run"] or row["beyond_record"] or row["elsewhere"]


def who(row: dict[str, Any]) -> str:
    """Return the identity of a received aircraft, and whether another sender than that aircraft used it."""
    return f"{row['identity']}{', sent from elsewhere' if row['elsewhere'] else ''}"


def _on_separation(figures: dict[str, Any]) -> list[str]:
    """Lines about the separation of the recorded aircraft; none if there is only one."""
    known = [row for row in figures["separations"] if row["minimum_m"] is not None]
    if not known:
        alone = len(figures["aircraft"]) < 2
        return [] if alone else ["Separation: not known: no two aircraft have positions at the same time"]
    lost = sum(not row["kept"] for row in known)
    how = f"LOST by {lost} of {len(known)} pairs" if lost else f"kept by {len(known)} of {len(known)} pairs"
    least = known[0]
    in_pairs = {name for row in known for name in row["pair"]}
    clocks = [
        f"; not certain, because the clock of {one['name']} was set by {one['clock_set_s']:.0f} s"
        for one in figures["aircraft"]
        if one["clock_set_s"] is not None and one["name"] in in_pairs
    ]
    return [
        f"Separation {how}; {' - '.join(least['pair'])}: closest {least['minimum_m']:.2f} m at "
        f"{least['minimum_time_s']:.2f} s ({least['required_m']:g} m {'kept' if least['kept'] else 'LOST'})"
        f"{''.join(clocks[:1])}"
    ]


def _on_traffic(figures: dict[str, Any]) -> str:
    """Line about the nearest aircraft without a record in this run, or at a time that its record does not
    cover: how near, when, and how it was received."""
    aircraft = figures["aircraft"]
    others = [(one["name"], row) for one in aircraft for row in one["traffic"] if is_other(row)]
    count = len({who(row) for _, row in others})
    predicted = [
        row for row in figures["conflicts"] if row["by"] != "positions" and not is_sensed(row["pair"][1])
    ]
    near = [(row["nearest"]["slant_m"], name, row) for name, row in others if row["nearest"] is not None]
    least = min(near, key=lambda one: one[0], default=None)
    if predicted and (least is None or predicted[0]["minimum_m"] < least[0]):
        row = predicted[0]
        words = f"{row['pair'][1]}, {row['minimum_m']:.2f} m from {row['pair'][0]} at {row['time_s']:.1f} s"
        count = max(count, len({row["pair"][1] for row in predicted}))
        return f"Nearest other aircraft: {words} ({row['by']}); {_in_all(count)}"
    if least is not None:
        return f"Nearest other aircraft: {_approach(least[1], least[2])}; {_in_all(count)}"
    if count:
        return f"Other aircraft: {count} heard; how near they came is not known"
    return f"Other aircraft: none was heard{'' if len(aircraft) < 2 else ' beside those of the run'}"


def _on_foreign_senders(aircraft: Sequence[dict[str, Any]]) -> list[str]:
    """Line about senders that use an identity of the run from elsewhere, with the nearest one; none if there
    were none."""
    found = [(one["name"], row) for one in aircraft for row in one["traffic"] if row["elsewhere"]]
    if not found:
        return []
    name, row = min(found, key=lambda one: one[1]["nearest"]["slant_m"])
    names = ", ".join(dict.fromkeys(row["identity"] for _, row in found))
    return [f"{_FOREIGN} {names}; nearest: {_approach(name, row)}"]


def _on_sensed(figures: dict[str, Any]) -> list[str]:
    """Line about the nearest thing in conflict that an onboard sensor saw; none if there was none."""
    seen = [row for row in figures["conflicts"] if is_sensed(row["pair"][1])]
    if not seen:
        return []
    row, count = seen[0], len(seen)
    words = f"{row['pair'][1]}, {row['minimum_m']:.2f} m from {row['pair'][0]} at {row['time_s']:.1f} s"
    more = f"; {count} obstacles or aircraft in conflict in all" if count > 1 else ""
    return [f"Nearest thing that a sensor aboard saw: {words} ({row['by']}){more}"]


def _in_all(count: int) -> str:
    return f"{count} other aircraft in all" if count > 1 else "no other was heard"


def _approach(name: str, row: dict[str, Any]) -> str:
    """Text on how near a received aircraft came."""
    nearest = row["nearest"]
    callsign = f" ({row['callsign']})" if row["callsign"] else ""
    height = ", at an unknown height,"
    if nearest["above_m"] is not None:
        way = "above" if nearest["above_m"] >= 0.0 else "below"
        height = f" and {abs(nearest['above_m']):.0f} m {way} it"
        height += " by barometric altitude" if nearest["barometric"] else ""
    return (
        f"{who(row)}{callsign}, {nearest['aside_m']:.0f} m beside {name}{height} at "
        f"{nearest['time_s']:.1f} s ({row['by']}, as reported)"
    )


def _on_remote_id(aircraft: Sequence[dict[str, Any]]) -> list[str]:
    found = []
    regions: dict[str, list[dict[str, Any]]] = {}
    for one in aircraft:
        if one["remote_id"]["region"] is not None:
            regions.setdefault(one["remote_id"]["region"], []).append(one)
    for region, members in regions.items():
        rows = [row for one in members for row in one["remote_id"]["sent"] if row["kept"] is not None]
        broken = [
            one["name"]
            for one in members
            if one["remote_id"]["not_legal_s"] > 0.0
            or any(row["kept"] is False for row in one["remote_id"]["sent"])
        ]
        if broken:
            found.append(f"Remote ID: minimum rates of region {region} NOT kept by {', '.join(broken)}")
        elif rows:
            found.append(f"Remote ID: minimum rates of region {region} kept by all {len(members)} aircraft")
        else:
            found.append(f"Remote ID: region {region} requires no minimum rate for the sent messages")
    return found


def _on_manoeuvres(aircraft: Sequence[dict[str, Any]]) -> str:
    counts = {one["name"]: len(one["manoeuvres"]) for one in aircraft if one["manoeuvres"]}
    words = f"Manoeuvres: {sum(counts.values())}"
    return f"{words}; gave way: {_most(counts.items())}" if counts else words


def _on_faults(aircraft: Sequence[dict[str, Any]]) -> str:
    """Line about faults and warnings. Doubts about tracks that were withdrawn, such as those right after a
    start, do not count as faults; the end of the line lists them."""
    rows = [row for one in aircraft for row in one["faults"]]
    lasting = Counter(_fault(row) for row in rows if row["until_s"] is None)
    withdrawn = Counter(_fault(row) for row in rows if row["until_s"] is not None)
    words = f"Faults and warnings: {lasting.total()}"
    words += f"; {_most(lasting.most_common())}" if lasting else ""
    return f"{words}; doubts that were withdrawn: {_most(withdrawn.most_common())}" if withdrawn else words


def _fault(row: dict[str, Any]) -> str:
    """Text of a fault for the first lines. A doubt about a track is described by its meaning, not by the name
    of its flag."""
    if row["what"] in ("vehicle", "companion"):
        return f"{row['what']}: {row['text']}"
    if row["what"].startswith("track "):
        return f"{row['what'].rpartition(': ')[0]}: {row['text'].partition(';')[0]}"
    return str(row["what"])


def _most(counts: Iterable[tuple[str, int]]) -> str:
    """The first few names, each with its count if it is more than 1."""
    rows = list(counts)
    words = [f"{name} ({count})" if count > 1 else name for name, count in rows[:_NAMED]]
    return ", ".join([*words, f"{len(rows) - _NAMED} more"] if len(rows) > _NAMED else words)


def damage(figures: dict[str, Any]) -> list[str]:
    """Return what is damaged or unreadable, one line each."""
    return [f"problem: {words}" for words in figures["problems"]]


def notes(figures: dict[str, Any]) -> list[str]:
    """Return what the input is and what it does not contain, one line each. None of these is an error."""
    said = [f"note: {words}" for words in figures.get("notes", ())]
    return said + [
        f"missing: {one['name']}: {words}" for one in figures["aircraft"] for words in one["missing"]
    ]
