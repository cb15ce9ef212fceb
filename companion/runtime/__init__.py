"""The flight loop of `companion run`, and what the pure core needs around it: links, files, threads.

`flight.Flight` is the flight loop. It runs `companion.system.CompanionSystem`, which joins the core
(`companion.core`), the MAVLink link and the gate, and it owns the other types of this room: `radios.Radios`
(all configured radios as one), `watchdog.Watchdog`, `signing_key.KeptSigning` and
`stored_parameters.KeptSettings`. The subfolders hold the links to the autopilot (`links`), the run folder
(`record`) and the console and status outputs (`status`). This room decides nothing about how the aircraft
flies. It may import every other room of companion except `commands` and `__main__`; the order is `ROOMS` in
tests/test_imports.py. Start reading at `flight.Flight.run`.
"""
