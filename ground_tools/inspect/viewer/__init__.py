"""Rerun recordings of runs: written from finished records, or live during a flight, and served to a browser.

`recording.write` writes a run to a .rrd file, and `live.follow` shows event records while they grow. Both
make a `Scene` (names, clocks, colours and the encounter) and give it to a `Writer`, which sends columns of
data to Rerun piece by piece. A `StepColumns` converts the steps of one aircraft to these columns, a
`Piece` at a time. `drawing` sends the columns, `blueprint` defines the initial layout of the views, `palette`
the colours, and `web` runs Rerun's web viewer on this machine only. Rerun is an optional dependency and is
imported on use. Start reading with `recording.write`.
"""
