"""Obstacles and aircraft that transmit nothing, as sensors aboard measure them.

`pose` says where and how turned the own vehicle was at a measurement. `seen` makes places in the local frame
of what a sensor reported, and groups them: an object (a pole, an aircraft) is one place, a surface (a wall) a
bounded number of them. `objects` follows objects over time, with their velocities; `surfaces` holds surfaces,
which stand still. `fusing` finds where a transmitted track and a sensed one are one aircraft.
`sensed.SensedTraffic` is all of it. Start with `sensed.py`.
"""

from companion.traffic.sensed.sensed import SensedTraffic

__all__ = ["SensedTraffic"]
