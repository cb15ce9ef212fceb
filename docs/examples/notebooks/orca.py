# %% [markdown]
# # The ORCA solver
#
# Each neighbour forbids a half-space of velocities; the solver finds the velocity nearest to a wish that
# all half-spaces and the greatest speed allow. Vectors are north, east, down.
#
# We fly north at 5 m/s, and another aircraft 60 m ahead comes towards us at 5 m/s, 1 m to the east. The
# volume that must stay free has a radius of 10 m, and conflicts within 20 s count.

# %%
import numpy as np

from companion.avoidance import kernels
from companion.avoidance.kernels import Vector

own, other = Vector(5.0, 0.0, 0.0), Vector(-5.0, 0.0, 0.0)
place = Vector(60.0, 1.0, 0.0)
normal, short = kernels.half_space(place, kernels.minus(own, other), 10.0, 20.0, 0.2)
print([round(float(x), 3) for x in normal], round(float(short), 3))

# %% [markdown]
#     [-0.15, -0.989, 0.0] 1.502
#
# `normal` is the direction in which the relative velocity leaves the volume soonest, and `short` (m/s)
# says by how much. Each of the two aircraft takes a half of it (reciprocal): a row of the table of
# planes holds the normal, and the least component of our velocity along it.

# %%
planes = np.zeros((1, 4))
kernels.put_plane(planes, 0, normal, kernels.dot(normal, own) + 0.5 * short)
feasible, found = kernels.solve(planes, 0, 1, 5.0, 0.0, own, np.zeros_like(planes))
print(feasible, [round(float(x), 3) for x in found])

# %% [markdown]
#     True [4.887, -0.742, 0.0]
#
# With both aircraft at such a velocity, the relative velocity leaves the volume: the same half-space
# asks for no more.

# %%
both = kernels.minus(found, Vector(-found.n, -found.e, -found.d))
_, still = kernels.half_space(place, both, 10.0, 20.0, 0.2)
print(round(float(still), 3) <= 0.0)

# %% [markdown]
#     True
#
# `companion.avoidance.Law` makes such half-spaces from tracks, with margins for errors and for the age
# of messages ([law.md](../law.md) has the equations), and adds walls, limits and the way back to the
# path.
