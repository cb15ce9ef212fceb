"""Flight software for a companion computer beside an ArduPilot or PX4 autopilot.

It broadcasts and receives Remote ID, keeps the vehicle clear of other aircraft, and returns it to its timed
path or its mission. Each module or package directly in this one is called a room. `tests/test_imports.py`
lists the rooms in `ROOMS`, and a room may import only rooms before it in that list; nothing here imports
`sitl_mocks` or `ground_tools`. Start with `core.Companion`, a pure state machine from events to commands
(types in `events`): it joins the own state (`ownship`), the tracks of others (`traffic`), the avoidance law
(`avoidance`), authority (`authority`) and our Remote ID (`broadcast`). `system.CompanionSystem` adds the
MAVLink link (`autopilot`) and the gate (`gate`), the last check of all bytes sent to the vehicle. `runtime`
runs that object in real time with its sockets and files, and `commands` holds the command line. Only
`runtime`, `commands` and the radio backends use clocks, sockets or threads.
"""

__version__ = "0.1.0"
