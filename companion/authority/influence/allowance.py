"""How long unproven traffic may hold the aircraft.

Remote ID and ADS-B are unsigned: a transmitter can invent aircraft that stay in conflict with this one for
as long as it likes. So every track whose identity no signature has verified is charged for the time in which
it is in conflict with the aircraft, or bounds its velocity, while the companion flies it. A track that has
spent its allowance is not avoided any more; others are. `containment` bounds how far such traffic may move
the aircraft.

Each of these rules closes a way around the others:

- A track may be in conflict for `track_s`, and inside its volume (separation and margins) for `inside_s` of
  that: an honest aircraft that is avoided does not stay there. Used time is remembered after the track has
  gone, so that silence renews nothing. A track that is first heard inside its volume takes over the time that
  the last tracks there have used, except those that stand still.
- A track that yields is avoided only as far as all others allow. Between two tracks there may be no way out,
  and the law would divide the violation between them. A track yields if it was first heard inside its volume,
  has been there for `remembered.PRESSES_S`, or follows the aircraft (`following`). It also yields if it
  appears near the aircraft soon after another one did, because both may be one transmitter that takes new
  names, or if it belongs to a burst of new tracks and is silent. Crewed traffic and tracks that stand still
  never yield.
- Tracks of one group have `group_s` together. Once that is spent, each of them has only a quarter of
  `track_s`, so a fake cannot spend the whole allowance of an honest aircraft by resembling it.
- All tracks together have `total_s` for the time in which the companion flies the aircraft because of them,
  the way back included. With `then = "resume"`, the last quarter is kept for tracks that were heard before it
  began and had used at most a quarter of `track_s`, so new identities cannot spend it.
- A track that stands still may block, but it cannot drive the aircraft anywhere. It is never flown into:
  where the total is spent and such a track is in the way, the vehicle is asked to hold. A track that has
  moved while it pressed the aircraft does not count as standing.
- Crewed traffic has a total of its own, `crewed_total_s`, and no allowance for each track: a helicopter is
  not ignored because it stayed for `track_s`.
- Proven tracks are never charged, and always avoided.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Sequence
from typing import Literal, NamedTuple

import msgspec

from companion.authority.influence.following import Followers
from companion.authority.influence.remembered import WHOLE, Key, Remembered, Used
from companion.avoidance.law import ASIDE, VERTICAL_SCALE, LawResult, Neighbour
from companion.config import Config, ContainmentConfig
from companion.events import AllowanceSpent, Command, Say, Severity, TrackView
from companion.geometry import Vec3

RESERVE = 0.25
"""Share of `total_s` that is kept for known tracks that have used little, and the share of `track_s` up to
which a track has used little."""
HELD_S = 60.0
"""Time under our control without a conflict is charged for at most this long after the last conflict."""
_STEP_S = 1.0
"""Longest time that is charged for one decision."""
_SQUEEZED_S = 15.0
"""Yielding is logged again only after this long without a decision in which a track yielded."""
_SILENT_S = 2.0
"""A track that was away for longer than this counts as another one when its name is heard again."""
_NEW_S, _HEIR_S = 2.0, 15.0
"""A track is new for `_NEW_S`. It can take over the used time of tracks that were heard within `_HEIR_S`."""
_MOST = 1000
"""Largest number of tracks that are remembered."""
_FORGOTTEN_S = 60.0
"""A track that has used nothing is forgotten this long after it was last heard."""
NEAR_M = 50.0
"""A track appears near us if it is first received at most this far outside of its volume."""
_BATCH_S, _SERIAL_S = 3.0, 60.0
"""Tracks that appear near us within `_BATCH_S` are one batch. A batch that appears within `_SERIAL_S` after
another one yields, because one transmitter may take new names. A single one may be an aircraft that took
off."""
_SAY_S = 5.0
"""Least time between two messages to the pilot about single tracks."""

_Scope = Literal["track", "group", "low", "total", "crewed"]


class _Acting(NamedTuple):
    """A track that changes our velocity now."""

    known: Remembered
    blocks: bool
    """True if it is in conflict; otherwise it only bounds the velocity."""


class Allowances:
    """The allowances of all unproven traffic. Times never decrease."""

    def __init__(self, config: Config) -> None:
        self._tracks: dict[Key, Remembered] = {}
        self._places: dict[Key, Remembered] = {}
        """Unproven neighbours of the latest decision, by their own names."""
        self._followers = Followers()
        self._groups: dict[str, Used] = {}
        self._total, self._crewed = Used(), Used()
        self._low_s: float | None = None
        """Time since which only the last quarter of the total is left; None if more is left."""
        self._conflict_s = {False: -math.inf, True: -math.inf}
        """Time of the last conflict with unproven traffic: with uncrewed (False) and with crewed (True)
        traffic."""
        self._charged_s = self._squeezed_s = -math.inf
        """Times of the last charge, and of the last decision in which a track yielded to another."""
        self._newest_batch_s = self._batch_before_s = -math.inf
        """Times at which the newest batch of tracks (`_BATCH_S`) and the one before it began to appear near
        us."""
        self._said_s = -math.inf
        self._decided_s = -math.inf
        """Time of the latest decision."""
        self._told: list[Command] = []
        self.hold: str | None = None
        """Why the vehicle is to be asked to hold, in words; None if it is not."""
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
        """The neighbours that the law is to avoid, in their order, and which of them yield.

        Args:
            here, velocity: own position and velocity (NED, m and m/s).
            neighbours: the tracks, followed by their alternative places, named as in `traffic.places`.
        """
        tracks, places = self._tracks, self._places
        places.clear()
        proven = set()
        for other in neighbours:
            place = key = other.adsb, other.track_id
            if other.proven:
                proven.add(key)
                continue
            if ASIDE in other.track_id:
                key = other.adsb, other.track_id.partition(ASIDE)[0]
            known = tracks.get(key) or self._remember(now_s, key, other)
            if key is place:
                if self._decided_s - known.heard_s > _SILENT_S:
                    known = tracks[key] = known.renewed(now_s, other, _predicted(other))
                    self._followers.forget(key)
                known.latest = other
                known.follows = key in self._followers and self._followers.hear(
                    now_s, key, here, velocity, other
                )
                known.see(now_s, _predicted(other))
            elif key in proven:  # the record is of its alternative place alone
                known.latest = other
                known.see(now_s, _predicted(other))
            places[place] = known
        self._decided_s = now_s
        self._forget(now_s)
        found = []
        for other in neighbours:
            if other.proven:
                found.append(other)
                continue
            known = places[other.adsb, other.track_id]
            if self._is_avoided(now_s, known):
                yields = known.yields(now_s) and not (other.crewed or known.stands(now_s))
                if yields:
                    presses = known.presses or known.entered
                    other = msgspec.structs.replace(other, yields=True, presses=presses)
                found.append(other)
        return found

    def _remember(self, now_s: float, key: Key, other: Neighbour) -> Remembered:
        known = self._tracks[key] = Remembered(key, other, now_s, now_s, _predicted(other), now_s)
        return known

    def _is_avoided(self, now_s: float, known: Remembered) -> bool:
        """Whether an unproven track is to be avoided."""
        config, other = self._config, known.latest
        if known.stands(now_s):
            return True
        if other.crewed:
            return config.crewed_then == "hold" or not self._crewed.spent
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
        *,
        held: bool,
        back: bool,
    ) -> None:
        """Charge the time since the last decision.

        Args:
            here, velocity: own position and velocity (NED, m and m/s).
            result: decision of the law about the neighbours that `admitted` has just returned.
            held: whether the companion flies the vehicle.
            back: whether the aircraft is on its path without a conflict. Time is then charged only for a
                guarded mission, because the companion goes on flying until the handback.
        """
        passed_s = min(now_s - self._charged_s, _STEP_S) if held else 0.0
        self._charged_s = now_s
        acting: list[_Acting] = []
        inside: set[Remembered] = set()
        for view in result.tracks:
            known = self._places.get((view.adsb, view.track_id))
            if known is None:
                continue
            if not known.latest.crewed and _is_inside(here, view):
                inside.add(known)
            if now_s - known.first_s <= _NEW_S and self._note_near(now_s, here, view, known):
                known.appeared_s = now_s
            if held and (view.conflict or view.active):
                acting.append(_Acting(known, view.conflict))
        self._enter(now_s, inside)
        for known, _ in acting:
            self._conflict_s[known.latest.crewed] = now_s
            self._followers.conflict(now_s, known.key, here, velocity, known.latest)
        charged = [known for known, _ in acting if not known.latest.crewed]
        self._charge_tracks(now_s, passed_s, charged, inside)
        counts = held and (self._guards or not back)
        self._charge_totals(now_s, passed_s if counts else 0.0)
        self._tell_squeeze(now_s, result)
        self.hold = self._why_hold(
            [known.latest for known, blocks in acting if blocks and self._is_avoided(now_s, known)]
        )

    def _note_near(self, now_s: float, here: Vec3, view: TrackView, known: Remembered) -> bool:
        """Note a new track that appears near us. Returns True if an earlier batch appeared not long
        before."""
        other = known.latest
        if other.known_s > _NEW_S or view.track_id != other.track_id:
            return False
        if other.split or not _is_inside(here, view, NEAR_M):
            return False
        if now_s - self._newest_batch_s > _BATCH_S:
            self._newest_batch_s, self._batch_before_s = now_s, self._newest_batch_s
        return now_s - self._batch_before_s <= _SERIAL_S

    def _enter(self, now_s: float, inside: Iterable[Remembered]) -> None:
        """Let tracks that were first heard inside their volumes take over the used time of others."""
        for known in inside:
            if not known.entered and now_s - known.first_s <= _NEW_S:
                known.appeared_s = now_s
                known.inherit(
                    t
                    for t in self._tracks.values()
                    if t.pressed_s and now_s - t.heard_s <= _HEIR_S and not t.stands(t.heard_s)
                )
            known.entered = True
            if known.appears(now_s):
                known.appeared_s = now_s

    def _charge_tracks(
        self, now_s: float, passed_s: float, charged: Sequence[Remembered], inside: Container[Remembered]
    ) -> None:
        config = self._config
        groups = {known.latest.group for known in charged if known.latest.group}
        acting = set(charged)
        for known in [k for k in self._tracks.values() if k.used.used_s or k.pressed_s or k in acting]:
            acts = known in acting
            within = acts and known in inside
            if within:
                known.pressed_s += passed_s
            elif known.pressed_s:
                known.pressed_s = max(0.0, known.pressed_s - 0.5 * passed_s)
            before = known.spent
            if acts or known.used.used_s:
                seconds = passed_s if acts else 0.0
                known.used.charge(now_s, seconds, config.track_s, config.refill_s)
                known.inside.charge(now_s, seconds if within else 0.0, config.inside_s, config.refill_s)
            if known.spent and not before:
                self._tell_track(now_s, known)
        for name in groups:
            group = self._groups.setdefault(name, Used())
            if group.charge(now_s, passed_s, config.group_s, config.refill_s) and group.spent:
                one = charged[0].key[1]
                text = f"tracks like {one} have held us for {config.group_s:g} s"
                self._tell_spent("group", f"{text}: each is avoided for less", one)
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
        elif self._total.used_s <= WHOLE * config.total_s:
            self._low_s = None

    def _why_hold(self, blocking: Sequence[Neighbour]) -> str | None:
        for other in blocking:
            if other.crewed and self._crewed.spent:
                return f"crewed traffic has held us for {self._config.crewed_total_s:g} s: {other.track_id}"
            if not other.crewed and self._total.spent:
                return f"unproven traffic has held us for {self._config.total_s:g} s: {other.track_id}"
        return None

    def _forget(self, now_s: float) -> None:
        """Forget tracks that have used nothing and are no longer heard. If more than `_MOST` remain, also
        forget silent tracks, beginning with those that have used least."""
        tracks = self._tracks
        for key in [k for k, t in tracks.items() if not t.used.used_s and now_s - t.heard_s > _FORGOTTEN_S]:
            del tracks[key]
        if len(tracks) > _MOST:
            silent = [key for key, known in tracks.items() if known.heard_s < now_s]
            silent.sort(key=lambda key: tracks[key].used.used_s)
            for key in silent[: len(tracks) - _MOST]:
                del tracks[key]
        groups = self._groups
        for name in [name for name, used in groups.items() if not used.used_s]:
            del groups[name]

    # ------------------------------------------------------------ what the pilot is told

    def _tell_track(self, now_s: float, known: Remembered) -> None:
        track_id = known.key[1]
        what = "it stands still and is still avoided" if known.stands(now_s) else "it is not avoided any more"
        text = f"{track_id} has held us for {known.used.used_s:.0f} s: {what}"
        self._told.append(AllowanceSpent(scope="track", track_id=track_id, text=text))
        if now_s - self._said_s >= _SAY_S:
            self._said_s = now_s
            self._told.append(Say(severity=Severity.WARNING, text=f"DMUCA: {text}"))

    def _tell_squeeze(self, now_s: float, result: LawResult) -> None:
        """Log that yielding tracks are avoided less because of another track."""
        acting = [view for view in result.tracks if view.conflict or view.active]
        yielding = [view.track_id for view in acting if view.yields]
        others = [view.track_id.partition(ASIDE)[0] for view in acting if not view.yields]
        if not yielding or not others:
            return
        if now_s - self._squeezed_s > _SQUEEZED_S:
            text = f"{', '.join(yielding)} yields to {others[0]}"
            self._told.append(AllowanceSpent(scope="squeeze", track_id=others[0], text=text))
        self._squeezed_s = now_s

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
        what = "not avoided any more" if then == "resume" else "the vehicle is asked to hold"
        self._tell_spent(scope, f"{who} has held us for {most_s:g} s: {what}")

    def _tell_spent(self, scope: _Scope, text: str, track_id: str = "") -> None:
        self._told.append(AllowanceSpent(scope=scope, track_id=track_id, text=text))
        self._told.append(Say(severity=Severity.WARNING, text=f"DMUCA: {text}"))


def _is_inside(here: Vec3, view: TrackView, more_m: float = 0.0) -> bool:
    """Whether the aircraft is inside the volume of a track, or at most `more_m` outside of it."""
    (n, e, d), (north, east, down) = view.position_ned_m, here
    scale = view.radius_m / view.height_m if view.height_m > 0.0 else VERTICAL_SCALE
    return math.hypot(n - north, e - east, scale * (d - down)) < view.radius_m + more_m


def _predicted(other: Neighbour) -> Vec3:
    (n, e, d), (vn, ve, vd), age = other.position_ned_m, other.velocity_ned_mps, other.age_s
    return n + age * vn, e + age * ve, d + age * vd
