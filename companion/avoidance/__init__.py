"""The avoidance law: from the own state, a timed path and the neighbours to one velocity command.

This is the paper's "decide": ORCA in three dimensions with margins for accuracy and message age, a return to
the timed path, geofence walls, and limits of speed, climb, descent and acceleration. `law.Law` is the
interface: it takes a `law.Situation` with `law.Neighbour`s and returns a `law.LawResult`. The numeric work is
done by functions compiled with numba in `kernels`, `programs`, `fence_planes` and `hard_planes`.
`trajectory.Trajectory` is the timed path, and `alerts.Alerts` derives alert levels from the same data.
Nothing here reads a clock, a socket or a random source. This room may import the rooms before it in `ROOMS`
(tests/test_imports.py), up to `config`; it uses `errors`, `geometry`, `events` and `config`. Start with
`law.py`, then `kernels.decide`; docs/avoidance.md explains the choices.
"""
