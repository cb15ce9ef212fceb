"""Bounds on the commanded velocity: the rules age, speed, change, height and fence.

The computation is independent of the law and simpler. Its bounds assume braking with the whole acceleration
limit. The law keeps margins inside these bounds, so that none of its commands reaches them.
"""

from __future__ import annotations

import math
from itertools import pairwise

from companion.config import Config
from companion.events import ClockRead, FenceArea, GlobalPosition, Parameter, VehicleParameters
from companion.gate.rules import Broken, Rule
from companion.geometry import LocalFrame, Vec3

_SLACK_MPS = 1e-3
"""Tolerance for the rounding of setpoints to 32-bit floats."""
_NOISE_MPS = 1.0
"""Allowance for the error of the measured velocity and for its change between two messages."""
_REACTION_S = 0.5
_BRAKING, _BRAKES = 0.05, 0.9
"""Fractions of the acceleration limit that define being slowed down. The commanded speed must be below the
flown speed by what `_BRAKING` of the limit achieves in one second. From then on it must keep falling with at
least `_BRAKES` of the limit."""
_BRAKED_S = 1.0
"""If a bound was not approached too fast for this long, the next excess starts a new braking."""
_HEIGHT_SLACK_M = 1.0
_FLOOR, _CEILING = -1, -2
_LONGEST_S = 1.0
_LATE_S = 0.5
_DRIFT = 1e-3
_CLOCKLESS_S = 10.0
_SLOW = 0.05
"""Largest rate at which the vehicle's clock may fall behind ours, if its answers prove that it does. Crystals
are a thousand times better, but a simulator on a busy computer is not."""
_MIXED_S, _LONGEST_MIXED_S = 0.25, 10.0
"""Autopilots stamp some messages when they are measured and others when they are sent. On a link that keeps
their order, a message is at most `_MIXED_S` older than one that came before it. A larger step back by a
late message shows that the link mixes old and new messages. Modes are then not trusted for as long as the old
message was late, but for `_LONGEST_MIXED_S` at most, because a restart of the vehicle's clock looks like a
long delay."""
_RESTART_S = 1.0
"""A clock counts as restarted if it goes back by more than this, either after a silence of more than this or
so far that its messages seem late by more than `_LONGEST_MIXED_S`."""

_GROUND_MPS = 2.0

_FRAME_REACH_M = 5_000.0
"""The local frame gets a new origin when the vehicle is farther than this from it. The tangent plane of a
companion that was started elsewhere, or before its vehicle knew its place, shifts the fence by metres."""
_MOVED_M = 10.0
"""The distances to the fence are measured again after the vehicle has moved this far."""
_NOWHERE = math.inf, math.inf

Edge = tuple[float, float, float, float]
"""North and east of both ends (m); for a circle: north and east of its centre, its radius (m), NaN."""
Wall = tuple[FenceArea, int, list[Edge], list[float], float]
"""Fence area, number of its first edge, its edges, the distance to each (m), and the least of these
distances, which is -1 if the vehicle already breaks this fence."""


class Bounds:
    """Known position and limits of the vehicle, and the last command."""

    def __init__(self, config: Config) -> None:
        limits = config.limits
        self._stale_s = config.vehicle.stale_after_s + _LATE_S
        self._late_s = max(_LATE_S, 0.5 * config.vehicle.stale_after_s)
        self._limits = limits
        self._speed, self._climb, self._descent = (
            limits.max_speed_mps,
            limits.max_climb_mps,
            limits.max_descent_mps,
        )
        self._acceleration = limits.max_acceleration_mps2
        self._areas = config.fence
        self._position: GlobalPosition | None = None
        self._velocity: Vec3 = (0.0, 0.0, 0.0)
        self._offset_s = math.inf
        """Our clock minus the vehicle's clock, from its least delayed message."""
        self._boot_s = self._stamp_s = -math.inf
        """Newest times of the vehicle's clock: `_boot_s` of a position, `_stamp_s` of any message."""
        self._clock_s = -math.inf
        """Time at which a message last carried the vehicle's clock."""
        self._read_s = -math.inf
        """Time of the last TIMESYNC answer about that clock."""
        self._mixed_until_s = -math.inf
        """Time until which old messages may still arrive among new ones."""
        self._frame: LocalFrame | None = None
        self._here = 0.0, 0.0
        self._walls: list[Wall] = []
        self._walls_at = _NOWHERE
        """Place (north, east) from which the distances in `_walls` were measured."""
        self._slowed: dict[int, tuple[float, float, float]] = {}
        """For each bound: the times at which it was first and last approached too fast, with the flown speed
        towards it at the first. Order: first time, speed, last time."""
        self._last: Vec3 = (0.0, 0.0, 0.0)
        self._last_s = -math.inf
        self._budget_mps = 0.0

    # ------------------------------------------------------------ messages of the vehicle

    def hear_clock(self, time_boot_s: float, now_s: float) -> None:
        """Take in the vehicle's own clock from any message that carries it."""
        delay_s = now_s - time_boot_s - self._offset_s
        if time_boot_s < self._stamp_s - _MIXED_S and delay_s > self._late_s:
            self._mixed_until_s = max(self._mixed_until_s, now_s + min(delay_s, _LONGEST_MIXED_S))
        silent = now_s - self._clock_s > _RESTART_S
        if time_boot_s < self._stamp_s - _RESTART_S and (silent or delay_s > _LONGEST_MIXED_S):
            # The clock has restarted, so the age of the last position is no longer known.
            self._offset_s, self._stamp_s, self._boot_s = math.inf, time_boot_s, -math.inf
            self._position = None
        passed_s = max(time_boot_s - self._stamp_s, 0.0)
        self._offset_s = min(now_s - time_boot_s, self._offset_s + _DRIFT * passed_s)
        self._stamp_s, self._clock_s = max(time_boot_s, self._stamp_s), now_s

    def hear_answer(self, event: ClockRead, now_s: float) -> None:
        """Take in an answer about the vehicle's clock (TIMESYNC).

        The clock was read after we asked. If it shows an earlier time than its messages let expect, the clock
        has fallen behind, and the messages are not late.
        """
        proven_s = event.asked_s - event.time_boot_s
        if proven_s > self._offset_s and event.time_boot_s > self._stamp_s - _RESTART_S:
            allowed_s = self._offset_s + _SLOW * max(now_s - self._read_s, 0.0)
            self._offset_s = min(proven_s, allowed_s) if self._read_s > -math.inf else self._offset_s
        self._read_s = now_s

    def hear_position(self, event: GlobalPosition, now_s: float) -> None:
        """Take in GLOBAL_POSITION_INT, dated by the vehicle's own clock."""
        self.hear_clock(event.time_boot_s, now_s)
        if event.time_boot_s < self._boot_s:
            return  # A newer position has overtaken this one.
        self._boot_s = event.time_boot_s
        self._position, self._velocity = event, event.velocity_ned_mps
        if self._frame is not None:
            self._here = self._frame.to_ned(event.lat_deg, event.lon_deg, event.alt_msl_m)[:2]
        if self._frame is None or math.hypot(*self._here) > _FRAME_REACH_M:
            self._frame = LocalFrame(event.lat_deg, event.lon_deg, event.alt_msl_m)
            self._here, self._walls_at = (0.0, 0.0), _NOWHERE

    def hear_parameters(self, event: VehicleParameters) -> None:
        """Take in the vehicle's own limits; the lower of these and the configured ones applies."""

        def lower(configured: float, own: Parameter | None) -> float:
            return configured if own is None else min(configured, own.value)

        limits = self._limits
        self._speed = lower(limits.max_speed_mps, event.speed_mps)
        self._climb = lower(limits.max_climb_mps, event.climb_mps)
        self._descent = lower(limits.max_descent_mps, event.descent_mps)
        self._acceleration = lower(limits.max_acceleration_mps2, event.acceleration_mps2)

    def hear_fence(self, areas: tuple[FenceArea, ...]) -> None:
        """Take in the vehicle's own fence, if it is configured to be used."""
        if self._limits.fence == "vehicle":
            self._areas, self._walls_at = areas, _NOWHERE

    def late(self, now_s: float) -> bool:
        """Whether messages received now may have been delayed on the way, judged by the vehicle's own clock.

        If no message has carried that clock for long, there is no evidence of delay and the result is False.
        """
        if self.mixed(now_s):
            return True
        if now_s - self._clock_s > _CLOCKLESS_S:
            return False
        return self._delay_s(now_s) > self._late_s

    def delay(self, now_s: float) -> str:
        """Delay of the messages received now, by the vehicle's own clock, in words with the allowed delay."""
        return f"{self._delay_s(now_s):.1f} s late (allowed: up to {self._late_s:g} s)"

    def _delay_s(self, now_s: float) -> float:
        return now_s - self._stamp_s - self._offset_s

    def mixed(self, now_s: float) -> bool:
        """Whether the link has lately delivered an old message after a newer one.

        A mode message, which carries no time, may then be just as old.
        """
        return now_s < self._mixed_until_s

    @property
    def flies_fast(self) -> bool:
        """Whether the vehicle is too fast to be on the ground, whatever landed state it reports."""
        return math.hypot(*self._velocity) > _GROUND_MPS

    # ------------------------------------------------------------ checks of setpoints

    def check(self, velocity: Vec3, now_s: float) -> None:
        """Check the rules age, speed, change, height and fence for a finite velocity.

        Raises:
            Broken: the velocity breaks one of them.
        """
        position = self._position
        if position is None or self._age_s(position, now_s) > self._stale_s:
            raise Broken(Rule.AGE, "the own position is unknown or too old")
        north, east, down = velocity
        if north == east == down == 0.0:
            return
        speed = math.hypot(north, east, down)
        if speed > self._speed + _SLACK_MPS:
            raise Broken(Rule.SPEED, f"speed {speed:.2f} m/s; allowed: up to {self._speed:g}")
        if not -self._climb - _SLACK_MPS <= down <= self._descent + _SLACK_MPS:
            raise Broken(Rule.SPEED, f"{down:.2f} m/s down; allowed: {-self._climb:g} to {self._descent:g}")
        self._check_change(velocity, now_s)
        self._check_height(position, down, now_s)
        if self._areas:
            self._check_fence(north, east, self._place(position, now_s), now_s)

    def left(self, velocity: Vec3, now_s: float) -> None:
        """Note that a setpoint was sent.

        `tests/companion/gate/test_proofs.py` proves a bound for setpoints that pass by comparison with the
        last setpoint. In t seconds their changes add up to no more than the acceleration limit allows in
        (t + 1 s), plus the slack.
        """
        changed = math.hypot(velocity[0] - self._last[0], velocity[1] - self._last[1])
        self._budget_mps = max(-_SLACK_MPS, self._allowed_mps(now_s) - changed)  # The slack counts only once.
        self._last, self._last_s = velocity, now_s

    def _allowed_mps(self, now_s: float) -> float:
        passed_s = min(now_s - self._last_s, _LONGEST_S)
        most = self._acceleration * _LONGEST_S
        return min(most, self._budget_mps + self._acceleration * max(passed_s, 0.0))

    def _check_change(self, velocity: Vec3, now_s: float) -> None:
        last, flown = self._last, self._velocity
        change = math.hypot(velocity[0] - last[0], velocity[1] - last[1])
        if now_s - self._last_s <= _LONGEST_S and change <= self._allowed_mps(now_s) + _SLACK_MPS:
            return
        # A law that starts or restarts begins at the flown velocity, reduced to its limits.
        factor = self._speed / max(self._speed, math.hypot(*flown))
        change = math.hypot(velocity[0] - factor * flown[0], velocity[1] - factor * flown[1])
        most = self._acceleration * _LONGEST_S + _NOISE_MPS
        if change > most:
            raise Broken(Rule.CHANGE, f"{change:.2f} m/s from the flown velocity; allowed: up to {most:.2f}")

    def _check_height(self, position: GlobalPosition, down: float, now_s: float) -> None:
        flown = self._velocity[2]
        height = position.height_above_home_m - self._age_s(position, now_s) * flown
        floor, ceiling = self._limits.floor_height_m, self._limits.ceiling_height_m
        if floor is not None and self._too_fast(_FLOOR, height - floor + _HEIGHT_SLACK_M, down, flown, now_s):
            raise Broken(Rule.HEIGHT, f"{down:.2f} m/s down at {height:.1f} m, the floor is at {floor:g} m")
        if ceiling is not None and self._too_fast(
            _CEILING, ceiling - height + _HEIGHT_SLACK_M, -down, -flown, now_s
        ):
            raise Broken(
                Rule.HEIGHT, f"{-down:.2f} m/s up at {height:.1f} m, the ceiling is at {ceiling:g} m"
            )

    def _too_fast(
        self, bound: int, room_m: float, towards_mps: float, flown_mps: float, now_s: float
    ) -> bool:
        """Whether a speed towards a bound is too high for the room left and the vehicle is not slowed down.

        `tests/companion/gate/test_proofs.py` proves that a speed that passes because of its room can be
        stopped in that room, and bounds how long a vehicle can pass as being slowed down.
        """
        needed_m = towards_mps * (_REACTION_S + 0.5 * towards_mps / self._acceleration)
        return (
            towards_mps > _SLACK_MPS
            and needed_m > room_m
            and self._faster(bound, towards_mps, flown_mps, now_s)
        )

    def _faster(self, bound: int, towards_mps: float, flown_mps: float, now_s: float) -> bool:
        """Whether the vehicle is not being slowed down enough since it was first too fast."""
        since_s, begun_mps, last_s = self._slowed.get(bound, (now_s, flown_mps, -math.inf))
        if now_s - last_s > _BRAKED_S:
            since_s, begun_mps = now_s, flown_mps
        self._slowed[bound] = since_s, begun_mps, now_s
        slowest = min(flown_mps, begun_mps - _BRAKES * self._acceleration * (now_s - since_s))
        return towards_mps > slowest - _BRAKING * self._acceleration

    # ------------------------------------------------------------ the fence

    def _age_s(self, position: GlobalPosition, now_s: float) -> float:
        return now_s - position.time_boot_s - self._offset_s

    def _place(self, position: GlobalPosition, now_s: float) -> tuple[float, float]:
        """North and east in the local frame (m), extrapolated to `now_s`."""
        age_s = self._age_s(position, now_s)
        return self._here[0] + age_s * self._velocity[0], self._here[1] + age_s * self._velocity[1]

    def _check_fence(self, north: float, east: float, here: tuple[float, float], now_s: float) -> None:
        speed = math.hypot(north, east)
        needed_m = speed * (_REACTION_S + 0.5 * speed / self._acceleration)  # the most in any direction
        if math.dist(here, self._walls_at) > _MOVED_M:
            self._walls, self._walls_at = self._measured_walls(here), here
        needed_m += math.dist(here, self._walls_at)  # An edge may be this much nearer than measured.
        for area, first, edges, rooms, least_m in self._walls:
            if least_m > needed_m:
                continue
            if _inside(edges, *here) != area.inclusion:
                room, un, ue = min(_nearest(edge, *here) for edge in edges)
                outward = -(north * un + east * ue)
                flown = -(self._velocity[0] * un + self._velocity[1] * ue)
                if self._too_fast(first, 0.0, outward, flown, now_s):
                    raise Broken(Rule.FENCE, f"{outward:.2f} m/s outward, {room:.1f} m outside the fence")
                continue
            for number, (edge, measured_m) in enumerate(zip(edges, rooms, strict=True), start=first):
                if measured_m > needed_m:
                    continue
                room, un, ue = _nearest(edge, *here)
                towards = north * un + east * ue
                flown = self._velocity[0] * un + self._velocity[1] * ue
                if self._too_fast(number, room, towards, flown, now_s):
                    raise Broken(Rule.FENCE, f"{towards:.2f} m/s towards a fence wall {room:.1f} m away")

    def _measured_walls(self, here: tuple[float, float]) -> list[Wall]:
        assert self._frame is not None
        walls: list[Wall] = []
        first = 0
        for area in self._areas:
            corners = [self._frame.to_ned(lat, lon, self._frame.alt_m)[:2] for lat, lon in area.points]
            edges = [(*a, *b) for a, b in pairwise([*corners, corners[0]])]
            if area.radius_m is not None:
                edges = [(*corners[0], area.radius_m, math.nan)]
            rooms = [_nearest(edge, *here)[0] for edge in edges]
            kept = _inside(edges, *here) == area.inclusion
            walls.append((area, first, edges, rooms, min(rooms) if kept else -1.0))
            first += len(edges)
        return walls


def _inside(edges: list[Edge], n: float, e: float) -> bool:
    if len(edges) == 1:
        return math.hypot(n - edges[0][0], e - edges[0][1]) < edges[0][2]
    odd = False
    for an, ae, bn, be in edges:
        if (ae > e) != (be > e) and n < an + (e - ae) / (be - ae) * (bn - an):
            odd = not odd
    return odd


def _nearest(edge: Edge, n: float, e: float) -> tuple[float, float, float]:
    """Distance (m) to the nearest point of an edge or circle, and its direction (unit north, east)."""
    an, ae, bn, be = edge
    if math.isnan(be):
        dn, de = n - an, e - ae
        away = math.hypot(dn, de)
        if away < 1e-6:
            return bn, 1.0, 0.0
        sign = math.copysign(1.0 / away, bn - away)
        return abs(bn - away), sign * dn, sign * de
    sn, se = bn - an, be - ae
    length2 = sn * sn + se * se
    share = min(max(((n - an) * sn + (e - ae) * se) / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
    dn, de = an + share * sn - n, ae + share * se - e
    room = math.hypot(dn, de)
    return (room, dn / room, de / room) if room > 1e-6 else (0.0, 0.0, 0.0)
