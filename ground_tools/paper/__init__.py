"""Recomputes the paper's published figures and compares them with the paper's statements about them.

`command` is the command `ground-tools paper`. Its list `FIGURES` names two functions from `figures` for each
published figure: `report` gives the statements and numbers, and `draw` writes the picture. `report.Report` is
the common type of the results: `Statement` for published statements that hold or not, `Comparison` for
numbers next to published ones, `Numbers` for other tables. `study` evaluates the channel model for the
figures of the fixed modes. `methods`, `measured` and `delays` provide the delays of the learned and the fixed
methods. `closed_loop` and `city` are experiments that go beyond the paper. Start reading with `command.run`
and `report`.
"""
