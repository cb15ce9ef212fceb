"""Explanations of what an aircraft did: manoeuvres, the constraints behind them, and its Remote ID traffic.

`manoeuvres.find` returns every `Manoeuvre` of a record with its reason, command, outcome and alternatives.
`why.Explainer` recomputes the half-spaces of one logged decision with the avoidance law's own kernel, and
judges what else could have been flown; its results are `Look`, `HalfSpace` and `Alternative`. `air.gather`
compares the Remote ID messages that were sent with the legal minimum, and computes losses, latencies and ages
of what was received. All times are the aircraft's own `now_s`. Start reading in `manoeuvres.py`.
"""
