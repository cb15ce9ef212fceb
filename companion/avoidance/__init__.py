"""The avoidance law: from the own state, a timed path and the neighbours to one velocity command.

This is the paper's "decide": ORCA in three dimensions with margins for accuracy and message age, a return to
the timed path, geofence walls, and limits of speed, climb, descent and acceleration. `law.Law` is the
interface: it takes a `law.Situation` with `law.Neighbour`s and returns a `law.LawResult`. The numeric work is
done by functions compiled with numba in the package `kernels`. `trajectory.Trajectory` is the timed path, and
`alerts.Alerts` derives alert levels from the same data. Nothing here reads a clock, a socket or a random
source. This room may import the rooms before it in `ROOMS` of tests/test_imports.py. Start with `law.py`,
then `kernels/decide.py`; docs/avoidance.md explains the choices.
"""

from companion.avoidance.alerts import Alerts, Level
from companion.avoidance.law import Law, LawResult, Neighbour, Situation
from companion.avoidance.trajectory import Trajectory
from companion.avoidance.walls import walls_of

__all__ = [
    "Alerts",
    "Law",
    "LawResult",
    "Level",
    "Neighbour",
    "Situation",
    "Trajectory",
    "walls_of",
]
