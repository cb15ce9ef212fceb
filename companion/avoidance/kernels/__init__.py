"""The numeric part of the law, compiled by numba in double precision. The functions also run uncompiled.

- `decide`: one decision, from the own state, the path and the neighbours to the command. Start here.
- `settings`: what a decision takes and gives: settings, own state, memory, result.
- `timelines`: the timed path, and the history of own velocities.
- `neighbours`: the past of tracks, and the planes of neighbours.
- `escape`: the plane for an aircraft that a sensor sees too late for a plane of ORCA.
- `crewed`: the velocity that stays well clear of crewed traffic.
- `powers`: whether received powers agree with reported positions.
- `walls`, `fence_planes`: the walls of a fence, and their planes.
- `programs`: the half-space of ORCA and the linear programs.
- `hard_planes`: the command within one period's change that satisfies the hard planes.
- `vectors`: vectors, planes and tables of them.
- `compiled`: how all of them are compiled and cached.

No function allocates: arrays are owned by the caller. What is called from Python at every step
(`decide_plain`, `note_velocity`, `note_track`, `path_position`, `path_nearest`) takes and returns plain
tuples, because numba takes 2 us to take over or to return a named one. `warm_up` calls all that Python calls
in flight.
"""

from companion.avoidance.kernels.compiled import FUNCTIONS, SOURCES
from companion.avoidance.kernels.crewed import crewed_wish, turn_rate
from companion.avoidance.kernels.decide import (
    BOUNDARY_LAG_S,
    ON_PLANE_MPS,
    decide,
    decide_plain,
    down_speeds,
    on_plane,
    warm_up,
)
from companion.avoidance.kernels.fence_planes import (
    BRAKES,
    DOWN_SPEEDS,
    FENCE_MARGIN_M,
    LAG_S,
    STOP_LAG_S,
    closing,
    plane_rows,
)
from companion.avoidance.kernels.hard_planes import Bounds, in_reach, limit
from companion.avoidance.kernels.neighbours import (
    GROWTH_MOST_MPS,
    KEPT_MORE,
    KEPT_S,
    NO_PAST,
    Other,
    Past,
    Seen,
    all_within,
    kept_for,
    note_track,
    other_at,
    past_at,
    put_other,
    put_past,
    seen_at,
    silent_after,
)
from companion.avoidance.kernels.powers import (
    BESIDE,
    HYPOTHESES,
    OFFSETS,
    note_power,
    suspicion,
)
from companion.avoidance.kernels.priority import SLACK_MPS, Asked, put_last, solve_in_order
from companion.avoidance.kernels.programs import Aim, half_space, solve
from companion.avoidance.kernels.settings import (
    DMUCA,
    NONE,
    OTHER_COLUMNS,
    PAPER,
    SEEN_COLUMNS,
    Decision,
    Own,
    Settings,
    State,
    Workspace,
    first_state,
    settings_at,
    workspace,
)
from companion.avoidance.kernels.timelines import (
    HISTORY_SAMPLES,
    History,
    Path,
    note_velocity,
    own_velocity_at,
    path_nearest,
    path_position,
    point_at,
)
from companion.avoidance.kernels.vectors import (
    Plane,
    Point,
    Triple,
    Vector,
    closest,
    dot,
    minus,
    plane_at,
    put_plane,
)
from companion.avoidance.kernels.walls import (
    IN_CIRCLE,
    IN_POLYGON,
    NO_WALLS,
    OUT_OF_CIRCLE,
    OUT_OF_POLYGON,
    Wall,
    after_area,
    crosses,
    inside,
    nearest_of_wall,
    wall_at,
)

__all__ = [
    "BESIDE",
    "BOUNDARY_LAG_S",
    "BRAKES",
    "DMUCA",
    "DOWN_SPEEDS",
    "FENCE_MARGIN_M",
    "FUNCTIONS",
    "GROWTH_MOST_MPS",
    "HISTORY_SAMPLES",
    "HYPOTHESES",
    "IN_CIRCLE",
    "IN_POLYGON",
    "KEPT_MORE",
    "KEPT_S",
    "LAG_S",
    "NONE",
    "NO_PAST",
    "NO_WALLS",
    "OFFSETS",
    "ON_PLANE_MPS",
    "OTHER_COLUMNS",
    "OUT_OF_CIRCLE",
    "OUT_OF_POLYGON",
    "PAPER",
    "SEEN_COLUMNS",
    "SLACK_MPS",
    "SOURCES",
    "STOP_LAG_S",
    "Aim",
    "Asked",
    "Bounds",
    "Decision",
    "History",
    "Other",
    "Own",
    "Past",
    "Path",
    "Plane",
    "Point",
    "Seen",
    "Settings",
    "State",
    "Triple",
    "Vector",
    "Wall",
    "Workspace",
    "after_area",
    "all_within",
    "closest",
    "closing",
    "crewed_wish",
    "crosses",
    "decide",
    "decide_plain",
    "dot",
    "down_speeds",
    "first_state",
    "half_space",
    "in_reach",
    "inside",
    "kept_for",
    "limit",
    "minus",
    "nearest_of_wall",
    "note_power",
    "note_track",
    "note_velocity",
    "on_plane",
    "other_at",
    "own_velocity_at",
    "past_at",
    "path_nearest",
    "path_position",
    "plane_at",
    "plane_rows",
    "point_at",
    "put_last",
    "put_other",
    "put_past",
    "put_plane",
    "seen_at",
    "settings_at",
    "silent_after",
    "solve",
    "solve_in_order",
    "suspicion",
    "turn_rate",
    "wall_at",
    "warm_up",
    "workspace",
]  # fmt: skip
