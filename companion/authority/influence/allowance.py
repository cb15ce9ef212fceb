"""How long unproven traffic may hold the aircraft.

Remote ID and ADS-B are unsigned: a transmitter can invent aircraft that stay in conflict with this one for
as long as it likes. So every track whose identity no signature has verified is charged for the time in which
it is in conflict with the aircraft while the companion holds it. A track that has spent its allowance is not
avoided any more; others are. `containment` bounds how far such traffic may move the aircraft.

Rules, each against one way around the others:

- A track has `track_s`, of which it may be inside its volume around the aircraft for `inside_s`: an honest
  aircraft that is avoided does not stay there. Its memory outlives the track, so that silence renews nothing,
  and a track that is first heard inside its volume takes over what the last ones there have used.
- A track that has been inside for `PRESSES_S`, or follows the aircraft (`following`), yields to others: while
  any other is near or in conflict, it is left out. Between both there may be no way out, and the law would
  divide the violation between them. It is avoided again if the aircraft comes nearer to it than before.
- Tracks of one group have `group_s` together. Once that is spent, each of them has a quarter of `track_s`: a
  fake cannot spend the allowance of an honest aircraft by sounding like it.
- All of them have `total_s` for the time in which the aircraft is held, the way back included. The last
  quarter of it is kept for tracks that were heard before and had then used up to a quarter of `track_s`: new
  identities cannot spend it.
- A track that stands still may block, but it cannot drive the aircraft anywhere. It is never flown into:
  where the total is spent and such a track is in the way, the vehicle is asked to hold. A track that has
  pressed the aircraft along does not count as one that stands.
- Crewed traffic has a total of its own, and no allowance for each track: nobody flies into a helicopter
  because it stayed.
- Proven tracks are neither charged nor left out.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from companion.authority.influence.following import Followers
from companion.avoidance.law import ASIDE, VERTICAL_SCALE, LawResult, Neighbour
from companion.config import Config, ContainmentConfig
from companion.events import AllowanceSpent, Command, Say, Severity, TrackView
from companion.geometry import Vec3

RESERVE = 0.25
"""Share of `total_s` that is kept for tracks that were heard before and have used little; and the share of
`track_s` that counts as little."""
_WHOLE = 0.5
"""A spent allowance counts as spent until this share of it is used."""
HELD_S = 60.0
"""After the last conflict, the time that the aircraft is held is charged for this long at most."""
_STEP_S = 1.0
"""Most time that is charged for one decision."""
STANDS_M, STANDS_S = 15.0, 30.0
"""A track stands still if it has stayed within this distance of a place for this long."""
PRESSES_S = 30.0
"""A track presses if it has been inside its volume for this long. Time outside counts half against it."""
_SQUEEZED_S = 3.0
"""A track that presses is left out until no other has been near, or in conflict, for this long."""
_NEAR_M = 300.0
_NEW_S, _HEIR_S = 2.0, 15.0
"""A track is new for `_NEW_S`. It takes over what tracks have used that were heard within `_HEIR_S`."""
_MOST = 1000
"""Most tracks, and most groups, that are remembered."""
_FORGOTTEN_S = 60.0
"""A track that has used nothing is forgotten this long after it was last heard."""
_SAY_S = 5.0
"""Least time between two texts about single tracks."""

_Key = tuple[bool, str]
_Scope = Literal["track", "group", "low", "total", "crewed"]


@dataclass(slots=True)
class _Used:
    """Time charged to one allowance, which falls while nothing is charged."""

    used_s: float = 0.0
    at_s: float = -math.inf
    spent: bool = False

    def charge(self, now_s: float, seconds: float, most_s: float, refill_s: float) -> bool:
        """Charge some time, perhaps none. Returns whether `spent` has changed."""
        passed_s = now_s - self.at_s
        if seconds <= 0.0 and passed_s < math.inf:
            self.used_s = max(0.0, self.used_s - passed_s * most_s / refill_s)
        self.used_s, self.at_s = min(self.used_s + seconds, most_s), now_s
        before = self.spent
        self.spent = self.used_s >= most_s or (before and self.used_s > _WHOLE * most_s)
        return self.spent is not before


@dataclass(slots=True)
class _Known:
    """What is remembered of a track."""

    first_s: float
    heard_s: float
    anchor: Vec3
    anchor_s: float
    used: _Used = field(default_factory=_Used)
    inside: _Used = field(default_factory=_Used)
    pressed_s: float = 0.0
    follows: bool = False
    entered: bool = False
    """It has been inside its volume."""
    reserved: bool = False
    """It had used little when only the last quarter of the total was left."""
    chases: bool = False
    """It has moved while it pressed. If it stands later, it is because the aircraft stands."""

    @property
    def spent(self) -> bool:
        return self.used.spent or self.inside.spent

    @property
    def presses(self) -> bool:
        return self.pressed_s >= PRESSES_S or self.follows

    def inherit(self, others: Iterable[_Known]) -> None:
        """Take over the most that other tracks have used."""
        for other in others:
            self.used.used_s = max(self.used.used_s, other.used.used_s)
            self.inside.used_s = max(self.inside.used_s, other.inside.used_s)
            self.pressed_s = max(self.pressed_s, other.pressed_s)
            self.chases = self.chases or other.chases

    def see(self, now_s: float, position: Vec3) -> None:
        self.heard_s = now_s
        if math.dist(self.anchor, position) > STANDS_M:
            self.anchor, self.anchor_s = position, now_s
            self.chases = self.chases or self.presses

    def stands(self, now_s: float) -> bool:
        return not self.chases and now_s - self.anchor_s >= STANDS_S


class Allowances:
    """The allowances of all unproven traffic. Times never decrease."""

    def __init__(self, config: Config) -> None:
        self._tracks: dict[_Key, _Known] = {}
        self._followers = Followers()
        self._groups: dict[str, _Used] = {}
        self._total, self._crewed = _Used(), _Used()
        self._low_s: float | None = None
        """Since when only the last quarter of the total is left; None: more is left."""
        self._conflict_s = {False: -math.inf, True: -math.inf}
        """Time of the last conflict with unproven traffic that is not crewed, and that is."""
        self._charged_s = self._squeezed_s = -math.inf
        """Times of the last charge, and of the last decision in which tracks that press were left out."""
        self._said_s = -math.inf
        self._told: list[Command] = []
        self.hold: str | None = None
        """Why the vehicle is to be asked to hold, in words; None: it is not."""
        self.configure(config)

    def configure(self, config: Config) -> None:
        """Use another configuration from now on."""
        self._config: ContainmentConfig = config.containment
        self._guards = config.flight.use == "guard"

    def told(self) -> list[Command]:
        """Texts and log entries since the last call."""
        told, self._told = self._told, []
        return told

    def admitted(
        self, now_s: float, here: Vec3, velocity: Vec3, neighbours: Sequence[Neighbour]
    ) -> list[Neighbour]:
        """The neighbours that the law is to avoid, in their order.

        Args:
            here, velocity: own position and velocity (NED, m and m/s).
        """
        for other in neighbours:
            if other.proven:
                continue
            key, position = _key(other), _predicted(other)
            known = self._tracks.get(key)
            if known is None:
                known = self._tracks[key] = _Known(now_s, now_s, position, now_s)
            if other.track_id == key[1]:
                known.follows = self._followers.hear(now_s, key, here, velocity, other)
                known.see(now_s, position)
        self._forget(now_s)
        return [other for other in neighbours if self._counts(now_s, other)]

    def _counts(self, now_s: float, other: Neighbour) -> bool:
        """Whether a track is to be avoided."""
        config = self._config
        known = None if other.proven else self._tracks.get(_key(other))
        if known is None or known.stands(now_s):
            return True
        if other.crewed:
            return config.crewed_then == "hold" or not self._crewed.spent
        if known.presses and now_s - self._squeezed_s < _SQUEEZED_S:
            return False
        little = known.used.used_s <= RESERVE * config.track_s
        if known.spent or (not little and self._group_spent(other)):
            return False
        if config.then == "hold" or self._low_s is None:
            return True
        return not self._total.spent and known.reserved

    def _group_spent(self, other: Neighbour) -> bool:
        group = self._groups.get(other.group) if other.group else None
        return group is not None and group.spent

    def charge(
        self,
        now_s: float,
        here: Vec3,
        velocity: Vec3,
        result: LawResult,
        neighbours: Iterable[Neighbour],
        *,
        held: bool,
        back: bool,
    ) -> None:
        """Charge the time since the last decision.

        Args:
            here, velocity: own position and velocity (NED, m and m/s).
            result: decision that was just made.
            neighbours: those that the law was given.
            held: whether the companion flies the vehicle.
            back: whether the aircraft is on its path without a conflict. Its time is then charged only if a
                mission is guarded, which is given back later.
        """
        passed_s = min(now_s - self._charged_s, _STEP_S) if held else 0.0
        self._charged_s = now_s
        by_key = {_key(other): other for other in neighbours if not other.proven}
        views = [(_key(view), view) for view in result.tracks]
        seen = [(by_key[key], view) for key, view in views if key in by_key]
        inside = {_key(o) for o, view in seen if not o.crewed and _is_inside(here, view)}
        self._enter(now_s, inside)
        acting = [other for other, view in seen if held and (view.conflict or view.active)]
        for other in acting:
            self._conflict_s[other.crewed] = now_s
            self._followers.conflict(now_s, _key(other), here, velocity, other)
        self._charge_tracks(now_s, passed_s, [other for other in acting if not other.crewed], inside)
        counts = held and (self._guards or not back)
        self._charge_totals(now_s, passed_s if counts else 0.0)
        self._squeeze(now_s, here, result)
        blocking = {key for key, view in views if view.conflict}
        self.hold = self._why_hold(
            [other for other in acting if _key(other) in blocking and self._counts(now_s, other)]
        )

    def _enter(self, now_s: float, inside: Iterable[_Key]) -> None:
        """Let tracks that were first heard inside their volumes take over what others have used."""
        for key in inside:
            known = self._tracks[key]
            if not known.entered and now_s - known.first_s <= _NEW_S:
                known.inherit(
                    t for t in self._tracks.values() if t.pressed_s and now_s - t.heard_s <= _HEIR_S
                )
            known.entered = True

    def _squeeze(self, now_s: float, here: Vec3, result: LawResult) -> None:
        """Note whether tracks that press are to be left out, because another track is near or in conflict."""
        found = {_key(view): view for view in result.tracks}
        pressing = [k for k in found if (t := self._tracks.get(k)) and t.presses and not t.stands(now_s)]
        others = [
            key
            for key, view in found.items()
            if key not in pressing
            and (view.conflict or view.active or math.dist(view.position_ned_m, here) < _NEAR_M)
        ]
        going_on = now_s - self._squeezed_s < _SQUEEZED_S
        if others and (going_on or pressing):
            self._squeezed_s = now_s
        if others and pressing and not going_on:
            text = f"{', '.join(name for _, name in pressing)} left out, as {others[0][1]} is near"
            self._told.append(AllowanceSpent(scope="squeeze", track_id=others[0][1], text=text))

    def _charge_tracks(
        self, now_s: float, passed_s: float, acting: Sequence[Neighbour], inside: Container[_Key]
    ) -> None:
        config = self._config
        groups = {other.group for other in acting if other.group}
        charged = {_key(other) for other in acting}
        going_on = now_s - self._squeezed_s < _SQUEEZED_S
        for key, known in self._tracks.items():
            within = key in charged and key in inside
            if within:
                known.pressed_s += passed_s
            elif known.pressed_s and not going_on:
                known.pressed_s = max(0.0, known.pressed_s - 0.5 * passed_s)
            before = known.spent
            if key in charged or known.used.used_s:
                seconds = passed_s if key in charged else 0.0
                known.used.charge(now_s, seconds, config.track_s, config.refill_s)
                known.inside.charge(now_s, seconds if within else 0.0, config.inside_s, config.refill_s)
            if known.spent and not before:
                self._tell_track(now_s, key[1], known)
        for name in groups:
            group = self._groups.setdefault(name, _Used())
            if group.charge(now_s, passed_s, config.group_s, config.refill_s) and group.spent:
                text = f"tracks like {acting[0].track_id} have held us for {config.group_s:g} s"
                self._tell_spent("group", f"{text}: each is avoided for less", acting[0].track_id)
        for name, group in self._groups.items():
            if name not in groups:
                group.charge(now_s, 0.0, config.group_s, config.refill_s)

    def _charge_totals(self, now_s: float, passed_s: float) -> None:
        config = self._config
        for crewed, used, most_s in (
            (False, self._total, config.total_s), (True, self._crewed, config.crewed_total_s)
        ):  # fmt: skip
            recent = now_s - self._conflict_s[crewed] <= HELD_S
            if used.charge(now_s, passed_s if recent else 0.0, most_s, config.refill_s):
                self._tell_total(crewed, used.spent)
        low = self._total.used_s >= (1.0 - RESERVE) * config.total_s
        if low and self._low_s is None:
            self._low_s = now_s
            for known in self._tracks.values():
                known.reserved = known.used.used_s <= RESERVE * config.track_s
            self._tell_low()
        elif self._total.used_s <= _WHOLE * config.total_s:
            self._low_s = None

    def _why_hold(self, blocking: Sequence[Neighbour]) -> str | None:
        for other in blocking:
            if other.crewed and self._crewed.spent:
                return f"crewed traffic has held us for {self._config.crewed_total_s:g} s: {other.track_id}"
            if not other.crewed and self._total.spent:
                return f"unproven traffic has held us for {self._config.total_s:g} s: {other.track_id}"
        return None

    def _forget(self, now_s: float) -> None:
        """Remove what is remembered of tracks that have used nothing and are not heard; at most `_MOST`
        remain: those that are heard now, then those that have used most."""
        tracks = self._tracks
        for key in [k for k, t in tracks.items() if not t.used.used_s and now_s - t.heard_s > _FORGOTTEN_S]:
            del tracks[key]
        if len(tracks) > _MOST:
            rank = {key: (known.heard_s >= now_s, known.used.used_s) for key, known in tracks.items()}
            for key in sorted(tracks, key=rank.__getitem__)[: len(tracks) - _MOST]:
                del tracks[key]
        groups = self._groups
        for name in [name for name, used in groups.items() if not used.used_s]:
            del groups[name]

    # ------------------------------------------------------------ what the pilot is told

    def _tell_track(self, now_s: float, track_id: str, known: _Known) -> None:
        what = "it stands and is still avoided" if known.stands(now_s) else "it is not avoided any more"
        text = f"{track_id} has held us for {known.used.used_s:.0f} s: {what}"
        self._told.append(AllowanceSpent(scope="track", track_id=track_id, text=text))
        if now_s - self._said_s >= _SAY_S:
            self._said_s = now_s
            self._told.append(Say(severity=Severity.WARNING, text=f"DMUCA: {text}"))

    def _tell_low(self) -> None:
        if self._config.then == "resume":
            text = "unproven traffic has nearly spent its allowance: new aircraft are not avoided any more"
            self._tell_spent("low", text)

    def _tell_total(self, crewed: bool, spent: bool) -> None:
        config = self._config
        who, most_s, then = (
            ("crewed traffic", config.crewed_total_s, config.crewed_then)
            if crewed
            else ("unproven traffic", config.total_s, config.then)
        )
        scope: _Scope = "crewed" if crewed else "total"
        if not spent:
            self._told.append(AllowanceSpent(scope=scope, spent=False, text=f"{who} is avoided again"))
            self._told.append(Say(severity=Severity.NOTICE, text=f"DMUCA: {who} is avoided again"))
            return
        what = "not avoided any more" if then == "resume" else "the vehicle is to hold"
        self._tell_spent(scope, f"{who} has held us for {most_s:g} s: {what}")

    def _tell_spent(self, scope: _Scope, text: str, track_id: str = "") -> None:
        self._told.append(AllowanceSpent(scope=scope, track_id=track_id, text=text))
        self._told.append(Say(severity=Severity.WARNING, text=f"DMUCA: {text}"))


def _key(other: Neighbour | TrackView) -> _Key:
    """The track, also for another place where it may be."""
    return other.adsb, other.track_id.partition(ASIDE)[0]


def _is_inside(here: Vec3, view: TrackView) -> bool:
    """Whether the aircraft is within the volume of a track."""
    n, e, d = (a - b for a, b in zip(view.position_ned_m, here, strict=True))
    return math.hypot(n, e, VERTICAL_SCALE * d) < view.radius_m


def _predicted(other: Neighbour) -> Vec3:
    (n, e, d), (vn, ve, vd), age = other.position_ned_m, other.velocity_ned_mps, other.age_s
    return n + age * vn, e + age * ve, d + age * vd
