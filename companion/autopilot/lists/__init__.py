"""Lists that the vehicle holds: its mission and its geofence, downloaded and converted to our own types.

`list_download.MissionDownload` fetches one list item by item, and `downloads.Downloads` fetches the two lists
one after the other. `mission.path_from_mission` makes a timed path from mission items, and
`fence.areas_from_items` makes fence areas; both refuse a list that they do not fully understand. The import
rules are those of `companion.autopilot` (`ROOMS` in tests/test_imports.py). Start reading at `downloads`,
then `mission`.
"""
