"""Where the vehicle is and how fast it may be asked to fly: the rules age and speed to fence.

All of it is written anew and more simply than in the law, with what a whole braking can do for a bound: the
law keeps margins inside of it, so that a command of the law reaches none of these.
"""

from __future__ import annotations

import math
from itertools import pairwise

from companion.config import Config
from companion.events import FenceArea, GlobalPosition, Parameter, VehicleParameters
from companion.gate.rules import Broken, Rule
from companion.geometry import LocalFrame, Vec3

_SLACK_MPS = 1e-3
"""A setpoint travels as 32-bit floats."""
_NOISE_MPS = 1.0
"""What the velocity that is flown may be measured wrong by, and change by between two messages."""
_REACTION_S = 0.5
_BRAKING, _BRAKES = 0.05, 0.9
"""A vehicle that is commanded slower than it flies, by what so much of its acceleration does in a second, and
from then on ever slower with so much of it, is being slowed down."""
_BRAKED_S = 1.0
"""Who was not too fast for so long begins anew."""
_HEIGHT_SLACK_M = 1.0
_FLOOR, _CEILING = -1, -2
_LONGEST_S = 1.0
_LATE_S = 0.5
_DRIFT = 1e-3
_CLOCKLESS_S = 10.0

_GROUND_MPS = 2.0

Edge = tuple[float, float, float, float]
"""North and east of both ends (m); of a circle: of its middle, its radius, NaN."""


class Bounds:
    """What is known of the vehicle's place, of its limits and of what was commanded last."""

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
        """Our clock less the vehicle's: of its least delayed message."""
        self._boot_s = self._stamp_s = -math.inf
        """Newest time of the vehicle's clock: of a position, of any message."""
        self._frame: LocalFrame | None = None
        self._here = 0.0, 0.0
        self._walls: list[tuple[FenceArea, list[Edge]]] | None = None
        self._clear_m, self._clear_at = -1.0, (0.0, 0.0)
        """No wall is nearer than so far to that place."""
        self._slowed: dict[int, tuple[float, float, float]] = {}
        """Bound -> since when it is approached too fast, how fast that was, when it was so last."""
        self._last: Vec3 = (0.0, 0.0, 0.0)
        self._last_s = -math.inf
        self._budget_mps = 0.0

    # ------------------------------------------------------------ what the vehicle says

    def hear_clock(self, time_boot_s: float, now_s: float) -> None:
        """The vehicle's own clock, in any message that tells it."""
        if time_boot_s < self._stamp_s - 1.0:
            self._offset_s = self._stamp_s = math.inf  # it began anew
        passed_s = max(time_boot_s - self._stamp_s, 0.0) if self._stamp_s < math.inf else 0.0
        self._offset_s = min(now_s - time_boot_s, self._offset_s + _DRIFT * passed_s)
        self._stamp_s = time_boot_s if self._stamp_s == math.inf else max(time_boot_s, self._stamp_s)

    def hear_position(self, event: GlobalPosition, now_s: float) -> None:
        """GLOBAL_POSITION_INT, dated by the vehicle's own clock."""
        self.hear_clock(event.time_boot_s, now_s)
        if self._boot_s - 1.0 <= event.time_boot_s < self._boot_s:
            return  # overtaken
        self._boot_s = event.time_boot_s
        if self._frame is None:
            self._frame = LocalFrame(event.lat_deg, event.lon_deg, event.alt_msl_m)
        self._position, self._velocity = event, event.velocity_ned_mps
        self._here = self._frame.to_ned(event.lat_deg, event.lon_deg, event.alt_msl_m)[:2]

    def hear_parameters(self, event: VehicleParameters) -> None:
        """The vehicle's own limits; the lower of both counts."""

        def lower(configured: float, own: Parameter | None) -> float:
            return configured if own is None else min(configured, own.value)

        limits = self._limits
        self._speed = lower(limits.max_speed_mps, event.speed_mps)
        self._climb = lower(limits.max_climb_mps, event.climb_mps)
        self._descent = lower(limits.max_descent_mps, event.descent_mps)
        self._acceleration = lower(limits.max_acceleration_mps2, event.acceleration_mps2)

    def hear_fence(self, areas: tuple[FenceArea, ...]) -> None:
        """The vehicle's own fence, where it is to be kept."""
        if self._limits.fence == "vehicle":
            self._areas, self._walls, self._clear_m = areas, None, -1.0

    def late(self, now_s: float) -> bool:
        """By the vehicle's own clock, what is heard from it now may be old: it waited on the way. Where no
        message tells that clock for long, nothing is known against what is heard."""
        if math.isinf(self._stamp_s):
            return False
        return self._late_s < now_s - self._stamp_s - self._offset_s <= _CLOCKLESS_S

    @property
    def flies_fast(self) -> bool:
        """Whatever the vehicle says: it is not on the ground."""
        return math.hypot(*self._velocity) > _GROUND_MPS

    # ------------------------------------------------------------ what may leave

    def check(self, velocity: Vec3, now_s: float) -> None:
        """The rules age and speed to fence, for a finite velocity."""
        position = self._position
        if position is None or self._age_s(position, now_s) > self._stale_s:
            raise Broken(Rule.AGE, "the own position is not known or too old")
        north, east, down = velocity
        if north == east == down == 0.0:
            return
        speed = math.hypot(north, east, down)
        if speed > self._speed + _SLACK_MPS:
            raise Broken(Rule.SPEED, f"{speed:.2f} m/s, at most {self._speed:g}")
        if not -self._climb - _SLACK_MPS <= down <= self._descent + _SLACK_MPS:
            raise Broken(
                Rule.SPEED, f"{down:.2f} m/s down, {-self._climb:g} to {self._descent:g} are allowed"
            )
        self._check_change(velocity, now_s)
        self._check_height(position, down, now_s)
        if self._areas:
            self._check_fence(north, east, self._place(position, now_s), now_s)

    def left(self, velocity: Vec3, now_s: float) -> None:
        """A setpoint has left.

        `tests/companion/gate/test_proofs.py` proves that the changes of setpoints that pass by the last one
        add up, in t seconds, to no more than the acceleration allows in t + 1 s, and the slack.
        """
        changed = math.hypot(velocity[0] - self._last[0], velocity[1] - self._last[1])
        self._budget_mps = max(-_SLACK_MPS, self._allowed_mps(now_s) - changed)  # the slack counts once
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
        # A law that begins, or begins anew, begins at the velocity that is flown; not above its limits.
        speed = math.hypot(*flown)
        factor = min(1.0, self._speed / speed) if speed > 0.0 else 1.0
        change = math.hypot(velocity[0] - factor * flown[0], velocity[1] - factor * flown[1])
        most = self._acceleration * _LONGEST_S + _NOISE_MPS
        if change > most:
            raise Broken(Rule.CHANGE, f"{change:.2f} m/s from what is flown, at most {most:.2f}")

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
        """A speed towards a bound that cannot be stopped in the room left, of a vehicle that is not being
        slowed down.

        `tests/companion/gate/test_proofs.py` proves that what passes by its room is stopped in it, and how
        long what passes as slowed down can go on.
        """
        needed_m = towards_mps * (_REACTION_S + 0.5 * towards_mps / self._acceleration)
        return (
            towards_mps > _SLACK_MPS
            and needed_m > room_m
            and self._faster(bound, towards_mps, flown_mps, now_s)
        )

    def _faster(self, bound: int, towards_mps: float, flown_mps: float, now_s: float) -> bool:
        """The vehicle is not being slowed down; or not as it must be since it was too fast."""
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
        """North and east of the local frame, carried on to now (m)."""
        age_s = self._age_s(position, now_s)
        return self._here[0] + age_s * self._velocity[0], self._here[1] + age_s * self._velocity[1]

    def _check_fence(self, north: float, east: float, here: tuple[float, float], now_s: float) -> None:
        reach = self._speed * (_REACTION_S + 0.5 * self._speed / self._acceleration)
        if math.dist(here, self._clear_at) + reach < self._clear_m:
            return
        nearest_m, bound = math.inf, 0
        for area, edges in self._made_walls():
            near = [_nearest(edge, *here) for edge in edges]
            room_m, un, ue = min(near)
            if _inside(edges, *here) != area.inclusion:
                nearest_m = 0.0
                outward = -(north * un + east * ue)
                flown = -(self._velocity[0] * un + self._velocity[1] * ue)
                if self._too_fast(bound, 0.0, outward, flown, now_s):
                    raise Broken(Rule.FENCE, f"{outward:.2f} m/s further out, {room_m:.1f} m outside")
                bound += len(edges)
                continue
            nearest_m = min(nearest_m, room_m)
            for number, (room, un, ue) in enumerate(near, start=bound):
                towards = north * un + east * ue
                flown = self._velocity[0] * un + self._velocity[1] * ue
                if room < reach and self._too_fast(number, room, towards, flown, now_s):
                    raise Broken(Rule.FENCE, f"{towards:.2f} m/s towards a wall {room:.1f} m away")
            bound += len(edges)
        self._clear_m, self._clear_at = nearest_m, here

    def _made_walls(self) -> list[tuple[FenceArea, list[Edge]]]:
        frame = self._frame
        assert frame is not None
        if self._walls is None:
            self._walls = []
            for area in self._areas:
                corners = [frame.to_ned(lat, lon, frame.alt_m)[:2] for lat, lon in area.points]
                edges = [(*a, *b) for a, b in pairwise([*corners, corners[0]])]
                if area.radius_m is not None:
                    edges = [(*corners[0], area.radius_m, math.nan)]
                self._walls.append((area, edges))
        return self._walls


def _inside(edges: list[Edge], n: float, e: float) -> bool:
    if len(edges) == 1:
        return math.hypot(n - edges[0][0], e - edges[0][1]) < edges[0][2]
    odd = False
    for an, ae, bn, be in edges:
        if (ae > e) != (be > e) and n < an + (e - ae) / (be - ae) * (bn - an):
            odd = not odd
    return odd


def _nearest(edge: Edge, n: float, e: float) -> tuple[float, float, float]:
    """Distance (m) to the nearest point of an edge or circle, and the direction of it."""
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
