"""What the companion asks the vehicle to fly: its flight mode, the speed of its mission, and its yaw.

`mode_and_speed.ModeAndSpeed` holds the mode and the speed that were asked for last.
`mode_request.ModeRequest` repeats a request until the vehicle reports the mode or refuses it, and gives up
when the pilot or a failsafe has acted. `yaw.Nose` computes the yaw of each setpoint. The import rules are
those of `companion.autopilot` (`ROOMS` in tests/test_imports.py). Start reading at `mode_and_speed`.
"""
