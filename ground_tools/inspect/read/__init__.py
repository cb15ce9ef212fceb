"""Readers for everything that `ground-tools inspect` and `export` can open.

Inputs are run folders, event records, vehicles' logs (.tlog, .bin, .ulg) and the true positions of simulated
vehicles.
The main types are `Run` and `AircraftRecord` (in `read_run`), `Facts` (the columns gathered from one record),
`TimeLine` (the common time of all aircraft), `Flown`, `Path` and `Separation` (positions in one frame and the
distances between aircraft), and `LinkHealth` (quality of the telemetry link). Nothing here draws or prints.
Start with `read_run.read_run`, then read `timeline.time_line` and `flown.flown`, which build on its result.
"""
