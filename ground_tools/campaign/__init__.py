"""Monte Carlo campaigns: thousands of simulated encounters that measure what the avoidance law is worth.

A `cells.Cell` names one kind of encounter, flown by one law in one world; each seed gives one flight, and
`cells.Row` holds its outcome. `generators` draws the timed paths and `world` describes errors, messages and
gusts. `flight` flies a whole fleet in compiled code with the companion's own law, using `vehicles` for motion
and messages and `outcome` for the measurements. `twins` flies the cases in which two aircraft send one
identity, `peers` holds the laws of others, which `peer_comparison` compares, `scenarios` intruders on
missions and everyday traffic, which `scenario_measures` measures, and `fences` with `fence_attacks` tests
whether an aircraft can be pushed out of its fence. `command` is the command line, `runs` flies what is
missing and sums it up, `tables` produces the tables of docs/safety.md, and `run_folder` writes single flights
for `ground-tools inspect`. `encounters` meets crewed aircraft that are drawn from published models. Start
reading with `cells.fly`, then `flight.fly`.
"""
