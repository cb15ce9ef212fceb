"""Monte Carlo campaigns: thousands of simulated encounters that measure the performance of the avoidance law.

A `cells.Cell` names one kind of encounter, flown by one law in one world; each seed gives one flight, and
`cells.Row` holds its outcome. `generators` draws the timed paths and `world` describes errors, messages and
gusts. `flight` flies a whole fleet in compiled code with the companion's own law, using `vehicles` for motion
and messages and `outcome` for the measurements. `twins` flies the cases in which two aircraft send one
identity. `peers` contains laws from other projects, which `peer_comparison` compares; `scenarios` contains
intruders on missions and everyday traffic, which `scenario_measures` measures. `fences` and `fence_attacks`
test whether neighbours can push an aircraft out of its fence, and `attacks` flies forging transmitters.
`encounters` draws crewed aircraft from published models, and `sensed` flies towards things that transmit
nothing. `command` is the command line, `runs` flies missing flights and sums up all, `tables` produces the
tables of docs/safety.md, and `run_folder` writes single flights for `ground-tools inspect`. Start reading
with `cells.fly`, then `flight.fly`.
"""
