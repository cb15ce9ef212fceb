"""A mock MAVLink vehicle that behaves like ArduPilot Copter or PX4.

It replaces an autopilot in tests, simulated encounters and real-time runs. `mock_vehicle.MockVehicle` is the
main type: it takes bytes and the time, and returns bytes. `options.VehicleOptions` configures it, `motion`
flies it, and `telemetry.Telemetry` builds its messages. `firmware` describes how the two firmwares differ,
and `served` has the mission, fence, parameter and Remote ID protocols. `troubles.Troubles` lets the caller
cause failures. `real_time` runs a vehicle on UDP and TCP (`sitl-mocks serve`). Start reading with
`mock_vehicle.py`; docs/mock_vehicle.md compares the mock with the real firmwares.
"""
