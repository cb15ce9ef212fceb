"""What ground stations request from the companion: its parameters, what it is, and files over MAVLink FTP.

`requests.GroundStations` takes the requests that are addressed to us. `own_parameters.OwnParameters` answers
the parameter protocol, `component_information.ComponentInformation` answers requests for what we are, and
`ftp.FileServer` serves the constant files that `metadata` builds. The import rules are those of
`companion.autopilot` (`ROOMS` in tests/test_imports.py); these files also need `adjustable_parameters`. Start
reading at `requests`.
"""
