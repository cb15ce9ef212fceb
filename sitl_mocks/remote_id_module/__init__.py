"""A mock of a Remote ID module with ArduRemoteID firmware (version 1.14).

It replaces the transmitter to which a companion sends its Remote ID data by MAVLink. `module.RemoteIdModule`
is the main type: MAVLink bytes in, bytes out, and `on_air` returns what a receiver can hear. `air.Air` models
the timing of the transmissions, and `data.py` converts the received messages for the encoder. `server.py`
runs a module in real time on UDP or a pseudo terminal (`sitl-mocks module`). Start reading with `module.py`.
"""
