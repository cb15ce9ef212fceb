"""A module with ArduRemoteID firmware as a radio: it is fed over MAVLink and broadcasts by itself.

`module_radio.ArduRemoteIdTransport` implements `companion.radio.radio.Radio`: it sets the module's rates
before arming and feeds it messages in flight. `module_messages.Module` is the protocol: it reads what the
module sends over a `ByteLink` and requests parameters, without socket or clock. The import rules are those of
`companion.radio` (`ROOMS` in tests/test_imports.py); the driver needs `autopilot` for MAVLink frames, and
`errors`, `events` and `remote_id`. Start reading at `module_radio`.
"""
