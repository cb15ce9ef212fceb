"""Export of runs for other software: tables, KML for Google Earth, and scenarios to fly again.

`export` implements the command `ground-tools export` and is the place to start reading. `tables` produces
rows of tracks, encounters, manoeuvres and alternatives in blocks, and writes them as CSV or Parquet. `kml`
writes paths and closest approaches for Google Earth. `topics` turns a run into messages with times and
topics, which `mcap` (with the schemas in `foxglove`) and `rosbag` write for robotics tools. `incident` turns
the closest approach as it was flown, or the timed paths as planned, into an `Incident`: a scenario for
`sitl-mocks demo --scenario`.
"""
