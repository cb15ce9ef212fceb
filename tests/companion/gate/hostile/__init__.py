"""`python -m tests.companion.gate.hostile`: a hostile program offers anything to the gate, in any state.

A history is one configuration, one vehicle and one program above the gate, all drawn at random: modes in any
order, arming, landing, parameters, fences, pauses in reading, silences and backlogs; and setpoints, mode
requests, other messages and garbage. `oracle` judges what has passed. In half of the histories the vehicle
is a point mass that flies what has passed, and its walls, floor and ceiling must hold. With `--through
system` the vehicle's bytes reach the gate through a whole companion (`CompanionSystem`), which is then
judged as well. `--history NUMBER` repeats one history. Exit status: 0 no rule was broken, 1 a rule was
broken, 2 wrong arguments.
"""
