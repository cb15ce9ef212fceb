"""Decides who flies the vehicle, and plans the path that is flown or guarded.

`table` lists the authority states (`State`) and the triggers that change them; read it first, then
`docs/authority.md`. `control.Control` runs the table: the core calls `Control.step` once per cycle and gets
back a `step.Step` with commands and perhaps a velocity. `readiness.Readiness` says why a vehicle may not be
taken yet, `modes.OurModes` tells our own mode changes from the pilot's, and `reasons.Reasons` has the words
for each change of state. A plan (protocol `plan.Plan`) supplies the path: `flown.FlownPlan` for a path that
the companion flies, `guard.GuardPlan` for a mission that the autopilot flies and the companion guards;
`handback.HandBack` returns a guarded vehicle to its mission. `influence` bounds how far and how long unproven
traffic may move the aircraft.

In this project, to take a vehicle is to take control of it, and traffic holds a vehicle while the companion
flies it because of that traffic. The velocity itself comes from the law in `companion.avoidance`, which knows
nothing of authority. This room may import the rooms before it in `ROOMS` of tests/test_imports.py.
"""
