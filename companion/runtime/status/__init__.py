"""What a flight reports while it runs: console lines, troubles, live status, and the service manager.

`console.Voice` prints lines from a thread of its own. `troubles.Troubles` reports each kind of trouble once,
to the user and to the pilot. `status_socket.StatusServer` serves a `Status` as JSON on a local socket, which
`companion status` reads; `live_state` builds the part of it that comes from the core (`companion.core`).
`flight_report.FlightReport` builds the rest, and the status line and the summary.
`service_manager.Notifier` talks to systemd. Nothing here may block or end the flight. As part of
`companion.runtime` these files may import every room before it (`ROOMS` in tests/test_imports.py). Start
reading at `status_socket.Status`.
"""
