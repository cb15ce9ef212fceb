"""The simulated air, which carries Remote ID frames between aircraft.

`ether.Ether` is the main type. It takes frames from senders, lets a channel from `sitl_mocks.channel` decide
about delay and loss at every receiver, and delivers the frames. `pair_statistics.PairStats` counts the frames
and the age of information for each pair of aircraft. `air_settings.AirSettings` is the [air] table of a
scenario and selects the channel. `server.py` runs the air as a process on a UDP socket (`sitl-mocks ether`).
Start reading with `ether.py`.
"""
