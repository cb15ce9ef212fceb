"""Independent last check of every byte that is sent to the vehicle.

The gate stands between the companion and the link. It sees every message of the vehicle in order of arrival
and lets only whole MAVLink frames pass that keep the rules of `rules.Rule`. It trusts no other part of the
companion: it learns what it needs from the vehicle's messages and from the frames that it has let pass, and
computes its bounds independently of the avoidance law. `gate.Gate` is the entry point; `mandate.Mandate`
tracks authority over the vehicle, and `bounds.Bounds` checks position, speed, height and fence. The position
of this room in the `ROOMS` list of `tests/test_imports.py` would allow more imports, but to stay independent
it uses only `autopilot` (mode tables and framing), `config`, `events` and `geometry`. Start with
`docs/gate.md` and `rules.py`, then read `gate.py`.
"""
