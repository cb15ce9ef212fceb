"""Flies attacks on fences, to find whether the behaviour of neighbours can make an aircraft cross its fence.

The vehicle is that of the campaign: it follows a velocity command with a lag and a limited acceleration. Some
flights begin in a state from which no manoeuvre within the acceleration limit stays inside. Their crossings
are counted separately.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance import walls
from companion.avoidance.law import Law, Situation
from companion.config import AvoidanceConfig
from companion.events import FenceArea
from ground_tools.campaign.fence_attacks import FRAME, OTHERS, WORLD, Encounter, Others, Traffic, draw, vec
from ground_tools.campaign.outcome import beyond

_PERIOD_STEPS = 2
_FLOWN_S = 45.0
_TRIES = 400
_AIMS = 48
_TURNS = 9


class Row(msgspec.Struct, frozen=True):
    """Outcome of one attack."""

    seed: int
    others: Others
    shape: str
    crossed_m: float
    """Largest distance beyond a border, from true positions; 0 if it never crossed."""
    error_m: float
    """Largest horizontal navigation error."""
    further_m: float
    """For a flight that begins outside: how much farther out it went than its starting point."""
    back_s: float
    """For a flight that begins outside: time until it was inside; infinite if it never was."""
    could_stop: bool
    """Whether it could have stayed inside by stopping straight ahead at the acceleration limit from the state
    in which it was taken over. Computed only for flights that begin inside and cross; otherwise False."""
    avoidable: bool
    """Whether an acceleration in some direction at the limit, followed by a stop, would have stayed inside
    from that state. Computed only for flights that begin inside and cross; otherwise False."""

    @property
    def over_m(self) -> float:
        """Distance beyond a border minus the navigation error; 0 or less means no crossing."""
        return self.crossed_m - self.error_m if self.crossed_m > 0.0 else 0.0


def fly(seed: int, *, noisy: bool = False, outside: bool = False) -> Row:
    """Draw and fly one attack.

    Args:
        noisy: simulate the campaign's GNSS error.
        outside: the flight begins beyond a border, and ghosts push the aircraft further out.
    """
    rng = np.random.default_rng([seed, 11, noisy, outside])
    one = draw(rng, noisy=noisy, outside=outside)
    return _fly(seed, one, rng)


def _fly(seed: int, one: Encounter, rng: np.random.Generator) -> Row:
    fence = walls.walls_of(one.areas, FRAME, one.path, one.sigma_m)
    law = Law(AvoidanceConfig(), one.limits, one.path, fence)
    step, lag = WORLD.step_s, WORLD.lag_s
    position = np.array(one.path.position(one.start_s))
    velocity = np.array(one.path.velocity(one.start_s))
    if one.out_m > 0.0:
        position, velocity = _displaced(rng, fence, position, one.out_m), np.zeros(3)
    start = position.copy(), velocity.copy()
    traffic = Traffic(rng, one, fence)
    command, error = velocity.copy(), rng.normal(0.0, 1.0, 3) * one.sigma_m
    keep = math.exp(-step / WORLD.sigma_memory_s)
    began = beyond(fence, position[0], position[1])
    farthest, largest, back = 0.0, 0.0, math.inf
    for tick in range(round(_FLOWN_S / step)):
        now = one.start_s + tick * step
        if tick % _PERIOD_STEPS == 0:
            others = traffic.heard(now, position, velocity)
            measured = vec(position + error)
            view = Situation(
                now, now, measured, vec(velocity), one.sigma_m, others, one.floor_down_m, one.ceiling_down_m
            )
            command = np.array(law.decide(view).chosen_ned_mps)
        position, velocity = _moved(position, velocity, command, lag, one.acceleration_mps2, step)
        out = beyond(fence, position[0], position[1])
        farthest = max(farthest, out)
        largest = max(largest, math.hypot(error[0], error[1]))
        if out == 0.0 and back == math.inf:
            back = now + step - one.start_s
        if one.sigma_m > 0.0:
            error = keep * error + math.sqrt(1.0 - keep * keep) * one.sigma_m * rng.normal(0.0, 1.0, 3)
    asked = farthest > 0.0 and one.out_m == 0.0
    return Row(
        seed=seed,
        others=one.others,
        shape=_shape(one.areas),
        crossed_m=farthest,
        error_m=largest,
        further_m=max(farthest - began, 0.0),
        back_s=back,
        could_stop=asked and _avoidable(one, fence, *start, turns=1),
        avoidable=asked and _avoidable(one, fence, *start, turns=_TURNS),
    )


def _moved(
    position: Floats, velocity: Floats, command: Floats, lag: float, acceleration: float, step: float
) -> tuple[Floats, Floats]:
    """Position and velocity after one step of the campaign's vehicle (`vehicles.move`); arrays of shape
    (..., 3)."""
    answer = (command - velocity) / lag
    size = np.linalg.norm(answer, axis=-1, keepdims=True)
    answer = answer * np.minimum(1.0, acceleration / np.maximum(size, 1e-12))
    return position + (velocity + 0.5 * step * answer) * step, velocity + step * answer


def _displaced(rng: np.random.Generator, fence: Floats, position: Floats, out_m: float) -> Floats:
    """A random point beyond some border by at most `out_m`; the given position if none was found."""
    for _ in range(_TRIES):
        wall = k.Wall(*fence[int(rng.integers(0, len(fence)))].tolist())
        a, b = np.array([wall.n, wall.e]), np.array([wall.end_n, wall.end_e])
        if wall.kind >= k.IN_CIRCLE:
            bearing = rng.uniform(0.0, 2.0 * math.pi)
            sign = 1.0 if wall.kind == k.IN_CIRCLE else -1.0
            far = wall.radius_m + sign * out_m
            place = a + far * np.array([math.cos(bearing), math.sin(bearing)])
        else:
            normal = np.array([-(b - a)[1], (b - a)[0]]) / np.linalg.norm(b - a)
            place = a + rng.uniform(0.0, 1.0) * (b - a) + rng.choice([-1.0, 1.0]) * out_m * normal
        if 0.0 < beyond(fence, place[0], place[1]) <= out_m + 1e-6:
            return np.array([*place, position[2]])
    return position


def _avoidable(one: Encounter, fence: Floats, position: Floats, velocity: Floats, *, turns: int) -> bool:
    """Whether accelerating in some direction at the limit for a time, and then stopping, stays inside.

    Args:
        turns: number of durations that are tried; with 1, only stopping at once is tried.
    """
    lag, step = WORLD.lag_s, WORLD.step_s
    longest = 1.5 * float(np.linalg.norm(velocity)) / one.limits.max_acceleration_mps2
    aims, times = np.meshgrid(
        np.linspace(0.0, 2.0 * math.pi, _AIMS, endpoint=False), np.linspace(0.0, 1.0, turns) * longest
    )
    aim = np.stack([np.cos(aims.ravel()), np.sin(aims.ravel()), np.zeros(aims.size)], axis=1)
    until, change = times.ravel()[:, None], one.limits.max_acceleration_mps2 * step
    p, v, c = (np.repeat(x[None], len(aim), axis=0) for x in (position, velocity, velocity))
    alive = np.ones(len(aim), bool)
    for tick in range(round((longest * 2.5 + 5.0) / step)):
        size = np.linalg.norm(c, axis=1, keepdims=True)
        stop = -c * np.minimum(1.0, change / np.maximum(size, 1e-12))
        c = c + np.where(tick * step < until, change * aim, stop)
        p, v = _moved(p, v, c, lag, one.acceleration_mps2, step)
        for i in np.flatnonzero(alive):
            alive[i] = beyond(fence, p[i, 0], p[i, 1]) == 0.0
        if not alive.any():
            return False
    return True


def _shape(areas: Sequence[FenceArea]) -> str:
    names = []
    for area in areas:
        what = "circle" if area.radius_m is not None else f"polygon{len(area.points)}"
        names.append(("in " if area.inclusion else "out ") + what)
    return " + ".join(names)


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Summary of many attacks, by the behaviour of the neighbours.

    A crossing counts if it is farther than the navigation error. Crossings are divided by the state in which
    the flight was taken over: stopping would have stayed inside, only another manoeuvre would have, or
    nothing would.
    """
    found: dict[str, Any] = {"runs": len(rows)}
    for others in OTHERS:
        some = [row for row in rows if row.others == others]
        over = [row for row in some if row.over_m > 0.0]
        stop = [row for row in over if row.could_stop]
        swerve = [row for row in over if row.avoidable and not row.could_stop]
        found[others] = {
            "runs": len(some),
            "crossed_though_it_could_stop": len(stop),
            "worst_though_it_could_stop_m": max((row.over_m for row in stop), default=0.0),
            "crossed_but_for_a_swerve": len(swerve),
            "worst_but_for_a_swerve_m": max((row.over_m for row in swerve), default=0.0),
            "crossed_unavoidably": len(over) - len(stop) - len(swerve),
            "worst_seed": max(stop + swerve, key=lambda row: row.over_m).seed if stop or swerve else None,
        }
    return found


def summary_outside(rows: Sequence[Row]) -> dict[str, Any]:
    """Summary of many attacks that begin outside."""
    further = sorted(row.further_m for row in rows)
    back = [row.back_s for row in rows if math.isfinite(row.back_s)]
    return {
        "runs": len(rows),
        "median_further_m": float(np.median(further)),
        "further_at_99_percent_m": float(np.quantile(further, 0.99)),
        "max_further_m": further[-1],
        "median_back_s": float(np.median(back)) if back else None,
        "not_back": len(rows) - len(back),
        "worst_seed": max(rows, key=lambda row: row.further_m).seed,
    }


def markdown(found: dict[str, Any]) -> str:
    """The result of `summary` as a table."""
    lines = [
        "| neighbours | flights | crossed though it could stop | worst, m | crossed but for a swerve "
        "| worst, m | crossed unavoidably | worst seed |",
        "|" + 8 * "---|",
    ]
    for others in OTHERS:
        one = found[others]
        lines.append(
            f"| {others} | {one['runs']:,} | {one['crossed_though_it_could_stop']:,} "
            f"| {one['worst_though_it_could_stop_m']:.2f} | {one['crossed_but_for_a_swerve']:,} "
            f"| {one['worst_but_for_a_swerve_m']:.2f} | {one['crossed_unavoidably']:,} "
            f"| {_or_dash(one['worst_seed'])} |"
        )
    return "\n".join([*lines, ""])


def markdown_outside(found: dict[str, Any]) -> str:
    """The result of `summary_outside` as a table."""
    back_s = None if found["median_back_s"] is None else f"{found['median_back_s']:.1f}"
    return (
        "| flights | farther out: median, m | 99 %, m | most, m | back inside after (median), s | not back "
        "| worst seed |\n"
        f"|{7 * '---|'}\n"
        f"| {found['runs']:,} | {found['median_further_m']:.2f} | {found['further_at_99_percent_m']:.2f} "
        f"| {found['max_further_m']:.2f} | {_or_dash(back_s)} | {found['not_back']:,} "
        f"| {found['worst_seed']} |\n"
    )


def _or_dash(value: object) -> str:
    return "-" if value is None else str(value)
