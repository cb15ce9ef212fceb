"""Obstacles and aircraft that transmit nothing, as sensors aboard measure them.

`pose` gives position and attitude of the own vehicle at a measurement. `seen` converts what a sensor reported
to places in the local frame, and groups them: an object (a pole, an aircraft) is one place, a surface (a
wall) a bounded number of them. `objects` tracks objects over time, with their velocities; `surfaces` holds
surfaces, which stand still. `fusing` finds where a transmitted track and a sensed one are the same aircraft.
`sensed.SensedTraffic` is all of it. Start with `sensed.py`.
"""

from companion.traffic.sensed.sensed import SensedTraffic

__all__ = ["SensedTraffic"]
