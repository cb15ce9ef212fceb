"""Attackers: one forging transmitter against the companion's own core, in lock-step.

An own aircraft flies with the real `Companion` (tracks, law and authority) and meets honest aircraft, while
one transmitter with physical limits sends forged messages that a vector of parameters determines. `scene`
draws the encounter. `kinds` lists the attacks with their parameters, and `crowd`, `ghosts` and `copies`
compute the sent messages. `air` carries real frames with the signal strength of the channel model. `craft`
moves the aircraft, `flight` flies one scene, and `outcome` evaluates it from true positions only. `search`
looks for the worst attack with CMA-ES, and `kept` holds cases that are flown again. `tables` summarises the
results, and `command` is the command line. Start reading with `flight.fly`.
"""
