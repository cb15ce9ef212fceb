"""Stand-ins for the hardware: MAVLink vehicles, Remote ID modules, and the radio channel between aircraft.

`vehicle` is an autopilot that speaks MAVLink like ArduPilot Copter or PX4, and `remote_id_module` is a Remote
ID transmitter with ArduRemoteID firmware. `channel` models the radio channel, and `air` carries Remote ID
frames between aircraft according to it. `encounters` flies several vehicles with their companions, in virtual
time or as processes in real time. `examinations` drives vehicles and companions through long or faulty
flights and judges the result. The command `sitl-mocks` (`cli.py`) starts all of these. Start reading with
docs/simulation.md, then with `vehicle/mock_vehicle.py` and `air/ether.py`.
"""
