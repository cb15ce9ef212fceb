"""Crewed and other traffic received by ADS-B through the autopilot's receiver (ADSB_VEHICLE).

Altitudes decide whether an aircraft passes above or below. A geometric altitude can be compared with our own.
A barometric one cannot: transponders send the pressure altitude of the standard atmosphere, which is 8 m off
for each hectopascal that the day's pressure differs, and receivers pass it on unchanged. It is compared with
our own pressure altitude, in which there is the same weather. While that is not known, a barometric altitude
separates aircraft only if the difference is larger than any weather error (`BAROMETRIC_M`).

Reports are checked against each other. One that its aircraft cannot have sent is taken for another
aircraft's. If only its altitude is impossible, either altitude may be the wrong one: then the height of the
new aircraft counts as unknown for a while, and it is avoided at any height. A velocity that the positions
contradict for several seconds is corrected by what they show (`Drift`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.avoidance import kernels as k
from companion.avoidance.law import Neighbour
from companion.config import AvoidanceConfig
from companion.events import AdsbVehicle
from companion.geometry import LocalFrame, Vec3
from companion.traffic.eviction import (
    HOLD_S,
    FullTable,
    Judgement,
    Motion,
    Ranking,
    Trust,
    allowance_of,
    margin_m,
)
from companion.traffic.plausibility import Drift
from companion.traffic.right_of_way import CREWED, FREE, share_of

SIGMA_M = 15.0
"""Assumed standard deviation of the horizontal position for each axis, because the message does not report
it. NACp 8, the least that most airspace requires, is 93 m at 95 %; present GNSS receivers reach a tenth of
that."""
SIGMA_MPS = 1.5
"""Assumed standard deviation of the velocity for each axis. NACv 2 is 3 m/s at 95 %."""
SIGMA_DOWN_M = 15.0
"""Assumed standard deviation of the difference between a geometric height and ours. GVA 2, which most
installations reach, is 45 m at 95 % in the standard; present GNSS receivers reach a fifth of that, and ours
errs by 5 m."""
PRESSURE_SIGMA_M = 30.0
"""As `SIGMA_DOWN_M`, for pressure altitudes: altimeter, encoder (in steps of up to 100 ft) and static source
of the other aircraft err by 10 to 30 m, and our own barometer by 10 m."""
BAROMETRIC_M = 300.0
"""Least difference from our own height at which a barometric altitude separates aircraft. It corresponds to
weather that is 37 hPa off the standard atmosphere."""
ESTABLISHED = 3
"""Number of reports from which an aircraft is established."""
_RANKED_S = 0.2
"""While the table is at least half full, all aircraft are ranked this often."""
MOST = 200
"""Most aircraft held at a time."""
EXPIRE_S = 15.0
"""Aircraft whose last report is older are removed."""
_MAX_RANGE_M = 50_000.0
"""Reports of places farther from us than this are ignored."""
_STAMP_S = 0.5
"""Mean error of reported ages, which are whole seconds, rounded down."""
_REPEATED_S = 5.0
PLACE = "/"
"""Separates an address from the number of a further place at which it is heard."""
_OFF_M, _TURNS_MPS2, _FASTEST_MPS = 300.0, 20.0, 600.0
_NEAR_M, _AGE_ERROR_S, _WRONG_MPS = 100.0, 1.0, 200.0
"""How far a report may be from the predicted place of its aircraft. `_NEAR_M` allows for the errors of both
positions, `_AGE_ERROR_S` of flight for that of the age, and `_WRONG_MPS` for a velocity that is not what the
aircraft flies; together at most `_OFF_M`, which is also allowed while its velocity is not known. It may have
turned and accelerated since (`_TURNS_MPS2`), up to `_FASTEST_MPS`."""
_TURNED_MPS, _CLIMBED_MPS, _CLIMBS_MPS2 = 10.0, 6.4, 10.0
"""How far its velocity may be from the last one: `_TURNED_MPS` and `_TURNS_MPS2` horizontally, `_CLIMBED_MPS`
(three standard deviations of both) and `_CLIMBS_MPS2` vertically."""
_APART_S, _LONG_S = 1.0, 5.0
"""Velocities are computed from positions `_APART_S` apart or more. If reports are more frequent than that,
the earlier position is replaced when it is `_LONG_S` old or twice that. Otherwise the course before a turn
would never be forgotten."""
_STEP_M, _CLIMB_MPS = 50.0, 51.0
"""How far an altitude may be from the last one: `_STEP_M`, and `_CLIMB_MPS` for the time between them. TCAS
II (version 7.1) takes no aircraft for a threat whose altitudes change faster than 10,000 ft/min, which is
51 m/s. `_STEP_M` allows for altitudes in steps of 100 ft, and for an age that is wrong by a second while the
aircraft climbs at 20 m/s. A change from geometric to barometric altitudes is given no more room: a forged one
would otherwise hide an aircraft whenever it follows a true one."""
DOUBTED_S = 60.0
"""A height counts as unknown for this long after such a change, as far as the law looks ahead
(`kernels.crewed.HORIZON_S`)."""
_NOISE_M = 3.0 * math.sqrt(2.0) * SIGMA_M
_STILL: Vec3 = (0.0, 0.0, 0.0)
_Height = tuple[float, float]
"""Time of a report with a known height, and that height (NED down, m)."""
_NOT_CREWED = frozenset({14, 17, 18, 19})
"""ADSB_EMITTER_TYPE of UAV, surface vehicles and point obstacles: the separation from drones suffices."""


@dataclass(slots=True)
class _Seen:
    position: Vec3
    velocity: Vec3
    reported: Vec3
    """Velocity as reported."""
    velocity_sent: bool
    """Whether it reported its velocity. Otherwise it is computed from two positions."""
    at_s: float
    alt_m: float
    """Reported altitude; 0 if it is not known."""
    vertical_known: bool
    barometric: bool
    crewed: bool
    told: tuple[object, ...]
    turn_rps: float
    """Turn rate, positive to the right."""
    reports: int
    threat_s: float
    """When it was last a threat (our monotonic time)."""
    anchor: _Seen | None
    """Earlier report to derive a velocity from; a second or more before this one if there is one."""
    next_anchor: _Seen | None
    """The report that replaces `anchor` when it is `_LONG_S` before."""
    spoken: _Seen | None
    """The last report with a velocity, if this one has none."""
    height: _Height | None
    """The last known height."""
    doubted_until_s: float
    """Until when its height counts as unknown, because the address had an impossibly different one before."""
    level: Drift
    """Compares positions and velocities: north and east."""
    upright: Drift
    """The same for the height."""


class AdsbTraffic:
    """Aircraft received by ADS-B, at most `MOST`. If there are more, `eviction` decides which are left out.
    An aircraft that we are about to meet is kept, wherever the others are.

    Args:
        own_icao: address of our own transponder, which the own receiver also hears; None: we have none.
        avoidance: configuration of the law, which says what a threat is.
    """

    def __init__(self, own_icao: int | None, avoidance: AvoidanceConfig | None = None) -> None:
        self.judgement = Judgement(avoidance or AvoidanceConfig())
        self._own_pressure_alt_m: float | None = None
        self.full = FullTable("ADS-B traffic", MOST)
        self._own_icao = own_icao
        self._seen: dict[str, _Seen] = {}
        """Aircraft by the names that `_name` gives, because an address may be heard at several places."""
        self._places: dict[str, set[int]] = {}
        """For each address, the numbers of the places at which it is held."""
        self._ranking = Ranking()
        self._ranked_s = -math.inf

    def note_own(
        self, now_s: float, position: Vec3, velocity: Vec3, pressure_alt_m: float | None = None
    ) -> None:
        """Store the own state (local NED), by which aircraft are ranked.

        Args:
            pressure_alt_m: own pressure altitude; None while unknown.
        """
        self._own_pressure_alt_m = pressure_alt_m
        self.judgement.position, self.judgement.velocity = position, velocity
        if 2 * len(self._seen) >= MOST and now_s >= self._ranked_s + _RANKED_S:
            self._ranked_s = now_s
            for name in self._seen:
                self._rank(name, now_s)

    def hear(
        self,
        event: AdsbVehicle,
        now_s: float,
        frame: LocalFrame,
        separation_m: float | None,
    ) -> None:
        """Process one report.

        Args:
            frame: local frame (its altitude datum is mean sea level).
            separation_m: height of the geoid above the ellipsoid here; None while unknown.
        """
        if event.icao == self._own_icao:
            return
        at_s = now_s - event.age_s - _STAMP_S
        alt_msl_m = event.alt_m
        if event.alt_geometric and alt_msl_m is not None:
            alt_msl_m = None if separation_m is None else alt_msl_m - separation_m
        position = frame.to_ned(event.lat_deg, event.lon_deg, frame.alt_m if alt_msl_m is None else alt_msl_m)
        own = self.judgement.position
        if math.hypot(position[0] - own[0], position[1] - own[1]) > _MAX_RANGE_M:
            return
        told = (event.lat_deg, event.lon_deg, event.alt_m, event.velocity_ned_mps)
        height = None if alt_msl_m is None else (at_s, position[2])
        name, jumped = self._name(event.icao, position, event.velocity_ned_mps, height, told, at_s)
        before = self._seen.get(name)
        # ArduPilot repeats the last report for seconds, always with its first age. Reports of an aircraft
        # that stands still look the same.
        repeated = before is not None and told == before.told and at_s - before.at_s <= _REPEATED_S
        moves = event.velocity_ned_mps != _STILL or (before is not None and before.level.found)
        if before is not None and (at_s <= before.at_s or (repeated and moves)):
            return
        doubted_until_s = now_s + DOUBTED_S if jumped else -math.inf
        self._seen.pop(name, None)
        seen = self._seen[name] = _Seen(
            position=position,
            velocity=event.velocity_ned_mps or (_STILL if before is None else before.velocity),
            reported=event.velocity_ned_mps or _STILL,
            velocity_sent=event.velocity_ned_mps is not None,
            at_s=at_s,
            alt_m=event.alt_m or 0.0,
            vertical_known=height is not None,
            barometric=not event.alt_geometric,
            crewed=event.emitter not in _NOT_CREWED,
            told=told,
            turn_rps=0.0,
            reports=1 if before is None else before.reports + 1,
            threat_s=-math.inf if before is None else before.threat_s,
            anchor=None,
            next_anchor=None,
            spoken=None,
            height=height if before is None else height or before.height,
            doubted_until_s=before.doubted_until_s if before is not None else doubted_until_s,
            level=Drift(_NOISE_M, SIGMA_MPS) if before is None else before.level,
            upright=Drift(_NOISE_M, SIGMA_MPS) if before is None else before.upright,
        )
        if before is not None:
            # A velocity from two positions needs reports that are not too close in time, at any report rate.
            anchor, later = before.anchor or before, before.next_anchor or before
            if at_s - before.at_s >= _APART_S:
                anchor = later = before
            elif at_s - later.at_s >= _LONG_S:
                anchor, later = later, before
            before.anchor = before.next_anchor = None
            seen.anchor, seen.next_anchor = anchor, later
            spoken = before if before.velocity_sent else before.spoken
            before.spoken = None
            if event.velocity_ned_mps is None:
                seen.spoken = spoken
                if at_s - anchor.at_s >= _APART_S:
                    seen.velocity = _between(anchor, seen)
            elif spoken is not None:
                if before.velocity_sent:
                    # The noise of velocities from positions would be taken for turns.
                    passed_s = at_s - before.at_s
                    seen.turn_rps = k.turn_rate(before.turn_rps, before.reported, seen.reported, passed_s)
                _correct(seen, spoken)
        self._rank(name, now_s)
        if len(self._seen) > MOST:
            self._make_room(now_s)

    def _name(
        self,
        icao: int,
        position: Vec3,
        velocity: Vec3 | None,
        height: _Height | None,
        told: tuple[object, ...],
        at_s: float,
    ) -> tuple[str, bool]:
        """Name of the aircraft that a report is about, such as `4B1234`. If that aircraft cannot be at the
        reported place with the reported velocity, another one uses its address and is named `4B1234/2`; both
        are kept. If several can be there, it is the one whose prediction the report fits best.

        Returns:
            The name, and whether the aircraft could be there, but not at that height.
        """
        address = f"{icao:06X}"
        free, best, least_m, jumped = 0, "", math.inf, False
        for place in range(1, max(self._places.get(address, ()), default=0) + 2):
            name = _name_at(address, place)
            seen = self._seen.get(name)
            if seen is None:
                free = free or place
            elif told == seen.told:
                return name, False
            elif (off_m := _off_m(seen, position, velocity, at_s)) < math.inf:
                jump_m, allowed_m = _jump_m(seen.height, height)
                jumped = jumped or jump_m > allowed_m
                if jump_m <= allowed_m and off_m + jump_m < least_m:
                    best, least_m = name, off_m + jump_m
        if best:
            return best, False
        self._places.setdefault(address, set()).add(free)
        return _name_at(address, free), jumped

    def _make_room(self, now_s: float) -> None:
        """Remove one aircraft, unless there are expired ones."""
        self._expire(now_s)
        if len(self._seen) > MOST:
            victim = self._ranking.first()
            self.full.note(now_s, self._ranking.standing(victim).threat)
            self._remove(victim)

    def _rank(self, name: str, now_s: float) -> None:
        """Update the aircraft's standing in the ranking. Consecutive addresses share an allowance."""
        seen = self._seen[name]
        age_s = max(0.0, now_s - seen.at_s)
        position, known = self._placed(seen, self.judgement.position[2], now_s)
        margin = margin_m(SIGMA_M, SIGMA_MPS, age_s, 0.0)
        motion = Motion(position, seen.velocity, age_s, margin, known, seen.crewed)
        trust = Trust.ESTABLISHED if seen.reports >= ESTABLISHED else Trust.FRESH
        was_threat = now_s - seen.threat_s <= HOLD_S
        standing, threat = self.judgement.standing(motion, trust, False, allowance_of(name[:4]), was_threat)
        if threat:
            seen.threat_s = now_s
        self._ranking.place(name, standing)

    def _placed(self, seen: _Seen, own_down_m: float, now_s: float) -> tuple[Vec3, bool]:
        """Position of an aircraft relative to ours, and whether its height is known."""
        if now_s < seen.doubted_until_s:
            return seen.position, False
        if not (seen.barometric and seen.vertical_known):
            return seen.position, seen.vertical_known
        north, east, down = seen.position
        if self._own_pressure_alt_m is None:
            return seen.position, abs(down - own_down_m) > BAROMETRIC_M
        return (north, east, own_down_m + self._own_pressure_alt_m - seen.alt_m), True

    def _remove(self, name: str) -> None:
        del self._seen[name]
        self._ranking.remove(name)
        address, _, place = name.partition(PLACE)
        places = self._places[address]
        places.discard(int(place or 1))
        if not places:
            del self._places[address]

    def _expire(self, now_s: float) -> None:
        for name in [n for n, seen in self._seen.items() if now_s - seen.at_s > EXPIRE_S]:
            self._remove(name)

    def clear(self) -> None:
        """Forget all aircraft, because the local frame of their positions is no longer valid."""
        for name in list(self._seen):
            self._remove(name)

    def neighbours(self, now_s: float, own_down_m: float) -> list[Neighbour]:
        """Every aircraft that is not expired, as input of the law. Expired ones are removed.

        Args:
            own_down_m: own NED down now. Barometric altitudes are compared with it, or with the own pressure
                altitude of the last `note_own`.
        """
        self._expire(now_s)
        return self.look(now_s, own_down_m)

    def look(self, now_s: float, own_down_m: float) -> list[Neighbour]:
        """Like `neighbours`, but without a change of state, so that a status display does not affect
        replays."""
        return [
            _neighbour(name, seen, now_s, *self._placed(seen, own_down_m, now_s))
            for name, seen in self._seen.items()
            if now_s - seen.at_s <= EXPIRE_S
        ]


def _name_at(address: str, place: int) -> str:
    return address if place == 1 else f"{address}{PLACE}{place}"


def _off_m(seen: _Seen, position: Vec3, velocity: Vec3 | None, at_s: float) -> float:
    """How far a report is horizontally from the predicted place of an aircraft, plus what the difference of
    the velocities makes in a second. Infinite if the aircraft cannot be there with that velocity."""
    apart_s, changed_mps = abs(at_s - seen.at_s), 0.0
    last = seen if seen.velocity_sent else seen.spoken
    if velocity is not None and last is not None:
        passed_s = abs(at_s - last.at_s)
        # A velocity that is right again after wrong ones follows `velocity`, which was corrected.
        changed_mps = min(_change_mps(one, velocity, passed_s) for one in (last.reported, last.velocity))
    known = seen.velocity_sent or seen.velocity != _STILL
    (n, e, _), (vn, ve, _) = seen.position, seen.velocity
    off_m = math.hypot(position[0] - n - vn * (at_s - seen.at_s), position[1] - e - ve * (at_s - seen.at_s))
    turned_m = 0.5 * _TURNS_MPS2 * apart_s * apart_s if known else math.inf
    near_m = _NEAR_M + _AGE_ERROR_S * math.hypot(vn, ve) + _WRONG_MPS * apart_s if known else _OFF_M
    if off_m > min(near_m, _OFF_M) + min(turned_m, _FASTEST_MPS * apart_s):
        return math.inf
    return off_m + changed_mps


def _change_mps(before: Vec3, after: Vec3, passed_s: float) -> float:
    """Difference of two velocities; infinite if no aircraft has both within that time."""
    turned_mps, climbed_mps = math.dist(before[:2], after[:2]), abs(after[2] - before[2])
    if turned_mps > _TURNED_MPS + _TURNS_MPS2 * passed_s:
        return math.inf
    if climbed_mps > _CLIMBED_MPS + _CLIMBS_MPS2 * passed_s:
        return math.inf
    return turned_mps + climbed_mps


def _jump_m(last: _Height | None, height: _Height | None) -> tuple[float, float]:
    """Difference of a reported height from the last known one, and the largest that is possible (m)."""
    if last is None or height is None:
        return 0.0, 0.0
    return abs(height[1] - last[1]), _STEP_M + _CLIMB_MPS * abs(height[0] - last[0])


def _correct(seen: _Seen, before: _Seen) -> None:
    """Correct the velocity of a report if the positions contradict the velocities.

    Args:
        before: the last report with a velocity.
    """
    passed_s = seen.at_s - before.at_s
    (n, e, d), (bn, be, bd) = seen.position, before.position
    (vn, ve, vd), (wn, we, wd) = seen.reported, before.reported
    seen.level.add((n - bn, e - be), (wn, we), (vn, ve), passed_s)
    alike = seen.vertical_known and before.vertical_known and seen.barometric == before.barometric
    if alike:
        seen.upright.add((d - bd, 0.0), (wd, 0.0), (vd, 0.0), passed_s)
    if seen.level.found:
        seen.turn_rps = 0.0
    if seen.level.found or seen.upright.found:
        (x, y), z = seen.level.error_mps, seen.upright.error_mps[0]
        seen.velocity = vn + x, ve + y, vd + z


def _neighbour(name: str, seen: _Seen, now_s: float, position: Vec3, known: bool) -> Neighbour:
    return Neighbour(
        track_id=name,
        position_ned_m=position,
        velocity_ned_mps=seen.velocity,
        age_s=max(0.0, now_s - seen.at_s),
        sigma_m=SIGMA_M,
        sigma_mps=SIGMA_MPS,
        share=share_of(FREE, CREWED if seen.crewed else FREE),
        vertical_known=known,
        crewed=seen.crewed,
        adsb=True,
        turn_rps=seen.turn_rps,
        sigma_down_m=PRESSURE_SIGMA_M if seen.barometric else SIGMA_DOWN_M,
    )


def _between(a: _Seen, b: _Seen) -> Vec3:
    """Velocity from one report to the next. The vertical part is 0 unless both heights are of the same
    kind."""
    k = 1.0 / (b.at_s - a.at_s)
    alike = a.vertical_known and b.vertical_known and a.barometric == b.barometric
    north, east, down = (k * (q - p) for p, q in zip(a.position, b.position, strict=True))
    return north, east, down if alike else 0.0
