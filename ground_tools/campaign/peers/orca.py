"""ORCA in three dimensions as published, or with other radii, in compiled code.

J. van den Berg, S. J. Guy, M. Lin, D. Manocha, "Reciprocal n-body collision avoidance" (2011). Half-spaces
and linear programs are the companion's kernels, which agree with the authors' library RVO2-3D on its own
cases (`ground-tools orca check`), and which also define the direction in an exact head-on encounter, in which
that library has none. Everything else is as published: planes around the present own velocity, a
responsibility of one half, a constant radius, no turn to the right, no margin, and no limit on what one
neighbour may demand.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.kernels.neighbours import Volume, volume_of
from companion.avoidance.kernels.vectors import length
from ground_tools.campaign.compiled import compiled
from ground_tools.campaign.flight import Mind, loop_of, state_of
from ground_tools.campaign.outcome import Log, Tally
from ground_tools.campaign.peers.common import AVOIDS, FIRST, beside, commanded, following, report
from ground_tools.campaign.powers import Powers
from ground_tools.campaign.vehicles import Fleet
from ground_tools.campaign.world import Conditions

_SHARE = 0.5


class Orca(NamedTuple):
    """Parameters."""

    radius_m: float
    """Combined radius R of both aircraft."""
    horizon_s: float
    """Time horizon tau."""
    overlap_s: float
    """Time in which to leave an overlapping volume. RVO2-3D uses its time step."""
    predicted: float
    """1: positions are extrapolated by the age of the message; 0: they are those of the message."""
    own_volume: float
    """1: the volume is that of the companion's own law instead of a ball of `radius_m`."""
    growth: float
    """1: that volume also grows with a track's own prediction errors."""


_compiled = compiled()


@_compiled
def parameters(settings: Floats, i: int) -> Orca:
    """The parameters of aircraft i."""
    p = settings[i, FIRST:]
    return Orca(p[0], p[1], p[2], p[3], p[4], p[5])


@_compiled
def plane(away: k.Vector, velocity: k.Vector, own: k.Vector, volume: Volume, overlap_s: float) -> k.Plane:
    """The half-space of allowed velocities for one neighbour.

    Args:
        away: its position minus ours, m.
        velocity: its velocity, m/s.
        own: the own velocity, m/s.
    """
    z = volume.scale
    normal, s = k.half_space(
        k.Vector(away.n, away.e, z * away.d),
        k.Vector(own.n - velocity.n, own.e - velocity.e, z * (own.d - velocity.d)),
        volume.radius, volume.horizon_s, overlap_s,
    )  # fmt: skip
    mapped = k.Vector(normal.n, normal.e, z * normal.d)
    size = length(mapped)
    least = (k.dot(mapped, own) + _SHARE * s) / size
    return k.Plane(k.Vector(mapped.n / size, mapped.e / size, mapped.d / size), least)


@_compiled
def decide(
    mind: Mind,
    i: int,
    count: int,
    own: k.Own,
    path: k.Path,
    fence: Floats,
    settings: Floats,
    law: k.Settings,
    work: k.Workspace,
) -> k.Decision:
    """The decision function; see `flight.Decide`."""
    state = state_of(mind, i)
    plain = following(mind, i, own, path, fence, law, work)
    if settings[i, AVOIDS] == 0.0:
        return plain
    p, conflict = parameters(settings, i), False
    for j in range(count):
        other = k.other_at(mind.neighbours, j)
        away, velocity = beside(other, own, p.predicted != 0.0)
        volume = Volume(p.radius_m, 1.0, p.horizon_s)
        if p.own_volume != 0.0:
            grown = volume_of(other, own, law)
            volume = Volume(grown.radius, grown.scale, p.horizon_s)
        asked = plane(away, velocity, own.velocity, volume, p.overlap_s)
        k.put_plane(work.planes, j, asked.normal, asked.least)
        wish, z = k.minus(plain.wanted, velocity), volume.scale
        flat = k.Vector(away.n, away.e, z * away.d)
        _, near2 = k.closest(flat, k.Vector(wish.n, wish.e, z * wish.d), volume.horizon_s)
        enters = near2 < volume.radius * volume.radius
        conflict = conflict or enters
        report(work.seen, j, own, plain.wanted, away, velocity, volume.radius, enters)
    feasible, found = k.solve(work.planes, 0, count, law.speed_mps, 0.0, plain.wanted, work.scratch)
    return commanded(plain, found, feasible, conflict, own, law, state)


@_compiled
def fly(
    rng: np.random.Generator,
    world: Conditions,
    path_times: Floats,
    path_points: Floats,
    fence: Floats,
    settings: Floats,
    kinds: Floats,
    trace: Floats,
    log: Log,
    pairs: Floats,
    result: Floats,
    craft: Fleet,
    tally: Tally,
    mind: Mind,
    work: k.Workspace,
    dark: int,
    dark_from: float,
    powers: Powers,
    power_rng: np.random.Generator,
) -> None:
    """The loop of this law; see `flight.Loop`."""
    loop_of(
        decide, rng, world, path_times, path_points, fence, settings, kinds, trace, log, pairs, result, craft,
        tally, mind, work, dark, dark_from, powers, power_rng,
    )  # fmt: skip
