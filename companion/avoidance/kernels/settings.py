"""Input and output of a decision apart from tables: settings, own state, memory and result of a law."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.arrays import Floats
from companion.avoidance.kernels.compiled import compiled
from companion.avoidance.kernels.fence_planes import plane_rows
from companion.avoidance.kernels.vectors import PLANE_COLUMNS, Vector

DMUCA, PAPER, NONE = 0.0, 1.0, 2.0
"""Laws."""
DEMAND = 2.0
"""Most that one neighbour's plane may require, as a multiple of the greatest speed."""
OTHER_COLUMNS, SEEN_COLUMNS = 19, 9
"""Number of fields of `Other` and of `Seen`."""
STEPS, AHEAD_COLUMNS = 16, 8
"""Moments for which crewed traffic is predicted, and what is written of each (`crewed`)."""


class Settings(NamedTuple):
    """Settings of one aircraft's law, all of them floats; its row in a table of settings."""

    law: float
    """DMUCA, PAPER or NONE."""
    radius_m: float
    """Sum of both conflict radii."""
    least_margin_m: float
    sigmas: float
    """Margin in standard deviations of the relative error."""
    quantum_mps: float
    """Error due to the resolution of a sent velocity."""
    growth: float
    """1: growth and silence of tracks are used, 0: they are not."""
    crewed_m: float
    """Separation from crewed traffic."""
    crewed_vertical: float
    """`vertical` for crewed traffic."""
    crewed_horizon_s: float
    """`horizon_s` for crewed traffic."""
    vertical: float
    """Factor on vertical distances: below 1 the volume is taller than wide."""
    horizon_s: float
    """tau."""
    overlap_s: float
    """Time in which to leave an overlapping volume."""
    look_s: float
    """Window of the conflict test."""
    right_rad: float
    """Turn to the right when in conflict."""
    speed_mps: float
    """Greatest speed."""
    climb_mps: float
    """Greatest climb."""
    descent_mps: float
    """Greatest descent."""
    acceleration_mps2: float
    """Greatest change of the command."""
    period_s: float
    """Time between two decisions."""
    recovery_s: float
    """T: time to close the gap to the path's point."""
    turn_s: float
    """Time before and after a corner of the path in which it is rounded, above 0."""
    quiet: float
    """Cycles without conflict before the published law recovers."""
    regained_m: float
    """Distance to the path's point that counts as back on the path."""
    catch_up_s: float
    """A gap along the path that takes longer than this to close delays the path; 0: never."""


class Own(NamedTuple):
    """The own state; NED, m and m/s."""

    position: Vector
    velocity: Vector
    sigma_m: float
    """Error of the position for each horizontal axis."""
    now_s: float
    path_time_s: float
    """The same instant on the path's clock."""
    floor_d: float
    """NED down of the floor; infinity: none."""
    ceiling_d: float
    """NED down of the ceiling; -infinity: none."""


class State(NamedTuple):
    """Memory of a law from one decision to the next, besides the history of own velocities."""

    command: Vector
    """The last command, m/s."""
    time_s: float
    """Its time; NaN before the first one."""
    quiet: float
    """Cycles without conflict."""
    delay_s: float
    """Delay of the path."""
    samples: int
    """Number of samples in the history of own velocities."""


class Workspace(NamedTuple):
    """Tables that a decision writes; made by `workspace`."""

    planes: Floats
    scratch: Floats
    """Working memory, as large as `planes`."""
    seen: Floats
    """Report on each neighbour, with the columns of `Seen`."""
    asked: Floats
    """(neighbours, 2, 4): plane of each neighbour, and plane for the place where a silent track may have
    stopped (0 if there is none)."""
    ahead: Floats
    """(neighbours, STEPS, AHEAD_COLUMNS): predictions of crewed traffic."""


class Decision(NamedTuple):
    """Result of a decision; NED, m/s."""

    chosen: Vector
    """The command."""
    wanted: Vector
    """Velocity that the aircraft would fly without neighbours."""
    solved: Vector
    """Velocity that the law would command without a limit on its change."""
    feasible: bool
    """Whether every plane is satisfied."""
    conflict: bool
    """Whether the wanted velocity would enter a volume."""
    recovering: bool
    """Whether the aircraft is on the way back to its path."""
    hard: int
    """Number of hard planes: least and greatest down speed, then those of the fence."""
    first: int
    """First row of planes that belongs to a neighbour."""
    at_least_down: bool
    """Whether the greatest climb bounds the velocity `solved`."""
    at_most_down: bool
    """Whether the greatest descent does."""
    at_fence: bool
    """Whether a hard plane of the fence does."""
    state: State


@compiled
def settings_at(settings: Floats, row: int) -> Settings:
    """A row of a table of settings."""
    r = settings[row]
    return Settings(
        r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], r[9], r[10], r[11], r[12], r[13], r[14], r[15],
        r[16], r[17], r[18], r[19], r[20], r[21], r[22], r[23],
    )  # fmt: skip


def first_state(settings: Settings, samples: int) -> State:
    """The state before the first decision. The published law begins as after a recovery.

    Args:
        samples: number of samples in the history of own velocities.
    """
    return State(Vector(0.0, 0.0, 0.0), math.nan, settings.quiet, 0.0, samples)


def workspace(walls: int, neighbours: int) -> Workspace:
    """Tables for decisions with up to this many walls and neighbours."""
    rows = plane_rows(walls, neighbours)
    return Workspace(
        planes=np.zeros((rows, PLANE_COLUMNS)),
        scratch=np.zeros((rows, PLANE_COLUMNS)),
        seen=np.zeros((neighbours, SEEN_COLUMNS)),
        asked=np.zeros((neighbours, 2, PLANE_COLUMNS)),
        ahead=np.zeros((neighbours, STEPS, AHEAD_COLUMNS)),
    )
