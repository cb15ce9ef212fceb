"""Helpers that several desk tools share.

`workers.in_parallel` runs work in local processes, and `cluster.on_ray` does the same on a Ray cluster.
`kept_lines.Kept` stores results line by line, so that an interrupted run can be continued. `intervals`
computes 95 % confidence intervals, `figure` makes matplotlib figures in the project's style, and `progress`
shows a progress bar. `sources` finds the code on which a result depends, and `provenance` records it beside
the result.
"""
