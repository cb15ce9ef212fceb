"""Encounters of several simulated aircraft, in virtual time and in real time.

A `scenario_file.Scenario` describes the aircraft, their paths, the air and the errors; `scenario` and `draw`
generate the paths of encounters. `lockstep.fly` flies a scenario in virtual time in one thread and returns a
`Run`, and `demo` is the command `sitl-mocks demo` around it. `swarm` is the command `sitl-mocks swarm`, which
runs every vehicle, every companion and the air as a process in real time. `verdict` derives separations and
deviations from the true positions, `awareness` evaluates the age of information, and `choosing` records the
chosen transports. Start reading with `lockstep.py`.
"""
