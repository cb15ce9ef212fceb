"""Differences between ArduPilot Copter and PX4 as data.

The mock vehicle reads these values instead of testing which firmware it imitates. `kinds.Manners` is
the type that describes one firmware's behaviour: modes, acknowledgements, setpoints, flight, mission protocol
and failsafes. `kinds.with_quirks` changes single fields. `behaviour.ARDUPILOT` and `behaviour.PX4` are the
two descriptions, and `param_tables.py` lists the parameters. Start reading with `kinds.py`;
docs/mock_vehicle.md gives the evidence.
"""
