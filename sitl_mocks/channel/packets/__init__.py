"""Packet-level simulation of the radio channel, the reference for the channel equations.

Every PDU, pointer, auxiliary packet and beacon has its channel and its time, and every receiver its scan
windows. `simulation.simulate` runs aircraft at fixed positions and rates and returns a `Result`, from which
`metrics` derives delay, age of information and loss. `timing.Assumptions` selects which effects of real
radios are simulated, `schedule` draws the sending times, and `reception.decide` decides which receiver gets
which packet. `access` models carrier sense of Wi-Fi stations, and `background` foreign transmissions.
`air_packets.PacketChannel` uses the same parts for the frames that companions really send. Start reading with
`simulation.py`.
"""
