"""Every manoeuvre of one aircraft, explained: its reason, what was done, the outcome, and the alternatives.

A manoeuvre is an interval in which the avoidance law flew and its chosen velocity differed from the wanted
one because of other aircraft or a fence, or in which a guarded vehicle was taken out of its mission. Gaps up
to `GAP_S` belong to the manoeuvre. A command that lags behind a corner of the path only because of the
acceleration limit is not a manoeuvre.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import msgspec

from companion.adjustable_parameters import applied
from companion.authority.table import HOLDING, State, Trigger
from companion.config import Config
from companion.errors import ConfigError
from companion.event_record import Step
from companion.events import (
    AuthorityChanged,
    Decision,
    FenceDownloaded,
    Settings,
    TrackView,
    VehicleParameters,
)
from companion.events.sensed import is_sensed, thing_of
from companion.geometry import Vec3
from companion.ownship import Ownship
from ground_tools.inspect.explain.why import Alternative, Explainer, HalfSpace, Look
from ground_tools.inspect.read.read_run import AircraftRecord

LEFT_MPS = 0.3
"""If the chosen and the wanted velocity differ by more than this, they count as different."""
GAP_S = 5.0
"""Longest gap within one manoeuvre."""
_FENCE = frozenset({"fence", "outside the fence"})
_HOLDING = frozenset(state.value for state in HOLDING)
_LEAST_TURN_DEG, _LEAST_CHANGE_MPS, _LEAST_LEVEL_MPS = 3.0, 0.2, 0.3
_TOO_FAST_MPS = 1.0
"""If a guarded vehicle was faster than the wanted speed by this or more at the start, the text mentions
it."""
_MOST_NAMED = 3


@dataclass(frozen=True, slots=True)
class Manoeuvre:
    """One manoeuvre. Times are the aircraft's own `now_s`."""

    start_s: float
    end_s: float
    guarded: bool
    """True if a guarded vehicle was taken out of its mission; False if the law was flying already."""
    tracks: tuple[str, ...]
    """Tracks that were in conflict or had an active half-space at any time, by the time of the first
    occurrence."""
    track: str | None
    """Of the tracks in conflict at the start, the one that would have come nearest. Without a conflict, the
    nearest one of the tracks with an active half-space. None if there is neither, as for a fence."""
    time_to_closest_s: float | None
    """Time to the closest approach to `track`, at the start and at the wanted velocity."""
    closest_m: float | None
    """Slant distance at that closest approach."""
    limits: tuple[str, ...]
    """Limits from `law.LIMITS` that bounded the velocity at any time, other than the speed limit."""
    feasible: bool
    """True if every decision kept every half-space."""
    deviation_m: float | None
    """Largest distance from the timed path's point until the path was regained; None without a path."""
    regained_s: float | None
    """When the aircraft was back within `avoidance.regained_m` of the path's point. None if that did not
    happen before the next manoeuvre or the end of the record."""
    nearest_track: str | None
    """The track that came nearest during the manoeuvre."""
    nearest_m: float | None
    """Distance to `nearest_track` as the law predicted it then, not the true distance."""
    nearest_s: float | None
    """Time of `nearest_m`."""
    decision: Decision
    """The decision at the start. For a guarded vehicle whose decision at the start has no conflict: the last
    decision before the take-over, if that one had a conflict."""
    half_spaces: tuple[HalfSpace, ...]
    """Half-spaces of the velocity space at the start, NED (m/s)."""
    alternatives: tuple[Alternative, ...]
    """Velocities that could have been flown at the start."""
    strongest: Decision
    """The decision whose chosen velocity is farthest from the wanted one."""
    why: str
    """Reason for the manoeuvre, as text."""
    done: str
    """What was commanded, as text."""
    came: str
    """Outcome, as text."""
    instead: tuple[str, ...]
    """The alternatives at the start, each with its outcome, as text. They are not evaluated again if the law
    changes its choice during the manoeuvre."""

    @property
    def text(self) -> str:
        """The whole explanation in a few sentences."""
        instead = f"Alternatives at the start: {'; '.join(self.instead)}." if self.instead else ""
        return " ".join(words for words in (self.why, self.done, self.came, instead) if words)


@dataclass(slots=True)
class _Open:
    """A manoeuvre that has not ended yet."""

    start_s: float
    guarded: bool
    decision: Decision
    look: Look
    strongest: Decision
    end_s: float = 0.0
    tracks: dict[str, None] = field(default_factory=dict)
    limits: dict[str, None] = field(default_factory=dict)
    feasible: bool = True
    deviation_m: float | None = None
    regained_s: float | None = None
    nearest: tuple[float, float, str] | None = None
    """Distance, time and track of the nearest approach."""

    def add_decision(self, now_s: float, decision: Decision) -> None:
        self.end_s, self.regained_s = now_s, None
        self.tracks |= dict.fromkeys(thing_of(t.track_id) for t in decision.tracks if t.conflict or t.active)
        self.limits |= dict.fromkeys(name for name in decision.limits if name != "speed")
        self.feasible = self.feasible and decision.feasible
        if _left(decision) > _left(self.strongest):
            self.strongest = decision
        for track in decision.tracks:
            distance = math.dist(track.position_ned_m, decision.position_ned_m)
            if self.nearest is None or distance < self.nearest[0]:
                self.nearest = distance, now_s, thing_of(track.track_id)

    def follow(self, now_s: float, decision: Decision, regained_m: float) -> None:
        """Update the distance from the path until the path is regained."""
        if decision.path_ned_m is None or self.regained_s is not None:
            return
        away = math.dist(decision.path_ned_m, decision.position_ned_m)
        self.deviation_m = max(self.deviation_m or 0.0, away)
        if away <= regained_m:
            self.regained_s = now_s


def _left(decision: Decision) -> float:
    """Return the distance (m/s) between the chosen and the wanted velocity."""
    return math.dist(decision.wanted_ned_mps, decision.chosen_ned_mps)


class _Finder:
    def __init__(self, config: Config) -> None:
        self._configured = self._config = config
        self._vehicle: VehicleParameters | None = None
        self._areas = self._config.fence
        self.own = Ownship()
        self._guarded = self._watching = False
        self._warned: tuple[float, Decision] | None = None
        self._explainer = Explainer(self._config)
        self.open: _Open | None = None
        self._closed: _Open | None = None
        """The last manoeuvre that is over. It is followed until the path is regained."""

    def _renew(self) -> None:
        self._explainer.configure(self._config, self._vehicle, self._areas)

    def _authority(self, now_s: float, event: AuthorityChanged) -> None:
        if event.trigger == Trigger.REGAINED.value and not self._guarded:
            # The record may end before the next decision, which would show it, too.
            for one in (self.open, self._closed):
                if one is not None and one.deviation_m is not None and one.regained_s is None:
                    one.regained_s = now_s
        held = event.state in _HOLDING
        self._guarded = held and (self._guarded or event.previous == State.WATCHING.value)
        self._watching = event.state == State.WATCHING.value

    def step(self, step: Step) -> Iterator[_Open]:
        """Take a step; yield manoeuvres that are over and no longer followed."""
        for event in step.events:
            self.own.observe(event, step.now_s)
            self._take(event)
        self._explainer.note(step.now_s, self.own.velocity_ned_mps)
        for command in step.commands:
            if isinstance(command, Decision):
                yield from self._decision(step.now_s, command)
            elif isinstance(command, AuthorityChanged):
                self._authority(step.now_s, command)

    def _take(self, item: object) -> None:
        match item:
            case VehicleParameters():
                self._vehicle = item
                self._renew()
            case FenceDownloaded():
                if self._config.limits.fence == "vehicle":
                    self._areas = item.areas
                    self._renew()
            case Settings():
                self._config = applied(self._configured, item)
                self._renew()

    def _decision(self, now_s: float, decision: Decision) -> Iterator[_Open]:
        if self._watching:
            self._warned = (now_s, decision) if any(t.conflict for t in decision.tracks) else None
        if self.open is not None and (self._watching or now_s - self.open.end_s > GAP_S):
            yield from self.close()
        bound = any(t.active for t in decision.tracks) or not _FENCE.isdisjoint(decision.limits)
        left = _left(decision) > LEFT_MPS and bound
        if not self._watching and (left or self._guarded):
            if self.open is None:
                yield from self._flush()
                self._begin(now_s, decision)
            assert self.open is not None
            self.open.add_decision(now_s, decision)
        for one in (self.open, self._closed):
            if one is not None:
                one.follow(now_s, decision, self._config.avoidance.regained_m)

    def _begin(self, now_s: float, decision: Decision) -> None:
        why, at_s = decision, now_s
        if self._guarded and self._warned is not None and not any(t.conflict for t in decision.tracks):
            at_s, why = self._warned
        try:
            height_m = None if self.own.position is None else self.own.position.height_above_home_m
            look = self._explainer.look(at_s, why, height_m, self.own.sigma_m)
        except (ConfigError, ValueError):  # the recorded fence is invalid; a flight would have refused it
            look = Look((), ())
        self.open = _Open(now_s, self._guarded, why, look, decision)

    def close(self) -> Iterator[_Open]:
        """End the open manoeuvre, and stop following the one before it."""
        yield from self._flush()
        self._closed, self.open = self.open, None

    def _flush(self) -> Iterator[_Open]:
        if self._closed is not None:
            yield self._closed
        self._closed = None

    def rest(self) -> Iterator[_Open]:
        """Yield the manoeuvres that are left at the end of the record."""
        yield from self.close()
        yield from self._flush()


def find(record: AircraftRecord) -> tuple[Manoeuvre, ...]:
    """Find every manoeuvre of a record in one pass over its steps.

    A record without a header, or with the law "none", has no manoeuvres.
    """
    if record.header is None or record.header.config.avoidance.law == "none":
        return ()
    finder = _Finder(record.header.config)
    found: list[_Open] = []
    for step in record.steps():
        found += finder.step(step)
    found += finder.rest()
    return tuple(_finished(one) for one in found)


class Starts:
    """Detects the start of manoeuvres of one aircraft while its record grows."""

    def __init__(self, config: Config) -> None:
        self._finder = None if config.avoidance.law == "none" else _Finder(config)
        self._told: _Open | None = None

    def step(self, step: Step) -> tuple[str, Decision] | None:
        """Take the next step. If a manoeuvre begins with it, return its reason as text and its decision."""
        if self._finder is None:
            return None
        for _over in self._finder.step(step):
            pass
        one = self._finder.open
        if one is None or one is self._told:
            return None
        self._told = one
        return _why(one), one.decision


def _finished(one: _Open) -> Manoeuvre:
    tracks = one.decision.tracks
    in_the_way = _by_distance(t for t in tracks if t.conflict) or _by_distance(t for t in tracks if t.active)
    track = in_the_way[0] if in_the_way else None
    nearest_m, nearest_s, nearest_track = one.nearest or (None, None, None)
    done = _done(one)
    return Manoeuvre(
        start_s=one.start_s,
        end_s=one.end_s,
        guarded=one.guarded,
        tracks=tuple(one.tracks),
        track=None if track is None else track.track_id,
        time_to_closest_s=None if track is None else track.time_to_closest_s,
        closest_m=None if track is None else track.closest_m,
        limits=tuple(one.limits),
        feasible=one.feasible,
        deviation_m=one.deviation_m,
        regained_s=one.regained_s,
        nearest_track=nearest_track,
        nearest_m=nearest_m,
        nearest_s=nearest_s,
        decision=one.decision,
        half_spaces=one.look.half_spaces,
        alternatives=one.look.alternatives,
        strongest=one.strongest,
        why=_why(one),
        done=done,
        came=_came(one),
        instead=tuple(outcome(other) for other in one.look.alternatives[1:]),
    )


def _by_distance(tracks: Iterable[TrackView]) -> list[TrackView]:
    """The tracks in the order of their closest points."""
    return sorted(tracks, key=lambda track: (track.closest_m, track.track_id))


def _why(one: _Open) -> str:
    conflicts = _by_distance(t for t in one.decision.tracks if t.conflict)
    if conflicts:
        ways = [
            f"within {t.closest_m:.1f} m of {t.track_id} in {t.time_to_closest_s:.1f} s (conflict volume "
            f"{t.radius_m:.1f} m, information {t.age_s:.1f} s old)"
            for t in conflicts[:_MOST_NAMED]
        ]
        more = f" and {len(conflicts) - _MOST_NAMED} more" if len(conflicts) > _MOST_NAMED else ""
        return f"The wanted velocity would have led {', '.join(ways)}{more}."
    bounds = [t.track_id for t in one.decision.tracks if t.active]
    bounds += [name for name in one.decision.limits if name != "speed"]
    return f"The wanted velocity was excluded by {', '.join(bounds) or 'a conflict just before'}."


def change(wanted: Vec3, chosen: Vec3) -> str:
    """Describe how a velocity differs from the wanted one."""
    level = math.hypot(wanted[0], wanted[1]), math.hypot(chosen[0], chosen[1])
    words = []
    if min(level) >= _LEAST_LEVEL_MPS:
        turn = math.degrees(
            math.atan2(
                wanted[0] * chosen[1] - wanted[1] * chosen[0], wanted[0] * chosen[0] + wanted[1] * chosen[1]
            )
        )
        if abs(turn) >= _LEAST_TURN_DEG:
            words.append(f"turned {'right' if turn > 0.0 else 'left'} by {abs(turn):.0f} deg")
    faster = level[1] - level[0]
    if abs(faster) >= _LEAST_CHANGE_MPS:
        words.append(f"{'faster' if faster > 0.0 else 'slower'} by {abs(faster):.1f} m/s")
    down = chosen[2] - wanted[2]
    if abs(down) >= _LEAST_CHANGE_MPS:
        words.append(f"{abs(down):.1f} m/s {'down' if down > 0.0 else 'up'}wards")
    return ", ".join(words) or "hardly changed"


def _done(one: _Open) -> str:
    most = change(one.strongest.wanted_ned_mps, one.strongest.chosen_ned_mps)
    taken = (
        "The aircraft left its mission for" if one.guarded else "The aircraft left the wanted velocity for"
    )
    flown, wanted = (math.hypot(*v[:2]) for v in (one.decision.velocity_ned_mps, one.decision.wanted_ned_mps))
    fast = one.guarded and flown - wanted >= _TOO_FAST_MPS
    slowed = f", at {flown:.1f} m/s instead of the wanted {wanted:.1f} m/s" if fast else ""
    words = f"{taken} {one.end_s - one.start_s:.1f} s{slowed}. The largest change of velocity was: {most}."
    bounds = [*one.tracks, *one.limits]
    words += f" The velocity was limited by {', '.join(bounds)}." if bounds else ""
    return words if one.feasible else f"{words} No velocity kept every half-space."


def _came(one: _Open) -> str:
    parts = []
    if one.nearest is not None:
        distance, when_s, track = one.nearest
        after_s = when_s - one.start_s
        what = "thing seen by the own sensor" if is_sensed(track) else "aircraft"
        parts.append(
            f"The nearest {what} was {track}, at {distance:.1f} m as predicted then, "
            f"{after_s:.1f} s after the start."
        )
    if one.deviation_m is not None:
        back = "did not return to it before the next manoeuvre or the end"
        if one.regained_s is not None:
            back = f"was back on it {one.regained_s - one.end_s:.1f} s after the manoeuvre"
        parts.append(f"The aircraft was at most {one.deviation_m:.1f} m from the timed path and {back}.")
    return " ".join(parts)


def outcome(one: Alternative) -> str:
    """Describe an alternative and what it would have led to."""
    if one.closest_track is None or one.closest_m is None:
        led = "no aircraft near"
    else:
        led = f"{one.closest_m:.1f} m from {one.closest_track} in {one.closest_in_s:.1f} s"
    return f"{one.name}: {led}, {verdict(one)}"


def verdict(one: Alternative) -> str:
    """Describe why an alternative was not flown."""
    if one.excluded_by:
        causes = ", ".join(f"{cause} (by {short:.1f} m/s)" for cause, short in one.excluded_by[:_MOST_NAMED])
        return f"excluded by {causes}"
    if one.from_wanted_mps == 0.0:
        return "not excluded yet, but in a conflict the law keeps to the right"
    enters = f", although it enters the conflict volume of {', '.join(one.enters)}" if one.enters else ""
    return f"allowed{enters}, {one.from_wanted_mps:.1f} m/s from the wanted velocity"


def figures(one: Manoeuvre) -> dict[str, object]:
    """Return the figures of a manoeuvre, ready for JSON."""
    return {
        "start_s": one.start_s,
        "end_s": one.end_s,
        "guarded": one.guarded,
        "tracks": list(one.tracks),
        "track": one.track,
        "time_to_closest_s": one.time_to_closest_s,
        "closest_m": one.closest_m,
        "limits": list(one.limits),
        "feasible": one.feasible,
        "deviation_m": one.deviation_m,
        "regained_s": one.regained_s,
        "nearest": {"track": one.nearest_track, "distance_m": one.nearest_m, "time_s": one.nearest_s},
        "half_spaces": [
            {**msgspec.to_builtins(space), "point_ned_mps": list(space.point_ned_mps)}
            for space in one.half_spaces
        ],
        "alternatives": msgspec.to_builtins(one.alternatives),
        "why": one.why,
        "done": one.done,
        "came": one.came,
        "instead": list(one.instead),
    }
