"""Radios that send and receive Remote ID: one interface, and a backend for each kind of hardware.

`radio.Radio` is the interface, and `radio.Health` is the state that a radio reports. `registry` lists the
kinds. Each has a folder: `hci` (Bluetooth controller), `wifi` (Linux Wi-Fi card), `arduremoteid` (module with
ArduRemoteID firmware), `ether` (simulated air), `plugin` (plug-ins) and `null` (no radio). The folder's
`section.py` declares its configuration and names its driver; these declarations and the registry are the room
`radio_sections`, which stands before `config`, so this package itself imports nothing.
`frames_io.FrameSender` and `FrameReceiver` convert messages to frames and back for all backends that handle
raw frames. A backend owns its sockets. This room may import the rooms before it in `ROOMS` of
tests/test_imports.py, up to `ownship`. Start reading at `radio.Radio`.
"""
