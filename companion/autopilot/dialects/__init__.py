"""The differences between autopilot firmwares, one file for each firmware, named like its `Firmware`.

`definition.Dialect` lists all that differs. `companion.autopilot.dialect` reads the files and holds
what the firmwares share.
"""
