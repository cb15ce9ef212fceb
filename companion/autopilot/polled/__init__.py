"""What the companion requests from the vehicle by itself: telemetry, parameters and the vehicle's clock.

`polling.Polling` joins the three. `streams.Streams` requests telemetry messages and watches their rates,
`parameters.ParameterReader` reads the few parameters that the companion needs, and `timesync.TimeSync`
measures the offset of the vehicle's clock with TIMESYNC. The import rules are those of `companion.autopilot`
(`ROOMS` in tests/test_imports.py). Start reading at `polling`.
"""
