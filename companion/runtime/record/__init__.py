"""The record of a flight on disk: run folder with configuration, manifest, tlog, event record and summary.

`run_record.RunRecord` keeps the steps of the core (`companion.core`) and the bytes of the link until the
vehicle is known, and then hands all of them to a `recorder.FlightRecorder`, whose thread does the writing.
`disk.DiskFloor` keeps a minimum of disk space free and deletes old runs if the configuration allows it. A
failing disk ends the record, never the flight. As part of `companion.runtime` these files may import every
room before it (`ROOMS` in tests/test_imports.py); they need `config`, `errors` and `event_record`. Start
reading at `run_record.RunRecord`.
"""
