"""Our own Remote ID broadcast: what is sent, on which transports, how often, and whether it is on the air.

`broadcaster.Broadcaster` joins the parts: events in, commands out, with no socket or clock. `own_messages`
makes Remote ID messages from our own state and the operator's position, `legal_floor` adds the transports
that the region's law requires, `schedule.Schedule` decides when each message goes out, and
`monitor.SelfMonitor` watches whether our own frames are received. `signer.Signer` runs after the core and
signs what was sent. This room may import the rooms before it in `ROOMS` of tests/test_imports.py. Start
reading at `broadcaster`.
"""
