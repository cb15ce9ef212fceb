"""Alert level of each received aircraft, with hysteresis, and the reason for it.

Levels are judged in the air, whether or not the companion flies, by extrapolating the present velocities:

- advisory: flying as planned would enter the aircraft's volume (separation and margin), or its separation
  would be lost within 1.5 horizons;
- caution: its separation would be lost within the horizon, or flying as planned would enter its volume and it
  bounds the velocity that the law chose;
- warning: its separation would be lost within half of the horizon, or is already lost.

A level is raised once `RAISE_OF` of the last `RAISE_IN` judgements agree (a warning at once). When no
judgement has been as high for `HOLD_S`, the level falls to the highest one judged meanwhile. These are the
M-of-N rule and the hysteresis of DAIDALUS (NASA/TM-20250000684 and its `alerting` parameters), with three
levels as there.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import msgspec

from companion.avoidance.law import LawResult, Neighbour, horizon_s, separation_m
from companion.config import AvoidanceConfig
from companion.events import AlertChanged, Command, Say, Severity, Threat
from companion.geometry import Vec3

RAISE_OF, RAISE_IN = 3, 5
HOLD_S = 8.0
TELL_S = 1.0
"""Least time between two COLLISION messages about one aircraft, and between two texts."""
MOST_TOLD = 5
"""Most aircraft that are sent as COLLISION at a time, the most urgent ones first."""

_Key = tuple[bool, str]
"""Key of a track: whether it is from ADS-B, and its id. The id alone may be ambiguous, because a Remote ID
sender can choose any."""


class Level(enum.IntEnum):
    """Alert level of an aircraft."""

    NONE = 0
    ADVISORY = 1
    CAUTION = 2
    WARNING = 3


_NONE = Level.NONE
"""Python 3.11 takes 0.1 us to look up a member of an enumeration."""


class Approach(msgspec.Struct, frozen=True, gc=False):
    """How two aircraft approach each other if both keep their velocities."""

    time_s: float
    """Time to the closest point; 0 if they move apart."""
    horizontal_m: float
    """Horizontal distance at the closest point."""
    vertical_m: float
    """Vertical distance at the closest point."""
    loss_s: float
    """Time until the separation is lost; infinite: it is not lost. 0: it is already lost."""


def approach(position: Vec3, velocity: Vec3, radius_m: float, scale: float) -> Approach:
    """The approach of another aircraft.

    Args:
        position: position of the other minus ours, NED, m.
        velocity: our velocity minus the other's, NED, m/s.
        radius_m: horizontal radius of the volume to keep clear of.
        scale: factor on vertical distances that makes the volume a ball.
    """
    (px, py, down), (vx, vy, sinking) = position, velocity
    pz, vz = scale * down, scale * sinking
    v2, pv = vx * vx + vy * vy + vz * vz, px * vx + py * vy + pz * vz
    t = pv / v2 if v2 > 0.0 else 0.0
    if t < 0.0:
        t = 0.0
    gap2 = px * px + py * py + pz * pz - radius_m * radius_m
    loss = math.inf
    if gap2 <= 0.0:
        loss = 0.0
    elif pv > 0.0 and (root := pv * pv - v2 * gap2) >= 0.0:
        loss = gap2 / (pv + math.sqrt(root))
    return Approach(t, math.hypot(px - t * vx, py - t * vy), abs(down - t * sinking), loss)


def time_to_cylinder(position: Vec3, velocity: Vec3, radius_m: float, height_m: float) -> float:
    """Time (s) until the aircraft are horizontally within a radius and vertically within a height of each
    other.

    Args:
        position, velocity: as for `approach`.

    Returns:
        0: they are so now; infinite: they never will be at their present velocities.
    """
    (n, e, d), (vn, ve, vd) = position, velocity
    outside2, v2, pv = n * n + e * e - radius_m * radius_m, vn * vn + ve * ve, n * vn + e * ve
    if v2 > 0.0:
        root2 = pv * pv - v2 * outside2
        if root2 < 0.0:
            return math.inf
        root = math.sqrt(root2)
        begin, end = (pv - root) / v2, (pv + root) / v2
    else:
        begin, end = (0.0, math.inf) if outside2 <= 0.0 else (math.inf, -math.inf)
    if vd != 0.0:
        level = sorted(((d - height_m) / vd, (d + height_m) / vd))
        begin, end = max(begin, level[0]), min(end, level[1])
    elif abs(d) > height_m:
        return math.inf
    return max(begin, 0.0) if max(begin, 0.0) <= end else math.inf


@dataclass(slots=True)
class _Watched:
    other: Neighbour
    way: Approach
    """Approach at the last judgement."""
    acting: bool = False
    level: Level = Level.NONE
    seen: deque[Level] = field(default_factory=lambda: deque(maxlen=RAISE_IN))
    held_s: float = -math.inf
    """When the level was last judged at least as high as now (monotonic)."""
    below: Level = Level.NONE
    """Highest level judged since `held_s`."""
    told_s: float = -math.inf
    """Time of the last COLLISION message (monotonic); -inf if none was sent since the last end of an
    alert."""
    settled: bool = False
    """The last `RAISE_IN` judgements were of this level."""
    said: Level = Level.NONE
    """Level of the last text about it; NONE again once the level falls below caution."""

    def look(self, level: Level, now_s: float) -> bool:
        """Process the level judged now; True if the alert level changed."""
        seen, before = self.seen, self.level
        seen.append(level)
        same = level is before and seen.count(level) == len(seen)
        self.settled = same and len(seen) == RAISE_IN
        if same:
            self.held_s, self.below = now_s, _NONE
            return False
        agreed = sorted(seen, reverse=True)[RAISE_OF - 1] if len(seen) >= RAISE_OF else Level.NONE
        raised = level if level is Level.WARNING else agreed
        if level >= self.level or raised > self.level:
            self.level, self.held_s, self.below = max(raised, self.level), now_s, Level.NONE
        else:
            self.below = max(self.below, level)
            if now_s - self.held_s >= HOLD_S:
                self.level, self.held_s, self.below = self.below, now_s, Level.NONE
        if self.level < Level.CAUTION:
            self.said = Level.NONE
        return self.level is not before


class Alerts:
    """The alert levels of all tracks of a flight."""

    def __init__(self, config: AvoidanceConfig) -> None:
        self.configure(config)
        self._watched: dict[_Key, _Watched] = {}
        self._said_s = -math.inf
        self._spoken = False
        """Whether a text was sent about a caution or warning that is not over."""

    def configure(self, config: AvoidanceConfig) -> None:
        """Use other separations and horizons from now on."""
        self._separations = separation_m(config, False), separation_m(config, True)
        """Volumes by which the closest point is found: those of uncrewed and of crewed traffic."""
        self._well_clear_m = config.crewed_horizontal_m, config.crewed_vertical_m
        self._horizons_s = horizon_s(config, False), horizon_s(config, True)

    @property
    def levels(self) -> dict[_Key, Level]:
        """Levels of all tracks that have one above NONE."""
        return {key: w.level for key, w in self._watched.items() if w.level is not Level.NONE}

    def look(
        self,
        now_s: float,
        position: Vec3,
        velocity: Vec3,
        neighbours: Sequence[Neighbour],
        result: LawResult | None,
    ) -> list[Command]:
        """Judge every neighbour once. Returns the messages to send and the log entries.

        Args:
            position: own position (m), NED.
            velocity: own velocity (m/s), NED.
            result: the law's last decision; None while the law does not run.
        """
        views = {} if result is None else {(view.adsb, view.track_id): view for view in result.tracks}
        limits = () if result is None else result.limits
        commands: list[Command] = []
        ended: list[_Watched] = []
        present = {(other.adsb, other.track_id): other for other in neighbours}
        for key, other in present.items():
            view = views.get(key)
            conflict, active = (False, False) if view is None else (view.conflict, view.active)
            way = self._approach(position, velocity, other)
            watched = self._watched.get(key)
            if watched is None:
                watched = self._watched[key] = _Watched(other, way)
            watched.other, watched.way, watched.acting = other, way, conflict and active
            level = self._level(other, way, conflict, active)
            if watched.settled and level is watched.level:
                watched.held_s = now_s
            elif watched.look(level, now_s):
                commands.append(_changed(watched, limits))
                ended += [watched] if watched.level < Level.CAUTION else []
        for key in sorted(self._watched.keys() - present.keys()):
            watched = self._watched.pop(key)
            if watched.level is not Level.NONE:
                watched.level, watched.acting = Level.NONE, False
                commands.append(_changed(watched, (), "not heard any more"))
                ended.append(watched)
        urgent = self._urgent()
        return commands + self._tell(now_s, ended, urgent) + self._say(now_s, urgent, limits)

    def _approach(self, position: Vec3, velocity: Vec3, other: Neighbour) -> Approach:
        (north, east, down), (vn, ve, vd) = other.position_ned_m, other.velocity_ned_mps
        age, (n, e, d) = other.age_s, position
        away = north + age * vn - n, east + age * ve - e, down + age * vd - d
        closing = velocity[0] - vn, velocity[1] - ve, velocity[2] - vd
        if not other.vertical_known:
            away, closing = (away[0], away[1], 0.0), (closing[0], closing[1], 0.0)
        way = approach(away, closing, *self._separations[other.crewed])
        if not other.crewed:
            return way
        loss_s = time_to_cylinder(away, closing, *self._well_clear_m)
        return Approach(way.time_s, way.horizontal_m, way.vertical_m, loss_s)

    def _level(self, other: Neighbour, way: Approach, conflict: bool, active: bool) -> Level:
        loss_s, horizon_s = way.loss_s, self._horizons_s[other.crewed]
        if loss_s <= 0.5 * horizon_s:
            return Level.WARNING
        if loss_s <= horizon_s or (conflict and active):
            return Level.CAUTION
        return Level.ADVISORY if conflict or loss_s <= 1.5 * horizon_s else _NONE

    def _urgent(self) -> list[_Watched]:
        """Aircraft at caution or above, the most urgent first."""
        caution = Level.CAUTION
        found = [w for w in self._watched.values() if w.level >= caution]
        return sorted(found, key=lambda w: (-w.level, w.way.loss_s, w.other.track_id))

    def _tell(self, now_s: float, ended: Sequence[_Watched], urgent: Sequence[_Watched]) -> list[Command]:
        """COLLISION messages: one for the end of each alert that was sent, then the most urgent aircraft,
        each once a second."""
        told: list[Command] = []
        for watched in ended:
            if watched.told_s > -math.inf:
                told.append(_threat(watched))
                watched.told_s = -math.inf
        for watched in urgent[:MOST_TOLD]:
            if now_s - watched.told_s >= TELL_S - 1e-6:
                watched.told_s = now_s
                told.append(_threat(watched))
        return told

    def _say(self, now_s: float, urgent: Sequence[_Watched], limits: tuple[str, ...]) -> list[Command]:
        """Texts: the first caution, every warning, and the end of all alerts; at most one text a second."""
        if not urgent:
            over, self._spoken = self._spoken, False
            return [Say(severity=Severity.INFO, text="DMUCA clear of traffic")] if over else []
        unsaid = [w for w in urgent if w.level > w.said and not (self._spoken and w.level < Level.WARNING)]
        if not unsaid or now_s - self._said_s < TELL_S - 1e-6:
            return []
        worst = unsaid[0]
        worst.said, self._said_s, self._spoken = worst.level, now_s, True
        severity = Severity.WARNING if worst.level is Level.WARNING else Severity.NOTICE
        return [Say(severity=severity, text=f"DMUCA {_changed(worst, limits).reason}")]


def _changed(watched: _Watched, limits: tuple[str, ...], why: str | None = None) -> AlertChanged:
    level, way, other = watched.level, watched.way, watched.other
    what = level.name.lower() if level is not Level.NONE else "clear"
    where = f"closest {way.horizontal_m:.0f} m aside, {way.vertical_m:.0f} m in height"
    if way.loss_s == 0.0:
        where = f"too near: {where}"
    elif way.time_s > 0.0:
        where = f"{where}, in {way.time_s:.0f} s"
    else:
        where = "parting"
    bounds = f"; limited by {', '.join(limits)}" if watched.acting and limits else ""
    return AlertChanged(
        track_id=other.track_id,
        level=int(level),
        reason=f"{what} {other.track_id}: {why or where}{'; avoiding' if watched.acting else ''}{bounds}",
        time_to_closest_s=way.time_s,
        horizontal_m=way.horizontal_m,
        vertical_m=way.vertical_m,
        acting=watched.acting,
        limits=limits,
    )


def _threat(watched: _Watched) -> Threat:
    return Threat(
        track_id=watched.other.track_id,
        adsb=watched.other.adsb,
        level={Level.CAUTION: 1, Level.WARNING: 2}.get(watched.level, 0),
        acting=watched.acting,
        time_to_closest_s=watched.way.time_s,
        horizontal_m=watched.way.horizontal_m,
        vertical_m=watched.way.vertical_m,
    )
