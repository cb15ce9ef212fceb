"""`sitl-mocks takeover`: short cases with a fault around the moment when the pilot selects a mode.

`cases` flies them in virtual time, `real_cases` with real processes in real time, and `command` is the
command line.
"""
