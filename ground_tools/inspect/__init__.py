"""Inspection and export of recorded runs: the commands `ground-tools inspect`, `picture` and `export`.

The subfolders follow the flow of the data. `read` opens run folders, event records and telemetry logs;
`explain` finds manoeuvres, the reasons for them, and Remote ID figures; `report` turns a run into figures,
text, an HTML page and plots; `viewer` writes Rerun recordings and shows them in a browser, also during a
flight; `export` writes tables, KML and scenarios. The central types are `read.read_run.Run` and
`read.flown.Flown`. Start reading in `command.py`, which implements `ground-tools inspect`. docs/inspect.md
describes the commands for users.
"""
