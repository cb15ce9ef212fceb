"""The MAVLink link to the autopilot (ArduPilot or PX4): bytes in, events out; commands in, bytes out.

`link.AutopilotLink` is the whole link to one vehicle, a pure state machine that is passed the time. `wire`
cuts and builds MAVLink frames, `readers` turns payloads into events, `encoders` and `outbox.Outbox` build and
queue what is sent, `dialects` has one file for each firmware, and `dialect` what the firmwares share.
`heard_vehicle.HeardVehicle` knows which vehicle is ours; `signing` and `belief` decide which frames are
accepted on a link with a key. The subfolders hold what is requested from the vehicle (`polled`, `lists`,
`modes`) and what is answered to others (`served`). This room may import the rooms before it in `ROOMS` of
tests/test_imports.py. Start reading at `link`.
"""
