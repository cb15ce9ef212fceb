"""Encounters with crewed aircraft, drawn from the published Bayesian networks of MIT Lincoln Laboratory.

`model` reads a parameter file, `sampling` draws tracks from it, and `pairing` places a track so that it meets
our own aircraft. `flight` flies the encounter in compiled code with the companion's own law; `volumes` finds
near mid-air collisions and losses of well clear, and `ratios` compares encounters with and without avoidance.
`cells` puts these together for a seed, and `command` is the command line. Start reading with `cells.fly`.
docs/encounters.md explains the figures.
"""
