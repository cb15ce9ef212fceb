"""Data that the mock vehicle stores and serves by MAVLink: missions, fences, parameters, Remote ID.

`mission.MissionBook` holds one list, a mission or a fence, and the protocol for its upload and download.
`mission_desk.MissionDesk` gives each mission message to the right list and imitates PX4's single transfer.
`params.ParamBook` holds the parameters and their two encodings. `remote_id.RemoteIdRelay` imitates
ArduPilot's handling of Remote ID data. Start reading with `mission.py`.
"""
