"""`ground-tools fly`: arm, take off, upload, start and land one or many vehicles, over MAVSDK.

`command` holds the options and runs the steps in order. `fleet.Fleet` carries out each step over all
vehicles, and leaves them in a safe state after a failure or Ctrl-C. `vehicle.Vehicle` is the connection to
one ArduPilot or PX4 vehicle, with its telemetry, commands and mission transfer. `missions` reads mission
files and turns a scenario's paths into missions. The tool never sends setpoints. Start reading with
`command`, then `fleet`.
"""
