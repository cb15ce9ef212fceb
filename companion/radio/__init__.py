"""Radios that send and receive Remote ID: one interface, and a backend for each kind of hardware.

`radio.Radio` is the interface, and `radio.Health` is the state that a radio reports. The backends are the
subfolders `hci` (Bluetooth controller), `wifi` (Linux Wi-Fi card), `arduremoteid` (module with ArduRemoteID
firmware) and `ether` (simulated air), and `null.NullTransport` for flights without a radio.
`frames_io.FrameSender` and `FrameReceiver` convert messages to frames and back for all backends that handle
raw frames. A backend owns its sockets. This room may import the rooms before it in `ROOMS` of
tests/test_imports.py: `errors`, `toml_reader`, `geometry`, `remote_id`, `events`, `geofence`, `config`,
`avoidance`, `adjustable_parameters`, `autopilot` and `ownship`. Start reading at `radio.Radio`.
"""
